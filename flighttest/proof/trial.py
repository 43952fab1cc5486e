"""One sealed trial: fly, diagnose blind, open the truth, measure by ablation, judge."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose import Diagnosis, diagnose
from flighttest.diagnose.bench import BLOCKS, Bench
from flighttest.diagnose.judge import size_in_floors
from flighttest.diagnose.model import TermVerdict, Verdict
from flighttest.diagnose.noise import Floor, floor_of
from flighttest.diagnose.rows import RESOLUTION, Rows, State
from flighttest.diagnose.run import OFF_GRID_S
from flighttest.diagnose.screen import amplitude_variants, orthonormal, shape_variants
from flighttest.errors import FitError, FlighttestError, RecordingError
from flighttest.identify.fit import fit
from flighttest.identify.onset import onset_delay, start_values
from flighttest.identify.prediction import coverage
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.proof.cases import Case
from flighttest.proof.flying import fly_campaign
from flighttest.segments import Segment
from flighttest.sim import SimOptions
from flighttest.sim.rotor_vehicle import RotorVehicle, random_rotor

FloatArray = NDArray[np.float64]

CONFUSABLE = 0.95


@dataclass(frozen=True)
class Outcome:
    """What came of one trial. named: effects the tool named, strongest first; sizes: hidden effect to noise floors after the refit (by
    ablation); classes: hidden effect to the ids the oracle cannot tell from it; forces: hidden effect to (true, found) RMS specific force
    that the base model leaves because of it, m/s^2; values: hidden effect that was named to its parameters that vehicle and catalogue
    share, name to (true, found, standard error), SI; base_r2: of the base fit alone; gain: share of the mean square above the floor
    that is gone on held-out data; coverage: of the diagnosed model's 95 % intervals on repeats it was not fitted to; own: what was
    named of the firmware's own doing (shaping, angle boost), which nobody hid and which is no false alarm."""

    index: int
    kind: str
    sha256: str
    hide: Mapping[str, Mapping[str, float]]
    named: tuple[str, ...] = ()
    own: tuple[str, ...] = ()
    verdict: str = ""
    sizes: Mapping[str, float] = field(default_factory=dict)
    classes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    forces: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, tuple[float, float, float]]] = field(default_factory=dict)
    base_r2: float = float("nan")
    gain: float = float("nan")
    coverage: float = float("nan")
    located: bool = False
    confusable: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    error: str = ""
    truth: str = ""
    code: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Outcome:
        """What `to_json` made, after it went through a file."""
        lists = {"named": tuple(data["named"]), "own": tuple(data["own"])}
        maps = {k: {n: tuple(v) for n, v in data[k].items()} for k in ("classes", "forces", "confusable")}
        values = {e: {k: tuple(v) for k, v in found.items()} for e, found in data.get("values", {}).items()}
        return cls(**{**data, **lists, **maps, "values": values})


def run(case: Case) -> Outcome:
    """Fly the sealed case, diagnose what was recorded, then open the seal."""
    sha = case.sha256()
    try:
        segments = _flown(case, case.hide)
        frame = random_rotor(case.vehicle_seed)
        # Blind: recorded segments and what an operator knows of his vehicle.
        found = diagnose(segments, Model(nominal_voltage_v=frame.nominal_voltage_v))
        sizes, classes, forces = _measured(case, segments, found, frame.nominal_voltage_v)
    except FlighttestError as error:
        return Outcome(case.index, case.kind, sha, case.hide, error=error.message, truth=case.truth())
    ranked = [f.term for f in sorted(found.findings, key=lambda f: f.evidence["delta_bic"])]
    own = tuple(t for t in ranked if case.generator == "sitl" and catalogue()[t].family == "autopilot")
    named = tuple(t for t in ranked if t not in own)
    return Outcome(
        index=case.index,
        kind=case.kind,
        sha256=sha,
        hide=case.hide,
        named=named,
        own=own,
        verdict=found.verdict.name,
        sizes=sizes,
        classes=classes,
        forces=forces,
        values=_values(case, found),
        base_r2=_r2(found),
        gain=_gain(found),
        coverage=_coverage(segments, found),
        # A firmware that adds something of its own is always located: what counts is what stays after that.
        located=found.verdict in (Verdict.UNKNOWN_PHYSICS, Verdict.PARTLY) if own else bool(found.located),
        confusable={
            f.term: tuple(r.term for r in f.rivals if r.verdict == TermVerdict.CONFUSABLE) for f in found.findings
        },
        truth=case.truth(),
    )


def _flown(case: Case, hide: Mapping[str, Mapping[str, float]]) -> tuple[Segment, ...]:
    options = SimOptions(
        airframe="rotor", hide={k: dict(v) for k, v in hide.items()}, seed=case.flight_seed, vehicle_seed=case.vehicle_seed,
        noise=case.noise, gust_rms_m_s=case.gust_rms_m_s,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        segments = tuple(s for s in fly_campaign(options, Path(folder), case.generator) if s.usable)
    if all(s.kind == "free" for s in segments):
        # Nothing has a twin in the flight without the effect, which its size is measured by.
        raise RecordingError(
            "no step of the campaign was flown to its end", "the vehicle does not settle with this in it"
        )
    return segments


def _values(case: Case, found: Diagnosis) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Of every hidden effect that was named, the parameters that the hidden vehicle has under the same name: (true, found, error)."""
    named = {f.term: f.parameters for f in found.findings if f.term in case.hide}
    truth = {term: dict(values) for term, values in case.hide.items()}
    if "attitude_extra_pole" in truth:
        # Hidden is a lag within the loops, declared the pole of the closed loop that comes of it.
        hidden = truth["attitude_extra_pole"]
        hidden["attitude_pole_tau"] = _closed_loop_pole_s(random_rotor(case.vehicle_seed), hidden["attitude_pole_tau"])
    return {
        term: {k: (truth[term][k], float(p["value"]), float(p["std"])) for k, p in table.items() if k in truth[term]}
        for term, table in named.items()
    }


def _closed_loop_pole_s(vehicle: RotorVehicle, lag_s: float) -> float:
    """Time constant of the slowest real pole that a lag of the moments, s, gives to loops of natural frequency omega and damping zeta, the
    rotors' own lag behind it: mean of roll and pitch."""
    poles = []
    for omega, zeta in ((vehicle.omega_roll, vehicle.zeta_roll), (vehicle.omega_pitch, vehicle.zeta_pitch)):
        rotor_s = vehicle.rotor_lag_s
        roots = np.roots([lag_s * rotor_s, lag_s + rotor_s, 1.0, 2.0 * zeta * omega, omega**2])
        poles.append(float(-1.0 / np.max(roots[np.abs(roots.imag) < 1e-6 * np.abs(roots)].real)))
    return float(np.mean(poles))


def _gain(found: Diagnosis) -> float:
    """Of the mean square above the noise floor on steps not used, the share that is gone: mean over the channels that were located."""
    held = [found.heldout[channel]["all"] for channel in {p.channel for p in found.located} & set(found.heldout)]
    above = [(h["rmse_before"] ** 2 - h["floor"] ** 2, h["rmse_after"] ** 2 - h["floor"] ** 2) for h in held]
    shares = [1.0 - max(after, 0.0) / before for before, after in above if before > 0]
    return float(np.mean(shares)) if shares else float("nan")


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


def _r2(found: Diagnosis) -> float:
    """Of the base fit alone, the median over channels of 1 - (RMSE / RMS about the first value)^2, over what moves."""
    values = []
    for entry in found.baselines.values():
        hold, base = entry.get("hold the first value"), entry.get("base model, refitted")
        if hold and base is not None:
            values.append(1.0 - (base / hold) ** 2)
    return float(np.median(values)) if values else float("nan")


def _measured(
    case: Case, segments: Sequence[Segment], found: Diagnosis, nominal_voltage_v: float
) -> tuple[dict[str, float], dict[str, tuple[str, ...]], dict[str, tuple[float, float]]]:
    """By ablation: the same flight without each hidden effect, and what of the difference the base model cannot copy."""
    sizes: dict[str, float] = {}
    classes: dict[str, tuple[str, ...]] = {}
    forces: dict[str, tuple[float, float]] = {}
    if not case.hide:
        return sizes, classes, forces
    oracle = [_Oracle(segments, block, nominal_voltage_v) for block in BLOCKS if _moves(segments, block)]
    for name in case.hide:
        twin = _flown(case, {k: v for k, v in case.hide.items() if k != name})
        best = 0.0
        for side in oracle:
            size, effect = side.size(twin)
            if size > best:
                best = size
                classes[name] = side.alike(name, effect)
            if side.block == "translation":
                alike = (name, *classes.get(name, ()))
                claimed = next((f.evidence["rms_force_left_m_s2"] for f in found.findings if f.term in alike), 0.0)
                usual = _Oracle(twin, side.block, nominal_voltage_v).force_power()
                forces[name] = (float(np.sqrt(max(side.force_power() - usual, 0.0))), float(claimed or 0.0))
        sizes[name] = best
        classes.setdefault(name, (name,))
    return sizes, classes, forces


def _moves(segments: Sequence[Segment], block: str) -> bool:
    return bool(Bench(tuple(segments), block).problem(Model()).parts)


class _Oracle:
    """One block of the base model on the recording, and what is left of differences beside it."""

    def __init__(self, segments: Sequence[Segment], block: str, nominal_voltage_v: float) -> None:
        self.segments, self.block = tuple(segments), block
        self.bench = Bench(self.segments, block)
        self.model = Model(
            ("linear_drag", "roll_pitch_coupling") if block == "roll_pitch" else ("linear_drag",), nominal_voltage_v
        )
        values = start_values(self.segments, self.model, onset_delay(self.segments))
        start = self.bench.start(
            self.model, {k: v + OFF_GRID_S if k.startswith("T_d") else v for k, v in values.items()}
        )
        names = tuple(n for n in self.bench.problem(self.model).names if self.model.term_of(n) != "roll_pitch_coupling")
        self.state: State = self.bench.fit(self.model, start, names, iterations=15)
        self.rows: Rows = self.bench.rows(self.model, self.state, names)
        self.basis = orthonormal(self.rows.columns(names))
        self.floor: Floor = floor_of(self.rows, self.segments, RESOLUTION)

    def size(self, twin: Sequence[Segment]) -> tuple[float, FloatArray]:
        """(size in noise floors, its noise taken off; the whitened difference itself with base and locals projected out)."""
        without = {s.name: s for s in twin}
        raw = []
        for part in self.bench.problem(self.model).parts:
            change = np.zeros(part.y.shape)
            for j, response in enumerate(part.responses):
                s = self.segments[response.index]
                other = without.get(s.name)
                if other is None:
                    continue
                for k, name in enumerate(part.outputs):
                    if name in s.y and name in other.y:
                        twin_y = np.interp(s.t_s - s.t_step_s, other.t_s - other.t_step_s, other.y[name])
                        change[j, : s.t_s.size, k] = s.y[name] - twin_y
            raw.append(np.where(part.mask, change, 0.0).reshape(len(part.responses), -1, 1))
        change = self.rows.of(raw)[0][:, 0]
        left = change - self.basis @ (self.basis.T @ change)
        size, _ = size_in_floors(self.rows, left * self.rows.scale * (self.rows.sample >= 0), self.segments, self.floor)
        return float(np.sqrt(max(size**2 - 2.0, 0.0))), left

    def alike(self, name: str, effect: FloatArray) -> tuple[str, ...]:
        """Ids that cannot be told from the hidden one on this recording: cosine of what is left above 0.95."""
        known = catalogue()
        if name not in known:
            return (name,)
        terms = [t for t in known.values() if t.id not in self.model.terms and self._acts(t)]
        if name not in {t.id for t in terms}:
            return (name,)
        variants = amplitude_variants(self.bench, self.model, self.state, terms, self.rows)
        variants += shape_variants(self.bench, self.model, self.state, terms, self.rows)
        own = [(v, v.columns - self.basis @ (self.basis.T @ v.columns)) for v in variants]
        mine = [(v, c, orthonormal(c)) for v, c in own if v.term.id == name and np.linalg.norm(c) > 1e-9]
        if not mine:
            return (name,)
        _, _, span = max(mine, key=lambda m: float(np.linalg.norm(m[2].T @ effect)))
        direction = span @ (span.T @ effect)
        length = float(np.linalg.norm(direction)) or 1.0
        found = {name}
        for v, c in own:
            if np.linalg.norm(c) > 1e-9 and float(np.linalg.norm(orthonormal(c).T @ direction)) / length > CONFUSABLE:
                found.add(v.term.id)
        return tuple(sorted(found))

    def _acts(self, term: Term) -> bool:
        if (block_of(term) == "translation") != (self.block == "translation"):
            return False
        known = self.bench.problem(self.model.with_terms(term)).names
        return any(p.name in known for p in term.params)

    def force_power(self) -> float:
        """Mean square of the specific force that the refitted base model leaves, all axes, (m/s^2)^2."""
        left = self.rows.residual * self.rows.scale
        axes = (self.rows.channel == c for c, name in enumerate(self.rows.channels) if name.startswith("f_"))
        return float(sum(np.mean(left[at] ** 2) for at in axes if at.any()))
