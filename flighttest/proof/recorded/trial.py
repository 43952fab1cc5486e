"""One sealed trial on real recordings: add what was drawn, diagnose blind, open; or compare two campaigns, or two flights in winds."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flighttest.channels import HELD_GROUPS
from flighttest.errors import FlighttestError, RecordingError
from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME, diagnose, run_diagnosis
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.pipeline.validity.status import status
from flighttest.proof import oracle
from flighttest.proof.outcome import Outcome, judged_outcome
from flighttest.proof.recorded.cases import ADDED, PART_S, Added, RecordedCase
from flighttest.proof.recorded.injection import inject
from flighttest.proof.recorded.side_by_side import Effects, OracleVehicle
from flighttest.proof.recorded.wind_pairs import CHANGED, compared_values, named_change, wind_difference
from flighttest.recording import Recording
from flighttest.recording.model import Series
from flighttest.segments import Segment, cut
from flighttest.segments.airborne import flights
from flighttest.validity.model import ValidityVerdict

STEP_MARGIN_S = 0.5  # before a scripted step its commands hold already
LEAST_SHARE = 0.5  # of the size asked for that an effect must reach to be the one
MOST_DEPARTURE_M_S = 5.0  # of a velocity; beyond it the flight would have been another one


def run_recorded(case: RecordedCase) -> Outcome:
    """Read the recordings, add what was drawn, diagnose what comes of it, then open the seal."""
    try:
        if case.kind != "natural":
            return _diagnosed(case)
        return _in_two_winds(case) if case.winds else _compared(case)
    except FlighttestError as error:
        return Outcome(case.index, case.kind, case.sha256(), {}, error=error.message, truth=case.truth())


def _read(case: RecordedCase, files: Sequence[str]) -> tuple[Recording, ...]:
    columns = Path(case.columns) if case.columns else None
    return open_recordings([Path(case.data) / f for f in files], Reading(columns))


def _diagnosed(case: RecordedCase) -> Outcome:
    whole = _read(case, case.files)
    recordings = tuple(part(r, case.begin) for r in whole)
    voltage = base_model(recordings, None).nominal_voltage_v
    flown = FlownTrial.of(recordings, voltage, case.answer_1_s, whole)
    hide = sized_effects(case, flown)
    added = flown.with_effects(hide)
    wall, used = time.perf_counter(), _processor_s()
    # Blind: the recordings, and nothing of what was added.
    segments = tuple(s for recording in added for s in cut(recording))
    found = run_diagnosis(segments, added, None, None)
    wall, used = time.perf_counter() - wall, _processor_s() - used
    sizes = {e: flown.size(hide) if len(hide) == 1 else flown.size(hide, without=e) for e in hide}
    outcome = judged_outcome(case, hide, found.to_json(), case.own, hide)
    kind = ("clean", "single", "pair")[len(hide)]  # these flights may show less than was asked for
    return replace(outcome, kind=kind, sizes=sizes, cpu_s=used, wall_s=wall)


def part(recording: Recording, begin: float) -> Recording:
    """At most `PART_S` of its flight; begin: where, as a share of the time that is left over."""
    spans = flights(recording)
    if not spans or spans[-1][1] - spans[0][0] <= PART_S:
        return recording
    first = spans[0][0] + begin * (spans[-1][1] - spans[0][0] - PART_S)
    last = first + PART_S
    series = {}
    for group, s in recording.series.items():
        # What holds its value was set before.
        start = (
            np.searchsorted(s.t_s, first, side="right") - 1 if group in HELD_GROUPS else np.searchsorted(s.t_s, first)
        )
        inside = slice(max(int(start), 0), int(np.searchsorted(s.t_s, last, side="right")))
        if s.t_s[inside].size:
            series[group] = Series(s.t_s[inside], {name: x[inside] for name, x in s.columns.items()})
    markers = tuple(m for m in recording.markers if first <= m.t_s <= last)
    return replace(recording, series=series, markers=markers)


def _processor_s() -> float:
    """Of this process and of those that it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@dataclass(frozen=True)
class FlownTrial:
    """Recordings, the vehicle that flew them as the oracle fits it, what the base model leaves of them, and the noise that is in that."""

    recordings: tuple[Recording, ...]
    vehicle: OracleVehicle
    steps: Mapping[str, Sequence[tuple[float, float]]]
    left: oracle.Left
    noise: oracle.OracleNoise

    @classmethod
    def of(
        cls,
        recordings: tuple[Recording, ...],
        nominal_voltage_v: float,
        answer_1_s: float,
        whole: tuple[Recording, ...],
    ) -> FlownTrial:
        """whole: what the recordings are parts of, to which the vehicle is fitted. Two minutes need not determine a lag: parts of one log
        had spin-up rates of 21 and 25 1/s, all of it 15.6, and an asymmetry of 1.5 that the former flew was found as 1.04 +- 0.13.

        RecordingError where there is too little to fit a vehicle to.
        """
        segments = _segments(recordings)
        left, noise = _left_and_noise(segments, nominal_voltage_v)
        if "translation" not in left.parameters:
            raise RecordingError("the throttle never changes in these flights", "list recordings of flights")
        steps = {
            r.name: [(s.t_s[0] - STEP_MARGIN_S, s.t_s[-1]) for s in segments if s.run == r.name and s.kind != "free"]
            for r in recordings
        }
        parted = any(a is not b for a, b in zip(whole, recordings, strict=True))
        every = _segments(whole) if parted else segments
        known = _left_and_noise(every, nominal_voltage_v)[0] if parted else left
        # Steps that a script asked for have references of their own; loops that somebody steered need their innovations.
        steered = oracle.steered_loops(every) if all(s.steered for s in every) else {}
        vehicle = OracleVehicle.fitted({**known.parameters, **steered}, nominal_voltage_v, answer_1_s)
        return cls(recordings, vehicle, steps, left, noise)

    def with_effects(self, effects: Effects) -> tuple[Recording, ...]:
        """The recordings as they would have been with the effects."""
        return tuple(inject(r, effects, self.vehicle, flights(r), self.steps[r.name]) for r in self.recordings)

    def departure_m_s(self, effects: Effects) -> float:
        """Most that any velocity changes by, m/s."""
        most = 0.0
        for before, after in zip(self.recordings, self.with_effects(effects), strict=True):
            for name in ("v_x_m_s", "v_y_m_s", "v_z_m_s"):
                if before.has(name):
                    change = after.channel(name)[1] - before.channel(name)[1]
                    most = max(most, float(np.nanmax(np.abs(change), initial=0.0)))
        return most

    def lowest_m(self) -> float:
        """Recorded height that a hundredth of some flight is below. An estimate that drifts may be under the ground for half of one."""
        heights = []
        for r in self.recordings:
            t, z = r.channel("height_m")
            heights += [z[(t >= a) & (t <= b) & np.isfinite(z)] for a, b in flights(r)]
        return min((float(np.quantile(z, 0.01)) for z in heights if z.size), default=-np.inf)

    def size(self, effects: Effects, without: str = "") -> float:
        """Noise floors that no refit of the base model copies: of all effects, or of one of them beside the others."""
        after = self._left(effects)
        before = self._left({e: v for e, v in effects.items() if e != without}) if without else self.left
        return oracle.size_in_floors(after.less(before), self.noise)

    def _left(self, effects: Effects) -> oracle.Left:
        voltage = self.vehicle.nominal_voltage_v
        return oracle.left(_segments(self.with_effects(effects)), self.noise, voltage, free=True, near=self.left)


def _left_and_noise(segments: Sequence[Segment], nominal_voltage_v: float) -> tuple[oracle.Left, oracle.OracleNoise]:
    """What the oracle's base model leaves of segments, weighted by the noise that is in that, and this noise."""
    noise = oracle.OracleNoise(oracle.FIRST, oracle.FIRST_DISTURBANCE)
    left = oracle.left(segments, noise, nominal_voltage_v, free=True)
    for _ in range(2):
        noise = noise.of_residual(left)
        left = oracle.left(segments, noise, nominal_voltage_v, free=True, near=left)
    return left, noise


def _segments(recordings: Sequence[Recording]) -> list[Segment]:
    """What is usable in them, named by kind and time: an effect may move what is cut, and only the same stretch of flight is compared."""
    return [
        replace(s, name=f"{r.name}/{s.kind}@{s.t_s[0]:.2f}")
        for r in recordings
        for s in cut(r)
        if s.usable and not s.between_steps
    ]


def sized_effects(case: RecordedCase, flown: FlownTrial) -> dict[str, dict[str, float]]:
    """The effects that are added: the first of the order that these flights show, each scaled to the size asked for as far as may be."""
    found: dict[str, dict[str, float]] = {}
    for effect in case.order:
        if len(found) == len(case.sizes):
            break
        one, wanted = ADDED[effect], case.sizes[len(found)]
        if not all(r.has(*one.needs) for r in flown.recordings):
            continue
        times, reached = 1.0, 0.0
        for _ in range(3):  # regula falsi through the origin: sizes grow nearly linearly
            values = _scaled(one, times, case.signs)
            reached = flown.size({effect: values})
            far = reached * one.most / times < 0.5 * LEAST_SHARE * wanted
            if abs(reached / wanted - 1.0) < 0.2 or (reached < wanted and times >= one.most) or far:
                break
            times = float(np.clip(times * wanted / max(reached, 1e-3), 0.1, one.most))
        if reached < LEAST_SHARE * wanted or flown.departure_m_s({effect: values}) > MOST_DEPARTURE_M_S:
            continue
        # Nearer to the ground than this it is as a fan in a wall (`AirEffects`), and no flight was there.
        if effect == "ground_effect" and flown.lowest_m() < 0.25 * math.sqrt(values["R2_m2"]):
            continue
        found[effect] = values
    return found


def _scaled(one: Added, times: float, signs: Sequence[float]) -> dict[str, float]:
    turned = dict(zip(one.scaled, signs, strict=False)) if one.signed else {}
    factor = 1.0 / times if one.inverse else times
    return {k: v * factor * turned.get(k, 1.0) if k in one.scaled else v for k, v in one.usual.items()}


def _compared(case: RecordedCase) -> Outcome:
    """Whether `status` flags the later campaign against a model of the earlier one."""
    earlier, later = _read(case, case.earlier), _read(case, case.files)
    wall, used = time.perf_counter(), _processor_s()
    with tempfile.TemporaryDirectory() as folder:
        diagnose(earlier, output=Path(folder) / "model")
        found = status(later, None, Path(folder) / "model" / MODEL_NAME, Path(folder))
    wall, used = time.perf_counter() - wall, _processor_s() - used
    flagged = found.value.verdict is ValidityVerdict.STALE
    return Outcome(
        case.index, case.kind, case.sha256(), {CHANGED: {}} if case.differs else {}, named=(CHANGED,) if flagged else (),
        verdict=found.value.verdict.name, cpu_s=used, wall_s=wall, truth=case.truth(),
    )  # fmt: skip


def _in_two_winds(case: RecordedCase) -> Outcome:
    """Whether one diagnosis of two flights, which has them by number only, distinguishes their winds."""
    flown = tuple(replace(r, name=f"flight {k}") for k, r in enumerate(_read(case, case.files), 1))
    wall, used = time.perf_counter(), _processor_s()
    found = run_diagnosis(tuple(s for r in flown for s in cut(r)), flown, None, None).to_json()
    wall, used = time.perf_counter() - wall, _processor_s() - used
    first, second = case.winds
    known = (second[0] - first[0], second[1] - first[1])
    difference = wind_difference(found, [r.name for r in flown])
    return Outcome(
        case.index, case.kind, case.sha256(), {CHANGED: {}} if case.differs else {}, named=named_change(difference, known),
        verdict=found["verdict"], values=compared_values(difference, known), cpu_s=used, wall_s=wall, truth=case.truth(),
    )  # fmt: skip
