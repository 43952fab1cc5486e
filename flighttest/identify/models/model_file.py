"""model.yaml: what a fit leaves for the next program (format model/1, see docs/formats.md)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from flighttest.datafiles import read_text, write_whole
from flighttest.documents import Form, Node, PlainData, YamlDocument, kind_of, read_form, require
from flighttest.errors import ModelError
from flighttest.frames import G_M_S2
from flighttest.identify.fit import Fit
from flighttest.identify.models.model_blocks import (
    CovarianceBlock,
    DiagnosedBlock,
    ModelData,
    ModelDumper,
    NoiseBlock,
    ParameterBlock,
    QualityBlock,
    ValidBlock,
    check_plain,
    children_of,
    constants_of,
    list_elements,
    noise_of,
    plain_block,
    terms_of,
)
from flighttest.physics.body import ATTITUDE_PARAMS, CHANNEL_DELAYS, DELAY, DELAY_PARAM
from flighttest.physics.model import NOMINAL_VOLTAGE_V, ROTOR_HEIGHT_M, Model
from flighttest.vehicle.fingerprint import FingerprintData
from flighttest.vehicle.identity import IdentityData

FloatArray = NDArray[np.float64]

NAMES = ("model.yaml", "fit.yaml")  # in a folder: the improved model of a diagnosis before the fit it began with
_TOP = (
    "format", "terms", "parameters", "constants", "delays", "covariance", "valid", "fingerprint", "runs", "noise", "fit_quality",
    "notes", "attitude_loops", "channel_delays", "onset_delay", "vehicle", "diagnosed",
)  # fmt: skip
_PARAMETER = ("value", "unit", "std", "interval_95", "source", "identifiable", "why", "fly", "symbol", "dof", "scatter")


@dataclass(frozen=True)
class StoredParameter:
    """One entry of `parameters`. std and interval_95 hold what the equations may err, scatter is the std without it, by which two fits of
    like flights differ."""

    value: float
    unit: str
    std: float | None = None
    interval_95: tuple[float, float] | None = None
    source: str = "fit"
    identifiable: bool = True
    why: str = ""
    fly: str = ""
    scatter: float | None = None


@dataclass(frozen=True)
class ModelFile:
    """A model.yaml, read. model: the physics; values: every parameter the model needs; covariance over `order`.

    valid, fingerprint, noise, fit_quality: as written; runs: names of the recordings it was fitted to; vehicle: {name, autopilot, sysid}
    as far as they are known; diagnosed: what was looked for in its own flights beside its terms, {} where nothing was.
    """

    model: Model
    parameters: Mapping[str, StoredParameter]
    values: Mapping[str, float]
    order: tuple[str, ...]
    covariance: FloatArray
    valid: ValidBlock
    fingerprint: FingerprintData = field(default_factory=FingerprintData)
    runs: tuple[Any, ...] = ()
    noise: NoiseBlock = field(default_factory=NoiseBlock)
    fit_quality: QualityBlock = field(default_factory=QualityBlock)
    notes: tuple[str, ...] = ()
    path: str = ""
    vehicle: IdentityData = field(default_factory=IdentityData)
    diagnosed: DiagnosedBlock = field(default_factory=DiagnosedBlock)

    @property
    def vehicle_name(self) -> str:
        """The vehicle that it is a model of; '' where that is not known."""
        return str(self.vehicle.get("name") or "")

    @property
    def delays_s(self) -> dict[str, float]:
        """Delay per channel, s, added terms included."""
        system = self.model.system
        p = np.array([self.values[n] for n in system.params])
        return dict(zip(system.delay_channels, np.asarray(system.delays_s(p)).ravel().tolist(), strict=True))


def as_data(
    found: Fit,
    *,
    fingerprint: FingerprintData | None = None,
    runs: Sequence[Any] | None = None,
    extra_quality: QualityBlock | None = None,
) -> ModelData:
    """A fit as the plain data of model.yaml."""
    parameters: dict[str, ParameterBlock] = {}
    for name, e in found.estimates.items():
        entry: ParameterBlock = {"value": _number(e.value), "unit": e.unit, "std": _number(e.std)}
        entry["interval_95"] = None if e.interval_95 is None else [_number(v) for v in e.interval_95]
        if e.scatter is not None:
            entry["scatter"] = _number(e.scatter)
        entry |= {"source": e.source, "identifiable": e.identifiable}
        if e.why:
            entry["why"] = e.why
        if e.fly:
            entry["fly"] = e.fly
        parameters[name] = entry
    order, matrix = covariance_with_mean_delay(found)
    valid = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(found.valid).items() if v is not None}
    quality: QualityBlock = {
        "status": found.status.value,
        "iterations": found.solution.iterations,
        "responses": len(found.problem.segments),
        "channels": {
            c: {"rmse": _number(q.rmse), "noise_floor": _number(q.floor), "r2": _number(q.r2), "residual": q.sentence}
            for c, q in found.quality.items()
        },
        "outliers": [o.sentence for o in found.outliers],
        "ties": [t.sentence for t in found.ties],
        "voltage_spread_at_equal_throttle_v": _number(found.voltage_spread_v),
        **found.checks,
        **(extra_quality or {}),
    }
    data: ModelData = {
        "format": "model/1",
        "terms": list(found.model.terms),
        "parameters": parameters,
        "constants": dict(found.model.constants),
        "attitude_loops": found.model.attitude_loops,
        "channel_delays": found.model.channel_delays,
        "delays": {c: {"value": _number(v), "unit": "s", "std": _number(s)} for c, (v, s) in found.delays_s.items()},
    }
    if found.onset is not None:
        data["onset_delay"] = {
            "mean_s": _number(found.onset.mean_s), "std_s": _number(found.onset.std_s), "count": found.onset.count,
            "channels_s": {k: _number(v) for k, v in found.onset.channel_s.items()},
        }  # fmt: skip
    data |= {
        "covariance": {"order": list(order), "matrix": [[_number(v) for v in row] for row in matrix]},
        "valid": cast(ValidBlock, valid),
        "fingerprint": fingerprint or FingerprintData(),
        "runs": list(runs if runs is not None else found.runs),
        "noise": {
            "channels": {c: n for c, v in found.noise.channel.items() if (n := _number(v)) is not None},
            "disturbances": {c: n for c, v in found.noise.disturbance.items() if (n := _number(v)) is not None},
            "correlations": {c: n for c, v in found.noise.correlation.items() if (n := _number(v)) is not None},
        },
        "fit_quality": quality,
        "notes": list(found.notes),
    }
    return data


def covariance_with_mean_delay(found: Fit) -> tuple[tuple[str, ...], FloatArray]:
    """The covariance with T_d, the mean of the channels' delays, as its last row."""
    names, matrix = found.covariance.names, found.covariance.matrix
    delays = [n for n in DELAY_PARAM.values() if n in names]
    if not delays or "T_d" in names:
        return names, matrix
    mean = np.array([1.0 / len(delays) if n in delays else 0.0 for n in names])
    expand = np.vstack([np.eye(len(names)), mean])
    return (*names, "T_d"), expand @ matrix @ expand.T


def write(path: Path, data: ModelData) -> None:
    """Write model.yaml from `as_data`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, yaml.dump(dict(data), Dumper=ModelDumper, sort_keys=False, allow_unicode=True, width=120))


def held_by(path: Path) -> Path:
    """The model file that a path stands for: itself, or what a run or diagnosis folder holds, the diagnosis' before the fit's. ModelError
    where a folder holds none."""
    if not path.is_dir():
        return path
    found = next((path / name for name in NAMES if (path / name).is_file()), None)
    if found is None:
        raise ModelError(f"{path} holds no model ({' or '.join(NAMES)})", "make one: flighttest diagnose RUN -o DIR")
    return found


def read(path: Path, *, whole: bool = False) -> ModelFile:
    """Read model.yaml, or the one that a folder holds; ModelError lists everything wrong with it.

    whole: it will be flown or exported, so that it has to hold every parameter of its terms; otherwise the body's may be missing.
    """
    path = held_by(path)
    text = read_text(path, ModelError, "model file")
    found = read_form(text, str(path), Form("model", _TOP, ModelError), lambda d, keys: _model_file(d, keys, str(path)))
    model, delays = found.model, (*DELAY_PARAM.values(), DELAY.name)
    missing = [
        n
        for n in model.names
        if n not in found.parameters and n not in delays and (whole or model.term_of(n) != "body")
    ]
    if missing:
        raise ModelError(
            f"{path}: parameters {', '.join(missing)} of its terms are missing",
            "write the file again with `flighttest fit`",
        )
    return found


def _model_file(document: YamlDocument, root: Mapping[str, Node], path: str) -> ModelFile:
    """The model of a document; block by block first, then each parameter by the model that the blocks state, where those are right."""
    terms = terms_of(document, root.get("terms"))
    parameters = _parameters(document, root.get("parameters"))
    constants = constants_of(document, root.get("constants"))
    noise = noise_of(document, root.get("noise"))
    order, matrix = _covariance(document, root.get("covariance"), parameters)
    check_plain(document, root)
    require(document, root, ("terms", "parameters"), document.line)
    plain = {k: n.plain() for k, n in root.items()}
    model = Model()
    if not document.problems:
        model = _model(terms, constants, plain, parameters)
        for name, node in children_of(document, root["parameters"]).items():
            _check_parameter(document, node, name, parameters[name], model)
    return ModelFile(
        model=model,
        parameters=parameters,
        values={} if document.problems else model.start({n: p.value for n, p in parameters.items()}),
        order=order,
        covariance=matrix,
        valid=cast(ValidBlock, plain.get("valid") or {}),
        fingerprint=cast(FingerprintData, plain.get("fingerprint") or {}),
        runs=tuple(list_elements(plain.get("runs"))),
        noise=noise,
        fit_quality=cast(QualityBlock, plain.get("fit_quality") or {}),
        notes=tuple(list_elements(plain.get("notes"))),
        path=path,
        vehicle=cast(IdentityData, plain.get("vehicle") or {}),
        diagnosed=cast(DiagnosedBlock, plain.get("diagnosed") or {}),
    )


def _model(
    terms: Sequence[str],
    constants: Mapping[str, float],
    plain: Mapping[str, PlainData],
    parameters: Mapping[str, StoredParameter],
) -> Model:
    """The physics. Attitude loops and a delay for each channel: as stated, otherwise as the parameters have them."""
    loops = plain.get("attitude_loops", any(n in parameters for n in ("omega_phi", "omega_theta", "sigma_r")))
    delays = plain.get("channel_delays", any(n in parameters for n in DELAY_PARAM.values()))
    return Model(
        tuple(terms),
        constants.get("nominal_voltage_v", NOMINAL_VOLTAGE_V),
        constants.get("g", G_M_S2),
        channel_delays=bool(delays),
        attitude_loops=bool(loops),
        rotor_height_m=constants.get("rotor_height_m", ROTOR_HEIGHT_M),
    )


def from_fit(found: Fit) -> ModelFile:
    """A fit as the model file it would be read back from, without the way over a disk."""
    order, matrix = covariance_with_mean_delay(found)
    parameters = {
        n: StoredParameter(e.value, e.unit, e.std, e.interval_95, e.source, e.identifiable, e.why, e.fly, e.scatter)
        for n, e in found.estimates.items()
    }
    data = as_data(found)
    return ModelFile(
        found.model, parameters, found.values, order, matrix, data["valid"], {}, tuple(data["runs"]), data["noise"],
        data["fit_quality"], found.notes,
    )  # fmt: skip


def _number(value: float | None) -> float | None:
    """Seven digits: enough for any use, and a file that reads well. None for what is no number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.7g}")


def _parameters(document: YamlDocument, node: Node | None) -> dict[str, StoredParameter]:
    if node is None:
        return {}
    if not isinstance(node.value, dict):
        document.wrong(node, f"expected a block of parameters, found {kind_of(node.value)}")
        return {}
    found = {}
    for name, child in node.value.items():
        entry = document.mapping(child, _PARAMETER)
        if "value" not in entry:
            document.wrong(child, f"parameter {name} has no value", "write `value:`")
            continue
        value = document.number(entry["value"], -1e9, 1e9)
        std, scatter = (
            None if key not in entry or entry[key].value is None else document.number(entry[key], 0.0, 1e9)
            for key in ("std", "scatter")
        )
        interval = entry["interval_95"].plain() if "interval_95" in entry else None
        pair = None
        if isinstance(interval, list):
            numbers = [float(v) for v in interval if isinstance(v, int | float) and not isinstance(v, bool)]
            if len(interval) == len(numbers) == 2 and np.isfinite(numbers).all() and numbers[0] <= numbers[1]:
                pair = (numbers[0], numbers[1])
            else:
                document.wrong(entry["interval_95"], "an interval is two rising numbers", "write [low, high]")
        elif interval is not None:
            document.wrong(entry["interval_95"], "an interval is two rising numbers", "write [low, high]")

        def text(key: str, default: str = "", entry: dict[str, Node] = entry) -> str:
            return str(entry[key].plain()) if key in entry else default

        identifiable = entry["identifiable"].plain() if "identifiable" in entry else True
        if not isinstance(identifiable, bool):
            document.wrong(entry["identifiable"], "expected true or false")
        if value is not None:
            found[name] = StoredParameter(
                value,
                text("unit"),
                std,
                pair,
                text("source", "fit"),
                bool(identifiable),
                text("why"),
                text("fly"),
                std if scatter is None else scatter,
            )
    return found


def _check_parameter(document: YamlDocument, node: Node, name: str, stored: StoredParameter, model: Model) -> None:
    """A name that the model has, in its unit, where such a parameter can lie."""
    known = {p.name: p for p in (*ATTITUDE_PARAMS, *CHANNEL_DELAYS, DELAY)} | dict(model.param)
    param = known.get(name)
    if param is None:
        near = get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]}?" if near else f"its terms have {', '.join(model.names)}"
        document.wrong(node, f"the model has no parameter {name}", hint)
        return
    if stored.unit and _plain_unit(stored.unit) != _plain_unit(param.unit):
        document.wrong(node, f"{name} is in {param.unit}, not in {stored.unit}", f"convert it to {param.unit}")
    slack = 1e-6 * param.scale  # of rounding
    if stored.source == "fit" and not param.lower - slack <= stored.value <= param.upper + slack:
        document.wrong(
            node, f"{stored.value:g} is outside {param.lower:g} to {param.upper:g} {param.unit}, where fits look"
        )
    elif stored.value <= 0.0 < param.lower:
        document.wrong(node, f"{stored.value:g}: {name} is above zero")


def _plain_unit(unit: str) -> str:
    return {"-": "1"}.get(unit, unit.replace("\u00b2", "^2").replace(" ", ""))


def _covariance(
    document: YamlDocument, node: Node | None, parameters: Mapping[str, StoredParameter]
) -> tuple[tuple[str, ...], FloatArray]:
    """Order and matrix; from the standard errors alone where the file has no covariance."""
    plain = plain_block(document, node)
    if node is None or not plain:
        names = tuple(n for n, p in parameters.items() if p.std is not None)
        return names, np.diag([float(parameters[n].std or 0.0) ** 2 for n in names])
    given = cast(CovarianceBlock, plain)
    names = tuple(map(str, list_elements(plain.get("order"))))
    try:
        matrix = np.array(given.get("matrix") or [], dtype=float).reshape(len(names), len(names))
    except (ValueError, TypeError):
        document.wrong(node, f"the matrix is not {len(names)} x {len(names)} numbers, as many as `order` names")
        return (), np.zeros((0, 0))
    if not np.isfinite(matrix).all():
        document.wrong(node, "the matrix holds something that is not a finite number")
    elif np.any(np.diag(matrix) < 0.0):
        document.wrong(node, "the matrix has a negative variance on its diagonal")
    elif not np.allclose(matrix, matrix.T, rtol=1e-5, atol=0.0):
        document.wrong(node, "the matrix is not symmetric")
    strange = [n for n in names if n not in parameters]
    if strange or len(set(names)) < len(names):
        named = ", ".join(strange) or ", ".join(n for n, k in Counter(names).items() if k > 1)
        document.wrong(
            node, f"`order` names {named}, which {'are no parameters of this file' if strange else 'stand there twice'}"
        )
    return names, matrix
