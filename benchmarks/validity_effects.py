"""Does `status` see an effect that came: sealed pairs of rotor flights, sizes drawn and measured by the oracle.

    python -m benchmarks.validity_effects --first 6000 --vehicles 6 --effects 3 --folder /tmp/effects [--write docs/validity.md]

A vehicle flies a campaign, which is diagnosed and becomes its model. Then it flies the shipped spot check: unchanged, and with one effect
each of usual size times 0.7 to 2.5, every flight in noise, gusts and with a pack of its own. `status` judges without the truth. The oracle
measures the effect in noise floors of that spot check, from flights without noise. Can be stopped and continued; one JSON line per pair.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.page import write_block
from benchmarks.validity import CELL_V, interval, script
from flighttest.errors import FlighttestError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME, run_diagnosis, write_diagnosis
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.validity.status import Today, gather_evidence
from flighttest.proof.cases import NOT_HIDDEN, sized
from flighttest.proof.flying import fly_campaign, sealed_vehicle
from flighttest.proof.oracle import left, oracle_noise, size_in_floors
from flighttest.sim import SimOptions
from flighttest.sim.plants.rotor_effects import EFFECTS
from flighttest.sim.plants.rotor_vehicle import random_rotor
from flighttest.validity.model import ValidityVerdict

REFERENCE = ("thrust_hover", "roll_pitch", "yaw_rate")
# Conditions of a day leave a model as it is.
CANDIDATES = sorted(
    n for n, e in EFFECTS.items() if e.known and n not in (*NOT_HIDDEN, "steady_wind", "accelerometer_bias")
)
BANDS = ((0.0, 0.35), (0.35, 0.7), (0.7, 1.0), (1.0, 2.0), (2.0, math.inf))
MARK = "benchmarks/validity_effects.py"


def options(vehicle_seed: int, number: int, hide: Mapping[str, dict[str, float]], quiet: bool = False) -> SimOptions:
    """One flight of a vehicle. number: draws noise, gusts and pack; quiet: without noise and gusts."""
    rng = np.random.default_rng([vehicle_seed, number, 0x45])
    gusts, full = float(rng.choice([0.0, 0.2])), float(rng.uniform(*CELL_V))
    return SimOptions(
        airframe="rotor",
        seed=vehicle_seed * 100 + number,
        vehicle_seed=vehicle_seed,
        hide=hide,
        noise=0.0 if quiet else 1.0,
        gust_rms_m_s=0.0 if quiet else gusts,
        voltage_v=random_rotor(vehicle_seed).cells * full,
        ready_s=2.0,
        gps_s=4.0,
    )


def model_of(vehicle_seed: int, folder: Path) -> ModelFile:
    """The diagnosed model of a reference campaign, flown where it is not there yet."""
    path = folder / f"{vehicle_seed}-model"
    if not (path / MODEL_NAME).is_file():
        flown = folder / f"{vehicle_seed}-reference"
        if not flown.exists():
            fly_campaign(options(vehicle_seed, 0, {}), flown.with_suffix(".part"), script=script(REFERENCE))
            flown.with_suffix(".part").rename(flown)
        recordings, vehicle = open_recordings([flown]), sealed_vehicle(vehicle_seed)
        segments = cut_all(recordings)
        found = run_diagnosis(segments, recordings, None, vehicle)
        write_diagnosis(found, segments, recordings, vehicle, None, path)
    return model_file.read(path / MODEL_NAME)


def judged(
    stored: ModelFile, vehicle_seed: int, number: int, hide: dict[str, dict[str, float]], folder: Path
) -> dict[str, Any]:
    """Fly one spot check, ask `status`, then the oracle."""
    flown = folder / f"{vehicle_seed}-{number}"
    spot = script(("spot_check",))
    segments = fly_campaign(options(vehicle_seed, number, hide), flown, script=spot)
    found = gather_evidence(stored, Today(open_recordings([flown]), sealed_vehicle(vehicle_seed)))
    stated = {e.term: (e.smallest, e.hidden) for e in found.not_seen}
    name = next(iter(hide), "")
    row: dict[str, Any] = {
        "vehicle": vehicle_seed, "number": number, "hidden": name, "values": hide.get(name, {}), "verdict": found.verdict.name,
        "alarms": [t.subset for t in found.tests if t.alarm], "appeared": [a.term for a in found.appeared],
        "stated": stated.get(name), "smallest": {k: v for k, (v, _) in stated.items()},
    }  # fmt: skip
    if hide:
        nominal = random_rotor(vehicle_seed).nominal_voltage_v
        quiet = [
            fly_campaign(
                options(vehicle_seed, number, h, quiet=True), folder / f"{vehicle_seed}-{number}-{k}", script=spot
            )
            for k, h in enumerate((hide, {}))
        ]
        noise = oracle_noise(segments, quiet[0], nominal)
        without = left(quiet[1], noise, nominal)
        row["floors"] = size_in_floors(left(quiet[0], noise, nominal, near=without).less(without), noise)
    return row


def measured(first: int, vehicles: int, effects: int, folder: Path) -> list[dict[str, Any]]:
    """One row per pair; what is there already is not flown again."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "pairs.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(r["vehicle"], r["number"]) for r in rows}
    for seed in range(first, first + vehicles):
        names = np.random.default_rng([seed, 0x46]).choice(CANDIDATES, size=effects, replace=False)
        for number in range(1, effects + 2):
            if (seed, number) in done:
                continue
            rng = np.random.default_rng([seed, number, 0x47])
            hide = sized([str(names[number - 2])], seed, rng) if number > 1 else {}
            try:
                row = judged(model_of(seed, folder), seed, number, hide, folder)
            except FlighttestError as error:
                row = {"vehicle": seed, "number": number, "hidden": next(iter(hide), ""), "error": str(error)}
            rows.append(row)
            with path.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            print(json.dumps({k: v for k, v in row.items() if k != "smallest"}), flush=True)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The results as Markdown."""
    good = [r for r in rows if "verdict" in r]
    lines = ["| spot check | pairs | called stale | the effect named |", "|---|---|---|---|"]

    def line(words: str, mine: list[dict[str, Any]]) -> str:
        stale = [r for r in mine if r["verdict"] == ValidityVerdict.STALE.name]
        named = sum(r["hidden"] in r["appeared"] for r in mine)
        return f"| {words} | {len(mine)} | {interval(len(stale), len(mine))} | {named if mine and mine[0]['hidden'] else '-'} |"

    lines.append(line("unchanged", [r for r in good if not r["hidden"]]))
    for low, high in BANDS:
        mine = [r for r in good if r["hidden"] and low <= r["floors"] < high]
        words = f"{low:g} to {high:g}" if math.isfinite(high) else f"{low:g} and more"
        if mine:
            lines.append(line(f"an effect of {words} noise floors", mine))
    failed = [r for r in rows if "error" in r]
    seeds = sorted({r["vehicle"] for r in rows})
    lines += [
        "",
        f"{len(seeds)} vehicles (seeds {seeds[0]} to {seeds[-1]}), {len(rows)} pairs, {len(failed)} of them not flown.",
    ]
    missed = [r for r in good if r["hidden"] and r["floors"] >= 1.0 and r["verdict"] != ValidityVerdict.STALE.name]
    lines += [f"Not seen above 1 noise floor: {r['hidden']} of {r['floors']:.1f}." for r in missed]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=6000, help="seed of the first vehicle")
    parser.add_argument("--vehicles", type=int, default=6)
    parser.add_argument("--effects", type=int, default=3, help="spot checks with an effect, per vehicle")
    parser.add_argument("--folder", type=Path, required=True, help="where flights and results are kept")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="also put the table into this page")
    words = parser.parse_args()
    text = table(measured(words.first, words.vehicles, words.effects, words.folder))
    print(text)
    if words.write is not None:
        write_block(words.write, MARK, text + "\n")


if __name__ == "__main__":
    main()
