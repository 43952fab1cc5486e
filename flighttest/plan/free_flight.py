"""Free flight before it is flown: the outer loop follows the waypoints on the prior model, with the link lost now and then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flighttest.plan.batched import Request, fly_rows
from flighttest.plan.clearance import Track
from flighttest.plan.fit_zone import DRIFT_S, SEARCH_STEP_S, FittedCell, Setting, track_of
from flighttest.plan.rehearse import GUID_TIMEOUT_S, Row

LOSS_EVERY_S = 1.0


def fly_waypoints(free: Sequence[FittedCell], setting: Setting) -> list[FittedCell]:
    """The cells with their tracks in the zone's own coordinates (a path is not placed: it has its place)."""
    rows = [_rows(f, setting) for f in free]
    every = [row for some in rows for row in some]
    if not every:
        return []
    flown = fly_rows(Request(every, SEARCH_STEP_S, DRIFT_S, GUID_TIMEOUT_S + DRIFT_S), setting.predictor)
    tracks = [track_of(flown, j, row) for j, row in enumerate(every)]
    ends = np.cumsum([len(some) for some in rows]).tolist()
    return [_fitted(f, tracks[end - len(some) : end], setting) for f, some, end in zip(free, rows, ends, strict=True)]


def _rows(f: FittedCell, setting: Setting) -> list[Row]:
    """The path as planned, and with the link lost now and then."""
    path, voltage = f.cell.waypoints, float(np.mean(setting.voltages_v))
    stop, start = setting.stop_throttle(f.cell), (path[0][1], path[0][2], path[0][3])
    row = Row(f.lead, (), None, 0.0, voltage, stop, start_m=start, waypoints=path)
    moments = np.arange(LOSS_EVERY_S, sum(piece.duration_s for piece in f.lead), LOSS_EVERY_S)
    return [row, *(row.losing_link_at(float(t)) for t in moments)]


def _fitted(f: FittedCell, flown: Sequence[Track], setting: Setting) -> FittedCell:
    origin = np.array(f.cell.waypoints[0][1:])
    tracks = [
        Track(t.t_s, t.p_m + origin, t.v_m_s, (t.reach_m[0] + origin[2], t.reach_m[1] + origin[2])) for t in flown
    ]
    speed = float(np.linalg.norm(tracks[0].v_m_s, axis=1).max())
    found = replace(f, nominal=tracks[:1], lost=tracks[1:], speed_m_s=speed)
    pace = float(f.cell.values["speed_m_s"])
    if pace > setting.speed_max_m_s:  # it would turn back long before the waypoints, and never be that fast
        return replace(
            found,
            complaint=f"its pace of {pace:g} m/s is above speed_max_m_s {setting.speed_max_m_s:g}",
            remedy="lower speed_m_s, or raise the limit",
        )
    if speed > setting.speed_max_m_s:
        return replace(
            found,
            complaint=f"it reaches {speed:.1f} m/s, above speed_max_m_s {setting.speed_max_m_s:g}",
            remedy="lower speed_m_s, or raise the limit",
        )
    return found
