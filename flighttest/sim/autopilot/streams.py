"""When which message is due: SET_MESSAGE_INTERVAL as ArduPilot grants it."""

from __future__ import annotations

RATE_MAX_HZ = 200.0


class Streams:
    """Message ids with their intervals, s. A message is due at a tick when its time has come: the interval is an average."""

    def __init__(self) -> None:
        self._interval: dict[int, float] = {}
        self._next: dict[int, float] = {}
        self._first = float("inf")

    def interval_s(self, message_id: int) -> float:
        """The interval of a message, s; 0 when it is not sent."""
        return self._interval.get(message_id, 0.0)

    def set(self, message_id: int, interval_s: float, t_s: float) -> None:
        """Send a message every interval_s, s, from t_s on; 0 or less stops it."""
        if interval_s <= 0.0:
            self._interval.pop(message_id, None)
            self._next.pop(message_id, None)
        else:
            self._interval[message_id] = interval_s
            # on a grid of its own interval, so that streams of one rate come in one tick
            self._next[message_id] = (int(t_s / interval_s + 1e-6) + 1) * interval_s
        self._first = min(self._next.values(), default=float("inf"))

    def due(self, t_s: float) -> list[int]:
        """Ids to be sent at t_s, s."""
        late = t_s + 1e-9
        if self._first > late:
            return []
        found = []
        times, intervals = self._next, self._interval
        for i, when in times.items():
            if when <= late:
                found.append(i)
                when += intervals[i]
                times[i] = when if when > late else t_s + intervals[i]
        self._first = min(times.values())
        return found
