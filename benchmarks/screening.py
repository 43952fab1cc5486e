"""How often score tests of free flight find a term where nothing is missing: python -m benchmarks.screening [FLIGHTS] [SECONDS]

Simulated position loops in gusts (tests/identify/test_free_flight.py), flown by the model itself. Terms with several settings, of which the
best is kept, are left out.
"""

from __future__ import annotations

import sys

import numpy as np

from flighttest.diagnose.free_flight.equation_screen import screen
from flighttest.identify.free_flight import estimate, stretches
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from tests.identify.test_free_flight import NAMES, flight

LEVELS = (0.05, 0.01, 0.001, 0.0002)
FIRST_SEED = 100


def main(flights: int, seconds: float) -> None:
    """Print the share of tests below each level."""
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + flights):
        flown = stretches(flight(seconds, seed))
        base = estimate(flown, Model(attitude_loops=False), free=NAMES, start={"sigma_t": 18.0, "T_d_thrust": 0.06})
        found += [s.p_value for s in screen(flown, base, tuple(catalogue().values())) if not s.shape]
    print(f"{len(found)} tests of {flights} flights of {seconds:g} s in which nothing is missing")
    for level in LEVELS:
        print(f"  p below {level:g}: {np.mean(np.array(found) < level):.2%}")


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 40, float(given[1]) if len(given) > 1 else 60.0)
