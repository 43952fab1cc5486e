"""The vehicle's clock, live. All waiting in flight uses it, so that a simulator may run at its own speed.

A `FollowedClock` goes by the stamps that arrive and runs on between them at the pace they keep, on the host's clock; a
`GrantedClock` belongs to a simulator in lock-step and moves only by the simulator's marks.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

_PACE_WINDOW_S = 2.0  # host seconds over which the pace is read
_PAUSE_S = 0.2  # host seconds without a stamp after which stamps may come in a burst
_LATE_S = 0.05  # host seconds by which a stamp after a pause is behind where it was held up
_PERIOD_S = 1.0  # the least delayed stamp is looked for over one to two of these
_REAL_TIME_TOLERANCE = 0.05  # a vehicle nearer to real time than this is a real one, and its pace exactly 1
_LEAP_S = 5.0  # farther than this no delay of a link moves a stamp against those before
_LEAP_STAMPS = 5  # that agree: one stamp alone is a damaged frame, or another vehicle's
_UNANSWERED_MAX = 1000  # questions that are remembered: four minutes of a silent link
_DRIFT = 2e-4  # two crystals differ by less than this


@dataclass(frozen=True)
class ClockOffset:
    """Ground minus vehicle time, s, from TIMESYNC; error_s is half the smallest round trip of `samples` answers."""

    offset_s: float
    error_s: float
    samples: int


class Clock(Protocol):
    """Where the vehicle's time comes from."""

    def now_s(self) -> float:
        """The vehicle's time, s; never goes back."""

    def ground_s(self) -> float:
        """The time to write into the record, s since 1970 on the ground's clock."""

    def heard(self, vehicle_s: float) -> None:
        """A message with the vehicle's time stamp has arrived now."""

    def answered(self, vehicle_s: float, round_trip_s: float) -> None:
        """A TIMESYNC answer has arrived now that was vehicle_s on the vehicle, half the round trip ago."""

    def keep_real_time(self) -> None:
        """The vehicle is known to be a real one: its clock runs as ours does, whatever the link makes of its stamps."""

    def hold(self) -> None:
        """From now on a leap of the vehicle's clock does not move this one: what waits for a time would be over at once."""

    @property
    def leap_s(self) -> float:
        """How far the vehicle's clock has leapt since `hold`, s."""

    @property
    def pace(self) -> float:
        """Vehicle seconds per host second."""


class FollowedClock:
    """Follows the stamps of the vehicle's messages. host_s and wall_s are injected by tests."""

    def __init__(self, host_s: Callable[[], float] = time.monotonic, wall_s: Callable[[], float] = time.time) -> None:
        self._host_s = host_s
        self._wall_ahead_s = wall_s() - host_s()
        self._pace = 1.0
        self._heard: deque[tuple[float, float]] = deque()
        # The least delayed stamp, as (host, vehicle), of the present and of the last short period.
        self._best: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)
        # (host, vehicle) before a pause of the host, as long as the stamps that came since are behind and catch up.
        self._paused: tuple[float, float] | None = None
        self._period_end_s = 0.0
        self._latest_s = 0.0
        self._started_s = host_s()
        self._shift_s, self._quickest_s = 0.0, math.inf
        # Of a real vehicle: (host, vehicle less host) by the least delayed stamp of all, which only drift makes older.
        self._ahead: tuple[float, float] | None = None
        self._real = False
        self._held = False
        self._leap_s = 0.0
        self._leaping: list[tuple[float, float]] = []  # (host, vehicle) of stamps in a row that contradict those before

    def hold(self) -> None:
        """From now on a forward leap of the stamps is taken off them; where they go back, the vehicle was booted anew."""
        self._held = True

    @property
    def leap_s(self) -> float:
        """How far the vehicle's clock has leapt since `hold`, s."""
        return self._leap_s

    def keep_real_time(self) -> None:
        """From now on the pace is 1, and a link that stalls or grows slower neither stops the clock nor sets it back."""
        self._real, self._pace = True, 1.0

    @property
    def pace(self) -> float:
        """Vehicle seconds per host second, 1.0 for a vehicle in real time."""
        return self._pace

    def heard(self, vehicle_s: float) -> None:
        """Follow a stamp: the least delayed of the last second or two sets the clock, since delays only ever add."""
        host = self._host_s()
        vehicle_s -= self._leap_s
        back = bool(self._heard) and vehicle_s < self._heard[-1][1] - _LEAP_S
        if self._held and self._leaps(host, vehicle_s, back):
            if len(self._leaping) < _LEAP_STAMPS:
                return
            self._leaping.clear()
            if not back:
                forward_s = vehicle_s - self._run_on(host)
                self._leap_s += forward_s
                vehicle_s -= forward_s
        if back:  # a reboot
            self._begin_anew()
        if self._real:
            drifted = -math.inf if self._ahead is None else self._ahead[1] - _DRIFT * (host - self._ahead[0])
            self._ahead = host, max(drifted, vehicle_s - host)
        if not self._real:
            self._follow_pace(host, vehicle_s)
        self._heard.append((host, vehicle_s))
        while host - self._heard[0][0] > _PACE_WINDOW_S:
            self._heard.popleft()
        period = _PERIOD_S if self._pace == 1.0 else 0.1 * _PERIOD_S
        if host >= self._period_end_s:
            self._best = (None, self._best[0])
            self._period_end_s = host + period
        present = self._best[0]
        if present is None or vehicle_s >= present[1] + (host - present[0]) * self._pace:
            self._best = ((host, vehicle_s), self._best[1])

    def _follow_pace(self, host: float, vehicle_s: float) -> None:
        """The pace of the stamps of the last two seconds, but not of those that a pause of the host held up."""
        if self._heard and self._paused is None and host - self._heard[-1][0] > _PAUSE_S:
            before = self._heard[-1]
            if self._behind_s(before, host, vehicle_s) > _LATE_S * self._pace:
                self._paused = before
                self._heard.clear()
        elif self._paused and self._behind_s(self._paused, host, vehicle_s) < -_LATE_S * self._pace:
            self._paused = None  # they were not held up, or are faster now
            self._heard.clear()
        since, first_s = next(((h, v) for h, v in self._heard if host - h <= _PACE_WINDOW_S), (host, vehicle_s))
        span, passed = host - since, vehicle_s - first_s
        # Stamps that stand still (a simulator that waits for us) are no pace: at none, no wait would end.
        if span <= 0.5 * _PACE_WINDOW_S or passed <= 0.0:
            return
        pace = passed / span
        if self._paused and pace > max(self._pace, 1.0) * (1.0 + _REAL_TIME_TOLERANCE):
            return  # they catch up; real time is no catching up of a pace that a growing queue made slow
        self._paused = None
        self._pace = 1.0 if abs(pace - 1.0) < _REAL_TIME_TOLERANCE else pace

    def _behind_s(self, before: tuple[float, float], host: float, vehicle_s: float) -> float:
        """By how much a stamp is behind what the present pace makes of one before."""
        return before[1] + (host - before[0]) * self._pace - vehicle_s

    def _begin_anew(self) -> None:
        self._heard.clear()
        self._paused = None
        self._best, self._latest_s, self._pace = (None, None), 0.0, 1.0
        self._shift_s, self._quickest_s, self._ahead = 0.0, math.inf, None
        self._leap_s = 0.0

    def _leaps(self, host: float, vehicle_s: float, back: bool) -> bool:
        """Whether a stamp contradicts those before. `_leaping` has those in a row that do and agree with one another."""
        far_s = _LEAP_S * max(self._pace, 1.0)
        if not back and vehicle_s < self._run_on(host) + far_s:
            self._leaping.clear()
            return False
        if self._leaping:
            since, before = self._leaping[-1]
            if abs(vehicle_s - before - (host - since) * self._pace) > far_s:
                self._leaping.clear()
        self._leaping.append((host, vehicle_s))
        return True

    def answered(self, vehicle_s: float, round_trip_s: float) -> None:
        """Stamps alone run late by the shortest way here; the quickest round trip measures by how much."""
        if self._pace != 1.0 or round_trip_s > 1.2 * self._quickest_s:
            return
        self._quickest_s = min(self._quickest_s, round_trip_s)
        vehicle_s -= self._leap_s
        late_s = vehicle_s + 0.5 * round_trip_s - (self._run_on(self._host_s()) - self._shift_s)
        if late_s < _LEAP_S:
            self._shift_s = max(late_s, 0.0)

    def _run_on(self, host: float) -> float:
        if self._ahead is not None:
            return host + self._ahead[1] + self._shift_s
        known = [b[1] + (host - b[0]) * self._pace for b in self._best if b is not None]
        return (
            max(known) + self._shift_s if known else host - self._started_s
        )  # nothing heard yet: waiting still needs an end

    def now_s(self) -> float:
        """The vehicle's time; runs on at the last pace while nothing arrives, so that silence can be measured."""
        self._latest_s = max(self._latest_s, self._run_on(self._host_s()))
        return self._latest_s

    def ground_s(self) -> float:
        """Wall clock time as it was at the start, and run on: in the field it is set in mid-flight, by as much as years."""
        return self._wall_ahead_s + self._host_s()


class GrantedClock:
    """The time of a simulator in lock-step: exact, and standing still between grants."""

    def __init__(self, wall_s: Callable[[], float] = time.time) -> None:
        self._now_s = 0.0
        self._wall_s = wall_s
        self._epoch_s: float | None = None

    @property
    def pace(self) -> float:
        """Always 1: the ground's clock is the vehicle's."""
        return 1.0

    def keep_real_time(self) -> None:
        """A simulator in lock-step keeps its own."""

    def hold(self) -> None:
        """Stamps do not move this clock."""

    @property
    def leap_s(self) -> float:
        """None is seen."""
        return 0.0

    def heard(self, vehicle_s: float) -> None:
        """Stamps do not move this clock."""

    def answered(self, vehicle_s: float, round_trip_s: float) -> None:
        """Nor do answers."""

    def reach(self, vehicle_s: float) -> None:
        """The simulator has come to this time."""
        if self._epoch_s is None:
            self._epoch_s = round(self._wall_s()) - vehicle_s
        self._now_s = max(self._now_s, vehicle_s)

    def now_s(self) -> float:
        """The vehicle's time."""
        return self._now_s

    def ground_s(self) -> float:
        """The vehicle's time, set forward to today: ground and vehicle share one clock in lock-step."""
        return self._now_s + (self._epoch_s if self._epoch_s is not None else self._wall_s())


class TimeSync:
    """Our TIMESYNC questions and their answers. All in vehicle or ground seconds, as given."""

    def __init__(self) -> None:
        self._asked: dict[int, float] = {}
        self._best: tuple[float, float, float] | None = None  # sent, vehicle, received of the quickest answer
        self._answers = 0

    def ask(self, ground_s: float) -> int:
        """The ts1 (ns) of a new question at ground_s."""
        ts1 = int(ground_s * 1e9)
        self._asked[ts1] = ground_s
        if len(self._asked) > _UNANSWERED_MAX:
            del self._asked[next(iter(self._asked))]
        return ts1

    def answer(self, tc1: int, ts1: int, ground_s: float) -> float | None:
        """An answer: its round trip, s; None for one to somebody else's question."""
        asked = self._asked.pop(ts1, None)  # a vehicle whose time has not begun to run answers with a tc1 of 0
        if asked is None:
            return None
        self._answers += 1
        if self._best is None or ground_s - asked < self._best[2] - self._best[0]:
            self._best = asked, tc1 * 1e-9, ground_s
        return ground_s - asked

    def offset(self) -> ClockOffset | None:
        """The offset by the sample with the smallest round trip, not the mean; None before the first answer."""
        if self._best is None:
            return None
        sent, vehicle, received = self._best
        return ClockOffset(0.5 * (sent + received) - vehicle, 0.5 * (received - sent), self._answers)
