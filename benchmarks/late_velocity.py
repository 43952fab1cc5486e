"""What share of a velocity's error a latency leaves: `python -m benchmarks.late_velocity LOG...`, for `diagnose.kinematics.MOST_LEFT`.

Of each log: the latency found by kinematics and the share of the mean square error that it leaves on stretches not used, as the log was
recorded, and with its velocity stamped so much later (`ADDED_S`). A log without attitude, accelerometer and velocity is left out.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.errors import FlighttestError
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.recording import Recording, Series
from flighttest.segments.align import prepare_motion

ADDED_S = (0.0, 0.03, 0.06, 0.1, 0.2, 0.35)


def left(recording: Recording, added_s: float) -> str:
    """'latency +- standard error, share left' in a cell; empty where kinematics show no latency."""
    v = recording.series["velocity"]
    series = {**recording.series, "velocity": Series(v.t_s + added_s, v.columns)}
    motion = prepare_motion(replace(recording, series=series))
    found = None if motion is None else motion.compatibility
    if found is None or not found.velocity_has_latency:
        return ""
    before, after = np.mean(found.errors_m2_s2, axis=0)
    return (
        f"{1000 * found.velocity_late_s:.0f} +- {1000 * found.velocity_late_std_s:.0f} ms, {100 * after / before:.0f} %"
    )


def main() -> None:
    """One row per log, as it is read."""
    print("| log | " + " | ".join("as recorded" if not s else f"{1000 * s:.0f} ms later" for s in ADDED_S) + " |")
    print("|---|" + "---|" * len(ADDED_S))
    for path in map(Path, sys.argv[1:]):
        try:
            recordings = open_recordings([path])
        except FlighttestError:
            continue
        for one in recordings:
            motion = prepare_motion(one) if "velocity" in one.series else None
            if motion is not None and motion.compatibility is not None:
                print(f"| {one.name} | " + " | ".join(left(one, s) for s in ADDED_S) + " |", flush=True)


if __name__ == "__main__":
    main()
