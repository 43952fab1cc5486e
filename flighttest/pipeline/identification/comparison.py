"""`flighttest compare`: two models, or the fits of two runs, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flighttest.errors import InputError
from flighttest.identify.models import model_file
from flighttest.identify.models.compare import LEVEL, ParameterDifference
from flighttest.identify.models.compare import compare as compare_models
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.pipeline.identification.fitting import cut_all, fit_segments
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result
from flighttest.report.document import Align, Cell, Document, Section, Table
from flighttest.report.numbers import join, join_some, number, percent, to_error, unit


def open_model(source: Path | ModelFile, progress: Progress = SILENT) -> ModelFile:
    """A model as it is, of its file, or the fit of a run or log."""
    if isinstance(source, ModelFile):
        return source
    path = source
    if not path.exists():
        raise InputError(f"{path}: there is no such model or run", "give a model.yaml, a run folder or a log")
    if path.suffix in (".yaml", ".yml") or any((path / name).is_file() for name in model_file.NAMES):
        return model_file.read(path)
    recordings = open_recordings([path], progress=progress)
    found = fit_segments(cut_all(recordings, progress), recordings, progress=progress)
    return model_file.from_fit(found)


def compare(first: Path | ModelFile, second: Path | ModelFile, progress: Progress = SILENT) -> Result:
    """z-scores per parameter between two models or two runs, and which differ, in one table."""
    a, b = open_model(first, progress), open_model(second, progress)
    found = compare_models(a, b)
    rows = tuple(_compared(d, a, b) for d in found)
    data = [
        {
            "name": d.name,
            "unit": d.unit,
            "first": d.first,
            "second": d.second,
            "difference": d.difference,
            "change": d.difference / abs(d.first) if d.difference is not None and d.first else None,
            "std": d.std,
            "z": d.z,
            "p_value": d.p_value,
            "different": d.differs,
            "sentence": d.sentence,
        }
        for d in found
    ]
    align: tuple[Align, ...] = ("left", "right", "right", "left", "right", "right", "left")
    note = f"z: difference over its standard error; differs: beyond chance at {LEVEL:.0%} over all parameters together"
    note += _carried(found, a, b)
    table = Table(("parameter", "first", "second", "unit", "change", "z", ""), rows, align, note)
    differing = [d.name for d in found if d.differs]
    tested = sum(d.z is not None for d in found)
    only = [d.name for d in found if d.first is None or d.second is None]
    if differing:
        verdict, tone = f"{join_some(differing)} differ{'s' if len(differing) == 1 else ''}.", "warn"
    elif tested:
        verdict, tone = f"No parameter differs beyond its error ({tested} compared).", "good"
    else:
        verdict, tone = "Nothing can be compared: no parameter is identified in both.", "bad"
    if only:
        verdict += f" In one of them only: {join(sorted(only))}."
    facts = {"first": str(first), "second": str(second)}
    document = Document("compare", verdict, tone, (Section("table", "", (table,)),), facts)  # type: ignore[arg-type]
    shown = {"parameters": data, "differing": differing, "only_in_one": sorted(only)}
    return Result(document, shown, value=found)


def _std_at(value: float, stored: StoredParameter) -> float | None:
    """Of a parameter as it is compared, which for K may be at another voltage than it is stored for."""
    return stored.std if stored.std is None or not stored.value else stored.std * abs(value / stored.value)


def _carried(found: Sequence[ParameterDifference], a: ModelFile, b: ModelFile) -> str:
    """That K of the second model is shown at the nominal voltage of the first, where the two have another."""
    gain = next((d for d in found if d.name == "K" and d.second is not None and "K" in b.parameters), None)
    if gain is None or gain.second == b.parameters["K"].value:
        return ""
    mine, other = (number(m.model.nominal_voltage_v, 3) for m in (a, b))
    stored = to_error(b.parameters["K"].value, b.parameters["K"].std)
    return f"; K of the second is that at {mine} V, the nominal voltage of the first ({stored} {unit(gain.unit)} at its own {other} V)"


def _compared(d: ParameterDifference, a: ModelFile, b: ModelFile) -> tuple[Cell | str, ...]:
    p, q = a.parameters.get(d.name), b.parameters.get(d.name)
    word = Cell("differs", "bad") if d.differs else Cell("same", "good")
    if d.z is None:
        word = Cell("-", "quiet", d.sentence)
    return (
        d.name,
        to_error(p.value, p.std) if p is not None else "-",
        "-" if q is None or d.second is None else to_error(d.second, _std_at(d.second, q)),
        unit(d.unit),
        percent(d.difference / abs(d.first)) if d.difference is not None and d.first else "-",
        "-" if d.z is None else f"{d.z:+.1f}",
        word,
    )
