"""How often 95 % intervals hold what was hidden: `python -m benchmarks.intervals`.

Every flight of the frozen bench that is there (`make frozen`) is fitted with the very terms that it conceals, and the estimates of their
parameters are held against the values the flight was made with. One row for each limit of what the equations may err
(`estimation.uncertainty.discrepancy.SHARE`; 0: scatter between cells alone), which is how that limit was chosen.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.frozen import reference, responses
from flighttest.estimation.uncertainty import discrepancy
from flighttest.estimation.uncertainty.covariance import covariance_of, interval_factor
from flighttest.identify.fit import Fit, fit
from flighttest.physics.catalogue import catalogue
from flighttest.proof.cases import Case

SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)


def concealed(case: Case) -> dict[str, float]:
    """Parameter to value of the effects that are terms of the catalogue under the same names."""
    terms = catalogue()
    own = {t: {p.name for p in terms[t].params} for t in case.hide if t in terms}
    return {n: v for t, names in own.items() for n, v in case.hide[t].items() if n in names}


def held(found: Fit, truth: dict[str, float]) -> dict[str, dict[float, bool]]:
    """Parameter to share to whether its interval holds the truth."""
    made: dict[str, dict[float, bool]] = {}
    for share in SHARES:
        discrepancy.SHARE = share
        known = covariance_of(found.problem, found.solution)
        for name in set(truth) & set(known.names):
            std, dof = known.of(np.eye(len(known.names))[known.names.index(name)])
            off = abs(found.values[name] - truth[name])
            made.setdefault(name, {})[share] = bool(off <= interval_factor(dof) * std)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    home = os.environ.get("FLIGHTTEST_FROZEN") or Path.home() / ".cache" / "flighttest" / "frozen"
    parser.parse_args()
    flights = Path(home) / "flights"
    count, inside, outside = 0, Counter[float](), Counter[str]()
    fitted = 0
    for key, (case, _, _) in reference().items():
        truth = concealed(case)
        if not truth or not (flights / key).exists():
            continue
        segments, model = responses(flights / key)
        model = model.with_terms(*(t for t in case.hide if t in catalogue()))
        fitted += 1
        for name, by_share in held(fit(segments, model, select="all", robust=False), truth).items():
            count += 1
            inside.update(share for share, good in by_share.items() if good)
            if not by_share[0.05]:
                outside[name] += 1
    print(f"{count} parameters of {fitted} flights\n\n| limit | inside |\n|---|---|")
    for share in SHARES:
        print(f"| {share:g} | {inside[share]} of {count}, {100 * inside[share] / max(count, 1):.0f} % |")
    print(f"\noutside at 0.05: {dict(outside)}")


if __name__ == "__main__":
    main()
