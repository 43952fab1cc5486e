"""Time of estimating and screening free flight by equation error against its length: python -m benchmarks.free_flight [SECONDS...]

A simulated position loop in gusts (tests/identify/test_free_flight.py), 50 Hz after alignment; processor time of one core.
"""

from __future__ import annotations

import sys
import time

from flighttest.diagnose.free_flight.equation_screen import screen
from flighttest.identify.free_flight import estimate, stretches
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from tests.identify.test_free_flight import flight


def main(lengths: list[float]) -> None:
    print(f"{'flight, s':>10}{'estimate, s':>13}{'screen, s':>11}{'terms':>7}   K ± std")
    for seconds in lengths:
        segments = flight(seconds, 1)
        begun = time.process_time()
        flown = stretches(segments)
        found = estimate(flown, Model(attitude_loops=False))
        middle = time.process_time()
        tested = screen(flown, found, tuple(catalogue().values()))
        end = time.process_time()
        reported = f"{found.values['K']:.2f} ± {found.std['K']:.2f}"
        print(f"{seconds:10.0f}{middle - begun:13.2f}{end - middle:11.2f}{len(tested):7d}   {reported}", flush=True)


if __name__ == "__main__":
    main([float(a) for a in sys.argv[1:]] or [100.0, 300.0, 1000.0])
