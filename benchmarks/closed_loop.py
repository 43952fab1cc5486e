"""Do intervals hold the truth where a controller answers gusts? `python -m benchmarks.closed_loop [--seeds 10] [--first 11]`.

Two known vehicles of the tests, under a height loop and under a position loop, calm and in gusts of 0.1, 0.25 and 0.5 m/s^2, 60 s each:
shares of the 95 % intervals that hold the truth, with the closed-loop bias counted as often as each column says.
"""

from __future__ import annotations

import argparse

import numpy as np

from flighttest.estimation.uncertainty.closed_loop import ALLOWED, closed_loop_bias
from flighttest.estimation.uncertainty.covariance import covariance_of, interval_factor
from flighttest.identify.fit import fit
from flighttest.physics.model import Model
from tests.identify.test_free_flight import TRUTH, flight
from tests.identify.test_optima import climbed

LEVEL = {"K": 54.55, "sigma_t": 20.36, "d_z": 0.51, "T_d_thrust": 0.1}
TIMES = (0.0, 1.0, 2.0, 3.0, 4.0)
GUSTS = (0.0, 0.1, 0.25, 0.5)


def held(seed: int, gust: float) -> list[tuple[str, list[bool]]]:
    """Of every parameter of both vehicles: which, and whether the interval holds it for each of `TIMES`."""
    found = []
    for loop, segments, truth in (
        ("position loop", flight(60.0, seed, gust=gust), TRUTH),
        ("height loop", climbed(gust, seed), LEVEL),
    ):
        made = fit(segments, Model(attitude_loops=False))
        known, bias = covariance_of(made.problem, made.solution), closed_loop_bias(made.problem, made.solution)
        for i, name in enumerate(known.names):
            error = abs(made.solution.values[name] - truth[name]) / interval_factor(known.dof[i])
            variance, moved = known.whole[i, i], bias[name] / ALLOWED
            found.append((loop, [bool(error <= np.hypot(np.sqrt(variance), k * moved)) for k in TIMES]))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=11)
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.seeds)
    print(f"{'loop':<16}{'gusts, m/s^2':>14}{'parameters':>12}" + "".join(f"{f'x {k:g}':>8}" for k in TIMES))
    for gust in GUSTS:
        rows = [row for seed in seeds for row in held(seed, gust)]
        for loop in ("height loop", "position loop"):
            mine = np.array([one for which, one in rows if which == loop])
            shares = "".join(f"{s:8.2f}" for s in mine.mean(axis=0))
            print(f"{loop:<16}{gust:14g}{len(mine):12d}{shares}", flush=True)


if __name__ == "__main__":
    main()
