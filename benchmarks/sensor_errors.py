"""What share of its error a sensor's latency or bias leaves: `python -m benchmarks.sensor_errors LOG...`, for `kinematics.MOST_LEFT`.

Of each log by kinematics: the latency of the velocity and the share of the mean square error that it leaves on stretches not used, as the
log was recorded, and with its velocity stamped so much later (`ADDED_S`); the upward bias of the accelerometer and the share that the whole
bias leaves, as recorded, and with so much more (`ADDED_M_S2`). A log without attitude, accelerometer and velocity is left out.
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
from flighttest.segments.compatibility import Compatibility

ADDED_S = (0.0, 0.03, 0.06, 0.1, 0.2, 0.35)
ADDED_M_S2 = (0.0, 0.25, 0.5, 1.0, 2.0)


def found(recording: Recording, late_s: float = 0.0, bias_m_s2: float = 0.0) -> Compatibility | None:
    """What kinematics show of a recording whose velocity is so much later, and whose accelerometer measures so much more upward."""
    v, f = recording.series["velocity"], recording.series["specific_force"]
    moved = {
        "velocity": Series(v.t_s + late_s, v.columns),
        "specific_force": Series(f.t_s, f.columns | {"f_z_m_s2": f.columns["f_z_m_s2"] + bias_m_s2}),
    }
    motion = prepare_motion(replace(recording, series={**recording.series, **moved}))
    return None if motion is None else motion.compatibility


def latency(recording: Recording, added_s: float) -> str:
    """'latency +- standard error, share left' in a cell; empty where kinematics show no latency."""
    made = found(recording, late_s=added_s)
    if made is None or not made.velocity_has_latency:
        return ""
    before, after = np.mean(made.errors_m2_s2, axis=0)
    return (
        f"{1000 * made.velocity_late_s:.0f} +- {1000 * made.velocity_late_std_s:.0f} ms, {100 * after / before:.0f} %"
    )


def bias(recording: Recording, added_m_s2: float) -> str:
    """'upward bias +- standard error, share left' in a cell."""
    made = found(recording, bias_m_s2=added_m_s2)
    if made is None or made.bias is None:
        return ""
    before, after = np.mean(made.bias.errors_m2_s4, axis=0)
    std = np.sqrt(made.bias.covariance[2][2])
    return f"{made.bias.value_m_s2[2]:.2f} +- {std:.2f} m/s^2, {100 * after / before:.0f} %"


def main() -> None:
    """One row per log, as it is read."""
    later = ["latency as recorded" if not s else f"{1000 * s:.0f} ms later" for s in ADDED_S]
    more = ["bias as recorded" if not b else f"{b:.2g} m/s^2 more" for b in ADDED_M_S2]
    print("| log | " + " | ".join((*later, *more)) + " |")
    print("|---|" + "---|" * (len(ADDED_S) + len(ADDED_M_S2)))
    for path in map(Path, sys.argv[1:]):
        try:
            recordings = open_recordings([path])
        except FlighttestError:
            continue
        for one in recordings:
            if {"velocity", "specific_force"} <= set(one.series) and found(one) is not None:
                cells = [*(latency(one, s) for s in ADDED_S), *(bias(one, b) for b in ADDED_M_S2)]
                print(f"| {one.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
