"""PX4 through MAVSDK: arming, positions and attitude targets in its offboard mode. What passes here has passed the gate already.

PX4 needs setpoints at more than 2 Hz before it lets offboard begin, and leaves it when they stop. MAVSDK's attitude setpoint
carries no yaw rate: a turn is flown by the heading of each target. Flown against a double of PX4's protocol only, never PX4 itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flighttest import frames
from flighttest.errors import InputError, LinkError
from flighttest.link.transport import URL_FORMS, full_url

CONNECT_S = 10.0
_SCHEMES = {
    "udpin": "udpin",
    "udp": "udpin",
    "udpout": "udpout",
    "tcp": "tcpout",
    "tcpout": "tcpout",
    "serial": "serial",
}


def mavsdk_url(url: str) -> str:
    """MAVSDK's form of one of our URLs. InputError for anything else."""
    kind, _, rest = full_url(url).partition(":")
    where, _, last = rest.rpartition(":")
    known = kind in _SCHEMES and bool(where) and last.isdecimal()
    if not known or (kind != "serial" and not 0 < int(last) < 65536):
        raise InputError(f"{url!r} is not a link", f"use {URL_FORMS}")
    return f"{_SCHEMES[kind]}://{rest}"


class Px4:
    """One PX4 vehicle. `offboard` and `action` are MAVSDK's plugins, or fakes of them."""

    def __init__(self, offboard: Any, action: Any, on_close: Callable[[], None] = lambda: None) -> None:
        self._offboard = offboard
        self._action = action
        self._on_close = on_close
        self._streaming = False

    @classmethod
    def connect(cls, url: str, timeout_s: float = CONNECT_S) -> Px4:
        """Open a link (our URL forms). LinkError when no autopilot answers within timeout_s."""
        from mavsdk import ComponentType, Configuration, Mavsdk  # only here: the library takes its time to load
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.offboard import Offboard

        sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
        sdk.add_any_connection(mavsdk_url(url))
        system = sdk.first_autopilot(timeout_s)
        if system is None:
            sdk.destroy()
            raise LinkError(f"nothing answers at {url}", "is the vehicle on, and the address right?")
        return cls(Offboard(system), Action(system), sdk.destroy)

    def steer(self, roll_rad: float, pitch_rad: float, yaw_rad: float, throttle: float) -> None:
        """Send one attitude target (NWU/FLU). LinkError where MAVSDK cannot take it."""
        from mavsdk.plugins.offboard import Attitude

        roll, pitch, yaw = (math.degrees(v) for v in frames.flip_euler([roll_rad, pitch_rad, yaw_rad]))
        self._do("attitude target", self._offboard.set_attitude, Attitude(roll, pitch, yaw, throttle))
        self._streaming = True

    def go_to(self, position_m: np.ndarray, yaw_rad: float) -> None:
        """Ask for a position (local NWU, m) and heading (NWU, rad)."""
        from mavsdk.plugins.offboard import PositionNedYaw

        north, east, down = (float(v) for v in frames.flip_vector(position_m))
        yaw = math.degrees(float(frames.flip_euler([0.0, 0.0, yaw_rad])[2]))
        self._do("position target", self._offboard.set_position_ned, PositionNedYaw(north, east, down, yaw))
        self._streaming = True

    def begin(self) -> None:
        """Enter offboard. LinkError before the first target (PX4 would refuse without a word), or where it is refused."""
        if not self._streaming:
            raise LinkError("offboard cannot begin before a target is sent", "send hover targets first")
        self._do("offboard", self._offboard.start)

    def end(self) -> None:
        """Leave offboard; PX4 holds."""
        self._do("leaving offboard", self._offboard.stop)
        self._streaming = False

    def arm(self) -> None:
        """Arm. LinkError with PX4's reason."""
        self._do("arming", self._action.arm)

    def take_off(self, height_m: float) -> None:
        """Take off to a height above the ground."""
        self._do("take-off height", self._action.set_takeoff_altitude, height_m)
        self._do("take-off", self._action.takeoff)

    def hold(self) -> None:
        """Brake and hold position: the abort mode."""
        self._do("hold", self._action.hold)

    def land(self) -> None:
        """Land where it is."""
        self._do("landing", self._action.land)

    def close(self) -> None:
        """Close the link."""
        self._on_close()

    @staticmethod
    def _do(what: str, call: Callable[..., Any], *arguments: Any) -> None:
        from mavsdk.plugins.action import ActionError
        from mavsdk.plugins.offboard import OffboardError

        try:
            call(*arguments)
        except (ActionError, OffboardError) as error:
            raise LinkError(f"PX4 refused {what} ({error})", "see its messages in the ground station") from error
