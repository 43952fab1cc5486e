"""An offboard attitude flight by the real MAVSDK against a vehicle that answers as PX4 does: no PX4 itself was flown."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import pytest

from flighttest.errors import LinkError
from flighttest.link.px4 import Px4
from tests.link.px4_double import LAND, LOITER, LOSS_S, OFFBOARD, POSITION, TAKE_OFF, Px4Double

HOVER = 0.4


def wait(until: Callable[[], bool], patience_s: float = 5.0) -> None:
    deadline = time.monotonic() + patience_s
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def stream(px4: Px4, roll_rad: float, for_s: float) -> None:
    deadline = time.monotonic() + for_s
    while time.monotonic() < deadline:
        px4.steer(roll_rad, 0.0, math.pi / 2, HOVER)
        time.sleep(0.02)


@pytest.mark.slow
def test_a_roll_step_is_flown_offboard_and_the_vehicle_lands() -> None:
    with Px4Double() as vehicle:
        px4 = Px4.connect(vehicle.url)
        try:
            px4.arm()
            px4.take_off(4.0)
            wait(lambda: vehicle.mode == LOITER and vehicle.height_m >= 4.0)
            stream(px4, 0.0, 0.2)
            px4.begin()
            assert vehicle.mode == OFFBOARD
            stream(px4, 0.3, 0.5)
            px4.hold()
            assert vehicle.mode == LOITER
            px4.land()
            wait(lambda: not vehicle.armed)
        finally:
            px4.close()
    rolls = [roll for _, roll, *_ in vehicle.targets]
    assert vehicle.modes[:1] == [TAKE_OFF]
    assert vehicle.modes[-1] == LAND
    assert max(rolls) == pytest.approx(0.3, abs=1e-3)
    assert min(rolls) == pytest.approx(0.0, abs=1e-3)
    assert all(yaw == pytest.approx(-math.pi / 2, abs=1e-3) for *_, yaw, _, _ in vehicle.targets)
    assert {round(thrust, 3) for *_, thrust, _ in vehicle.targets} == {HOVER}


def test_arming_that_px4_refuses_is_an_error() -> None:
    with Px4Double(why_not="No GPS") as vehicle:
        px4 = Px4.connect(vehicle.url)
        try:
            with pytest.raises(LinkError, match="PX4 refused arming"):
                px4.arm()
        finally:
            px4.close()
    assert not vehicle.armed


@pytest.mark.slow
def test_offboard_ends_by_the_vehicle_when_targets_stop() -> None:
    """MAVSDK repeats the last target by itself until it is stopped: PX4 notices only a client that was killed."""
    with Px4Double(armed=True, height_m=3.0) as vehicle:
        px4 = Px4.connect(vehicle.url)
        stream(px4, 0.0, 0.2)
        px4.begin()
        assert vehicle.mode == OFFBOARD
        px4.close()
        wait(lambda: vehicle.mode == POSITION, LOSS_S + 3.0)


def test_a_pilot_who_takes_over_keeps_the_vehicle_while_targets_still_come() -> None:
    with Px4Double(armed=True, height_m=3.0) as vehicle:
        px4 = Px4.connect(vehicle.url)
        try:
            stream(px4, 0.0, 0.2)
            px4.begin()
            vehicle.pilot()
            stream(px4, 0.3, 0.5)
        finally:
            px4.close()
    assert vehicle.modes == [OFFBOARD, POSITION]
