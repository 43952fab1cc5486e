"""`flighttest export`: a model for other programs and simulators, and what of it they cannot hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flighttest.identify.models import model_file
from flighttest.identify.models.export import export as write_export
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.results import Result, check_writable
from flighttest.report.document import Bullets, Document, Section, Table
from flighttest.report.numbers import join, number

KINDS = ("casadi", "c", "json", "fmu", "rotorpy")


def export(model: Path | ModelFile, kind: str, output: Path) -> Result:
    """Write a model for other programs. casadi, c, json: the model itself; fmu, rotorpy: as a vehicle of another simulator."""
    stored = model_file.read(model, whole=True) if isinstance(model, Path) else model
    if kind not in ("fmu", "rotorpy"):
        return _itself(stored, kind, output)
    check_writable(output)
    path, what, data = (_fmu if kind == "fmu" else _rotorpy)(stored, output)
    table = Table(("file", "what it is"), ((str(path), what),))
    blocks = (table, Bullets(tuple(data["left_out_sentences"])))
    document = Document("export", f"{path} written.", "good", (Section("files", "", blocks),))
    return Result(document, {"files": [str(path)], "to": kind} | data)


def _itself(stored: ModelFile, kind: str, output: Path) -> Result:
    written = write_export(stored, kind, output)  # type: ignore[arg-type]
    rows = tuple((str(path), _what(path)) for path in written)
    verdict = f"{len(written)} file{'s' if len(written) != 1 else ''} written to {output}."
    section = Section("files", "", (Table(("file", "what it is"), rows),))
    return Result(Document("export", verdict, "good", (section,)), {"files": [str(p) for p in written], "to": kind})


def _what(path: Path) -> str:
    return {
        "model.json": "states, inputs, delays, parameters, covariance, validity",
        "dynamics.casadi": "x_dot = dynamics(x, u)",
        "step.casadi": "x_next = step(x, u, dt), one RK4 step",
        "step_jacobian.casadi": "A, B = step_jacobian(x, u, dt)",
        "flighttest_model.c": "the same functions in C99",
        "flighttest_model.h": "its header",
        "example.c": "a small program that calls them",
    }.get(path.name, "")


def _fmu(stored: ModelFile, output: Path) -> tuple[Path, str, dict[str, Any]]:
    from flighttest.twin import fmu

    said = ["every term of the model and its delays are in it; the battery's voltage is an input"]
    what = "FMI 2.0 co-simulation, compiled for this system, with its C source"
    return fmu.write_fmu(stored, output), what, {"left_out": [], "left_out_sentences": said}


def _rotorpy(stored: ModelFile, output: Path) -> tuple[Path, str, dict[str, Any]]:
    from flighttest.twin import rotorpy

    path = rotorpy.write_vehicle(stored, output)
    lacking, error = rotorpy.lacking(stored), rotorpy.left_error(stored)
    said = [
        f"RotorPy's vehicle has no {join(list(lacking), 'or')}" if lacking else "no term of the model is left out",
        "drag follows the rotor speed instead of being constant, and is one number for forward and left",
        f"on tilt steps of 0.3 rad and throttle steps of a fifth, 3 s long, this leaves {number(error['velocity_m_s'], 2)} m/s and "
        f"{number(error['attitude_rad'], 2)} rad at most against the model's own simulation, in steps of 2 ms",
        "mass, arm and inertia are not identified: the forces per mass and the attitude loops are what holds",
    ]
    data = {"left_out": list(lacking), "left_error": error, "left_out_sentences": said}
    return path, "quad_params, and Commands: references and throttle to RotorPy's cmd_ctbm", data
