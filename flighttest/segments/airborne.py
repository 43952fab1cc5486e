"""When the vehicle was in the air: as said by the autopilot where it says so, else told from throttle and height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.recording import Recording

FloatArray = NDArray[np.float64]

_ASIDE_S = 1.0  # the legs leave the ground some time after take-off is declared
_IDLE = 0.02  # throttle of motors that do not lift
_LOW_M = 0.15
_STILL_M_S = 0.15


def airborne(recording: Recording) -> tuple[float, float]:
    """From take-off to landing, s."""
    start, end = recording.t_span_s
    start, end = _armed(recording, start, end)
    up = [m.t_s for m in recording.markers if m.label == "take-off" and m.t_s >= start]
    down = [m.t_s for m in recording.markers if m.label == "landed" and m.t_s > (up[0] if up else start)]
    if up:
        start = up[0] + _ASIDE_S
    if down:
        end = down[-1] - 0.5
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


def _off_ground(recording: Recording, start: float, end: float) -> tuple[float, float]:
    """Without the stretches at both ends in which the vehicle stands at its lowest."""
    if not recording.has("height_m", "v_x_m_s"):
        return start, end
    t, height = recording.channel("height_m")
    inside = (t >= start) & (t <= end) & np.isfinite(height)
    t, height = t[inside], height[inside]
    if t.size < 10:
        return start, end
    ground = float(np.min(height))
    high = np.flatnonzero(height > ground + _LOW_M)
    if not high.size:
        return start, end
    first, last = int(high[0]), int(high[-1])
    if first > 0 and _still(recording, t[0], t[max(first // 2, 1)]):
        start = float(t[first])
    if last < t.size - 1 and _still(recording, t[(last + t.size) // 2], t[-1]):
        end = float(t[last])
    return start, end


def _still(recording: Recording, start: float, end: float) -> bool:
    t, v = recording.channel("v_x_m_s")
    inside = (t >= start) & (t <= end) & np.isfinite(v)
    return bool(inside.any()) and float(np.median(np.abs(v[inside]))) < _STILL_M_S
