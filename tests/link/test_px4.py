"""The PX4 edge: degrees, signs and order, against stand-ins for MAVSDK's plugins that refuse as it does."""

import math
from typing import Any

import numpy as np
import pytest
from mavsdk.plugins.action import ActionError, ActionResult
from mavsdk.plugins.offboard import OffboardError, OffboardResult

from flighttest.errors import LinkError
from flighttest.link.px4 import Px4


class Offboard:
    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []
        self.refuse = False

    def set_attitude(self, attitude: Any) -> None:
        self.calls.append(("attitude", attitude))

    def set_position_ned(self, position: Any) -> None:
        self.calls.append(("position", position))

    def start(self) -> None:
        if self.refuse:
            raise OffboardError(OffboardResult.COMMAND_DENIED, "start()")
        self.calls.append(("start", None))

    def stop(self) -> None:
        self.calls.append(("stop", None))


class Action:
    def arm(self) -> None:
        raise ActionError(ActionResult.COMMAND_DENIED, "arm()")


def test_degrees_and_signs() -> None:
    offboard = Offboard()
    px4 = Px4(offboard, Action())
    px4.steer(0.2, 0.3, math.pi / 2, 0.5)
    px4.go_to(np.array([1.0, 2.0, 3.0]), math.pi / 2)
    attitude, position = offboard.calls[0][1], offboard.calls[1][1]
    found = (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg, attitude.thrust_value)
    assert found == pytest.approx((11.4592, -17.1887, -90.0, 0.5), abs=1e-3)
    assert (position.north_m, position.east_m, position.down_m, position.yaw_deg) == pytest.approx(
        (1.0, -2.0, -3.0, -90.0)
    )


def test_offboard_begins_only_after_a_target() -> None:
    offboard = Offboard()
    px4 = Px4(offboard, Action())
    with pytest.raises(LinkError, match="before a target"):
        px4.begin()
    px4.steer(0.0, 0.0, 0.0, 0.4)
    px4.begin()
    px4.end()
    assert [name for name, _ in offboard.calls] == ["attitude", "start", "stop"]
    with pytest.raises(LinkError, match="before a target"):
        px4.begin()


def test_a_refusal_is_an_error_that_says_what() -> None:
    offboard = Offboard()
    offboard.refuse = True
    px4 = Px4(offboard, Action())
    px4.steer(0.0, 0.0, 0.0, 0.4)
    with pytest.raises(LinkError, match="PX4 refused offboard"):
        px4.begin()
    with pytest.raises(LinkError, match="PX4 refused arming"):
        px4.arm()
