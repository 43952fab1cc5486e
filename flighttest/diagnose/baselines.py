"""What simpler answers would give, beside the model: hold the first value, only the delay, the paper's model, the previous model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flighttest.diagnose.bench import Bench
from flighttest.diagnose.fitted import Fitted
from flighttest.diagnose.model import short
from flighttest.diagnose.rows import Rows
from flighttest.estimation.responses import zero_order_hold as held
from flighttest.segments.model import Segment

REFERENCE = {"roll_rad": "roll_ref_rad", "pitch_rad": "pitch_ref_rad", "r_rad_s": "yaw_rate_ref_rad_s"}


def baselines(
    bench: Bench,
    base: Fitted,
    now: Fitted,
    segments: Sequence[Segment],
    previous: Mapping[str, tuple[float, float | None]],
) -> dict[str, dict[str, float]]:
    """Channel to baseline to RMSE in the channel's unit, all on the same samples."""
    found: dict[str, dict[str, float]] = {}
    delay = {
        "roll_rad": base.state.values.get("T_d_attitude", base.state.values.get("T_d", 0.1)),
        "r_rad_s": base.state.values.get("T_d_yaw_rate", base.state.values.get("T_d", 0.1)),
    }
    delay["pitch_rad"] = delay["roll_rad"]
    rows = base.rows
    for c, name in enumerate(rows.channels):
        at = np.flatnonzero(rows.channel == c)
        if not at.size:
            continue
        standing, late = [], []
        for i in np.unique(rows.segment[at]):
            segment = segments[int(i)]
            sample = rows.sample[at][rows.segment[at] == i]
            y = np.asarray(segment.y[name])[sample]
            standing.append(y - y[: min(4, y.size)].mean())
            if name in REFERENCE and REFERENCE[name] in segment.u:
                late.append(y - held(segment.u[REFERENCE[name]], segment.t_s[sample] - delay[name]))
        entry = {"hold the first value": _rmse(np.concatenate(standing))}
        if late:
            entry["only the delay"] = _rmse(np.concatenate(late))
        entry["base model, refitted"] = _rmse(rows.open_residual[at])
        entry["with what was left out"] = _rmse(
            now.rows.open_residual[now.rows.channel == now.rows.channels.index(name)]
        )
        found[short(name)] = entry
    if previous:
        known = {k: float(v[0]) for k, v in previous.items() if k in base.state.values}
        old: Rows | Any = bench.rows(
            base.model, bench.fit(base.model, bench.moved(base.model, base.state, known), (), iterations=3), ()
        )
        for c, name in enumerate(old.channels):
            at = np.flatnonzero(old.channel == c)
            if at.size:
                found.setdefault(short(name), {})["previous model, as it was"] = _rmse(old.open_residual[at])
    return found


def _rmse(x: Any) -> float:
    return float(np.sqrt(np.mean(np.asarray(x) ** 2)))
