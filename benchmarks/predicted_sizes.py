"""How well the size of a term is predicted before it is refitted: `python -m benchmarks.predicted_sizes`.

Every flight of the frozen bench that is there (`make frozen`) is diagnosed. Of each term that is named, the size predicted from the model
without it (`diagnose.selection.proposals`) is divided by the size that its refit has. What is predicted below `SURELY` of the least size
with a name is not refitted: it must be less than the smallest of these ratios. Terms without a linear coefficient are tried
whatever their prediction where a fit is lacking, and are counted apart.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from benchmarks.frozen import reference, responses
from flighttest.diagnose import diagnose
from flighttest.diagnose.output_error import answer
from flighttest.diagnose.residuals.discrepancy import discrepancy_of
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, floor_of
from flighttest.diagnose.selection.candidates import candidates_at
from flighttest.diagnose.selection.proposals import SURELY, PredictedSizes
from flighttest.diagnose.selection.search import Search
from flighttest.diagnose.selection.subsets import Subsets
from flighttest.estimation.linearisation import Optimum
from flighttest.physics.model import Model


def ratio(search: Search, term: str) -> float:
    """Predicted over refitted size of a named term."""
    evidence, estimator = search.evidence[term], search.estimator
    without = evidence.without
    found = candidates_at(estimator, without.model, without.at, without.rows, [search.terms[term]])
    floor = floor_of(without.rows, estimator.segments, RESOLUTION)
    known = discrepancy_of(without.rows, without.residual(), estimator.segments, floor)
    subsets = Subsets.at(without.rows, without.names, found, known, floor)
    assert search.floor is not None
    sizes = PredictedSizes(without.rows, without.names, found, estimator.segments, search.floor)
    return float(sizes.least(subsets.ranked(1)).max(initial=0.0)) / evidence.floors


ENDED: list[Search] = []


class Kept(Search):
    """A search that is remembered when it has ended."""

    def run(self, model: Model, start: Optimum) -> None:
        super().run(model, start)
        ENDED.append(self)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.parse_args()
    home = os.environ.get("FLIGHTTEST_FROZEN") or Path.home() / ".cache" / "flighttest" / "frozen"
    answer.Search = Kept  # type: ignore[attr-defined]
    rows: dict[bool, list[tuple[float, float, str]]] = {True: [], False: []}
    flown = [k for k in reference() if (Path(home) / "flights" / k).exists()]
    for key in flown:
        ENDED.clear()
        diagnose(*responses(Path(home) / "flights" / key))
        for search in ENDED:
            for term, evidence in search.evidence.items():
                linear = bool(search.terms[term].amplitudes)
                rows[linear].append((ratio(search, term), evidence.floors, f"{term} of {key}"))
    print(f"{len(flown)} flights; not refitted below {SURELY:g}\n")
    print("| named terms | number | smallest ratio | 10 % | median | 90 % | largest |\n|---|---|---|---|---|---|---|")
    for linear, some in rows.items():
        quantiles = np.quantile([r for r, _, _ in some], [0.0, 0.1, 0.5, 0.9, 1.0]) if some else np.full(5, np.nan)
        what = "with" if linear else "without"
        print(f"| {what} a linear coefficient | {len(some)} | {' | '.join(f'{q:.2f}' for q in quantiles)} |")
    print("\nsmallest:")
    for r, floors, what in sorted(rows[True])[:8]:
        print(f"- {r:.2f}: {what}, {floors:.1f} noise floors")


if __name__ == "__main__":
    main()
