"""How often 95 % intervals hold what was hidden: `python -m benchmarks.intervals`.

Every flight of the frozen bench that is there (`make frozen`) is fitted with the very terms that it conceals, and the estimates of their
parameters, and of those of the base model that the vehicle has, are held against the values the flight was made with. One row for each
limit of what the equations may err (`estimation.uncertainty.discrepancy.SHARE`; 0: scatter between cells alone), which is how that limit
was chosen. Ratio: error over half the interval, median, 0.34 where intervals are neither too narrow nor too wide.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.frozen import reference, responses
from flighttest.estimation.uncertainty import discrepancy
from flighttest.estimation.uncertainty.covariance import covariance_of, interval_factor
from flighttest.identify.fit import Fit, fit
from flighttest.physics.catalogue import catalogue
from flighttest.proof.cases import Case
from flighttest.proof.outcome import BASE, shared_truth

SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)
USED = discrepancy.SHARE


def concealed(case: Case) -> dict[str, float]:
    """Parameter to value of the effects that are terms of the catalogue under the same names."""
    terms = catalogue()
    own = {t: {p.name for p in terms[t].params} for t in case.hide if t in terms}
    return {n: v for t, names in own.items() for n, v in case.hide[t].items() if n in names}


def ratios(found: Fit, truth: dict[str, float]) -> dict[str, dict[float, float]]:
    """Parameter to share to error over half the 95 % interval."""
    made: dict[str, dict[float, float]] = {}
    for share in SHARES:
        discrepancy.SHARE = share
        known = covariance_of(found.problem, found.solution)
        for name in set(truth) & set(known.names):
            std, dof = known.of(np.eye(len(known.names))[known.names.index(name)])
            made.setdefault(name, {})[share] = abs(found.values[name] - truth[name]) / (interval_factor(dof) * std)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    home = os.environ.get("FLIGHTTEST_FROZEN") or Path.home() / ".cache" / "flighttest" / "frozen"
    parser.parse_args()
    flights = Path(home) / "flights"
    of: dict[str, list[dict[float, float]]] = {"effects": [], "base": []}
    outside, fitted = Counter[str](), 0
    for key, (case, _, _) in reference().items():
        if not set(case.hide) <= set(catalogue()) or not (flights / key).exists():
            continue
        truth = {"effects": concealed(case), "base": shared_truth(replace(case, hide={}))[BASE]}
        segments, model = responses(flights / key)
        found = fit(segments, model.with_terms(*case.hide), select="all", robust=False)
        fitted += 1
        for kind, values in truth.items():
            for name, by_share in ratios(found, values).items():
                of[kind].append(by_share)
                outside[name] += by_share[USED] > 1.0
    print(f"{fitted} flights\n\n| limit | parameters of | number | inside | ratio |\n|---|---|---|---|---|")
    for share in SHARES:
        for kind, rows in of.items():
            found_ratios = np.array([row[share] for row in rows])
            inside = f"{int((found_ratios <= 1.0).sum())}, {100 * (found_ratios <= 1.0).mean():.0f} %"
            print(f"| {share:g} | {kind} | {len(rows)} | {inside} | {np.median(found_ratios):.2f} |")
    print(f"\noutside at {USED:g}: {dict(+outside)}")


if __name__ == "__main__":
    main()
