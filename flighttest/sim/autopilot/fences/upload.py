"""The fence's transfer by MAVLink's mission protocol, both ways. A vehicle asks again for what does not come, and gives up in the end."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot import telemetry
from flighttest.sim.autopilot.fences.breach import Area, areas_of
from flighttest.sim.autopilot.vehicle import CommandedVehicle

KIND = dialect.MAV_MISSION_TYPE_FENCE
_MOST = 84  # of ArduCopter's storage on a small board
_AGAIN_S, _OVER_S = 1.0, 8.0
_ACCEPTED, _ERROR, _DENIED = dialect.MAV_MISSION_ACCEPTED, dialect.MAV_MISSION_ERROR, dialect.MAV_MISSION_DENIED
_FRAMES = (
    dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)  # fmt: skip


class FenceUpload:
    """The items of the fence, and the one transfer that may be under way. areas: what they make."""

    def __init__(self, vehicle: CommandedVehicle) -> None:
        self._v = vehicle
        self.areas: tuple[Area, ...] = ()
        self._items: list[Any] = []
        self._incoming: list[Any] | None = None
        self._count = 0
        self._sender = (0, 0)
        self._heard_s = self._asked_s = 0.0
        self._enable = 0
        self._switched_on = 0

    @property
    def in_force(self) -> int:
        """FENCE_TYPE bits that are checked: as FENCE_TYPE was when FENCE_ENABLE changed last, and what was switched on by command."""
        self._follow()
        return self._switched_on & int(self._v.store["FENCE_TYPE"])

    def switch(self, on: bool, kinds: int) -> None:
        """MAV_CMD_DO_FENCE_ENABLE."""
        self._follow()
        kinds &= int(self._v.store["FENCE_TYPE"])
        self._switched_on = self._switched_on | kinds if on else self._switched_on & ~kinds

    def _follow(self) -> None:
        enable = int(self._v.store["FENCE_ENABLE"])
        if enable != self._enable:
            self._enable = enable
            self._switched_on = int(self._v.store["FENCE_TYPE"]) if enable else 0

    def count(self, m: Any) -> None:
        """MISSION_COUNT: a station begins to write."""
        sender = _sender(m)
        if self._incoming is not None and sender != self._sender:
            self._ack(sender, _DENIED)
        elif m.count > _MOST:
            self._ack(sender, dialect.MAV_MISSION_NO_SPACE)
        elif m.count == 0:
            self.clear(m)
        else:
            self._incoming, self._count, self._sender = [], int(m.count), sender
            self._heard_s = self._v.time_s
            self._request()

    def item(self, m: Any) -> None:
        """MISSION_ITEM_INT: one that was asked for."""
        if self._incoming is None or _sender(m) != self._sender:
            return
        if m.seq != len(self._incoming):
            return  # it came twice
        self._heard_s = self._v.time_s
        if m.frame not in _FRAMES:
            self._finish(dialect.MAV_MISSION_UNSUPPORTED_FRAME)
            return
        self._incoming.append(m)
        if len(self._incoming) < self._count:
            self._request()
            return
        areas = _areas(self._incoming)
        if areas is None:
            self._finish(_ERROR)
            return
        self._items, self.areas = self._incoming, areas
        self._finish(_ACCEPTED)

    def clear(self, m: Any) -> None:
        """MISSION_CLEAR_ALL."""
        self._items, self.areas, self._incoming = [], (), None
        self._ack(_sender(m), _ACCEPTED)

    def listed(self, m: Any) -> None:
        """MISSION_REQUEST_LIST: how many there are."""
        v = self._v
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_count_message(*_sender(m), len(self._items), KIND)))

    def wanted(self, m: Any) -> None:
        """MISSION_REQUEST_INT: one of them."""
        v = self._v
        if not 0 <= m.seq < len(self._items):
            self._ack(_sender(m), dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        item = self._items[m.seq]
        kept = (item.param1, 0.0, 0.0, 0.0, item.x, item.y, 0.0)
        fields = (m.seq, dialect.MAV_FRAME_GLOBAL, item.command, 0, 0, *kept, KIND)
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_item_int_message(*_sender(m), *fields)))

    def look(self, t_s: float) -> None:
        """Follow FENCE_ENABLE, and ask again for what does not come."""
        self._follow()
        if self._incoming is None:
            return
        if t_s - self._heard_s > _OVER_S:
            self._finish(dialect.MAV_MISSION_OPERATION_CANCELLED)
        elif t_s - self._asked_s > _AGAIN_S:
            self._request()

    def _request(self) -> None:
        v = self._v
        assert self._incoming is not None
        self._asked_s = v.time_s
        wanted = (*self._sender, len(self._incoming), KIND)
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_request_message(*wanted)))

    def _finish(self, result: int) -> None:
        self._incoming = None
        self._ack(self._sender, result)

    def _ack(self, sender: tuple[int, int], result: int) -> None:
        v = self._v
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_ack_message(*sender, result, KIND)))


def _sender(m: Any) -> tuple[int, int]:
    return m.get_srcSystem(), m.get_srcComponent()


def _areas(items: list[Any]) -> tuple[Area, ...] | None:
    return areas_of([(m.command, m.param1, telemetry.local_of(m.x, m.y)) for m in items])
