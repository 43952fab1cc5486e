"""What simpler answers would give, beside the model: hold the first value, only the delay, the paper's model, the previous model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flighttest.channels import REFERENCE_OF
from flighttest.diagnose.model import short
from flighttest.diagnose.selection.comparison import Fitted
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.responses import zero_order_hold
from flighttest.segments.model import Segment


def baselines(
    estimator: Estimator,
    base: Fitted,
    now: Fitted,
    segments: Sequence[Segment],
    previous: Mapping[str, tuple[float, float | None]],
) -> dict[str, dict[str, float]]:
    """Channel to baseline to RMSE in the channel's unit, all on the same samples."""
    found: dict[str, dict[str, float]] = {}
    delay = {
        "roll_rad": base.at.values.get("T_d_attitude", base.at.values.get("T_d", 0.1)),
        "r_rad_s": base.at.values.get("T_d_yaw_rate", base.at.values.get("T_d", 0.1)),
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
            if name in REFERENCE_OF and REFERENCE_OF[name] in segment.u:
                late.append(y - zero_order_hold(segment.u[REFERENCE_OF[name]], segment.t_s[sample] - delay[name]))
        entry = {"hold the first value": _rmse(np.concatenate(standing))}
        if late:
            entry["only the delay"] = _rmse(np.concatenate(late))
        entry["base model, refitted"] = _rmse(rows.unprofiled_residual[at])
        entry["with what was left out"] = _rmse(
            now.rows.unprofiled_residual[now.rows.channel == now.rows.channels.index(name)]
        )
        found[short(name)] = entry
    if previous:
        known = {k: float(v[0]) for k, v in previous.items() if k in base.at.values}
        there = estimator.fit(base.model, estimator.moved(base.model, base.at, known), (), noise=False)
        old = estimator.linearise(base.model, there, ())
        for c, name in enumerate(old.channels):
            at = np.flatnonzero(old.channel == c)
            if at.size:
                found.setdefault(short(name), {})["previous model, as it was"] = _rmse(old.unprofiled_residual[at])
    return found


def _rmse(x: Any) -> float:
    return float(np.sqrt(np.mean(np.asarray(x) ** 2)))
