"""When the vehicle was in the air: as the autopilot reports it where it does, else inferred from throttle and height."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.recording import Recording

FloatArray = NDArray[np.float64]

_ASIDE_S = 1.0  # the legs leave the ground some time after take-off is declared
_IDLE = 0.02  # throttle of motors that do not lift
_LOW_M = 0.15
_STILL_M_S = 0.15
_STANDS_S = 1.0  # motors off for so long in the air would be a fall at 10 m/s
# Where the specific force shows what carries it: rotors have followed their command by half of that (lags are 0.05 to 0.2 s), its median.
_RESTS_S = 0.5
# An estimate drifts while the vehicle stands (by 0.2 m/s in a Crazyflie's log); in a fall of `_STANDS_S` the median speed is 5 m/s.
_STANDS_M_S = 0.5
_RESTS_M_S2 = 0.5  # specific force of what stands differs from g by less
# Of the throttle at which most of the flight has a specific force near g. With less, and that force, something else carries the vehicle:
# no climb, descent, battery or ground effect doubles the thrust per throttle.
_CARRIED = 0.5
_LIFTS = 0.9  # of the throttle in free air: rotors 0.8 radii above the ground carry the vehicle with it (Cheeseman and Bennett, 1955)
_WORTH_S = 3.0  # of a low hover at either end: less holds no window, and may be a lift-off or a touch-down
_FALLEN_S = 1.0  # upside down for so long: no flip lasts longer, and thrust downwards has made 20 m/s
# Control is lost where roll or pitch is further than this from all that was asked for in the last second (ArduCopter's crash check,
# crash_check.cpp: CRASH_CHECK_ANGLE_DEVIATION_DEG), and was since an attitude that followed.
_LOST_RAD, _FOLLOWED_RAD = math.radians(30.0), math.radians(5.0)
_ASKED_S = 1.0  # loops of multirotors have answered by then
_LOST_S = 0.2  # in all, of a second: one wrong sample of an attitude is no loss of control
_FOLLOWED_S = 2.0  # followed before: what never did has references of something else
# Of an attitude that follows again: what lies still stays within `_FOLLOWED_RAD` of targets that move by twice as much.
_MOVED_RAD = 2.0 * _FOLLOWED_RAD


def flights(recording: Recording) -> tuple[tuple[float, float], ...]:
    """From take-off to landing, s, of every flight of a recording in order; none where the vehicle stood all the time."""
    start, end = _whole(recording)
    landings = _stands(recording, start, end)
    lost = _without_control(recording, start, end, landings)
    bounds = [start]
    for down, up in _joined([*landings, *_crashes(recording, start, end), *lost]):
        bounds += [down, up]
    pieces = zip(bounds[::2], [*bounds[1::2], end], strict=True)
    # What is left beside a stand is the edge of a sample, or legs that had not left the ground yet.
    return tuple((a, b) for a, b in pieces if b - a > (_ASIDE_S if len(bounds) > 1 else 0.0))


def takeoffs(recording: Recording) -> tuple[float, ...]:
    """Where each flight begins, s; where control was regained none does."""
    regained = {end for _, end in control_lost(recording)} - {m.t_s for m in recording.markers if m.label == "take-off"}
    return tuple(start for start, _ in flights(recording) if start not in regained)


def control_lost(recording: Recording) -> tuple[tuple[float, float], ...]:
    """From where the attitude leaves what was asked for, to where it is shown to follow again, else to the end of that flight, s, of every
    flight in which control was lost (a collision, a failure): in what state the vehicle and its estimates are meanwhile is not known."""
    start, end = _whole(recording)
    return tuple(_without_control(recording, start, end, _stands(recording, start, end)))


def _whole(recording: Recording) -> tuple[float, float]:
    """From the first take-off to the landing that no other take-off follows, s."""
    start, end = recording.t_span_s
    start, end = _armed(recording, start, end)
    up = [m.t_s for m in recording.markers if m.label == "take-off" and m.t_s >= start]
    down = [m.t_s for m in recording.markers if m.label == "landed" and m.t_s > (up[0] if up else start)]
    if up and down and up[-1] > down[-1]:
        down = []  # the last flight has no landing: it ended in a crash, or the recording ended first
    if up:
        start = up[0] + _ASIDE_S
    if down:  # ArduCopter says so once it has stood with falling throttle for a second or two
        end = min(down[-1], _off_ground(recording, start, down[-1])[1]) - 0.5
    if not up:
        start = max(start, _driven(recording, start, end)[0], _off_ground(recording, start, end)[0])
    if not down:
        end = min(end, _driven(recording, start, end)[1], _off_ground(recording, start, end)[1])
    return (start, end) if start < end else recording.t_span_s


def _armed(recording: Recording, start: float, end: float) -> tuple[float, float]:
    if not recording.has("armed"):
        return start, end
    t, armed = recording.channel("armed")
    on = t[armed > 0]
    if not on.size:
        return start, end
    off = t[(armed == 0) & (t > on[-1])]
    return max(start, float(on[0])), min(end, float(off[0])) if off.size else end


def _driven(recording: Recording, start: float, end: float) -> tuple[float, float]:
    """From the first to the last throttle that is more than idling."""
    if not recording.has("throttle"):
        return start, end
    t, throttle = recording.channel("throttle")
    on = t[(throttle > _IDLE) & (t >= start) & (t <= end)]
    return (float(on[0]), float(on[-1])) if on.size > 1 else (start, end)


def _idle(recording: Recording, start: float, end: float, t: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of t (n,) are at most a second before the motors are driven, and after, with a throttle recorded that is idle."""
    if not recording.has("throttle"):
        return np.zeros(t.size, dtype=bool), np.zeros(t.size, dtype=bool)
    begins, ends = _driven(recording, start, end)
    known, throttle = recording.channel("throttle")
    known = known[np.isfinite(throttle)]  # rows at the end of a table that was cut off have none
    if not known.size:
        return np.zeros(t.size, dtype=bool), np.zeros(t.size, dtype=bool)
    before = (t < begins) & (t >= max(begins - _ASIDE_S, known[0]))
    return before, (t > ends) & (t <= min(ends + _ASIDE_S, known[-1]))


def _off_ground(recording: Recording, start: float, end: float) -> tuple[float, float]:
    """Without the stretches at both ends in which the vehicle stands: at most `_LOW_M` above where it was with idle motors just before and
    after, or above its lowest where motors are driven to the end."""
    if not recording.has("height_m", "v_x_m_s"):
        return start, end
    t, height = recording.channel("height_m")
    inside = (t >= start) & (t <= end) & np.isfinite(height)
    t, height = t[inside], height[inside]
    if t.size < 10:
        return start, end
    before, after = _idle(recording, start, end, t)
    first = int(np.argmax(height > _ground(height, before) + _LOW_M))
    last = t.size - 1 - int(np.argmax(height[::-1] > _ground(height, after) + _LOW_M))
    up, down = float(t[first]), float(t[last])
    grounded = before.any() or not _hovers(recording, (start, up), start, (up, down))
    if first > 0 and grounded and _still(recording, t[0], t[max(first // 2, 1)], _slow(before)):
        start = up
    grounded = after.any() or not _hovers(recording, (down, end), end - _STANDS_S, (up, down))
    if last < t.size - 1 and grounded and _still(recording, t[(last + t.size) // 2], t[-1], _slow(after)):
        end = down
    return start, end


def _hovers(recording: Recording, low: tuple[float, float], outermost: float, high: tuple[float, float]) -> bool:
    """Whether a stretch near the lowest height begins or ends, in the second from `outermost` on, with the throttle of the flight above it:
    that is no spooling up or down on the ground. (A record that ends in a hover of 28 s at 1.1 m was called the ground.)"""
    if not recording.has("throttle") or low[1] - low[0] < _WORTH_S:
        return False
    t, throttle = recording.channel("throttle")
    spans = ((outermost, outermost + _STANDS_S), high)
    edge, above = (throttle[(t >= a) & (t <= b) & np.isfinite(throttle)] for a, b in spans)
    return bool(edge.size and above.size) and float(np.median(edge)) > _LIFTS * float(np.median(above))


def _ground(height: FloatArray, idle: NDArray[np.bool_]) -> float:
    """Where it stood, m: as near in time as can be, since estimated heights drift, by 0.5 m in seconds in a Crazyflie's log."""
    return float(np.median(height[idle]) if idle.any() else np.min(height))


def _slow(idle: NDArray[np.bool_]) -> float:
    """Speed below which the vehicle stands, m/s, where idle motors show that it does not fly, or nothing does."""
    return _STANDS_M_S if idle.any() else _STILL_M_S


def _still(recording: Recording, start: float, end: float, slower_m_s: float, name: str = "v_x_m_s") -> bool:
    t, v = recording.channel(name)
    inside = (t >= start) & (t <= end) & np.isfinite(v)
    return bool(inside.any()) and float(np.median(np.abs(v[inside]))) < slower_m_s


def _stands(recording: Recording, start: float, end: float) -> list[tuple[float, float]]:
    """Stretches in which the vehicle stands, s: between two flights, and after a take-off that was declared too early."""
    return [*_landings(recording, start, end), *_not_yet_up(recording, start, end)]


def _not_yet_up(recording: Recording, start: float, end: float) -> list[tuple[float, float]]:
    """From where the autopilot reports a take-off to where the vehicle is higher than `_LOW_M` above where it stood with idle motors just
    before, else to the end of that flight, s, where it is at rest for longer than a declared take-off takes. ArduCopter reports one as soon
    as the throttle is more than half of that at mid stick (land_detector.cpp), with which nothing need fly."""
    if not recording.has("height_m", "throttle"):
        return []
    t, height = recording.channel("height_m")
    t, height = t[np.isfinite(height)], height[np.isfinite(height)]
    ends = sorted(m.t_s for m in recording.markers if m.label in ("take-off", "landed"))
    found: list[tuple[float, float]] = []
    for up in [m.t_s for m in recording.markers if m.label == "take-off" and start - _ASIDE_S <= m.t_s < end]:
        idle = (t > up - _ASIDE_S) & (t < up) & ~_is_driven(recording, t)
        behind = (t >= up) & (t <= next((at for at in ends if at > up), end))
        if not idle.any() or not behind.any():
            continue
        lifted = t[behind & (height > _ground(height, idle) + _LOW_M)]
        until = float(lifted[0]) if lifted.size else float(t[behind][-1])
        if until - up > _ASIDE_S + _STANDS_S and _at_rest(recording, up, until):
            found.append((up, until))
    return found


def _landings(recording: Recording, start: float, end: float) -> list[tuple[float, float]]:
    """Stretches between two flights, s: motors give too little to fly, and the vehicle is at rest for all that was recorded; short ones
    where its specific force is known to be that of rest."""
    if not recording.has("throttle"):
        return []
    t, throttle = recording.channel("throttle")
    inside = (t >= start) & (t <= end) & np.isfinite(throttle)
    t, idle = t[inside], throttle[inside] <= _too_little(recording, t[inside], throttle[inside])
    turns = np.flatnonzero(np.diff(np.concatenate([[False], idle, [False]]).astype(np.int8)))
    found: list[tuple[float, float]] = []
    for first, after in zip(turns[::2], turns[1::2], strict=True):
        down, up = float(t[first]), float(t[after - 1])
        long = up - down >= _STANDS_S or (up - down >= _RESTS_S and _carried(recording, down, up))
        if long and _at_rest(recording, down, up):
            found.append(_low(recording, down, up))
    return found


def _too_little(recording: Recording, t: FloatArray, throttle: FloatArray) -> float:
    """Throttle with which nothing flies: an idle one, and where the specific force shows that something else carries the vehicle then, half
    of that which mostly does."""
    at, force = _known_force(recording)
    if not at.size:
        return _IDLE
    carried = (np.abs(np.interp(t, at, force) - _weight(recording)) < _RESTS_M_S2) & (throttle > _IDLE)
    return max(_IDLE, _CARRIED * float(np.median(throttle[carried]))) if carried.any() else _IDLE


def _known_force(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """(t, f_z) where it was measured."""
    if not recording.has("f_z_m_s2"):
        return np.zeros(0), np.zeros(0)
    t, force = recording.channel("f_z_m_s2")
    good = np.isfinite(force)
    return t[good], force[good]


def _weight(recording: Recording) -> float:
    """Specific force that carries the vehicle, as its accelerometer reads it (one of 2014: 8.2), m/s^2: the median with driven motors."""
    t, force = _known_force(recording)
    if not t.size or not recording.has("throttle"):
        return G_M_S2
    at, throttle = recording.channel("throttle")
    good = np.isfinite(throttle)
    driven = np.interp(t, at[good], throttle[good]) > _IDLE if good.any() else np.zeros(t.size, dtype=bool)
    return float(np.median(force[driven])) if driven.any() else G_M_S2


def _crashes(recording: Recording, start: float, end: float) -> list[tuple[float, float]]:
    """Stretches in which the vehicle lies upside down, s, with the fall before and until it takes off again, where that is recorded."""
    if not recording.has("roll_rad", "pitch_rad"):
        return []
    t, roll = recording.channel("roll_rad")
    pitch = np.interp(t, *recording.channel("pitch_rad"))
    inside = (t >= start) & (t <= end) & np.isfinite(roll) & np.isfinite(pitch)
    t, over = t[inside], (np.cos(roll) * np.cos(pitch))[inside] < 0.0
    turns = np.flatnonzero(np.diff(np.concatenate([[False], over, [False]]).astype(np.int8)))
    again = sorted(m.t_s + _ASIDE_S for m in recording.markers if m.label == "take-off")
    found = []
    for first, after in zip(turns[::2], turns[1::2], strict=True):
        down, up = float(t[first]), float(t[after - 1])
        if up - down >= _FALLEN_S:
            found.append((down - _ASIDE_S, next((a for a in again if a > down), up)))
    return found


def _without_control(
    recording: Recording, start: float, end: float, landings: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    ends = sorted([*(m.t_s for m in recording.markers if m.label == "take-off"), *(up for _, up in landings), end])
    found: list[tuple[float, float]] = []
    begin = start
    for stop in ends:
        while begin < stop <= end and (lost := _lost_from(recording, begin, stop)) is not None:
            begin = _follows_again(recording, lost, stop) or stop
            found.append((lost, begin))
        begin = max(begin, stop)
    return found


def _follows_again(recording: Recording, lost: float, end: float) -> float | None:
    """Where an attitude that left its targets has followed them again for as long as one must to be lost, and moved with them by more than
    what lies still seems to, with driven motors, s; None where it never does."""
    t, far = _beside_targets(recording, lost, end)
    follows = (far <= _FOLLOWED_RAD) & _is_driven(recording, t)
    angles = [np.interp(t, *recording.channel(f"{axis}_rad")) for axis in ("roll", "pitch")]
    turns = np.flatnonzero(np.diff(np.concatenate([[False], follows, [False]]).astype(np.int8)))
    for first, after in zip(turns[::2], turns[1::2], strict=True):
        spans = [np.maximum.accumulate(a[first:after]) - np.minimum.accumulate(a[first:after]) for a in angles]
        shown = (np.max(spans, axis=0) > _MOVED_RAD) & (t[first:after] - t[first] >= _FOLLOWED_S)
        if shown.any():
            return float(t[first + int(np.argmax(shown))])
    return None


def _is_driven(recording: Recording, t: FloatArray) -> NDArray[np.bool_]:
    """(n,) where the throttle is more than idle, as far as it was recorded."""
    if not recording.has("throttle"):
        return np.ones(t.size, dtype=bool)
    at, throttle = recording.channel("throttle")
    at, throttle = at[np.isfinite(throttle)], throttle[np.isfinite(throttle)]
    return np.asarray(throttle[np.maximum(np.searchsorted(at, t, side="right") - 1, 0)] > _IDLE)


def _beside_targets(recording: Recording, start: float, end: float) -> tuple[FloatArray, FloatArray]:
    """Times of the attitude (n,), s, and how far roll or pitch is outside of what was asked for, rad (n,)."""
    t = recording.channel("roll_rad")[0] if recording.has("roll_rad", "pitch_rad") else np.zeros(0)
    t = t[(t >= start) & (t <= end)]
    return t, np.maximum(*(_outside_targets(recording, axis, t) for axis in ("roll", "pitch"))) if t.size else t


def _lost_from(recording: Recording, start: float, end: float) -> float | None:
    """Where roll or pitch leaves what was asked for, s; None where both stay with it, or never followed it."""
    t, far = _beside_targets(recording, start, end)
    beyond = far > _LOST_RAD
    for k in np.flatnonzero(beyond & (t - start >= _FOLLOWED_S)):
        soon = slice(k, int(np.searchsorted(t, t[k] + _ASKED_S, side="right")))
        if np.ptp(t[soon]) * beyond[soon].mean() >= _LOST_S:
            followed = t[:k][far[:k] <= _FOLLOWED_RAD]
            return float(followed[-1]) if followed.size and followed[-1] - start >= _FOLLOWED_S else None
    return None


def _outside_targets(recording: Recording, axis: str, t: FloatArray) -> FloatArray:
    """(n,) rad that an angle is outside of all its targets of the last `_ASKED_S`, held; 0 where there were none, or it is not known."""
    nearest = np.full(t.size, np.inf)
    angle = np.interp(t, *recording.channel(f"{axis}_rad"))
    for name in (f"{axis}_ref_rad", f"{axis}_shaped_rad"):
        at, asked = recording.channel(name) if recording.has(name) else (np.zeros(0), np.zeros(0))
        at, asked = at[np.isfinite(asked)], asked[np.isfinite(asked)]
        if not at.size:
            continue
        first = np.maximum(np.searchsorted(at, t - _ASKED_S, side="right") - 1, 0)
        last = np.maximum(np.searchsorted(at, t, side="right") - 1, 0)
        pairs = np.stack([first, last + 1], axis=1).ravel()
        padded = np.append(asked, asked[-1])
        most, least = (one.reduceat(padded, pairs)[::2] for one in (np.maximum, np.minimum))
        beside = np.maximum(np.maximum(angle - most, least - angle), 0.0)
        nearest = np.minimum(nearest, np.where((at[last] >= t - _ASKED_S) & (at[last] <= t), beside, 0.0))
    return np.where(np.isfinite(nearest), nearest, 0.0)


def _joined(stretches: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """In order, those that overlap as one."""
    found: list[tuple[float, float]] = []
    for a, b in sorted(stretches):
        if found and a <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], b)
        else:
            found.append((a, b))
    return found


def _at_rest(recording: Recording, start: float, end: float) -> bool:
    """By the velocities that are known there, of which the vertical one suffices; else by the specific force."""
    known = [v for v in ("v_x_m_s", "v_y_m_s", "v_z_m_s") if _known_in(recording, v, start, end)]
    if "v_z_m_s" in known:
        return all(_still(recording, start, end, _STANDS_M_S, v) for v in known)
    return _carried(recording, start, end)


def _carried(recording: Recording, start: float, end: float) -> bool:
    """Whether the specific force is that of what rests or hovers."""
    t, force = _known_force(recording)
    inside = (t >= start) & (t <= end)  # none: no evidence that it stood
    return bool(inside.any()) and abs(float(np.median(force[inside])) - _weight(recording)) < _RESTS_M_S2


def _known_in(recording: Recording, name: str, start: float, end: float) -> bool:
    if not recording.has(name):
        return False
    t, values = recording.channel(name)
    return bool(np.isfinite(values[(t >= start) & (t <= end)]).any())


def _low(recording: Recording, down: float, up: float) -> tuple[float, float]:
    """A rest with what belongs to touching down and lifting off: as long as the vehicle is lower than a hand above where it stood."""
    if not recording.has("height_m"):
        return down - _ASIDE_S, up + _ASIDE_S
    t, height = recording.channel("height_m")
    known = np.isfinite(height)
    t, height = t[known], height[known]
    first, last = ((t >= a) & (t <= b) for a, b in ((down, min(down + _ASIDE_S, up)), (max(up - _ASIDE_S, down), up)))
    if not first.any() or not last.any():
        return down - _ASIDE_S, up + _ASIDE_S
    before = t[(height > _ground(height, first) + _LOW_M) & (t < down)]
    behind = t[(height > _ground(height, last) + _LOW_M) & (t > up)]
    return float(before[-1]) if before.size else down, float(behind[0]) if behind.size else up
