"""`FlightControl`: one cycle of the flight, and `steer`, the only place from which an attitude target leaves.

The pilot always wins: from the HEARTBEAT on that shows a mode that this program did not ask for, nothing is sent, and the second one ends
the flight.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from flighttest.flight.execution.live_view import LiveView
from flighttest.flight.execution.machine import Event, FlightState, Machine
from flighttest.flight.gate import GateLimits, Refusal, refusals, stop_throttles
from flighttest.flight.outcome import HOW_TO_STOP, HOW_TO_STOP_HANDED, OnProgress
from flighttest.flight.preparation.changes import ExternalChanges
from flighttest.flight.preparation.preflight import TIMEOUT_S
from flighttest.flight.recorder import Recorder
from flighttest.flight.state import StateReader, VehicleState
from flighttest.flight.transmitter import ModeSwitch, Transmitter
from flighttest.frames import G_M_S2
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.session import Session
from flighttest.link.states import BROKEN, LinkState
from flighttest.link.streams import StreamRates
from flighttest.mavlink import CopterMode, mode_name
from flighttest.mavlink.dialect import Message, is_armed, is_warning
from flighttest.plan import AttitudeTarget

UNSURE_S = (
    0.3  # without an answer: a question in 0.25 s (session.TIMESYNC_EVERY_S), and 50 ms for the way there and back
)
NOT_HEARD = "the vehicle is not heard any more"
NOT_ANSWERED = "the vehicle does not answer any more"
TAKE_OVER = "PILOT, take over with the mode switch"
NO_SWITCH = "the pilot's transmitter is not received: keep clear, it flies by its own failsafes"
AHEAD_SHARE = 0.4  # of a period: 8 ms at 50 Hz; a program that is held up for less delays no target
CONFIRMED_WITHIN_S = 2.5  # after a HEARTBEAT that contradicts those before: the next one comes within a second
SAID_WITHIN_S = 3.0  # before a change: a fence or failsafe states its reason with it, and the second HEARTBEAT decides a second later
UNLIKE_BEATS = 2  # in a row, as for a take-over; the first after the switch was seen may be of before
GIVE_UP_AFTER_S = 30.0  # without a HEARTBEAT: the vehicle's own failsafes have long acted
UPLINK_GIVE_UP_S = 60.0  # heard, but without an answer: as long as it may come back it is asked to land
# What shows whose vehicle it is, what the transmitter does, what others changed, or a warning.
_WATCHED = frozenset({"HEARTBEAT", "SYS_STATUS", "RC_CHANNELS", "PARAM_VALUE", "STATUSTEXT"})


@dataclass
class Stops:
    """What the operator asked for: `count()` is how often Ctrl-C was pressed."""

    count: Callable[[], int]

    @property
    def orderly(self) -> bool:
        """Stop after making the vehicle safe."""
        return self.count() >= 1

    @property
    def now(self) -> bool:
        """Stop sending at once."""
        return self.count() >= 2


@dataclass(frozen=True)
class Unconfirmed:
    """What one HEARTBEAT has shown, heard at t_s. overtaken: how many had been: one between two that agree contradicts them."""

    event: Event
    mode: int
    t_s: float
    overtaken: int


class FlightControl:
    """Everything a flying procedure needs. `cycle` lets one period pass; `steer` sends one target or returns why not."""

    def __init__(
        self,
        vehicle: ArduPilot,
        gate: GateLimits,
        recorder: Recorder,
        *,
        rate_hz: float,
        stops: Stops,
        external_changes: ExternalChanges,
        on_progress: OnProgress | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.session: Session = vehicle.session
        self.gate = gate
        self.recorder = recorder
        self.period_s = 1.0 / rate_hz
        self.reader = StateReader(self.session)
        self.state: VehicleState = self.reader.read()
        self.hover_throttle = gate.hover_throttle
        self._stops = stops
        self.external_changes = external_changes
        self._view = LiveView(self.session, on_progress)
        self.machine = Machine()
        self._mode = -1  # as HEARTBEAT showed it last
        self._safe_modes: frozenset[int] = frozenset()
        self._was_armed = False
        self._unconfirmed: Unconfirmed | None = None
        self._boots = self.session.boots
        self._others = set(self.session.others)
        self.streams: StreamRates | None = None
        self._transmitter = Transmitter()
        self.mode_switch = ModeSwitch()
        self._switch_modes: dict[int, int] = {}  # by its position
        self._chosen: int | None = None  # by the switch that took over
        self._unlike = 0  # HEARTBEATs in a row that show another
        self._warnings: deque[tuple[float, str]] = deque(maxlen=8)  # of the vehicle, and when they came
        self._link = LinkState.SEARCHING
        self.session.listen(self._watch)

    # -- whose vehicle it is -------------------------------------------------------------------------------------------------

    def on(self, event: Event, why: str = "") -> None:
        """Report an event. The mode that is shown when the vehicle becomes ours, or is handed back, is the one to start from."""
        if not self.machine.ours or event is Event.HANDED_BACK:
            self._mode, self._was_armed = self.vehicle.mode, self.vehicle.armed
            self._unconfirmed, self.session.held = None, False
            self.mode_switch.forget()
        self.machine.on(event, why)
        if not self.machine.ours and self._unconfirmed is not None and self._unconfirmed.event is Event.DISARMED:
            self._unconfirmed, self.session.held = None, False  # nothing is left to decide, and parameters are restored

    def use_channels(self, parameters: Mapping[str, float]) -> None:
        """The transmitter's channels by the vehicle's parameters."""
        self.reader.throttle_channel = int(parameters.get("RCMAP_THROTTLE", self.reader.throttle_channel))
        self.mode_switch.channel = int(parameters.get("FLTMODE_CH", self.mode_switch.channel))
        self._switch_modes = {n: int(parameters[f"FLTMODE{n}"]) for n in range(1, 7) if f"FLTMODE{n}" in parameters}

    @property
    def owned(self) -> bool:
        """Whether the vehicle is ours to fly: neither before take-off, nor while the pilot has it."""
        return self.machine.ours

    @property
    def taken_over(self) -> bool:
        """Whether the pilot has taken the vehicle: nothing is sent any more."""
        return self.session.port.muted

    def ask_safe_mode(self, modes: Collection[CopterMode]) -> None:
        """From now on the first of these modes that HEARTBEAT shows is the one that was asked for."""
        self._safe_modes = frozenset(int(m) for m in modes)
        if self.machine.state is not FlightState.ASKING:
            self.on(Event.ASK)

    def _watch(self, message: Message, t_s: float) -> None:
        if self.session.boots != self._boots:
            self._boots = self.session.boots
            self.on(Event.REBOOTED)
        kind = message.get_type()
        if kind not in _WATCHED:
            return
        text = self._transmitter.look(message)
        if text and self.machine.state is not FlightState.GROUND:
            self.recorder.event("note", text, t_s)
            self.alarm(text)
        if self.taken_over and kind == "HEARTBEAT":
            self._watch_late(int(message.custom_mode), is_armed(message), t_s)
        if not self.machine.ours:
            return
        if self.mode_switch.moved(message, t_s) and not self._transmitter.lost:
            # Also into the mode that the vehicle is in by a request of ours, which HEARTBEAT cannot show.
            self._unconfirmed = Unconfirmed(Event.FOREIGN_MODE, self.vehicle.mode, t_s, self.session.overtaken)
            self._decide(t_s, by_switch=True)
            return
        if kind == "PARAM_VALUE":
            text = self.external_changes.look(message.param_id, float(message.param_value))
            if text:
                self.recorder.event("note", text, t_s)
        if kind == "STATUSTEXT" and is_warning(message):
            self._warnings.append((t_s, message.text.strip()))
            self.alarm(f"message of the vehicle: {message.text.strip()}")
        if kind == "HEARTBEAT":
            self._watch_mode(int(message.custom_mode), is_armed(message), t_s)

    def _watch_late(self, mode: int, armed: bool, t_s: float) -> None:
        """What was under way when the pilot took over may arrive after the pilot's change of mode."""
        if self.machine.state is FlightState.NOT_ARMED and armed:
            self.machine.on(Event.ARMED)
            self.alarm(f"the vehicle is armed in {mode_name(mode)} by a request that was under way at the take-over")
        late = mode in self.session.mode_requests.open and mode != self._mode
        # Taken over by the switch, and still in a mode of ours that is not the switch's: the request arrived after the pilot's change.
        unlike = self._chosen is not None and mode == self._mode != self._chosen
        self._unlike = self._unlike + 1 if unlike else 0
        if self.machine.state is not FlightState.WITH_PILOT or not (late or self._unlike >= UNLIKE_BEATS):
            return
        self.machine.on(Event.OVERRULED)
        text = f"the vehicle is in {mode_name(mode)} by a request that was under way at the take-over: move the mode switch again"
        self.recorder.event("note", text, t_s, {"mode": mode})
        self.alarm(text)

    def _watch_mode(self, mode: int, armed: bool, t_s: float) -> None:
        foreign = not self.session.mode_requests.shows(mode, t_s) and mode != self._mode
        disarmed = self._was_armed and not armed
        if not foreign and self.machine.state is FlightState.ASKING and mode in self._safe_modes:
            self.on(Event.LANDS if mode == CopterMode.LAND else Event.HOLDS)
        elif not foreign and self._landing and mode != CopterMode.LAND:
            self.on(Event.ASK)  # a mode that was asked for before LAND came after it: it is not landing any more
        if foreign or disarmed:
            event = Event.DROPPED if foreign and disarmed else Event.DISARMED if disarmed else Event.FOREIGN_MODE
            shown = Unconfirmed(event, mode, t_s, self.session.overtaken)
            # Nothing is sent from the first HEARTBEAT on; the second one decides, since one frame may be damaged or another vehicle's.
            if self._unconfirmed is None or replace(self._unconfirmed, t_s=t_s) != shown:
                self._unconfirmed, self.session.held = shown, True
                return
            self._decide(t_s)
            return
        self._unconfirmed, self.session.held = None, False
        self._mode, self._was_armed = mode, armed

    def _decide(self, t_s: float, *, by_switch: bool = False) -> None:
        """Somebody else changed the mode, or the vehicle is disarmed."""
        assert self._unconfirmed is not None
        shown, self._unconfirmed, self.session.held = self._unconfirmed, None, False
        if self.machine.state is FlightState.ARMING and (self._was_armed or self.vehicle.armed):
            self.on(Event.ARMED)
        why = "" if by_switch else self._said_before(t_s)
        if shown.event is Event.FOREIGN_MODE and self.machine.state is FlightState.OFFERED:
            self.recorder.event(
                "note", f"the pilot has the vehicle ({mode_name(shown.mode)})", t_s, {"mode": shown.mode}
            )
        elif shown.event is Event.FOREIGN_MODE:
            self.session.port.mute()
            self.recorder.event("take_over", mode_name(shown.mode), t_s, {"mode": shown.mode})
            who = (
                "the pilot moved the mode switch"
                if by_switch
                else why or "by the pilot, a failsafe, the fence or a station"
            )
            self._mode = shown.mode
            self._chosen = self._switch_modes.get(self.mode_switch.position or 0) if by_switch else None
            self.alarm(f"in {mode_name(shown.mode)} ({who}): nothing is sent any more; {self._to_do}")
        elif not self._landing:
            self.recorder.event("note", "disarmed in flight", t_s)
        what = f"the mode became {mode_name(shown.mode)}" if self.taken_over else "disarmed"
        self.on(shown.event, f"{what} {why}" if why else "")

    def _said_before(self, t_s: float) -> str:
        """The vehicle's warnings just before a change that others caused, which may be its reason; else ''."""
        said = dict.fromkeys(text for at_s, text in self._warnings if 0.0 <= t_s - at_s <= SAID_WITHIN_S)
        return "after the vehicle's message " + ", ".join(f'"{text}"' for text in said) if said else ""

    @property
    def _to_do(self) -> str:
        """What an alarm asks for: of a transmitter that is not received no mode switch takes over."""
        return NO_SWITCH if self._transmitter.lost else TAKE_OVER

    @property
    def _landing(self) -> bool:
        return self.machine.state is FlightState.LANDING

    def _watch_link(self) -> None:
        if self.streams is None:
            return  # preflight: the code that waits for an answer reports the silence
        before, link = self._link, self.session.look_at_link()
        if link is not before:
            self._link = link
            if link in BROKEN:
                self.recorder.event("note", f"link: {link.value}", self.state.t_s)
        if link in BROKEN and self.machine.ours:
            self.alarm(f"{NOT_HEARD if link is LinkState.LOST else NOT_ANSWERED}: {self._to_do}")
        text = self.streams.keep() if self.machine.ours else ""
        if text:
            self.recorder.event("note", text, self.state.t_s)
        if self.session.others - self._others:
            self._others |= self.session.others
            text = (
                "another vehicle is heard on this link; its messages are not taken for those of the vehicle that flies"
            )
            self.recorder.event("note", text, self.state.t_s)
        if self._unconfirmed is not None and not 0.0 <= self.state.t_s - self._unconfirmed.t_s < CONFIRMED_WITHIN_S:
            self._decide(self.state.t_s)
        if self.state.mode_age_s > GIVE_UP_AFTER_S:
            # A program that stood still reads what has waited first.
            self.session.advance(self.session.now_s() + self.period_s)
            self.state = self.reader.read()
            if self.state.mode_age_s > GIVE_UP_AFTER_S:
                self.on(Event.DOWNLINK_GONE)
        if self.state.uplink_silence_s > UPLINK_GIVE_UP_S:
            self.on(Event.UPLINK_GONE)

    # -- time ----------------------------------------------------------------------------------------------------------------

    def cycle(self) -> VehicleState:
        """Let one period of the vehicle's time pass and read the state. Raises FlightEnded on a take-over."""
        self.session.advance(self.session.now_s() + self.period_s)
        return self.after()

    def until(self, t_s: float) -> VehicleState:
        """Let time pass until the vehicle's clock shows t_s."""
        self.session.advance(t_s)
        return self.after()

    def after(self) -> VehicleState:
        """What every cycle ends with: state, take-over, progress."""
        self.recorder.flush()
        self.state = self.reader.read()
        self._report()
        self._watch_link()
        return self.state

    @property
    def pace(self) -> float:
        """Vehicle seconds per second of the host, at least 1."""
        return max(self.session.clock.pace, 1.0)

    @property
    def stop_asked(self) -> bool:
        """Whether the flight is to end in order: the operator asked for it, nothing can be recorded, or the vehicle was set up anew."""
        return self._stops.orderly or bool(self.recorder.failure) or bool(self.external_changes.vital)

    @property
    def stop_reason(self) -> str:
        """Why, as a sentence."""
        if self.recorder.failure:
            return f"the record cannot be written: {self.recorder.failure}"
        return self.external_changes.vital[0] if self.external_changes.vital else "the operator asked to stop"

    @property
    def stop_now(self) -> bool:
        """Whether the operator asked to stop sending at once."""
        return self._stops.now

    # -- targets -------------------------------------------------------------------------------------------------------------

    @property
    def ahead_s(self) -> float:
        """How long before its time a target is judged and handed over: nothing where no thread sends it on time."""
        return AHEAD_SHARE * self.period_s if self.session.port.on_time else 0.0

    def steer(
        self,
        target: AttitudeTarget,
        yaw_rad: float,
        with_rate: bool = False,
        *,
        step: bool = False,
        at_s: float | None = None,
    ) -> tuple[Refusal, ...]:
        """Send a target if the gate lets it pass; else send nothing and report why. yaw_rad: the heading for the quaternion; step: see
        `gate.refusals`; at_s: when it leaves, None at once."""
        found = refusals(target, self.state, self.gate, step=step)
        if not found and not self.taken_over:
            rate = target.yaw_rate_rad_s if with_rate else None
            self.vehicle.steer((target.roll_rad, target.pitch_rad, yaw_rad), rate, target.throttle, at_s)
        return found

    def release_target(self) -> AttitudeTarget:
        """Level, with the throttle that stops the present climb or descent, hover where that is known too late. Always passes the gate."""
        state = self.state
        # Fed back over a link that takes longer, a climb becomes a swing to the ground (seen: 1 to 6 m with a second of delay).
        prompt = state.silence_s < 0.5 and state.uplink_silence_s < UNSURE_S * self.pace
        climb = state.climb_m_s if prompt else None
        throttle = self.hover_throttle
        if climb is not None and math.isfinite(climb):
            # It may be the last that arrives for GUID_TIMEOUT: a climb that is stopped in less is reversed until the next one acts.
            low, high = self.gate.stop_throttle
            wanted = self.hover_throttle * (1.0 - climb / (G_M_S2 * TIMEOUT_S))
            throttle = min(max(wanted, low), high)
        return AttitudeTarget(0.0, 0.0, 0.0, 0.0, throttle)

    def release(self) -> None:
        """Send level attitude with a stopping or hover throttle."""
        yaw = self.state.attitude_rad[2] if self.state.attitude_rad else 0.0
        yaw = yaw if math.isfinite(yaw) else 0.0
        refused = self.steer(self.release_target(), yaw)
        assert not refused, "a release target must always pass"

    def use_hover(self, throttle: float) -> None:
        """Fly with this hover throttle from now on, in the gate as well."""
        self.hover_throttle = throttle
        self.gate = replace(
            self.gate, hover_throttle=throttle, stop_throttle=stop_throttles(self.gate.limits, throttle)
        )

    # -- the live view -------------------------------------------------------------------------------------------------------------

    def show(self, **changes: Any) -> None:
        """Change what the live view shows: fields of FlightProgress."""
        self._view.show(**changes)

    def alarm(self, text: str) -> None:
        """Alarm the operator now, with a sound where there is one and the same was not said while an alarm is shown."""
        if self._view.alarm(text):
            self._report(at_once=True)

    def _report(self, at_once: bool = False) -> None:
        handed = self.machine.state is FlightState.HANDED
        how_to_stop = HOW_TO_STOP_HANDED if handed else HOW_TO_STOP
        self._view.report(self.state, self.gate, at_once=at_once, stopping=self.stop_asked, how_to_stop=how_to_stop)
