"""What the parts of the autopilot read of the vehicle, and what they may do to it: `copter.Autopilot` is one such vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from flighttest.sim.autopilot.control import Measured, PositionControl
from flighttest.sim.autopilot.guided import AngleControl
from flighttest.sim.autopilot.navigation import Navigator
from flighttest.sim.autopilot.parameters import ParameterStore
from flighttest.sim.autopilot.safety import Boot
from flighttest.sim.plants.plant import Command, Motion, Plant
from flighttest.sim.sensors import Sensors
from flighttest.sim.wire import Encoder


@dataclass(slots=True)
class Target:
    """The attitude target as the controllers have it now, NWU: rad, rad/s, and the throttle asked for before any boost."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    yaw_rate: float = 0.0
    throttle: float = 0.0


class TelemetrySource(Protocol):
    """What telemetry reads of the autopilot."""

    encoder: Encoder
    motion: Motion
    sensors: Sensors
    store: ParameterStore
    command: Command
    target: Target
    mode: int
    armed: bool
    landed: bool
    capacity_ah: float
    fence_breach: int

    @property
    def charge_used_ah(self) -> float:
        """Charge drawn since the battery was last declared full, A h."""

    @property
    def time_s(self) -> float:
        """Vehicle time, s since boot."""

    @property
    def has_position(self) -> bool:
        """Whether the estimator uses GPS."""

    @property
    def has_home(self) -> bool:
        """Whether home and the estimator's origin are set."""

    @property
    def armable(self) -> bool:
        """Whether the arming checks pass."""

    @property
    def taking_off(self) -> bool:
        """Whether it climbs to its take-off height."""


class Streaming(Protocol):
    """Messages sent at intervals of their own: `telemetry.Streams`."""

    def interval_s(self, message_id: int) -> float:
        """The interval of a message, s; 0 when it is not sent."""

    def set(self, message_id: int, interval_s: float, t_s: float) -> None:
        """Send a message every interval_s, s, from t_s on; 0 or less stops it."""


class FenceArea(Protocol):
    """A polygon or circle of the fence: `fences.breach.Area`."""

    @property
    def inclusion(self) -> bool:
        """Whether it must not be left, instead of not be entered."""

    def holds(self, px: float, py: float) -> bool:
        """Whether a place lies in it, NWU about home, m."""


class KeepsFence(Protocol):
    """The fence aboard and its transfer: `fences.upload.FenceUpload`. Each takes a message of the mission protocol."""

    @property
    def areas(self) -> Sequence[FenceArea]:
        """What its items make."""

    def count(self, m: Any) -> None:
        """A station begins to write."""

    def item(self, m: Any) -> None:
        """One item of it."""

    def clear(self, m: Any) -> None:
        """The fence is removed."""

    def listed(self, m: Any) -> None:
        """How many items there are."""

    def wanted(self, m: Any) -> None:
        """One of them is read."""

    @property
    def in_force(self) -> int:
        """FENCE_TYPE bits that are checked."""

    def switch(self, on: bool, kinds: int) -> None:
        """Kinds of fence, bits of FENCE_TYPE, are switched on or off."""

    def look(self, t_s: float) -> None:
        """What does not come is asked for again, at vehicle time t_s, s."""


class CommandedVehicle(TelemetrySource, Protocol):
    """What commands, targets and the slow duties read of the vehicle, and do to it. outbox: frames to be sent, in order."""

    plant: Plant
    boot: Boot
    angle: AngleControl
    control: PositionControl
    navigator: Navigator
    outbox: list[bytes]
    landed_s: float
    disarmed_s: float

    @property
    def fence(self) -> KeepsFence:
        """The fence aboard."""

    @property
    def streams(self) -> Streaming:
        """What is sent at which interval."""

    @property
    def lifting(self) -> bool:
        """Whether the motors have spun up since arming."""

    @property
    def thrust_is_thrust(self) -> bool:
        """GUID_OPTIONS bit 3: the thrust field is a throttle, not a climb rate."""

    def measured(self) -> Measured:
        """What the controllers see now."""

    def set_mode(self, mode: int) -> bool:
        """Change mode; False, with the reason as STATUSTEXT, where it is refused."""

    def arm(self, *, force: bool = False) -> bool:
        """Arm the motors; False, with the reason as STATUSTEXT, where it is refused."""

    def disarm(self, *, force: bool = False) -> bool:
        """Disarm the motors; False in the air unless forced."""

    def arming_refusal(self) -> str | None:
        """Why it would not arm now, in the firmware's words; None when it would."""

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V."""

    def say(self, text: str, severity: int = ...) -> None:
        """STATUSTEXT, in chunks where it is long."""
