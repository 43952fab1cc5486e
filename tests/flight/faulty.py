"""A vehicle in this process behind a link that can fail as a real one does, and small plans to fly on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from flighttest import flight
from flighttest.flight import FlightResult, FlightSettings
from flighttest.flight.gate import GateLimits, stop_throttles
from flighttest.flight.state import VehicleState
from flighttest.link.clock import Clock
from flighttest.mavlink.dialect import dialect, parser
from flighttest.plan import AttitudeTarget, Leg, Phase, Plan
from flighttest.script.model import Limits, Repeat, Reset, Script
from flighttest.sim import InProcess, SimOptions
from flighttest.vehicle.model import DEFAULT_VEHICLE, Zone

LIMITS = Limits(
    tilt_target_max_rad=0.61,
    tilt_abort_rad=0.87,
    throttle=(0.0, 0.6),
    height_m=(2.0, 10.0),
    speed_max_m_s=8.0,
    voltage_min_v=21.0,
)


def fly(
    plan: Plan,
    url: str,
    run_dir: Path,
    *,
    transport: object | None = None,
    clock: Clock | None = None,
    **options: object,
) -> FlightResult:
    """`flighttest.flight.fly` with its options by name."""
    return flight.fly(plan, url, run_dir, FlightSettings(**options), transport=transport, clock=clock)  # type: ignore[arg-type]


@dataclass
class FaultyLink:
    """The built-in vehicle behind a link. down: frames of neither direction pass, except the clock's (lock-step needs them).

    sent: message names in order, with the vehicle's time; hook: called with each message before it is handed over. deaf: the
    vehicle receives nothing, but its messages arrive; mute: the other way round; silenced: messages of the vehicle that do not arrive.
    """

    options: SimOptions
    down: Callable[[float], bool] = lambda _t: False
    hook: Callable[[object, float], None] | None = None
    deaf: Callable[[float], bool] = lambda _t: False
    mute: Callable[[float], bool] = lambda _t: False
    silenced: Callable[[str, float], bool] | None = None
    sent: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.sim = InProcess(self.options)
        self._ours, self._theirs, self._pilot = parser(1, 1), parser(1, 1), parser(255, 190)
        self._aside = b""

    def send(self, data: bytes) -> None:
        now = self.sim.time_s
        for message in self._ours.parse_buffer(data) or []:
            kind = message.get_type()
            if kind != "SYSTEM_TIME":
                self.sent.append((now, kind))
                if self.hook is not None:
                    self.hook(message, now)
                if self.down(now) or self.deaf(now):
                    continue
            self.sim.send(bytes(message.get_msgbuf()))

    def receive(self, _timeout_s: float) -> bytes:
        data, self._aside = self._aside + self.sim.receive(), b""
        now = self.sim.time_s
        lost = self.down(now) or self.mute(now)
        if not data or not (lost or self.silenced):
            return data
        silenced = self.silenced or (lambda _kind, _t: False)
        messages = self._theirs.parse_buffer(data) or []
        return b"".join(
            bytes(m.get_msgbuf())
            for m in messages
            if m.get_type() == "SYSTEM_TIME" or not (lost or silenced(m.get_type(), now))
        )

    def close(self) -> None:
        pass

    def say(self, component: int, *messages: object) -> None:
        """As a gimbal, a companion computer or an ADS-B receiver aboard would: from the vehicle's system id."""
        sender = parser(1, component)
        self._aside += b"".join(bytes(m.pack(sender)) for m in messages)  # type: ignore[attr-defined]

    def set_parameter(self, name: str, value: float) -> None:
        """As the pilot's transmitter, or another ground station, would."""
        message = dialect.MAVLink_param_set_message(1, 1, name.encode(), value, dialect.MAV_PARAM_TYPE_REAL32)
        self.sim.send(bytes(message.pack(self._pilot)))


LANDS_M_S = 1.5  # 0.5 by default: a third of the processor time of a short flight would be its landing


def options(parameters: Mapping[str, float] | None = None, **changes: object) -> SimOptions:
    set_to = {"LAND_SPD_MS": LANDS_M_S, **(parameters or {})}
    return SimOptions(lockstep=True, ready_s=1.0, gps_s=2.0, parameters=set_to, **changes)  # type: ignore[arg-type]


def make_leg(
    name: str = "roll+0.30",
    profile: Callable[[float], AttitudeTarget] | None = None,
    duration_s: float = 1.5,
    kind: str = "roll_step",
) -> Leg:
    def roll(t_s: float) -> AttitudeTarget:
        return AttitudeTarget(t_s, 0.3 if 0.3 <= t_s < 0.8 else -0.3 if 0.8 <= t_s < 1.3 else 0.0, 0.0, 0.0, 0.17)

    phases = (
        Phase("entry", 0.0, 0.3, False),
        Phase("step", 0.3, 0.8, True),
        Phase("coast", 0.8, duration_s, False),
    )
    return Leg(
        f"test/{name}/r1",
        "test",
        kind,
        {"amplitude_rad": 0.3},
        1,
        (0.0, 0.0, 5.0),
        0.0,
        duration_s,
        0.3,
        phases,
        profile or roll,
    )


def make_plan(*legs: Leg, by: str = "guided", limits: Limits = LIMITS) -> Plan:
    reset = Reset((0.0, 0.0, 5.0), (0.0,), by, 0.5)  # type: ignore[arg-type]
    script = Script(
        "test", "", (), "GUIDED_NOGPS", 50.0, "absolute", limits, reset, (), Repeat(), "format: maneuver/1\n", "0" * 64
    )
    return Plan(script, DEFAULT_VEHICLE, legs or (make_leg(),), limits, reset, 50.0)


GATE = GateLimits(LIMITS, Zone(), 0.18, stop_throttles(LIMITS, 0.18))
GOOD = VehicleState(
    t_s=100.0,
    mode=20,
    armed=True,
    mode_age_s=0.05,
    attitude_rad=(0.0, 0.0, 0.3),
    attitude_age_s=0.01,
    velocity_m_s=(0.0, 0.0, 0.0),
    position_m=(0.0, 0.0, 5.0),
    position_age_s=0.02,
    height_m=5.0,
    climb_m_s=0.0,
    voltage_v=24.0,
    ekf_ok=True,
    position_ok=True,
    silence_s=0.01,
)
HOVER = AttitudeTarget(0.0, 0.0, 0.0, 0.0, 0.18)
TILTED = AttitudeTarget(0.0, 0.2, 0.0, 0.0, 0.18)
