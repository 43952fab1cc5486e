"""A fitted model for other programs: CasADi functions, C99, and a description in JSON (docs/formats.md, Export)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.identify.models.model_blocks import ValidBlock
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.simulate import rk4
from flighttest.version import __version__

FloatArray = NDArray[np.float64]

ExportKind = Literal["casadi", "c", "json"]
JACOBIANS = ("step_A", "step_B")


def functions(stored: ModelFile) -> dict[str, ca.Function]:
    """dynamics(x, u) -> x_dot, step(x, u, dt) -> x_next, step_jacobian(x, u, dt) -> A, B; fitted numbers inside, delays left out."""
    system = stored.model.system
    x, u, dt = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs)), ca.SX.sym("dt")
    p = ca.DM([stored.values[n] for n in system.params])
    x_dot = ca.densify(system.function(x, u, p)[0])
    dynamics = ca.Function("dynamics", [x, u], [ca.cse(x_dot)], ["x", "u"], ["x_dot"])
    x_next = rk4(lambda at: dynamics(at, u), x, dt)
    step = ca.Function("step", [x, u, dt], [ca.cse(ca.densify(x_next))], ["x", "u", "dt"], ["x_next"])
    jacobians = ca.cse([ca.densify(ca.jacobian(x_next, x)), ca.densify(ca.jacobian(x_next, u))])
    slopes = ca.Function("step_jacobian", [x, u, dt], jacobians, ["x", "u", "dt"], list(JACOBIANS))
    return {"dynamics": dynamics, "step": step, "step_jacobian": slopes}


def sensitivity(stored: ModelFile) -> ca.Function:
    """step_sensitivity(x, u, dt) -> slopes of x_next by the parameters of `known_order`, (n_x, n): with the covariance, how far a step
    of the model is to be trusted."""
    system = stored.model.system
    x, u, dt = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs)), ca.SX.sym("dt")
    known = known_order(stored)
    free = ca.SX.sym("p", len(known))
    p = ca.vertcat(*(free[known.index(n)] if n in known else ca.SX(stored.values[n]) for n in system.params))
    x_next = rk4(lambda at: system.function(at, u, p)[0], x, dt)
    by_p = ca.Function("by_p", [x, u, dt, free], [ca.densify(ca.jacobian(x_next, free))])
    fitted = ca.DM([stored.values[n] for n in known])
    return ca.Function("step_sensitivity", [x, u, dt], [ca.cse(by_p(x, u, dt, fitted))], ["x", "u", "dt"], ["step_P"])


def known_order(stored: ModelFile) -> list[str]:
    """Parameters of the covariance that a step depends on: delays are not in it."""
    return [n for n in stored.order if n in stored.model.system.params and not n.startswith("T_d")]


class Quantity(TypedDict):
    """One entry of a vector."""

    name: str
    unit: str


class ExportedParameter(TypedDict):
    """One parameter, SI."""

    value: float
    unit: str
    std: float | None
    interval_95: list[float] | None
    source: str
    identifiable: bool


class ExportedCovariance(TypedDict):
    """Covariance of the parameters in this order."""

    order: list[str]
    matrix: list[list[float]]


class Hovering(TypedDict):
    """A state at rest and the inputs that hold it."""

    x: list[float]
    u: list[float]


class ExportData(TypedDict):
    """model.json (format export/1): what the functions' vectors mean."""

    format: str
    generator: str
    terms: list[str]
    states: list[Quantity]
    inputs: list[Quantity]
    parameters: dict[str, ExportedParameter]
    covariance: ExportedCovariance
    sensitivity_order: list[str]
    delays_s: dict[str, float]
    valid: ValidBlock
    constants: dict[str, float]
    frames: dict[str, str]
    hover: Hovering


def description(stored: ModelFile) -> ExportData:
    """model.json: what the functions' vectors mean."""
    system = stored.model.system
    delays = stored.delays_s
    parameters: dict[str, ExportedParameter] = {
        n: {
            "value": p.value, "unit": p.unit, "std": p.std,
            "interval_95": None if p.interval_95 is None else list(p.interval_95),
            "source": p.source, "identifiable": p.identifiable,
        }
        for n, p in stored.parameters.items()
    }  # fmt: skip
    return {
        "format": "export/1",
        "generator": f"flighttest {__version__}",
        "terms": list(stored.model.terms),
        "states": [{"name": n, "unit": unit} for n, unit in system.states.items()],
        "inputs": [{"name": n, "unit": unit} for n, unit in system.inputs.items()],
        "parameters": parameters,
        "covariance": {"order": list(stored.order), "matrix": error_covariance(stored).tolist()},
        "sensitivity_order": known_order(stored),
        "delays_s": {n: delays.get(c, 0.0) for n, c in system.input_delay.items()},
        "valid": stored.valid,
        "constants": dict(stored.model.constants),
        "frames": {"world": "NWU", "body": "FLU"},
        "hover": {"x": hover_state(stored).tolist(), "u": hover_input(stored).tolist()},
    }


def error_covariance(stored: ModelFile) -> FloatArray:
    """(k, k) over `stored.order`, of the errors of the values: that of model.yaml, which is of the scatter between cells alone, with the
    standard error of each parameter, which holds what the equations may err."""
    scatter = np.sqrt(np.diag(stored.covariance))
    std = [p.std if (p := stored.parameters.get(n)) is not None and p.std else 0.0 for n in stored.order]
    wider = np.maximum(np.array(std) / np.where(scatter > 0.0, scatter, np.inf), 1.0)
    return np.asarray(stored.covariance * np.outer(wider, wider))


def hover_state(stored: ModelFile) -> Any:
    """A state at rest, level, thrust equal to weight."""
    return np.array([stored.model.g_m_s2 if n == "a_t_m_s2" else 0.0 for n in stored.model.system.states])


def hover_input(stored: ModelFile) -> Any:
    """Inputs that hold it, at the middle of the voltage range seen (nominal where none was)."""
    valid = stored.valid.get("voltage_v")
    voltage = float(np.mean(valid)) if valid else stored.model.nominal_voltage_v
    level = {"voltage_v": voltage, "throttle": float(stored.model.hover_throttle(stored.values, voltage))}
    return np.array([level.get(n, 0.0) for n in stored.model.system.inputs])


def export(stored: ModelFile, kind: ExportKind, folder: Path) -> tuple[Path, ...]:
    """Write the files of one kind into `folder` (made if need be); returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    described = folder / "model.json"
    described.write_text(json.dumps(_finite(description(stored)), indent=1) + "\n", encoding="utf-8")
    written = [described]
    if kind == "casadi":
        made = functions(stored) | ({"step_sensitivity": sensitivity(stored)} if known_order(stored) else {})
        for name, function in made.items():
            path = folder / f"{name}.casadi"
            function.save(str(path))
            written.append(path)
    elif kind == "c":
        written += _write_c(stored, folder)
    return tuple(written)


def _finite(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def c_code(made: Sequence[ca.Function], folder: Path) -> None:
    """flighttest_model.c with its header."""
    generator = ca.CodeGenerator(
        "flighttest_model.c", {"with_header": True, "casadi_int": "int", "casadi_real": "double"}
    )
    for function in made:
        generator.add(function)
    generator.generate(str(folder) + "/")
    source = folder / "flighttest_model.c"
    source.write_text(_quieted(source.read_text(encoding="utf-8")), encoding="utf-8")


def _write_c(stored: ModelFile, folder: Path) -> list[Path]:
    """flighttest_model.c with its header, and example.c with numbers to check against."""
    made = functions(stored)
    c_code(list(made.values()), folder)
    system = stored.model.system
    x, u = hover_state(stored), hover_input(stored)
    x = x + 0.01 * np.arange(1, x.size + 1)
    expected = np.asarray(made["step"](x, u, 0.02)).ravel()
    states = "\n".join(f" *   x[{i}] {n}, {unit}" for i, (n, unit) in enumerate(system.states.items()))
    inputs = "\n".join(f" *   u[{i}] {n}, {unit}" for i, (n, unit) in enumerate(system.inputs.items()))
    example = folder / "example.c"
    example.write_text(
        _EXAMPLE.format(
            states=states, inputs=inputs, n_x=x.size, n_u=u.size,
            x=", ".join(f"{v:.17g}" for v in x), u=", ".join(f"{v:.17g}" for v in u),
            expected=", ".join(f"{v:.17g}" for v in expected),
        ),
        encoding="utf-8",
    )  # fmt: skip
    return [folder / "flighttest_model.c", folder / "flighttest_model.h", example]


def _quieted(code: str) -> str:
    """CasADi's C leaves parameters of its fixed interface unused; mark them, for builds with -Wextra."""

    def use(match: re.Match[str]) -> str:
        names = [n for n in ("arg", "res", "iw", "w", "mem") if re.search(rf"\b{n}\b[,)]", match.group(0))]
        return match.group(0) + "\n  " + " ".join(f"(void){n};" for n in names)

    code = re.sub(r"^static int casadi_f\d+\([^)]*\) \{", use, code, flags=re.MULTILINE)
    return re.sub(r"^CASADI_SYMBOL_EXPORT void \w+_release\(int mem\) \{", use, code, flags=re.MULTILINE)


_EXAMPLE = """/* One 20 ms step of the fitted model. Build: cc -std=c99 -Wall -Wextra -o example example.c flighttest_model.c -lm
 * Frames: world North-West-Up, body Forward-Left-Up. Inputs are the delayed ones (see delays_s in model.json).
{states}
{inputs}
 */
#include <math.h>
#include <stdio.h>

#include "flighttest_model.h"

int main(void) {{
  const double x[{n_x}] = {{{x}}};
  const double u[{n_u}] = {{{u}}};
  const double dt = 0.02;
  const double expected[{n_x}] = {{{expected}}};
  double x_next[{n_x}];
  const double *arg[step_SZ_ARG] = {{0}};
  double *res[step_SZ_RES] = {{0}};
  int iw[step_SZ_IW + 1];
  double w[step_SZ_W + 1];
  double worst = 0.0;
  int i;
  arg[0] = x;
  arg[1] = u;
  arg[2] = &dt;
  res[0] = x_next;
  if (step(arg, res, iw, w, 0) != 0) return 1;
  for (i = 0; i < {n_x}; ++i) {{
    const double off = fabs(x_next[i] - expected[i]) / (1.0 + fabs(expected[i]));
    if (off > worst) worst = off;
    printf("x_next[%d] = %.10g\\n", i, x_next[i]);
  }}
  printf("largest difference from the CasADi function: %.3g\\n", worst);
  return worst < 1e-10 ? 0 : 1;
}}
"""
