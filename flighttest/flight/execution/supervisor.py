"""The supervisor, when a target was refused: release the vehicle in the same cycle, ask for the abort mode, keep sending until it is
confirmed."""

from __future__ import annotations

import math
from collections.abc import Callable

from flighttest.flight.execution.control import FlightControl
from flighttest.flight.execution.machine import Event, FlightState
from flighttest.flight.gate import on_ground
from flighttest.flight.state import VehicleState
from flighttest.mavlink import CopterMode, mode_name
from flighttest.mavlink.dialect import dialect
from flighttest.recording.manifest import EventData

ASK_EVERY_S = 0.2
ASK_ANYWAY_S = 2.0  # without an answer: the gate flies no step on a link that takes longer
NEXT_MODE_AFTER_S = 1.5
_ENTRY_S = 3.0
LEVELS_BEFORE = 3  # targets before GUIDED_NOGPS: a link that loses a twentieth loses all of them in one of 8000 entries, a fifth in 125
# Without a HEARTBEAT for so long no mode is asked for: the pilot may have chosen one, and would not be seen.
UNSEEN_S = 1.5
UNHEARD_S = (
    0.7  # without a message no pilot's change of mode is seen: asked once then, and again when something is heard
)
UPLINK_LOST_S = 3.0  # without an answer: then an operator who asked to stop is not kept waiting for it
STOP_AFTER_S = 20.0  # of asking for LAND over a lost uplink, after the operator asked to stop
RELEASE_AFTER_S = 5.0  # of asking for the abort mode after the operator asked to stop sending at once
REST_PATIENCE_S = 6.0
AT_REST_M_S = 0.4
_STICK_MID = 0.5
_STICK_DEAD_ZONE = 0.1  # THR_DZ is 100 of 1000 by default


def abort_modes(state: VehicleState) -> tuple[CopterMode, ...]:
    """Modes to ask for, in order. Not RTL: it climbs and crosses the zone.

    BRAKE with a position; LOITER or ALT_HOLD only while the throttle stick is inside its dead zone at mid, since they take the
    climb rate from it; else LAND.
    """
    stick_mid = state.throttle_stick is not None and abs(state.throttle_stick - _STICK_MID) <= _STICK_DEAD_ZONE
    modes: list[CopterMode] = []
    if state.position_ok:
        modes.append(CopterMode.BRAKE)
        if stick_mid:
            modes.append(CopterMode.LOITER)
    elif stick_mid:
        modes.append(CopterMode.ALT_HOLD)
    return (*modes, CopterMode.LAND)


def abort(control: FlightControl, why: tuple[str, ...], step: str = "") -> CopterMode:
    """Bring the vehicle into its abort mode and return it. The first release leaves before anything else. step: the one that ends here.

    Level targets go out every cycle until HEARTBEAT shows the mode. FlightEnded when the pilot takes over, or the link stays silent.
    """
    control.release()
    modes = abort_modes(control.state)
    report(control, why, step, modes)
    return ask_until_shown(control, modes, control.release)


def report(control: FlightControl, why: tuple[str, ...], step: str, modes: tuple[CopterMode, ...]) -> None:
    """Note why what is flown ends here, in which situation and with which modes to ask for, and alarm the operator."""
    state = control.state
    situation: EventData = {
        "modes": [m.name for m in modes],
        "height_m": state.height_m,
        "climb_m_s": state.climb_m_s,
        "position_m": state.position_m,
        "velocity_m_s": state.velocity_m_s,
        "tilt_rad": state.tilt_rad,
        "voltage_v": state.voltage_v,
        "silence_s": state.silence_s,
    }
    control.recorder.event("abort", "; ".join(why) or "abort", state.t_s, situation)
    control.alarm((f"{step} is stopped: " if step else "") + ("; ".join(why) or "abort"))


class ModeRequest:
    """When a mode is asked for: at once, and again only where the request is known to be lost, so that no repeat that is under way
    arrives after a pilot's change of mode and overrules it. Known: a question that left after it was answered, and a HEARTBEAT that came
    after that answer still shows another mode."""

    def __init__(self, control: FlightControl) -> None:
        self._control = control
        self._asked_s = self._handled_s = -math.inf

    def ask_where_due(self, mode: CopterMode, before: Callable[[], None] = lambda: None) -> None:
        """Ask for a mode if it is time to. before: called just before each request leaves."""
        if not self.due:
            return
        before()
        if self._control.vehicle.ask_mode(mode):
            self._asked_s, self._handled_s = self._control.session.now_s(), math.inf

    @property
    def due(self) -> bool:
        """Whether a request may leave now: the vehicle is heard, so that a pilot's change of mode would be seen, and none is under way."""
        state, now = self._control.state, self._control.session.now_s()
        if state.mode_age_s >= UNSEEN_S or state.silence_s >= UNHEARD_S or now - self._asked_s < ASK_EVERY_S:
            return False
        if math.isinf(self._handled_s) and self._control.session.answered_since(self._asked_s):
            self._handled_s = now
        return state.t_s - state.mode_age_s > self._handled_s or now - self._asked_s >= ASK_ANYWAY_S


def ask_until_shown(control: FlightControl, modes: tuple[CopterMode, ...], meanwhile: Callable[[], None]) -> CopterMode:
    """Ask for modes, one after the other, until HEARTBEAT shows one of them, however long the link takes; meanwhile: called each cycle.

    FlightEnded when the pilot takes over, the link stays away (`control`), or the operator asks for an end and the vehicle does not answer.
    """
    release_s = math.inf
    began = control.session.now_s()
    request = ModeRequest(control)
    heard_again = began
    index = 0
    # Only what was asked for: a pilot who chooses another mode meanwhile, be it one of ours, has taken over.
    control.ask_safe_mode(modes[:1])
    while True:
        now = control.session.now_s()
        unheard = control.stop_asked and control.state.uplink_silence_s > UPLINK_LOST_S
        if control.stop_now or unheard:
            release_s = min(release_s, now + (RELEASE_AFTER_S if control.stop_now else STOP_AFTER_S))
            if now > release_s:
                control.on(Event.GIVEN_UP if control.stop_now else Event.UPLINK_GONE)
        if request.due and now - heard_again > NEXT_MODE_AFTER_S * (index + 1):
            index = min(index + 1, len(modes) - 1)
            control.ask_safe_mode(modes[: index + 1])
        request.ask_where_due(modes[index])
        state = control.cycle()
        if control.machine.state is not FlightState.ASKING:
            control.recorder.event("mode", mode_name(state.mode), state.t_s, {"mode": state.mode})
            return CopterMode(state.mode)
        if state.silence_s >= 1.0:
            heard_again = control.session.now_s()
        meanwhile()


def release(control: FlightControl, why: str) -> None:
    """Into the abort mode from wherever the vehicle is ours."""
    if control.owned and control.state.mode == CopterMode.GUIDED_NOGPS:
        abort(control, (why,))
    elif control.owned and control.vehicle.armed and control.state.mode == CopterMode.GUIDED:
        ask_until_shown(control, abort_modes(control.state), lambda: None)


def come_to_rest(control: FlightControl) -> None:
    """Stay in the abort mode until it has stopped the vehicle: the next mode may not brake as hard (GUIDED takes 10 m to stop a climb of
    4 m/s, flown). Only where a position is known, and not for long: LAND does not come to rest in the air, and what lies on the ground
    does not come to rest in BRAKE, which lifts it.
    """
    deadline = control.session.now_s() + REST_PATIENCE_S
    while control.session.now_s() < deadline and not control.stop_asked:
        state = control.state
        still = (state.speed_m_s or 0.0) < AT_REST_M_S or on_ground(state, control.gate)
        if state.mode != CopterMode.BRAKE or not state.position_ok or still:
            return
        control.cycle()


def enter(
    control: FlightControl,
    mode: CopterMode,
    timeout_s: float = 5.0,
    meanwhile: Callable[[], None] = lambda: None,
    before: Callable[[], None] = lambda: None,
) -> bool:
    """Ask for a mode until a fresh HEARTBEAT shows it; False after timeout_s. meanwhile: called each cycle; before: before each request."""
    deadline = control.session.now_s() + timeout_s
    request = ModeRequest(control)
    while True:
        now = control.session.now_s()
        request.ask_where_due(mode, before)
        state = control.cycle()
        if state.mode == mode and state.mode_age_s < UNSEEN_S:
            return True
        if now > deadline:
            return False
        meanwhile()


def enter_nogps(control: FlightControl, hold: Callable[[], None] = lambda: None) -> bool:
    """Into GUIDED_NOGPS, which keeps the throttle of the last attitude target until the next one, for the time that a link takes there and
    back (0.1 of full throttle over 0.2 s: 0.6 m/s down, flown). In GUIDED, which takes attitude targets, too, level targets with the
    throttle that holds height go before the request, several since one may be lost; level targets are sent from the vehicle's acceptance
    on, HEARTBEAT or not.

    hold: asks GUIDED for the present place, called after each of those targets: where the request is lost, GUIDED goes on holding its
    place (level, it drifted 2.2 m in 2.6 s with 8 m/s of wind, flown). The throttle of the target is kept.
    """
    asked_s = control.session.now_s()

    def level() -> None:
        if control.state.mode == CopterMode.GUIDED:
            control.release()
            hold()

    def hover() -> None:
        ack = control.session.latest.get("COMMAND_ACK")
        if ack is None or ack.t_s < asked_s:
            return
        if (ack.message.command, ack.message.result) == (dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_RESULT_ACCEPTED):
            control.release()

    for _ in range(LEVELS_BEFORE - 1 if control.state.mode == CopterMode.GUIDED else 0):
        level()
        control.cycle()
    if not enter(control, CopterMode.GUIDED_NOGPS, _ENTRY_S, hover, level):
        return False
    control.release()
    return True
