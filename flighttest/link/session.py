"""One vehicle on one port: its latest messages, its time, and questions with answers. Does not interpret, does not hide a timeout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flighttest.errors import LinkError
from flighttest.link.clock import Clock, ClockOffset, FollowedClock, GrantedClock, TimeSync
from flighttest.link.lockstep import Grants
from flighttest.link.port import MavlinkPort
from flighttest.link.requests import ModeRequests
from flighttest.link.states import LinkEvent, LinkMachine, LinkState
from flighttest.link.transport import ENOUGH, Sequence
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect, is_vehicle

CONNECT_S = 10.0  # host seconds
HEARTBEAT_EVERY_S = 1.0
TIMESYNC_EVERY_S = 0.25  # its answers also show that the uplink works; 120 bytes a second each way
LOST_S = 6.0  # without a message (HEARTBEATs come once a second at least): waiting for an answer ends with a LinkError
UNANSWERED_S = 10.0
QUIET_S = 1.5  # more than from one HEARTBEAT to the next: a vehicle that is not heard for longer cannot show whether it receives
_DRAIN_MAX = 100  # receives in a row: seconds of a real link, and an end where a simulator sends faster than it is read
_POLL_S = 0.02  # host seconds one receive may block
_OVERTAKING_S = 0.2  # a link does not reorder over longer; sequence numbers begin anew after some 0.3 s
_SILENCE_MAX_S = 10.0  # host seconds a simulator in lock-step may take for a grant


class LinkSilent(LinkError):
    """The vehicle was there, and is not heard any more, or receives nothing: not a refusal."""


class StoppedByOperator(LinkError):
    """The operator asked to stop while `Session.stop_asked` was set: nothing on the vehicle was changed yet."""


@dataclass(frozen=True)
class Heard:
    """A message with the vehicle's time of its arrival, s."""

    message: Message
    t_s: float


class Session:
    """The conversation with one vehicle. `advance` is the only place where time passes and messages come in.

    vehicle_system is 0 until the first HEARTBEAT of an autopilot. latest: message name to the last one heard from the vehicle. others:
    system ids of further autopilots that were heard, the vehicle's own where there are two of it. boots: how often the vehicle's clock
    began anew. stop_asked: set as long as waiting may be broken off (`advance` raises StoppedByOperator once it is true).
    """

    def __init__(self, port: MavlinkPort, clock: Clock | None = None) -> None:
        self.port = port
        self.clock: Clock = clock or FollowedClock()
        self.vehicle_system = 0
        self.others: set[int] = set()
        self.latest: dict[str, Heard] = {}
        self.counts: dict[str, int] = {}
        self._listeners: list[Callable[[Message, float], None]] = []
        self._timesync = TimeSync()
        self._asked_s: dict[int, float] = {}  # when each TIMESYNC question left, by its ts1
        self._answered_s: float | None = None  # when the newest answered one had left
        self._unanswered_s: float | None = (
            None  # when the oldest question left that waits for its answer, none since is answered
        )
        self.mode_requests = ModeRequests()
        self._grants: Grants | None = None
        self._next_heartbeat_s = self._next_timesync_s = 0.0
        self.last_heard_s = 0.0
        self.boots = 0
        self.overtaken = 0  # HEARTBEATs that came after one sent later, or after one of another vehicle
        self._held = False
        self._sequence = Sequence()
        self.link = LinkMachine()
        self.stop_asked: Callable[[], bool] | None = None

    def listen(self, listener: Callable[[Message, float], None]) -> None:
        """Call `listener(message, vehicle time s)` for every message from the vehicle."""
        self._listeners.append(listener)

    def forget(self, listener: Callable[[Message, float], None]) -> None:
        """Stop calling a listener."""
        self._listeners.remove(listener)

    @property
    def lock_step(self) -> bool:
        """Whether a simulator waits for our grants."""
        return self._grants is not None

    def enter_lock_step(self) -> None:
        """Go on in lock-step with a simulator that has agreed to it: from now on its time is granted by `advance`."""
        grants = Grants(0.0)
        self.send(dialect.MAVLink_system_time_message(time_unix_usec=0, time_boot_ms=0))  # asks what time it is
        self._await_mark(grants)
        granted = GrantedClock()
        granted.reach(grants.now_s)
        self._grants = grants
        self.clock = granted
        self.link.on(LinkEvent.BOOTED, granted.now_s())
        self._timesync = TimeSync()
        self._asked_s.clear()
        self._answered_s = self._unanswered_s = None
        self._next_heartbeat_s = self._next_timesync_s = 0.0

    def _await_mark(self, grants: Grants) -> None:
        """Receive until a simulator's end mark moves its time on."""
        self._grants, before, silent_s = grants, grants.marks, 0.0
        while grants.marks == before:
            frames = self.port.frames_received
            self._take(_POLL_S)
            silent_s = 0.0 if self.port.frames_received > frames else silent_s + _POLL_S
            if silent_s > _SILENCE_MAX_S:
                raise LinkError("the simulator stopped answering in lock-step", "start it again")

    def now_s(self) -> float:
        """The vehicle's time, s."""
        return self.clock.now_s()

    @property
    def held(self) -> bool:
        """Whether a frame may have shown that the pilot has the vehicle: nothing but granted time is sent."""
        return self._held

    @held.setter
    def held(self, held: bool) -> None:
        self._held = held
        if held:
            self.port.cancel()

    def send(self, message: Message) -> bool:
        """Send one message; False after `port.mute()`, and while `held`."""
        return not self.held and self.port.send(message)

    def send_at(self, t_s: float, message: Message) -> bool:
        """Send one message when the vehicle's clock shows t_s, if it is not cancelled before (`port.cancel`)."""
        wait_s = (t_s - self.now_s()) / max(self.clock.pace, 0.05)
        return not self.held and self.port.send_at(max(wait_s, 0.0), message)

    def advance(self, until_s: float) -> None:
        """Let time pass until the vehicle's clock shows until_s, taking in what arrives. Returns at once when it is past."""
        while True:
            if self.stop_asked is not None and self.stop_asked():
                raise StoppedByOperator("the operator asked to stop before anything was changed on the vehicle")
            self._keep_alive()
            if self._grants is not None:
                self._advance_granted(until_s)
                return
            before = self.clock.now_s()
            self._take(min(max(until_s - before, 0.0) / max(self.clock.pace, 0.05), _POLL_S))
            now = self.clock.now_s()
            if now >= until_s or now < before:  # it goes back when the vehicle was booted anew
                return

    def _advance_granted(self, until_s: float) -> None:
        assert self._grants is not None
        assert isinstance(self.clock, GrantedClock)
        for grant in self._grants.upto(until_s):
            self._keep_alive()
            self.port.send(grant)
            self._await_mark(self._grants)
            self.clock.reach(self._grants.now_s)

    def _keep_alive(self) -> None:
        now = self.clock.now_s()
        if now >= self._next_heartbeat_s:
            self._next_heartbeat_s = now + HEARTBEAT_EVERY_S * max(self.clock.pace, 1.0)
            self.send(
                dialect.MAVLink_heartbeat_message(
                    type=dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                    autopilot=dialect.MAV_AUTOPILOT_INVALID,
                    base_mode=0,
                    custom_mode=0,
                    system_status=dialect.MAV_STATE_ACTIVE,
                    mavlink_version=3,
                )
            )
        if self.vehicle_system and now >= self._next_timesync_s:
            self._next_timesync_s = now + TIMESYNC_EVERY_S * max(self.clock.pace, 1.0)
            ts1 = self._timesync.ask(self.clock.ground_s())
            if self.send(dialect.MAVLink_timesync_message(tc1=0, ts1=ts1)):
                self._asked_s[ts1] = now
                self._unanswered_s = now if self._unanswered_s is None else self._unanswered_s

    def _take(self, timeout_s: float) -> None:
        """Take in what has arrived, all of it: after a pause of the host, a pilot's change of mode may be the last in the queue."""
        messages = self.port.receive(timeout_s)
        for _ in range(_DRAIN_MAX):
            for message in messages:
                self._dispatch(message)
            if not messages or self._grants is not None:
                return
            messages = self.port.receive(0.0)

    def _dispatch(self, message: Message) -> None:
        if not self._is_the_vehicles(message):
            return
        kind = message.get_type()
        answer = kind == "TIMESYNC" and self._is_answer(message)
        if self._grants is not None and self._grants.heard(message):
            return  # the clock's own mark is no sign of the link
        stamp = getattr(message, "time_boot_ms", None)
        if stamp:
            self.clock.heard(stamp * 1e-3)
        t_s = self.clock.now_s()
        booted = t_s < self.last_heard_s
        if booted:
            self.latest.clear()  # what it sent before is not fresh, however late its clock was
            self._asked_s.clear()
            self._answered_s = self._unanswered_s = None
            self.boots += 1
        gap_s = t_s - self.last_heard_s
        if gap_s > QUIET_S * max(self.clock.pace, 1.0) and self._unanswered_s is not None:
            self._unanswered_s += gap_s  # answers were lost with all the rest
        self.last_heard_s = t_s
        self.latest[kind] = Heard(message, t_s)
        self.counts[kind] = self.counts.get(kind, 0) + 1
        self.link.on(LinkEvent.BOOTED if booted else LinkEvent.ANSWER if answer else LinkEvent.MESSAGE, t_s)
        for listener in tuple(self._listeners):
            listener(message, t_s)

    def _is_the_vehicles(self, message: Message) -> bool:
        """Whether a message is from the autopilot that is connected, and none that came later has overtaken it. Notes other vehicles."""
        header = message.get_header()
        if header.srcComponent != COMPONENT_AUTOPILOT:
            return False  # a gimbal or companion computer aboard has the vehicle's system id, but its own mode, clock and answers
        system = header.srcSystem
        beat = message.get_type() == "HEARTBEAT"
        if beat and not self.vehicle_system and is_vehicle(message):
            self.vehicle_system = system
        if system and system == self.vehicle_system:
            return not self._is_another_vehicles(message) and not (beat and self._overtaken(message))
        if beat and system != self.vehicle_system and is_vehicle(message):
            self.others.add(system)
        return False

    def _is_answer(self, timesync: Message) -> bool:
        """Whether a TIMESYNC message answers a question of ours; the clock takes it in."""
        trip = self._timesync.answer(timesync.tc1, timesync.ts1, self.clock.ground_s())
        if trip is None:
            return False
        self.clock.heard(timesync.tc1 * 1e-9)
        self.clock.answered(timesync.tc1 * 1e-9, trip)
        return self._answered(timesync.ts1)

    def _is_another_vehicles(self, message: Message) -> bool:
        """Whether a message is another vehicle's that has the same system id. A simulator in lock-step is alone."""
        if self._grants is not None:
            return False
        foreign = self._sequence.foreign(message.get_seq(), bytes(message.get_msgbuf()), self.clock.now_s())
        if self._sequence.foreign_frames >= ENOUGH:
            self.others.add(self.vehicle_system)
        return foreign

    def _answered(self, ts1: int) -> bool:
        """Whether a question of ours was answered: the vehicle has received it, and what was sent before it."""
        asked_s = self._asked_s.pop(ts1, None)
        if asked_s is None:
            return False
        self._asked_s = {t: s for t, s in self._asked_s.items() if s > asked_s}
        self._answered_s = asked_s if self._answered_s is None else max(self._answered_s, asked_s)
        self._unanswered_s = min(self._asked_s.values(), default=None)
        self.mode_requests.answered(asked_s, self.clock.now_s())
        return True

    def _overtaken(self, heartbeat: Message) -> bool:
        """Whether a HEARTBEAT comes after one that was sent later: the mode it shows is over."""
        last = self.latest.get("HEARTBEAT")
        if last is None or not 0.0 <= self.clock.now_s() - last.t_s < _OVERTAKING_S:
            return False
        if (heartbeat.get_seq() - last.message.get_seq()) % 256 < 128:
            return False
        self.overtaken += 1
        return True

    @property
    def silence_s(self) -> float:
        """Vehicle seconds since anything was heard from the vehicle."""
        return self.clock.now_s() - self.last_heard_s

    @property
    def uplink_silence_s(self) -> float:
        """Vehicle seconds for which the vehicle was heard without a sign that anything we sent had arrived: since the oldest TIMESYNC
        question left that neither it nor a later one was answered. 0 while none is open (a program that stood still asked none), and for
        a vehicle that never answered one."""
        if self._answered_s is None or self._unanswered_s is None:
            return 0.0
        heard_s = min(self.clock.now_s(), self.last_heard_s + QUIET_S * max(self.clock.pace, 1.0))
        return max(heard_s - self._unanswered_s, 0.0)

    def answered_since(self, t_s: float) -> bool:
        """Whether a TIMESYNC question that left after t_s was answered: the vehicle has received, or never will, what was sent before."""
        return self._answered_s is not None and self._answered_s >= t_s

    @property
    def offset(self) -> ClockOffset | None:
        """Ground minus vehicle time by TIMESYNC, None before the first answer."""
        return self._timesync.offset()

    def require_link(self) -> None:
        """LinkSilent where the vehicle that was connected is not heard, or answers nothing."""
        state = self.look_at_link()
        if state is LinkState.LOST:
            raise LinkSilent(
                f"the link was lost: nothing has been heard from the vehicle for {LOST_S:.0f} s",
                "check that the vehicle is on, the radio or cable, and the distance",
            )
        if state is LinkState.ONE_WAY:
            raise LinkSilent(
                f"the link was lost in one direction: the vehicle is heard, but has answered nothing for {UNANSWERED_S:.0f} s",
                "check the transmitting side of the radio, or the address that is sent to",
            )

    def look_at_link(self) -> LinkState:
        """The state of the link now: what has not come for long is an event, too."""
        pace, now = max(self.clock.pace, 1.0), self.clock.now_s()
        if self.vehicle_system and self.silence_s > LOST_S * pace:
            return self.link.on(LinkEvent.SILENCE, now)
        if self.vehicle_system and self.silence_s > QUIET_S * pace:
            self.link.on(LinkEvent.PAUSE, now)
        if self.uplink_silence_s > UNANSWERED_S * pace:
            self.link.on(LinkEvent.UNANSWERED, now)
        return self.link.state

    def await_message(self, wanted: Callable[[Message], bool], timeout_s: float) -> Message | None:
        """The next message from the vehicle for which `wanted` is true, or None after timeout_s of the vehicle's time."""
        found: list[Message] = []

        def look(message: Message, _t_s: float) -> None:
            if not found and wanted(message):
                found.append(message)

        self.listen(look)
        try:
            deadline = self.now_s() + timeout_s
            while (
                not found and self.now_s() < deadline - 1e-6
            ):  # nearer no simulator grants time: it has whole milliseconds
                self.advance(min(self.now_s() + 0.02, deadline))
                if not found:
                    self.require_link()  # after reading what has waited: the last call may be long ago
        finally:
            self.forget(look)
        return found[0] if found else None

    def connect(self, timeout_s: float | None = None) -> Message:
        """The first HEARTBEAT of an autopilot, and the vehicle's time from TIMESYNC where it answers. LinkError without a HEARTBEAT.

        timeout_s is in host seconds: there is no other clock yet.
        """
        timeout_s = CONNECT_S if timeout_s is None else timeout_s
        beat = self.await_message(lambda m: m.get_type() == "HEARTBEAT", timeout_s)
        if beat is None and self.port.refused:
            raise LinkError(
                f"{self.port.refused} frames were refused: none was signed with this key",
                "give the vehicle its key with `flighttest sign`, or leave the key out",
            )
        if beat is None:
            raise LinkError(
                f"no HEARTBEAT of an autopilot within {timeout_s:.0f} s",
                "check the URL, that the vehicle is on, and that it sends to this port",
            )
        self.port.keep_to(self.vehicle_system, COMPONENT_AUTOPILOT)
        for _ in range(10):
            self._next_timesync_s = 0.0
            if self.await_message(lambda m: m.get_type() == "TIMESYNC" and self.offset is not None, 0.1) is not None:
                break
        if self.offset is None and self.port.hears_signatures and not self.port.signs:
            raise LinkError(
                "the vehicle signs what it sends, and does not answer what is not signed",
                "give its key: --signing-key FILE, or signing_key in vehicle.yaml",
            )
        self._asked_s.clear()  # on a clock that was not the vehicle's yet
        self._answered_s = self._unanswered_s = None
        return beat
