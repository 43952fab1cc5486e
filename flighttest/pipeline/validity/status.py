"""`flighttest status`: the stored model against today's vehicle and new recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flighttest.diagnose import Diagnosis
from flighttest.errors import FitError, InputError
from flighttest.estimation.solver import Start
from flighttest.identify.fit import Fit
from flighttest.identify.fit import fit as identify
from flighttest.identify.fixed_parameters import stored_noise
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.identify.selection import problem_of
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.recordings.batteries import battery_of, battery_reference
from flighttest.pipeline.recordings.fingerprints import of_recordings, of_vehicle
from flighttest.pipeline.recordings.sources import RecordingSource, named, open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import rerun_options
from flighttest.pipeline.store.history import campaigns, watched, when
from flighttest.pipeline.store.identities import NAME_IT, whose
from flighttest.pipeline.store.lineage import in_use
from flighttest.pipeline.validity.evidence import (
    NOT_DIAGNOSED,
    appeared,
    as_old,
    doubtful,
    effects,
    not_seen,
    shows_more,
    subsets_of,
    untested,
    untested_sentences,
)
from flighttest.pipeline.validity.reflights import reflights
from flighttest.pipeline.vehicles.live import LiveVehicle
from flighttest.recording import Recording
from flighttest.report.numbers import join, paths
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.sections.validity import status_document
from flighttest.segments import Segment
from flighttest.validity import matched_pair
from flighttest.validity.assess import RecordingEvidence, assess
from flighttest.validity.between_campaigns import prior
from flighttest.validity.compare import Estimates, MatchedPairs
from flighttest.validity.hover import Hover, hover
from flighttest.validity.matched_pair import DELAY_S
from flighttest.validity.model import Assessment, ValidityVerdict
from flighttest.validity.motor_load import MotorLoad, motor_load
from flighttest.vehicle.fingerprint import FingerprintData, fingerprint
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import Vehicle

ALPHA_DETERMINED = 2.0
VAGUE = 0.2  # relative standard error beyond which the stored value serves better
ENOUGH_HISTORY = 5  # unchanged campaigns after which the vehicle's own scatter replaces the stated allowance


def status(
    runs: Sequence[RecordingSource],
    vehicle: Path | None,
    model: Path | ModelFile | None,
    out: Path,
    output: Path | None = None,
    progress: Progress = SILENT,
    present: LiveVehicle | None = None,
) -> Result:
    """Current, stale or unknown; what changed; what to fly. RUNS together are one campaign; present: the vehicle as it is now."""
    declared = load_vehicle(vehicle, to_fly=False) if vehicle is not None else None
    recordings = open_recordings(runs, progress=progress)
    name = whose(recordings, declared, out)
    if model is not None:
        stored = model_file.read(model) if isinstance(model, Path) else model
        _one_vehicle(stored, name)
        name = name or stored.vehicle_name
    elif recordings and not name:
        raise InputError(
            f"{join([named(r) for r in runs])}: of an unknown vehicle", f"{NAME_IT}, or name a model with --model"
        )
    else:
        stored = in_use(out, name)
        name = name or stored.vehicle_name
    found = gather_evidence(stored, Today(recordings, declared, name, out, present), progress)
    flown = [*(out / r for r in map(str, stored.runs)), *(r for r in runs if isinstance(r, Path))]
    page = Page(output, rerun_options(flown, out, vehicle))
    return status_result(found, stored, declared, [named(r) for r in runs], page, present)


def _one_vehicle(stored: ModelFile, name: str) -> None:
    """InputError where a model is of another vehicle than the one that is asked about."""
    if name and stored.vehicle_name and name != stored.vehicle_name:
        raise InputError(f"{stored.path} is a model of {stored.vehicle_name}, not of {name}", f"name a model of {name}")


@dataclass(frozen=True)
class Today:
    """What is known of a vehicle today. recordings: one new campaign, possibly none; vehicle: as declared; name: the vehicle's; out: where
    its earlier campaigns may lie; present: the vehicle as it is now, which counts more than the recordings."""

    recordings: Sequence[Recording] = ()
    vehicle: Vehicle | None = None
    name: str = ""
    out: Path | None = None
    present: LiveVehicle | None = None


def gather_evidence(
    stored: ModelFile, now: Today, progress: Progress = SILENT, diagnosed: Diagnosis | None = None
) -> Assessment:
    """All the evidence. diagnosed: the new recordings from this model on, found here where it is not given."""
    recordings, vehicle, name, out, present = now.recordings, now.vehicle, now.name, now.out, now.present
    subsets = subsets_of(stored.model)
    tested = [n for names in subsets.values() for n in names]
    base = watched(stored, "model", tested)
    today = today_fingerprint(recordings, vehicle)
    if present is not None:
        reached = fingerprint(None, present.firmware, present.parameters).as_data()
        today = {**(today or {}), **reached}
    untestable: list[str] = []
    series: list[Estimates] = []
    new = {r.name for r in recordings}
    known = campaigns(out, name) if out is not None and name else []
    earlier = [c.estimates for c in known if c.follows(stored) and not new & set(map(str, c.model.runs))]
    segments = cut_all(recordings, progress) if recordings else ()
    whole = [s for s in segments if s.usable]
    usable = comparable(stored, whole)
    paired = None
    stds: dict[str, float | None] = {}
    if recordings:
        shorter = any(new is not old for new, old in zip(usable, whole, strict=True))
        if usable and (diagnosed is None or (shorter and shows_more(diagnosed, stored))):
            diagnosed = effects(usable, recordings, stored, vehicle, progress)
        try:
            again, stds = reestimate(stored, usable, recordings[-1].name, progress)
            series = [*earlier, again]
            paired = matched_pairs(stored, base, usable)
        except FitError as error:
            untestable.append(f"the new recordings could not be fitted: {error.message}")
    sought = diagnosed if stored.diagnosed else None  # what one that was never diagnosed lacks may be as old as it is
    load = stored_motors(stored), motor_load(usable)
    if load[0] is not None and usable and load[1] is None:
        untestable.append("motors: the commands of four motors were not recorded")
    battery = battery_of(recordings) if recordings else None
    spread = discrepancy_allowed(stored, base, earlier)
    found = assess(
        model_fingerprint=stored.fingerprint,
        vehicle_fingerprint=today,
        stored=base,
        new=RecordingEvidence(
            runs=series,
            matched=paired,
            spread=spread,
            battery=battery,
            battery_reference=battery_reference(stored),
            hovers=(stored_hover(stored), hover(usable, stored.model.nominal_voltage_v)),
            motors=load,
            untestable=untestable,
            appeared=appeared(sought, stored) if sought is not None else (),
            doubtful=doubtful(sought, stored) if sought is not None else "",
            not_seen=not_seen(sought, stored) if sought is not None else (),
        ),
        subsets=subsets,
    )
    missed = untested(stored, subsets, found.tests, stds, spread) if recordings else ()
    since = flown_until(stored)
    return replace(
        found,
        changes=tuple(c if c.since else replace(c, since=since) for c in found.changes),
        cannot_tell=(
            *untested_sentences(missed),
            *found.cannot_tell,
            *(as_old(sought, stored) if sought is not None else ()),
            *((NOT_DIAGNOSED,) if usable and not stored.diagnosed else ()),
        ),
        untested=missed,
    )


def comparable(stored: ModelFile, segments: Sequence[Segment]) -> list[Segment]:
    """New responses as far as the model's own flights looked after such steps."""
    return list(matched_pair.as_long_as(matched_pair.matched_pairs_from(stored.fit_quality.get("steps")), segments))


def stored_hover(stored: ModelFile) -> Hover | None:
    """The throttle that held height in a model's flights, where it was kept."""
    kept = stored.fit_quality.get("hover")
    if not isinstance(kept, Mapping):
        return None
    try:
        volts = kept.get("log_voltage")
        there = None if volts is None else float(volts)
        return Hover(float(kept["throttle"]), float(kept["std"]), float(kept["dof"]), there)
    except (KeyError, TypeError, ValueError):
        return None


def stored_motors(stored: ModelFile) -> MotorLoad | None:
    """How the motors shared the load in a model's flights, where it was kept."""
    kept = stored.fit_quality.get("motors")
    if not isinstance(kept, Mapping):
        return None
    try:
        shares = np.array([float(v) for v in kept["shares"]])
        found = MotorLoad(shares, float(kept["spread"]), float(kept["dof"]), int(kept["flights"]))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    sound = shares.shape == (4,) and bool(np.all(shares > 0.0)) and found.spread > 0.0 and found.dof > 0.0
    return found if sound and found.flights > 0 else None


def flown_until(stored: ModelFile) -> str:
    """What is known of when an undated change came about: after the model's last flight; empty where that has no date."""
    dates = sorted(filter(None, (when(str(run)) for run in stored.runs)))
    return f"after {dates[-1]}" if dates else ""


def today_fingerprint(recordings: Sequence[Recording], vehicle: Vehicle | None) -> FingerprintData | None:
    """What is known of today's vehicle: the file's components before the recordings', the recordings' firmware and parameters."""
    if not recordings:
        return of_vehicle(vehicle) if vehicle is not None else None
    seen = of_recordings(recordings, vehicle)
    if vehicle is not None:
        declared = of_vehicle(vehicle)
        if "components" in declared:
            seen["components"] = declared["components"]
        if "mass_kg" in declared:
            seen["mass_kg"] = declared["mass_kg"]
        if "nominal_voltage_v" in declared:
            seen["nominal_voltage_v"] = declared["nominal_voltage_v"]
    return seen


def reestimate(
    stored: ModelFile, usable: Sequence[Segment], name: str, progress: Progress = SILENT
) -> tuple[Estimates, dict[str, float | None]]:
    """The stored model's parameters from new responses alone, and the standard error of each, None where nothing determines it.

    What the new recordings cannot determine (for instance alpha over a short flight) is held at the stored value, so that it does not blur
    the rest; the test's covariance carries the stored doubt anyway.
    """
    if not usable:
        raise FitError("no response can be used", "see `flighttest segment`")
    progress.stage(f"estimating again from {len(usable)} responses")
    return reestimate_segments(stored, usable, name)


def reestimate_segments(
    stored: ModelFile, segments: Sequence[Segment], name: str
) -> tuple[Estimates, dict[str, float | None]]:
    """`reestimate` from segments that are already cut."""
    start = Start(stored.values, stored_noise(stored.noise, problem_of(segments, stored.model, values=stored.values)))
    found = identify(segments, stored.model, start=start)
    tested = [n for names in subsets_of(stored.model).values() for n in names]
    stds = {n: found.estimates[n].std for n in tested if n in found.estimates}
    weak = {n: stored.values[n] for n in stds if _determines_less(found, stored, n)}
    if weak:
        found = identify(segments, stored.model, start=start, frozen=weak)
    estimates = watched(model_file.from_fit(found), name, tested)
    return replace(estimates, log_voltage=log_voltage_ratio(segments, stored.model.nominal_voltage_v)), stds


def matched_pairs(stored: ModelFile, base: Estimates, segments: Sequence[Segment]) -> MatchedPairs | None:
    """The new steps against those that a model's own flights had too; None where it kept none, or too few match."""
    kept = matched_pair.matched_pairs_from(stored.fit_quality.get("steps"))
    if not kept:
        return None
    problem = problem_of(segments, stored.model, values=stored.values)
    noise = stored_noise(stored.noise, problem)
    return matched_pair.compare_matched(kept, base, stored.values, noise, problem) if noise is not None else None


def log_voltage_ratio(segments: Sequence[Segment], nominal_v: float) -> float:
    """ln(U / U_n) over the throttle steps, else over all that was flown; NaN where no voltage was recorded."""
    known = [s for s in segments if s.usable and np.isfinite(s.y.get("voltage_v", np.full(1, np.nan))).any()]
    chosen = [s for s in known if s.kind in ("throttle_step", "tilt_throttle")] or known
    if not chosen:
        return math.nan
    return math.log(float(np.mean([np.nanmean(s.y["voltage_v"]) for s in chosen])) / nominal_v)


def _determines_less(found: Fit, stored: ModelFile, name: str) -> bool:
    """Whether the new recordings determine a parameter so badly that the stored value serves the others better.

    alpha, which moves K along, already when it is known half as well as before: the voltage range of a short flight is no change
    of the vehicle.
    """
    kept = stored.parameters.get(name)
    if kept is None or not kept.identifiable:
        return False
    new = found.estimates[name]
    size = DELAY_S if name.startswith("T_d") else abs(new.value)
    if new.std is None or (not new.identifiable and new.std > VAGUE * size):
        return True
    return name == "alpha" and kept.std is not None and new.std > ALPHA_DETERMINED * kept.std


def discrepancy_allowed(stored: ModelFile, base: Estimates, earlier: Sequence[Estimates]) -> dict[str, float]:
    """Relative discrepancy to allow for: this vehicle's own campaigns where there are enough, else what the model's campaign measured
    between its conditions. What neither determines keeps the stated prior.

    Thrust per throttle goes with the density of the air and the weight of the packs, which are those of one day in all the conditions of
    one campaign: for K the stated prior of what campaigns differ by comes on top of what it measured.
    """
    kept = stored.fit_quality.get("discrepancy")
    known = {str(n): float(v) for n, v in kept.items() if _number(v)} if isinstance(kept, Mapping) else {}
    if "K" in known:
        known["K"] = math.hypot(known["K"], prior("K"))
    return {**known, **(own_scatter(base, earlier) or {})}


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < 10.0


def own_scatter(base: Estimates, earlier: Sequence[Estimates]) -> dict[str, float] | None:
    """Relative scatter of this vehicle's own campaigns beyond their stated errors; None before there are enough of them."""
    found = {}
    base = base.known
    for i, name in enumerate(base.names):
        rows = [
            (float(e.values[e.names.index(name)]), float(e.covariance[e.names.index(name), e.names.index(name)]))
            for e in (one.known for one in earlier)
            if name in e.names
        ]
        if len(rows) < ENOUGH_HISTORY or not base.values[i]:
            continue
        values = np.array([v for v, _ in rows])
        extra = float(np.var(values, ddof=1)) - float(np.mean([s for _, s in rows]))
        # The root of half the chi-square's spread: the scatter of few campaigns is itself badly known.
        found[name] = float(
            np.sqrt(max(extra, 0.0)) * (1.0 + 1.0 / np.sqrt(2.0 * (len(rows) - 1))) / abs(float(base.values[i]))
        )
    return found or None


@dataclass(frozen=True)
class Page:
    """Where the page and the scripts to fly go, if anywhere, and the options of the commands that fly them."""

    output: Path | None = None
    options: str = ""


def status_result(
    found: Assessment,
    stored: ModelFile,
    vehicle: Vehicle | None,
    runs: Sequence[str],
    page: Page,
    present: LiveVehicle | None = None,
) -> Result:
    """Document, data, and with an output folder the page and the scripts to fly."""
    output = page.output
    rows, minutes, repeats = reflights(found, stored, vehicle, output, page.options)
    facts = {"model": stored.path or "the last one fitted"}
    if vehicle is not None:
        facts["vehicle"] = vehicle.path or vehicle.name
    elif stored.vehicle_name:
        facts["vehicle"] = stored.vehicle_name
    if present is not None:
        facts["read"] = present.sentence
    if runs:
        facts["new flight"] = paths(list(runs))
    document = status_document(found, facts, rows, brief=True)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        html.write_html(status_document(found, facts, rows), output / "status.html")
        document = replace(document, footer=f"page: {output / 'status.html'}")
    data = plain(found)
    data["verdict"] = found.verdict.name
    data["matters"] = data["impact"]  # keys by the names before, which programs may read yet
    data["tests"] = [{**test, "alike": test["matched"]} for test in data["tests"]]
    data["repeats"] = {name: need.repeats for name, need in repeats.items()}
    data["minutes"] = minutes
    shown = rows if found.fly or found.verdict is ValidityVerdict.UNKNOWN else ()
    data["reflights"] = [plain(row) for row in shown]
    data["compared"] = facts
    data["page"] = str(output / "status.html") if output is not None else None
    status_of = {
        ValidityVerdict.CURRENT: Status.DONE,
        ValidityVerdict.STALE: Status.STALE,
        ValidityVerdict.UNKNOWN: Status.DONE,
    }
    return Result(document, data, status_of[found.verdict], found)
