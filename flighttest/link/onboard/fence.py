"""The fence (geofence) that a vehicle keeps aboard: read, written and verified by MAVLink's mission protocol with MISSION_TYPE_FENCE.

MAVLink guide, "Mission Protocol"; answers and their time limits as ArduPilot's MissionItemProtocol.cpp handles them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flighttest.errors import LinkError
from flighttest.link.session import Session
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect

MOST_ITEMS = 700  # more than any autopilot keeps
_KIND = dialect.MAV_MISSION_TYPE_FENCE
_ANSWER_S, _TRIES = 1.5, 5
_LOOK_EVERY_S = 0.02
_ITEM_KINDS = ("MISSION_ITEM_INT", "MISSION_ITEM")
_REQUESTS = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
_ALTITUDE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class FenceItem:
    """One item of a fence. command: a MAV_CMD_NAV_FENCE_...; params: param1 to param4; x, y: latitude and longitude, degE7; z: m."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float = 0.0


def polygon(corners_e7: Sequence[tuple[int, int]]) -> tuple[FenceItem, ...]:
    """A polygon that must not be left, from the latitudes and longitudes of its corners, degE7."""
    command, frame = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, dialect.MAV_FRAME_GLOBAL
    return tuple(FenceItem(command, frame, (float(len(corners_e7)), 0.0, 0.0, 0.0), x, y) for x, y in corners_e7)


def same_fence(one: Sequence[FenceItem], other: Sequence[FenceItem]) -> bool:
    """Whether two fences are one: commands, places and the first parameter (number of corners, or radius). A frame may come back as
    its integer form, and what an autopilot does not keep (further parameters, height) as 0."""
    if len(one) != len(other):
        return False
    return all(
        (a.command, a.x, a.y) == (b.command, b.x, b.y)
        and abs(a.params[0] - b.params[0]) <= _ALTITUDE_TOLERANCE * max(abs(a.params[0]), 1.0)
        for a, b in zip(one, other, strict=True)
    )


class Fence:
    """The fence of the vehicle of a session."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._target = (session.vehicle_system, COMPONENT_AUTOPILOT)

    def read(self) -> tuple[FenceItem, ...]:
        """All items, none where there is no fence. LinkError where the vehicle does not report it."""
        counted = self._ask(
            dialect.MAVLink_mission_request_list_message(*self._target, _KIND),
            lambda m: m.get_type() == "MISSION_COUNT",
        )
        if counted is None:
            raise LinkError("the vehicle does not state its fence", "is it ArduCopter 4.1 or newer?")
        if counted.count > MOST_ITEMS:
            raise LinkError(f"the vehicle states a fence of {counted.count} items", "look at it with a ground station")
        items: list[FenceItem] = []
        for number in range(counted.count):
            item = self._ask(
                dialect.MAVLink_mission_request_int_message(*self._target, number, _KIND),
                lambda m, number=number: m.get_type() in _ITEM_KINDS and m.seq == number,  # type: ignore[misc]
            )
            if item is None:
                raise LinkError(f"item {number} of the vehicle's fence does not arrive", "move closer")
            items.append(_item(item))
        self._send(dialect.MAVLink_mission_ack_message(*self._target, dialect.MAV_MISSION_ACCEPTED, _KIND))
        return tuple(items)

    def write(self, items: Sequence[FenceItem]) -> None:
        """Replace the vehicle's fence by these items (none: remove it) and read it back. LinkError where it is not the same then."""
        if items:
            self._upload(items)
        else:
            self._clear()
        seen = self.read()
        if not same_fence(seen, items):
            raise LinkError(
                f"the fence reads back as {len(seen)} items that are not the {len(items)} written",
                "another ground station may be writing it: look at it there",
            )

    def _clear(self) -> None:
        ack = self._ask(
            dialect.MAVLink_mission_clear_all_message(*self._target, _KIND), lambda m: m.get_type() == "MISSION_ACK"
        )
        if ack is None or ack.type != dialect.MAV_MISSION_ACCEPTED:
            raise LinkError(f"the vehicle does not remove its fence{_result(ack)}", "remove it with a ground station")

    def _upload(self, items: Sequence[FenceItem]) -> None:
        heard = deque[Message]()

        def listen(message: Message, _t_s: float) -> None:
            if message.get_type() in _REQUESTS and self._is_ours(message):
                heard.append(message)

        session = self._session
        last = dialect.MAVLink_mission_count_message(*self._target, len(items), _KIND)
        sent_all, tries = False, 0
        session.listen(listen)
        try:
            self._send(last)
            while tries < _TRIES:
                asked = self._next(heard)
                if asked is None:
                    if sent_all:
                        return  # its acknowledgement may be lost: what is read back decides
                    tries += 1
                    self._send(last)
                    continue
                tries = 0
                if asked.get_type() == "MISSION_ACK":
                    if asked.type == dialect.MAV_MISSION_ACCEPTED and sent_all:
                        return
                    raise LinkError(f"the vehicle refuses the fence{_result(asked)}", "is another station writing one?")
                if not 0 <= asked.seq < len(items):
                    raise LinkError(f"the vehicle asks for item {asked.seq} of {len(items)} of a fence", "try again")
                last = self._message(asked.seq, items[asked.seq])
                sent_all = sent_all or asked.seq == len(items) - 1
                self._send(last)
        finally:
            session.forget(listen)
        raise LinkError("the vehicle does not take the fence", "is the link two-way, and the vehicle ArduCopter?")

    def _next(self, heard: deque[Message]) -> Message | None:
        session = self._session
        deadline_s = session.now_s() + _ANSWER_S * max(session.clock.pace, 1.0)
        while not heard and session.now_s() < deadline_s - 1e-6:
            session.advance(min(session.now_s() + _LOOK_EVERY_S, deadline_s))
            if not heard:
                session.require_link()
        return heard.popleft() if heard else None

    def _message(self, number: int, item: FenceItem) -> Message:
        return dialect.MAVLink_mission_item_int_message(
            *self._target, number, item.frame, item.command, 0, 1, *item.params, item.x, item.y, item.z, _KIND
        )

    def _send(self, message: Message) -> None:
        self._session.send(message)

    def _ask(self, question: Message, wanted: Callable[[Message], bool]) -> Message | None:
        session = self._session
        for _ in range(_TRIES):
            session.send(question)
            answer = session.await_message(
                lambda m: wanted(m) and self._is_ours(m), _ANSWER_S * max(session.clock.pace, 1.0)
            )
            if answer is not None:
                return answer
        return None

    def _is_ours(self, message: Message) -> bool:
        """Whether it is part of a fence's transfer with us, not of a mission's or another station's."""
        return message.mission_type == _KIND and message.target_system in (0, self._session.port.system)


def _item(message: Message) -> FenceItem:
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        x, y = round(x * 1e7), round(y * 1e7)
    params = (message.param1, message.param2, message.param3, message.param4)
    return FenceItem(int(message.command), int(message.frame), params, int(x), int(y), float(message.z))


def _result(ack: Message | None) -> str:
    if ack is None:
        return ""
    named = dialect.enums["MAV_MISSION_RESULT"].get(ack.type)
    return f" ({named.name if named else ack.type})"
