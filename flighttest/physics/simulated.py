"""A model run open loop from inputs as a table: `Model.simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.errors import InputError
from flighttest.physics.core import Param
from flighttest.physics.simulate import Simulable, simulate

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """An open-loop run. t_s: (n,) s; channels: name to (n,), inputs, outputs and states, SI, world North-West-Up, body Forward-Left-Up."""

    t_s: FloatArray
    channels: Mapping[str, FloatArray]

    def __repr__(self) -> str:
        return f"<Simulated: {self.t_s.size} samples, {self.t_s[0]:g} to {self.t_s[-1]:g} s, of {', '.join(self.channels)}>"

    def to_frame(self) -> pd.DataFrame:
        """One column per channel, indexed by t_s."""
        import pandas as pd

        return pd.DataFrame(dict(self.channels), index=pd.Index(self.t_s, name="t_s"))

    def plot(self) -> go.Figure:
        """Every channel over time, one panel per group."""
        from flighttest.plotting import by_group, over_time

        return over_time(by_group(self.t_s, self.channels), "simulated")


class Runnable(Simulable, Protocol):
    """A model that has what to take for inputs and parameters that are not given: `physics.model.Model`."""

    @property
    def nominal_voltage_v(self) -> float:
        """Battery voltage where none is given, V."""

    @property
    def param(self) -> Mapping[str, Param]:
        """Parameters by name."""

    def start(self, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters by name: `values`, and the model's own for the rest."""

    def hover_throttle(self, values: Mapping[str, float], voltage_v: ArrayLike) -> FloatArray:
        """Throttle that holds height at these voltages, V, of their shape."""


def run_open_loop(
    model: Runnable,
    inputs: Mapping[str, ArrayLike] | pd.DataFrame,
    values: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
) -> Simulated:
    """`Model.simulate`, where the arguments are described."""
    given = {str(name): _column(str(name), column) for name, column in inputs.items()}
    if "t_s" not in given:
        raise InputError("the inputs have no t_s", "give sample times, s, beside the inputs")
    t_s = given.pop("t_s")
    if t_s.size < 2 or not bool(np.all(np.diff(t_s) > 0)):
        raise InputError("t_s does not increase", "give at least two rising sample times, s")
    for name, column in given.items():
        if column.shape != t_s.shape:
            raise InputError(f"{name} has {column.size} samples, t_s {t_s.size}", "give one sample per time")
    _known(given, model.system.inputs, "input")
    _known(values or {}, model.param, "parameter")
    _known(start or {}, model.system.states, "state")
    full = model.start(values)
    volts = given.setdefault("voltage_v", np.full(t_s.size, model.nominal_voltage_v))
    given.setdefault("throttle", model.hover_throttle(full, volts))
    held = {n: (t_s, c) for n, c in given.items() if model.system.input_delay[n]}
    interpolated = {n: (t_s, c) for n, c in given.items() if not model.system.input_delay[n]}
    found = simulate(model, full, t_s, dict(start or {}), held, interpolated)
    return Simulated(t_s, {**given, **found})


def _column(name: str, values: Any) -> FloatArray:
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not made of numbers", "give one number per sample time") from error
    if column.ndim != 1 or not bool(np.isfinite(column).all()):
        raise InputError(f"{name} is not one finite number per sample time", "fill or drop what is missing")
    return column


def _known(given: Mapping[str, Any], known: Mapping[str, Any], what: str) -> None:
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"
            raise InputError(f"the model has no {what} {name!r}", hint)
