"""`flighttest export`: a model for other programs and simulators, and what of it they cannot hold."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flighttest.datafiles import check_writable
from flighttest.identify.models import model_file
from flighttest.identify.models.export import export as write_export
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.results import Result
from flighttest.report.document import Bullets, Document, Section, Table
from flighttest.report.numbers import join, number

KINDS = ("casadi", "c", "json", "fmu", "rotorpy", "ardupilot")


def export(model: Path | ModelFile, kind: str, output: Path) -> Result:
    """Write a model for other programs. casadi, c, json: the model itself; fmu, rotorpy, ardupilot: as a vehicle of another
    simulator."""
    stored = model_file.read(model, whole=True) if isinstance(model, Path) else model
    if kind not in _VEHICLES:
        return _itself(stored, kind, output)
    check_writable(output)
    rows, data = _VEHICLES[kind](stored, output)
    table = Table(("file", "what it is"), tuple((str(path), what) for path, what in rows))
    blocks = (table, Bullets(tuple(data["left_out_sentences"])))
    verdict = f"{join([str(path) for path, _ in rows])} written."
    document = Document("export", verdict, "good", (Section("files", "", blocks),))
    return Result(document, {"files": [str(path) for path, _ in rows], "to": kind} | data)


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
        "step_sensitivity.casadi": "slopes of x_next by the parameters of the covariance",
        "flighttest_model.c": "the same functions in C99",
        "flighttest_model.h": "its header",
        "example.c": "a small program that calls them",
    }.get(path.name, "")


ExportedFiles = list[tuple[Path, str]]


def _fmu(stored: ModelFile, output: Path) -> tuple[ExportedFiles, dict[str, Any]]:
    from flighttest.twin import fmu

    sentences = ["every term of the model and its delays are in it; the battery's voltage is an input"]
    what = "FMI 2.0 co-simulation, compiled for this system, with its C source"
    return [(fmu.write_fmu(stored, output), what)], {"left_out": [], "left_out_sentences": sentences}


def _rotorpy(stored: ModelFile, output: Path) -> tuple[ExportedFiles, dict[str, Any]]:
    from flighttest.twin import rotorpy

    path = rotorpy.write_vehicle(stored, output)
    lacking, error = rotorpy.lacking(stored), rotorpy.left_error(stored)
    sentences = [
        f"RotorPy's vehicle has no {join(list(lacking), 'or')}" if lacking else "no term of the model is left out",
        "drag follows the rotor speed instead of being constant, and is one number for forward and left",
        *(
            ["fuselage drag goes with the speed of the whole airflow, not of each axis"]
            if "quadratic_drag" in stored.model.terms
            else []
        ),
        f"on tilt steps of 0.3 rad and throttle steps of a fifth, 3 s long, this leaves {number(error['velocity_m_s'], 2)} m/s and "
        f"{number(error['attitude_rad'], 2)} rad at most against the model's own simulation, in steps of 2 ms",
        "mass, arm and inertia are not identified: the forces per mass and the attitude loops are what holds",
    ]
    data = {"left_out": list(lacking), "left_error": error, "left_out_sentences": sentences}
    return [(path, "quad_params, and Commands: references and throttle to RotorPy's cmd_ctbm")], data


def _over_voltages(stored: ModelFile, share: float) -> str:
    alpha = stored.parameters.get("alpha")
    if alpha is None or not alpha.identifiable:
        return "how that of the model does is not known (alpha)"
    return f"at most {share:.1%} off over the voltages of the model"


def _ardupilot(stored: ModelFile, output: Path) -> tuple[ExportedFiles, dict[str, Any]]:
    from flighttest.twin import ardupilot

    (frame, parameters), made = ardupilot.write_frame(stored, output)
    sentences = [
        f"ArduPilot's frame has no {join(list(made.lacking), 'or')}"
        if made.lacking
        else "no term of the model is left out",
        f"its thrust goes with the square of the voltage: {_over_voltages(stored, made.thrust_share)}",
        "its drag is one number for all axes and follows the root of the thrust, and it loses thrust in a climb",
        f"on tilt steps of 0.3 rad and throttle steps of a fifth, 3 s long, this leaves {number(made.velocity_m_s, 2)} m/s and "
        f"{number(made.force_m_s2, 2)} m/s^2 at most against the model's own simulation in the middle of its voltages",
        f"its motors have no lag: that of the thrust is the firmware's throttle filter (PILOT_THR_FILT), and the attitude loops are left "
        f"with {made.tilt_share:.1%} of a tilt step and {made.yaw_share:.1%} of a yaw rate step",
        *made.loops.notes,
        f"fly it: flighttest sim --backend sitl --frame {shlex.quote(str(output))}",
    ]
    data = {
        "left_out": list(made.lacking),
        "left_error": {
            "velocity_m_s": made.velocity_m_s,
            "force_m_s2": made.force_m_s2,
            "thrust_share": made.thrust_share,
            "tilt_share": made.tilt_share,
            "yaw_share": made.yaw_share,
        },
        "left_out_sentences": sentences,
    }
    return [
        (frame, "frame for --model x:vehicle.json"),
        (parameters, "parameters for --defaults, after your own"),
    ], data


_VEHICLES: dict[str, Callable[[ModelFile, Path], tuple[ExportedFiles, dict[str, Any]]]] = {
    "fmu": _fmu,
    "rotorpy": _rotorpy,
    "ardupilot": _ardupilot,
}
