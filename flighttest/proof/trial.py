"""One sealed trial: fly, diagnose blind, open the truth, measure what was hidden by twin flights."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from flighttest.diagnose import Diagnosis, diagnose
from flighttest.diagnose.records import DiagnosisData
from flighttest.errors import FitError, FlighttestError, RecordingError
from flighttest.identify.fit import fit
from flighttest.identify.validation.prediction import coverage
from flighttest.physics.model import Model
from flighttest.proof import oracle
from flighttest.proof.cases import ALIASED, Case
from flighttest.proof.flying import CAMPAIGN, case_options, fly_campaign
from flighttest.proof.outcome import Outcome, firmware_terms, judged_outcome, shared_truth
from flighttest.proof.transplanted_noise import RealNoise, blocks_of
from flighttest.recording.model import Recording
from flighttest.segments import Segment
from flighttest.sim.plants.rotor_vehicle import random_rotor


@dataclass(frozen=True)
class OracleAnswer:
    """The oracle's answer on a case. sizes: hidden effect to noise floors; forces: to the RMS specific force that the base model leaves
    because of it, m/s^2; classes: to the ids that cannot be distinguished from it in this campaign."""

    sizes: Mapping[str, float] = field(default_factory=dict)
    forces: Mapping[str, float] = field(default_factory=dict)
    classes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def run_trial(case: Case) -> Outcome:
    """Fly the sealed case, diagnose what was recorded, then open the seal."""
    try:
        segments = flown_segments(case)
        frame = random_rotor(case.vehicle_seed)
        wall, cpu = time.perf_counter(), time.process_time()
        # Blind: recorded segments and what an operator has of a vehicle.
        found = diagnose(segments, Model(nominal_voltage_v=frame.nominal_voltage_v))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        measured = measure(case, segments)
    except FlighttestError as error:
        sha, truth = case.sha256(), case.truth()
        return Outcome(case.index, case.kind, sha, case.hide, error=error.message, truth=truth)
    outcome = opened(case, found.to_json(), measured)
    return replace(outcome, coverage=_coverage(segments, found), cpu_s=cpu, wall_s=wall)


def opened(case: Case, found: DiagnosisData, measured: OracleAnswer) -> Outcome:
    """A diagnosis (diagnosis.json) beside the truth and the oracle's answer."""
    claimed = {f["term"]: f["evidence"].get("rms_force_left_m_s2") or 0.0 for f in found["findings"]}
    forces = {
        effect: (true, next((claimed[t] for t in measured.classes.get(effect, (effect,)) if t in claimed), 0.0))
        for effect, true in measured.forces.items()
    }
    return replace(
        judged_outcome(case, case.hide, found, firmware_terms(case), shared_truth(case)),
        sizes=measured.sizes,
        classes=measured.classes,
        forces=forces,
    )


def measure(case: Case, recorded: Sequence[Segment]) -> OracleAnswer:
    """Every hidden effect of a case, by quiet twin flights with and without it."""
    if not case.hide:
        return OracleAnswer()
    voltage = random_rotor(case.vehicle_seed).nominal_voltage_v
    quiet = flown_segments(case, quiet=True)
    noise = oracle.oracle_noise(recorded, quiet, voltage)
    with_all = oracle.left(quiet, noise, voltage)
    effects = {
        e: with_all.less(oracle.left(flown_segments(case, without=e, quiet=True), noise, voltage)) for e in case.hide
    }
    return OracleAnswer(
        {e: oracle.size_in_floors(left, noise) for e, left in effects.items()},
        {e: oracle.force_left(left) for e, left in effects.items()},
        {e: ALIASED.get(e, (e,)) for e in effects},
    )


def flown_segments(case: Case, without: str = "", quiet: bool = False) -> tuple[Segment, ...]:
    """What can be used of the campaign of a case, or of its twin without one of its effects, or without noise and gusts."""
    with tempfile.TemporaryDirectory() as folder:
        flown = fly_campaign(
            case_options(case, without, quiet), Path(folder), case.generator, CAMPAIGN, partial(_noisy, case, quiet)
        )
    segments = tuple(s for s in flown if s.usable)
    if all(s.kind == "free" for s in segments):
        # Nothing has a twin in the flight without the effect, which its size is measured by.
        raise RecordingError(
            "no step of the campaign was flown to its end", "the vehicle does not settle with this effect"
        )
    return segments


def _noisy(case: Case, quiet: bool, flown: Recording) -> Recording:
    if quiet or case.noise_from is None:
        return flown
    frame = random_rotor(case.vehicle_seed)
    drag = (frame.drag_x_1_s, frame.drag_y_1_s, frame.drag_z_1_s)
    return RealNoise(blocks_of(case.noise_from), drag, case.flight_seed).on(flown)


def _coverage(segments: Sequence[Segment], found: Diagnosis) -> float:
    """Share of samples of the second repeats inside the 95 % intervals of the diagnosed model, fitted to the first: mean over channels."""
    first = [s for s in segments if s.repeat <= 1]
    second = [s for s in segments if s.repeat > 1]
    start = {n: v for n, v in found.values.items() if n in found.model.names}
    try:
        shares = [c.share for c in coverage(fit(first, found.model, start=start), second)]
    except FitError:
        return float("nan")
    return float(np.mean(shares)) if shares else float("nan")
