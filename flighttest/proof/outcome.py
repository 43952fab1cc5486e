"""What came of one sealed trial: the truth and a diagnosis, as written in diagnosis.json, held against each other."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from flighttest.diagnose.model import TermVerdict, Verdict
from flighttest.diagnose.records import DiagnosisData, ParameterRow
from flighttest.estimation.uncertainty.distributions import NORMAL_95
from flighttest.frames import G_M_S2
from flighttest.physics.catalogue import catalogue
from flighttest.proof.cases import Case
from flighttest.sim.plants.rotor_vehicle import RotorVehicle, random_rotor

BASE = "base"  # what `Outcome.values` calls the model that every diagnosis starts from


@dataclass(frozen=True)
class Outcome:
    """One trial. named: effects the tool named, strongest first; probability: of each of them, where the diagnosis states one; sizes:
    hidden effect to noise floors after the refit; classes: hidden effect to the ids the oracle cannot distinguish from it; forces:
    hidden effect to (true, found) RMS specific force that the base model leaves because of it, m/s^2; values: hidden effect that was
    named, and `BASE` where nothing is hidden, to the parameters that vehicle and catalogue share, name to (true, found, lower, upper
    end of the 95 % interval), SI; base_r2: of the base fit alone; gain: share of the mean square above the floor that is gone on held-out
    data; coverage: of the diagnosed model's 95 % intervals on repeats it was not fitted to; located: whether something was found to
    be missing somewhere, None where unknown; own: what was named of the firmware itself (shaping, angle boost), which was not hidden
    and is no false alarm; cpu_s, wall_s: of the diagnosis, 0 where unknown."""

    index: int
    kind: str
    sha256: str
    hide: Mapping[str, Mapping[str, float]]
    named: tuple[str, ...] = ()
    probability: Mapping[str, float] = field(default_factory=dict)
    own: tuple[str, ...] = ()
    verdict: str = ""
    sizes: Mapping[str, float] = field(default_factory=dict)
    classes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    forces: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = field(default_factory=dict)
    base_r2: float = float("nan")
    gain: float = float("nan")
    coverage: float = float("nan")
    located: bool | None = None
    confusable: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    cpu_s: float = 0.0
    wall_s: float = 0.0
    error: str = ""
    truth: str = ""
    code: str = ""

    def to_json(self) -> dict[str, object]:
        """Plain types."""
        return asdict(self)

    @property
    def real_noise(self) -> bool:
        """Whether its noise and disturbance are of real recordings, by its truth."""
        return bool(self.truth) and "noise_from" in json.loads(self.truth)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Outcome:
        """What `to_json` made, after it went through a file; what is not in it keeps its default."""
        lists = {k: tuple(data[k]) for k in ("named", "own") if k in data}
        maps = {k: {n: tuple(v) for n, v in data[k].items()} for k in ("classes", "forces", "confusable") if k in data}
        values = {e: {k: tuple(v) for k, v in found.items()} for e, found in data.get("values", {}).items()}
        return cls(**{**data, **lists, **maps, "values": values})


class Sealed(Protocol):
    """A trial's truth: its number, its kind, and the text that was sealed."""

    @property
    def index(self) -> int:
        """Its number in the proof."""
        ...

    @property
    def kind(self) -> str:
        """What is hidden: nothing, one effect, two, ..."""
        ...

    def truth(self) -> str:
        """As sealed: JSON with sorted keys."""
        ...

    def sha256(self) -> str:
        """Of the truth."""
        ...


def judged_outcome(
    case: Sealed,
    hide: Mapping[str, Mapping[str, float]],
    found: DiagnosisData,
    own: Collection[str],
    truth: Mapping[str, Mapping[str, float]],
) -> Outcome:
    """A case whose seal is opened beside its diagnosis (diagnosis.json); nothing that an oracle measures is in it.

    hide: what was hidden, effect to values; own: terms that the vehicle is known to have without it; truth: true values by term, and of
    the `BASE` model's parameters where they are known.
    """
    findings = sorted(found["findings"], key=lambda f: f["evidence"].get("delta_bic") or 0.0)
    ranked = [f["term"] for f in findings]
    its_own = tuple(t for t in ranked if t in own)
    unfinished = found["verdict"] in (Verdict.UNKNOWN_PHYSICS.name, Verdict.PARTLY.name)
    return Outcome(
        index=case.index,
        kind=case.kind,
        sha256=case.sha256(),
        hide=hide,
        named=tuple(t for t in ranked if t not in its_own),
        probability={f["term"]: p for f in findings if (p := f["evidence"].get("probability")) is not None},
        own=its_own,
        verdict=found["verdict"],
        values=_values(truth, found),
        base_r2=_r2(found),
        gain=_gain(found),
        # A firmware that adds something of its own is always located: what counts is what stays after that.
        located=unfinished if its_own else bool(found["located"]),
        confusable={
            f["term"]: tuple(r["term"] for r in f["rivals"] if r["verdict"] == TermVerdict.CONFUSABLE) for f in findings
        },
        truth=case.truth(),
    )


def firmware_terms(case: Case) -> frozenset[str]:
    """Terms of a firmware, which brings loops of its own and is no part of what is hidden."""
    if case.generator != "sitl":
        return frozenset()
    return frozenset(t for t, term in catalogue().items() if term.family == "autopilot")


def shared_truth(case: Case) -> dict[str, dict[str, float]]:
    """Effect to the true values of the parameters that hidden vehicle and catalogue have under one name; `BASE` as well, where nothing
    else acts."""
    vehicle, known = random_rotor(case.vehicle_seed), catalogue()
    truth = {name: dict(values) for name, values in case.hide.items() if name in known}
    if "attitude_extra_pole" in truth:
        # Hidden is a lag within the loops, declared the pole of the closed loop that comes of it.
        hidden = truth["attitude_extra_pole"]
        hidden["attitude_pole_tau"] = closed_loop_pole_s(vehicle, hidden["attitude_pole_tau"])
    names = {name: {p.name for p in known[name].params} for name in truth}
    truth = {name: {k: v for k, v in values.items() if k in names[name]} for name, values in truth.items()}
    if not case.hide:
        drag = {"d_x": vehicle.drag_x_1_s, "d_y": vehicle.drag_y_1_s, "d_z": vehicle.drag_z_1_s}
        truth[BASE] = {"K": G_M_S2 / vehicle.hover_throttle, "alpha": vehicle.alpha, **drag}
    return truth


def _values(
    truth: Mapping[str, Mapping[str, float]], found: DiagnosisData
) -> dict[str, dict[str, tuple[float, float, float, float]]]:
    tables = {f["term"]: f["parameters"] for f in found["findings"]} | {BASE: found["after"]}
    return {
        term: {k: (true, *_interval(tables[term][k])) for k, true in values.items() if k in tables[term]}
        for term, values in truth.items()
        if term in tables
    }


def _interval(parameter: ParameterRow) -> tuple[float, float, float]:
    """Value and 95 % interval; not a number where the diagnosis has none."""
    value, std, ends = float(parameter["value"]), parameter["std"], parameter.get("interval_95")
    if ends is None:
        ends = (float("nan"),) * 2 if std is None else (value - NORMAL_95 * std, value + NORMAL_95 * std)
    low, high = (float("nan") if end is None else float(end) for end in ends)
    return value, low, high


def closed_loop_pole_s(vehicle: RotorVehicle, lag_s: float) -> float:
    """Time constant of the slowest real pole that a lag of the moments, s, gives to loops of natural frequency omega and damping zeta, the
    rotors' own lag behind it: mean of roll and pitch."""
    poles = []
    for omega, zeta in ((vehicle.omega_roll, vehicle.zeta_roll), (vehicle.omega_pitch, vehicle.zeta_pitch)):
        rotor_s = vehicle.rotor_lag_s
        roots = np.roots([lag_s * rotor_s, lag_s + rotor_s, 1.0, 2.0 * zeta * omega, omega**2])
        poles.append(float(-1.0 / np.max(roots[np.abs(roots.imag) < 1e-6 * np.abs(roots)].real)))
    return float(np.mean(poles))


def _gain(found: DiagnosisData) -> float:
    """Of the mean square above the noise floor on steps not used, the share that is gone: mean over the channels that were located."""
    channels = {p["channel"] for p in found["located"]} & set(found["heldout"])
    held = [found["heldout"][channel]["all"] for channel in sorted(channels)]
    above = [(h["rmse_before"] ** 2 - h["floor"] ** 2, h["rmse_after"] ** 2 - h["floor"] ** 2) for h in held]
    shares = [1.0 - max(after, 0.0) / before for before, after in above if before > 0]
    return float(np.mean(shares)) if shares else float("nan")


def _r2(found: DiagnosisData) -> float:
    """Of the base fit alone, the median over channels of 1 - (RMSE / RMS about the first value)^2, over what moves."""
    pairs = [(e.get("hold the first value"), e.get("base model, refitted")) for e in found["baselines"].values()]
    values = [1.0 - (base / hold) ** 2 for hold, base in pairs if hold and base is not None]
    return float(np.median(values)) if values else float("nan")
