"""Free flight before it is flown: the outer loop follows the waypoints on the prior model, with the link lost now and then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flighttest.plan.fit_zone import DRIFT_S, SEARCH_STEP_S, Fitted, Setting, track_of
from flighttest.plan.rehearse import Row, rehearse
from flighttest.plan.room import Track
from flighttest.script.model import Reset
from flighttest.vehicle.model import Zone

LOSS_EVERY_S = 1.0


def fly_waypoints(f: Fitted, setting: Setting, reset: Reset, zone: Zone) -> Fitted:
    """The cell with its tracks in the zone's own coordinates (a path is not placed: it says where it is)."""
    path = f.cell.waypoints
    lead_s = sum(piece.duration_s for piece in f.lead)
    voltage = float(np.mean(setting.voltages_v))
    row = Row(
        f.lead,
        (),
        None,
        0.0,
        voltage,
        setting.stop_throttle(f.cell),
        start_m=(path[0][1], path[0][2], path[0][3]),
        waypoints=path,
    )
    moments = np.arange(LOSS_EVERY_S, lead_s, LOSS_EVERY_S)
    rows = [row, *(row.losing_link_at(float(t)) for t in moments)]
    flown = rehearse(rows, setting.predictor, SEARCH_STEP_S, DRIFT_S)
    origin = np.array(path[0][1:])
    tracks = []
    for j, one in enumerate(rows):
        track = track_of(flown, j, one)
        tracks.append(
            Track(
                track.t_s,
                track.p_m + origin,
                track.v_m_s,
                (track.reach_m[0] + path[0][3], track.reach_m[1] + path[0][3]),
            )
        )
    speed = float(np.linalg.norm(tracks[0].v_m_s, axis=1).max())
    found = replace(f, nominal=tracks[:1], lost=tracks[1:], speed_m_s=speed)
    if speed > setting.speed_max_m_s:
        return replace(
            found,
            complaint=f"it reaches {speed:.1f} m/s, above speed_max_m_s {setting.speed_max_m_s:g}",
            remedy="lower speed_m_s, or raise the limit",
        )
    return found
