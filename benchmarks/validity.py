"""Validity on sealed pairs of rotor flights: detection, false alarms and the subset named.

    python benchmarks/validity.py fly --first 5000 --vehicles 40 --folder /tmp/pairs
    python benchmarks/validity.py judge --folder /tmp/pairs --write docs/validity.md

`fly` draws vehicles and keeps what was cut from their flights: one reference campaign each, and against it campaigns and spot checks,
unchanged or with one change, every one in another wind (0 to 4 m/s, gusts of 15 % of it) with other packs over their whole voltage
range. It can be stopped and continued. Every pair of a kind is another vehicle, so that the pairs are independent. `judge` sees nothing of
the truth while it compares, and needs two seconds per pair.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import pickle
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import stats

from flighttest.errors import FlighttestError
from flighttest.identify.fit import fit
from flighttest.identify.models.model_file import ModelFile, from_fit
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import for_later_flights
from flighttest.pipeline.recordings.batteries import battery_of
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.store.history import watched
from flighttest.pipeline.validity.status import discrepancy_allowed, matched_pairs, reestimate_segments
from flighttest.proof.flying import fly_campaign
from flighttest.recording import Provenance, Recording, Series
from flighttest.script.shipped import resolve
from flighttest.segments import Segment
from flighttest.sim import SimOptions
from flighttest.sim.plants.rotor_vehicle import random_rotor
from flighttest.validity.battery import check_resistance
from flighttest.validity.compare import subset_tests

# What changes, as factors on constants of the rotor vehicle. A payload divides the drag per mass and keeps the current for a thrust.
HEAVIER = 1.08
CHANGES: dict[str, dict[str, float]] = {
    "unchanged": {},
    "thrust -5 %": {"hover_throttle": 1.0 / 0.95},
    "mass +8 %": {
        "mass_kg": HEAVIER,
        "hover_throttle": HEAVIER,
        "hover_current_a": HEAVIER**1.5,
        **{f"drag_{axis}_1_s": 1.0 / HEAVIER for axis in "xyz"},
    },
    "attitude 20 % slower": {"omega_roll": 0.8, "omega_pitch": 0.8},
    "resistance +20 %": {"resistance_ohm": 1.2},
}
# The subset an operator should be shown; None: only the battery's monitor may alarm.
TOUCHED: dict[str, str | None] = {
    "unchanged": None,
    "thrust -5 %": "thrust",
    "mass +8 %": "thrust",
    "attitude 20 % slower": "attitude",
    "resistance +20 %": None,
}
# Shipped scripts of each flight, flown in one go. A model's own campaign is flown over a span of voltage, as the shipped `thrust` asks:
# with a pack from the upper and one from the lower half of the range.
EXTENTS: dict[str, tuple[tuple[str, ...], ...]] = {
    "reference": (("thrust_hover", "roll_pitch", "yaw_rate"), ("thrust_hover",)),
    "campaign": (("thrust_hover", "roll_pitch", "yaw_rate"),),
    "spot": (("spot_check",),),
}
CELL_V = (3.65, 4.15)  # at rest; the load takes another 0.1 to 0.2 V off
WIND_M_S = 4.0


@dataclass(frozen=True)
class Flown:
    """What the program under test may see of one campaign: responses, and the battery of each flight."""

    segments: tuple[Segment, ...]
    batteries: tuple[Series, ...]


def script(names: Sequence[str]) -> str:
    """Shipped scripts as one, every step once, with more air below and above, so that no draw of a vehicle lacks space."""
    parts = [yaml.safe_load(resolve(name).read_text(encoding="utf-8")) for name in names]
    data = dict(parts[0])
    data["steps"] = [step for part in parts for step in part["steps"]]
    data["repeat"] = {"each": 1, "order": "interleaved"}
    data["limits"] = {**data["limits"], "height_m": [1, 14]}
    data["reset"] = {**data["reset"], "settle_s": 1}
    return str(yaml.safe_dump(data, sort_keys=False))


def fly(vehicle_seed: int, number: int, kind: str, extent: str) -> Flown:
    """One campaign of a vehicle. number: of the campaign, 0 is the reference; it draws wind, packs and noise."""
    rng = np.random.default_rng([vehicle_seed, number, 0x43])
    frame = random_rotor(vehicle_seed)
    wind, to = rng.uniform(0.0, WIND_M_S), rng.uniform(0.0, 2 * math.pi)
    segments: list[Segment] = []
    batteries: list[Series] = []
    flights = EXTENTS[extent]
    for k, names in enumerate(flights):
        full = 1.0 - (k + rng.uniform(0.0, 1.0)) / len(flights)
        options = SimOptions(
            airframe="rotor",
            seed=(vehicle_seed * 100 + number) * 10 + k,
            vehicle_seed=vehicle_seed,
            vehicle={n: getattr(frame, n) * f for n, f in CHANGES[kind].items()},
            hide={"steady_wind": {"w_north": wind * math.cos(to), "w_west": wind * math.sin(to)}},
            gust_rms_m_s=0.15 * wind,
            voltage_v=frame.cells * (CELL_V[0] + full * (CELL_V[1] - CELL_V[0])),
            ready_s=2.0,
            gps_s=4.0,
        )
        with tempfile.TemporaryDirectory() as folder:
            segments += fly_campaign(options, Path(folder), script=script(names))
            batteries += [r.series["battery"] for r in open_recordings([Path(folder)]) if "battery" in r.series]
    return Flown(tuple(segments), tuple(batteries))


def planned(kinds: Sequence[str]) -> Iterator[tuple[int, str, str]]:
    """Number, kind and extent of a vehicle's campaigns, the reference first."""
    yield 0, "unchanged", "reference"
    for i, kind in enumerate(CHANGES):
        if kind in kinds:
            yield 1 + i, kind, "campaign"
            yield 11 + i, kind, "spot"


def fly_all(first: int, vehicles: int, kinds: Sequence[str], folder: Path) -> None:
    """Fly what is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for vehicle_seed in range(first, first + vehicles):
        for number, kind, extent in planned(kinds):
            path = folder / f"{vehicle_seed}-{number:02d}.pkl.gz"
            if path.exists():
                continue
            flown, error = Flown((), ()), ""
            try:
                flown = fly(vehicle_seed, number, kind, extent)
            except FlighttestError as refusal:
                error = str(refusal)
            packed = gzip.compress(pickle.dumps((kind, extent, flown.segments, flown.batteries, error)), 3)
            path.with_suffix(".part").write_bytes(packed)
            path.with_suffix(".part").rename(path)
            print(vehicle_seed, number, kind, extent, error, flush=True)


def judged(stored: ModelFile, own: Flown, new: Flown) -> dict[str, Any]:
    """What the program reports of a campaign: subsets that raise an alarm, the battery's alarm, and the relative change of each
    parameter."""
    base = watched(stored, "model")
    usable = [s for s in new.segments if s.usable]
    found, _ = reestimate_segments(stored, usable, "new")
    tests = subset_tests(
        base, found, spread=discrepancy_allowed(stored, base, ()), matched=matched_pairs(stored, base, usable)
    )
    before = battery_of([recorded(b) for b in own.batteries])
    battery = check_resistance(
        battery_of([recorded(b) for b in new.batteries]), None if isinstance(before, str) else before
    )
    return {
        "alarms": [t.subset for t in tests if t.alarm],
        "battery": battery.alarm,
        "p": {t.subset: t.p_value for t in tests},
        "shifts": {n: shift for t in tests for n, (shift, _) in t.shifts.items()},
        "alike": {t.subset: t.matched for t in tests},
        "detectable": {n: size for t in tests for n, size in t.detectable.items()},
    }


def recorded(battery: Series) -> Recording:
    """A recording that holds nothing but its battery."""
    return Recording("flight", {"battery": battery}, (), Provenance("", "flight"))


def modelled(vehicle_seed: int, flown: Flown) -> ModelFile:
    """The stored model of a reference campaign, as `flighttest run` would keep it."""
    model = Model(nominal_voltage_v=random_rotor(vehicle_seed).nominal_voltage_v)
    found = fit([s for s in flown.segments if s.usable], model)
    return replace(from_fit(found), fit_quality=for_later_flights(found))


def kept(path: Path) -> tuple[str, str, Flown, str]:
    """Kind, extent, what was flown, and why it was not."""
    kind, extent, segments, batteries, error = pickle.loads(gzip.decompress(path.read_bytes()))
    return kind, extent, Flown(tuple(segments), tuple(batteries)), error


def judge_all(folder: Path) -> list[dict[str, Any]]:
    """Judge what was not judged yet; one JSON line per pair of a vehicle's reference with another of its flights."""
    rows_path = folder / "pairs.jsonl"
    rows = [json.loads(line) for line in rows_path.read_text().splitlines()] if rows_path.exists() else []
    done = {(r["vehicle"], r["number"]) for r in rows}
    for path in sorted(folder.glob("*-00.pkl.gz")):
        seed = int(path.name.split("-")[0])
        todo = [p for p in sorted(folder.glob(f"{seed}-*.pkl.gz")) if p != path and (seed, number_of(p)) not in done]
        _, _, own, refused = kept(path)
        if not todo or refused:
            continue
        stored = modelled(seed, own)
        for each in todo:
            kind, extent, new, error = kept(each)
            row: dict[str, Any] = {"vehicle": seed, "number": number_of(each), "kind": kind, "extent": extent}
            try:
                row |= {"error": error} if error else judged(stored, own, new)
            except FlighttestError as refusal:
                row["error"] = str(refusal)
            rows.append(row)
            with rows_path.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            print(row["vehicle"], kind, extent, row.get("alarms"), row.get("battery"), row.get("error", ""), flush=True)
    return rows


def number_of(path: Path) -> int:
    """The campaign's number, from the name of its file."""
    return int(path.name.split("-")[1].split(".")[0])


def interval(found: int, of: int) -> str:
    """'39 of 40 (87 to 100 %)': Clopper and Pearson's 95 % interval."""
    if not of:
        return "-"
    low = stats.beta.ppf(0.025, found, of - found + 1) if found else 0.0
    high = stats.beta.ppf(0.975, found + 1, of - found) if found < of else 1.0
    return f"{found} of {of} ({100 * low:.0f} to {100 * high:.0f} %)"


def table(rows: list[dict[str, Any]]) -> str:
    """The results as Markdown."""
    good = [r for r in rows if "alarms" in r]
    lines = ["| change | second flight | detected | right subset alone, of those detected |", "|---|---|---|---|"]
    for kind in (k for k in CHANGES if k != "unchanged"):
        for extent in ("campaign", "spot"):
            mine = [r for r in good if (r["kind"], r["extent"]) == (kind, extent)]
            if not mine:
                continue
            wanted = [] if TOUCHED[kind] is None else [TOUCHED[kind]]
            hits = [r for r in mine if (r["alarms"] if wanted else r["battery"])]
            right = [r for r in hits if r["alarms"] == wanted]
            lines.append(
                f"| {kind} | {WORDS[extent]} | {interval(len(hits), len(mine))} | {interval(len(right), len(hits))} |"
            )
    lines += ["", "| unchanged vehicle | pairs | model called stale | battery called another |", "|---|---|---|---|"]
    for extent in ("campaign", "spot"):
        still = [r for r in good if r["extent"] == extent and TOUCHED[r["kind"]] is None]
        same = [r for r in good if r["extent"] == extent and r["kind"] != "resistance +20 %"]
        alarms = interval(sum(bool(r["alarms"]) for r in still), len(still))
        battery = interval(sum(r["battery"] for r in same), len(same))
        lines.append(f"| {WORDS[extent]} | {len(still)} | {alarms} | {battery} |")
    failed = [r for r in rows if "error" in r]
    vehicles = sorted({r["vehicle"] for r in rows})
    lines += [
        "",
        f"{len(vehicles)} vehicles (seeds {vehicles[0]} to {vehicles[-1]}), {len(rows)} pairs, {len(failed)} of them not judged"
        + "".join(f"; {r['kind']}, {WORDS[r['extent']]}: {r['error'].splitlines()[0]}" for r in failed[:3])
        + ".",
    ]
    return "\n".join(lines)


WORDS = {"campaign": "campaign", "spot": "two-minute spot check"}
BEGIN, END = "<!-- measured: benchmarks/validity.py -->", "<!-- end -->"


def write(page: Path, text: str) -> None:
    """Put the tables between the marks of a page."""
    whole = page.read_text(encoding="utf-8")
    head, rest = whole.split(BEGIN, 1)
    page.write_text(f"{head}{BEGIN}\n{text}\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["fly", "judge"])
    parser.add_argument("--first", type=int, default=5000, help="seed of the first vehicle")
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--kinds", nargs="*", default=list(CHANGES), choices=list(CHANGES), help="changes to fly")
    parser.add_argument("--folder", type=Path, required=True, help="where flights and results are kept")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="also put the tables into this page")
    words = parser.parse_args()
    if words.what == "fly":
        fly_all(words.first, words.vehicles, words.kinds, words.folder)
        return
    rows = judge_all(words.folder)
    text = table(rows)
    print(text)
    if words.write is not None:
        write(words.write, text)


if __name__ == "__main__":
    main()
