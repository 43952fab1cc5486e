"""The built-in vehicle and everything that flies it, beside the processor time they take: 20 times real time on two cores and more."""

import time
from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome
from flighttest.proof.flying import InProcessTransport
from flighttest.sim import InProcess, SimOptions
from tests.flight.faulty import fly, make_leg, make_plan, options


@pytest.mark.parametrize("airframe", ["paper", "rotor"])
def test_the_vehicle_alone_leaves_time_for_others(airframe: str) -> None:
    vehicle = InProcess(SimOptions(airframe=airframe))
    began = time.process_time()
    vehicle.advance(30.0)
    assert 30.0 / (time.process_time() - began) > 60.0  # 270 to 310 where little else runs


def test_a_flight_with_both_ends_in_one_process(run_dir: Path) -> None:
    link = InProcessTransport(options())
    began = time.process_time()
    result = fly(make_plan(*(make_leg(name) for name in "ab")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    # Both ends on one core; 40 where little else runs and the flight is long.
    assert link.io.time_s / (time.process_time() - began) > 6.0
