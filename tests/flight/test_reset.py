"""What counts as settled at the start of a leg."""

from dataclasses import replace

import pytest

from flighttest.flight.execution.reset import LegStart, Settling
from flighttest.flight.state import VehicleState
from flighttest.frames import G_M_S2

START = LegStart((0.0, 0.0, 5.0), 0.0, settle_s=1.0)
STILL = VehicleState(
    10.0, attitude_rad=(0.0, 0.0, 0.0), velocity_m_s=(0.0, 0.0, 0.0), position_m=(0.1, 0.0, 5.0), height_m=5.0,
    climb_m_s=0.0, position_ok=True,
)  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "settled"),
    [
        ({}, True),
        ({"attitude_rad": (0.17, 0.1, 0.0)}, True),  # leans into 5 m/s of wind and does not move
        ({"attitude_rad": (0.4, 0.0, 0.0)}, False),
        ({"attitude_rad": (0.17, 0.1, 0.0), "position_ok": False}, False),  # the tilt may be an error of the filter
        ({"attitude_rad": (0.1, 0.0, 0.0), "position_ok": False}, True),
        ({"velocity_m_s": (0.5, 0.0, 0.0)}, False),
        ({"position_m": (1.0, 0.0, 5.0)}, False),
        ({"attitude_rad": (0.0, 0.0, 0.3)}, False),
        ({"silence_s": 1.0}, False),
    ],
)
def test_settled_is_near_slow_and_facing_right(changed, settled):
    state = replace(STILL, **changed)
    settling = Settling(START)
    assert not settling.done(state, 0.3)
    assert settling.done(replace(state, t_s=state.t_s + 1.0), 0.3) is settled
    assert settling.hover_throttle == (0.3 if settled else None)


def test_a_climb_that_is_still_being_braked_does_not_spoil_the_hover_throttle() -> None:
    """At 2.5 % more than what hovers a vehicle gains a quarter of a metre per second in a second."""
    settling = Settling(START)
    for k in range(51):
        settling.done(replace(STILL, t_s=10.0 + 0.02 * k, climb_m_s=-0.2 + 0.02 * k * 0.025 * G_M_S2), 0.205)
    assert settling.hover_throttle == pytest.approx(0.2, rel=1e-3)
