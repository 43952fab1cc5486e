"""Currency on sealed pairs of rotor campaigns: detection, false alarms and the subset named. `python benchmarks/currency.py --pairs 20`.

Each pair is one vehicle: a campaign for the stored model, then a second one, unchanged or with one change, in another wind (0 to 4 m/s) and
with another pack. Prints one line per kind and writes every pair as JSON lines, so that runs can be added up.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections import Counter
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from flighttest.currency.compare import Estimates, subset_tests
from flighttest.errors import FlighttestError
from flighttest.identify.fit import fit
from flighttest.identify.model_file import ModelFile, from_fit
from flighttest.physics.model import Model
from flighttest.pipeline.currency import reestimate_segments, tested_part
from flighttest.proof.flying import fly_campaign
from flighttest.script.shipped import resolve
from flighttest.segments import Segment
from flighttest.sim import SimOptions
from flighttest.sim.rotor_vehicle import random_rotor

# What changes, as constants of the rotor vehicle (factor on each), and the subset an operator should be told.
CHANGES: dict[str, tuple[dict[str, float], str]] = {
    "none": ({}, ""),
    "thrust -5 %": ({"hover_throttle": 1.0 / 0.95}, "thrust"),
    "mass +8 %": ({"mass_kg": 1.08, "hover_throttle": 1.08}, "thrust"),
    "attitude 20 % slower": ({"omega_roll": 0.8, "omega_pitch": 0.8}, "attitude"),
}
CAMPAIGN = {"thrust_hover": 1, "roll_pitch": 1, "yaw_rate": 1}
SPOT = {"spot_check": 1}
VEHICLES = 1000  # seed of the first vehicle


def script(name: str, repeats: int) -> str:
    data = yaml.safe_load(resolve(name).read_text(encoding="utf-8"))
    data["repeat"] = {**data.get("repeat", {}), "each": repeats}
    data["repeat"].pop("over_voltage_v", None)
    data.setdefault("limits", {})["height_m"] = [1, 14]
    return str(yaml.safe_dump(data, sort_keys=False))


def flown(vehicle_seed: int, seed: int, factors: dict[str, float], scripts: dict[str, int]) -> list[Segment]:
    rng = np.random.default_rng(seed)
    frame = random_rotor(vehicle_seed)
    wind, to = rng.uniform(0.0, 4.0), rng.uniform(0.0, 2 * math.pi)
    segments: list[Segment] = []
    for k, (name, repeats) in enumerate(scripts.items()):
        options = SimOptions(
            airframe="rotor",
            seed=seed * 10 + k,
            vehicle_seed=vehicle_seed,
            vehicle={n: getattr(frame, n) * f for n, f in factors.items()},
            hide={"steady_wind": {"w_north": wind * math.cos(to), "w_west": wind * math.sin(to)}},
            gust_rms_m_s=0.1 * wind,
            voltage_v=frame.cells * rng.uniform(3.75, 4.1),
        )
        with tempfile.TemporaryDirectory() as folder:
            segments += [s for s in fly_campaign(options, Path(folder), script(name, repeats)) if s.usable]
    return segments


@lru_cache(maxsize=1)
def stored_model(index: int) -> ModelFile:
    nominal = random_rotor(VEHICLES + index).nominal_voltage_v
    return from_fit(fit(flown(VEHICLES + index, 100 * index, {}, CAMPAIGN), Model(nominal_voltage_v=nominal)))


def pair(index: int, kind: str, scripts: dict[str, int]) -> dict[str, object]:
    factors, wanted = CHANGES[kind]
    stored = stored_model(index)
    flight_seed = 100 * index + 1 + list(CHANGES).index(kind)
    new = reestimate_segments(stored, flown(VEHICLES + index, flight_seed, factors, scripts), "new")
    names, values, matrix = tested_part(stored)
    base = Estimates("model", names, values, matrix)
    tests = subset_tests(base, new)
    return {
        "index": index,
        "kind": kind,
        "scripts": sorted(scripts),
        "alarms": [t.subset for t in tests if t.alarm],
        "wanted": wanted,
        "shifts": {n: c for t in tests for n, (c, _) in t.shifts.items()},
        "z": {n: z for t in tests for n, (_, z) in t.shifts.items()},
        "std": {
            n: [
                float(np.sqrt(e.covariance[e.names.index(n), e.names.index(n)]) / abs(e.values[e.names.index(n)]))
                for e in (base, new)
                if n in e.names
            ]
            for n in base.names
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--pairs", type=int, default=10, help="of each kind")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--spot", action="store_true", help="the second flight is the spot check")
    parser.add_argument("--kinds", nargs="*", default=list(CHANGES))
    parser.add_argument("--out", type=Path, default=Path("currency.jsonl"))
    words = parser.parse_args()
    found: Counter[str] = Counter()
    placed: Counter[str] = Counter()
    tried: Counter[str] = Counter()
    with words.out.open("a") as log:
        for index in range(words.first, words.first + words.pairs):
            for kind in words.kinds:
                try:
                    row = pair(index, kind, SPOT if words.spot else CAMPAIGN)
                except FlighttestError as error:
                    print(f"{index} {kind}: {error}")
                    continue
                log.write(json.dumps(row) + "\n")
                log.flush()
                tried[kind] += 1
                found[kind] += bool(row["alarms"])
                placed[kind] += row["alarms"] == [row["wanted"]]
                shifts = {n: f"{100 * c:+.1f}" for n, c in dict(row["shifts"]).items()}  # type: ignore[call-overload]
                print(index, kind, row["alarms"], shifts, flush=True)
    for kind in words.kinds:
        print(f"{kind}: alarms {found[kind]} of {tried[kind]}, right subset alone {placed[kind]}")


if __name__ == "__main__":
    main()
