"""Do the intervals hold the truth? `python -m benchmarks.coverage [--seeds 20] [--first 100]`.

The built-in vehicle flies thrust, roll_pitch and yaw_rate in this process, once per seed (half a minute each); what was recorded is cut and
fitted, and every parameter's 95 % interval is held against Table 2.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from flighttest.flight.fly import fly
from flighttest.identify.fit import fit
from flighttest.pipeline.planning.checking import plans, predictor_for
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.proof.flying import InProcessTransport
from flighttest.script.load import PARAMETERS
from flighttest.segments import Segment, cut
from flighttest.sim import SimOptions
from flighttest.sim.plants.plant_paper import PaperParameters
from flighttest.vehicle.model import DEFAULT_VEHICLE

SCRIPTS = ("thrust", "roll_pitch", "yaw_rate")
CHANNELS = ("T_d_attitude", "T_d_yaw_rate", "T_d_thrust")


def campaign(seed: int) -> list[Segment]:
    """What was cut from one campaign."""
    compiled = plans(SCRIPTS, DEFAULT_VEHICLE, predictor_for(None, DEFAULT_VEHICLE))
    with tempfile.TemporaryDirectory() as folder:
        runs = [Path(folder) / plan.script.name for plan in compiled]
        for k, (plan, run) in enumerate(zip(compiled, runs, strict=True)):
            options = SimOptions(airframe="paper", seed=1000 * seed + k, lockstep=True)
            fly(plan, "sim", run, transport=InProcessTransport(options))
        return [s for recording in open_recordings(runs) for s in cut(recording)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    asked = parser.parse_args()
    table = PaperParameters()
    truth = {n: float(getattr(table, n if n in PARAMETERS else "T_d")) for n in (*PARAMETERS, *CHANNELS)}
    errors, claimed, held = [], [], []
    for seed in range(asked.first, asked.first + asked.seeds):
        found = fit(campaign(seed)).estimates
        unknown = [n for n in truth if not found[n].identifiable]
        print(f"seed {seed}: not known: {', '.join(unknown) or 'none'}", file=sys.stderr, flush=True)
        errors.append([found[n].value - v for n, v in truth.items()])
        claimed.append([found[n].std or np.nan for n in truth])
        interval = {n: found[n].interval_95 or (np.inf, -np.inf) for n in truth}
        held.append([interval[n][0] <= v <= interval[n][1] for n, v in truth.items()])
    error, std, inside = np.array(errors), np.array(claimed), np.array(held)
    values = np.array(list(truth.values()))
    print("| parameter | interval holds | worst error | bias / std | spread / std |\n|---|---|---|---|---|")
    for i, name in enumerate(truth):
        z = error[:, i] / std[:, i]
        worst = 100 * np.max(np.abs(error[:, i])) / values[i]
        print(f"| {name} | {100 * inside[:, i].mean():.0f} % | {worst:.2f} % | {z.mean():+.2f} | {z.std():.2f} |")
    print(
        f"\n{asked.seeds} seeds, {len(PARAMETERS)} parameters pooled: "
        f"{100 * inside[:, : len(PARAMETERS)].mean():.1f} % of the intervals hold the truth."
    )


if __name__ == "__main__":
    main()
