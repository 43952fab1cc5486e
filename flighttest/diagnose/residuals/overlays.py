"""The responses where the base model is worst: measured, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flighttest.channels import CHANNELS
from flighttest.diagnose.model import short
from flighttest.diagnose.records import Overlay
from flighttest.estimation.linearisation import Linearisation
from flighttest.segments.model import Segment

WORST = 2  # per channel


def overlays(before: Linearisation, after: Linearisation, segments: Sequence[Segment]) -> list[Overlay]:
    """Per channel, the responses with the largest mean square: time since the step, measured, and both predictions."""
    found: list[Overlay] = []
    for c, name in enumerate(before.channels):
        at = before.channel == c
        count = np.bincount(before.segment[at], minlength=len(segments))
        power = np.bincount(
            before.segment[at], before.unprofiled_residual[at] ** 2, minlength=len(segments)
        ) / np.maximum(count, 1)
        for i in np.argsort(-power)[:WORST]:
            rows = np.flatnonzero(at & (before.segment == i))
            if rows.size < 3:
                continue
            rows = rows[np.argsort(before.sample[rows])]
            segment = segments[int(i)]
            sample = before.sample[rows]
            measured = np.asarray(segment.y[name])[sample]
            found.append(
                {
                    "channel": short(name), "unit": CHANNELS[name].unit, "segment": segment.name, "kind": segment.kind,
                    "t_s": (segment.t_s[sample] - segment.t_step_s).tolist(), "measured": measured.tolist(),
                    "before": (measured - before.unprofiled_residual[rows]).tolist(),
                    "after": (measured - after.unprofiled_residual[rows]).tolist(),
                }
            )  # fmt: skip
    return found
