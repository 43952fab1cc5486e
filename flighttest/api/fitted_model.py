"""A model with numbers: fitted just now, or read from model.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from flighttest.datafiles import read_text
from flighttest.documents import YamlDocument
from flighttest.errors import InputError, ModelError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_blocks import ModelData
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.equations import ModelEquations
from flighttest.physics.model import Model
from flighttest.physics.simulated import Simulated
from flighttest.report.document import Figure, Panel, Trace
from flighttest.report.render.plotly_figure import drawn

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    from numpy.typing import ArrayLike

    from flighttest.identify.fit import Fit


@dataclass(frozen=True)
class FittedModel:
    """A model, its parameters and what is known of them. stored: everything model.yaml holds, typed (covariance, range of validity,
    fingerprint, noise); data: the same as plain data, as it is written."""

    stored: ModelFile
    data: ModelData

    def __repr__(self) -> str:
        known = sum(bool(p.identifiable) for p in self.parameters.values())
        return (
            f"<FittedModel {' + '.join(self.physics.terms)}: {known} of {len(self.parameters)} parameters identifiable>"
        )

    @property
    def physics(self) -> Model:
        """The terms, without numbers: what `ft.fit(..., model=...)` takes and terms are added to."""
        return self.stored.model

    @property
    def parameters(self) -> Mapping[str, StoredParameter]:
        """By name: value, unit, std, interval_95, source, identifiable, and what would make it known."""
        return self.stored.parameters

    @property
    def values(self) -> dict[str, float]:
        """Every parameter that a simulation needs, by name, SI."""
        return dict(self.stored.values)

    def equations(self) -> ModelEquations:
        """The model written out with its numbers; `print` it."""
        return self.physics.equations(self.values)

    def citations(self) -> tuple[str, ...]:
        """The literature behind the model, each work once."""
        return self.physics.citations()

    def simulate(
        self, inputs: Mapping[str, ArrayLike] | pd.DataFrame, start: Mapping[str, float] | None = None
    ) -> Simulated:
        """Run it open loop from t_s (n,) and inputs (n,) by channel name; see `Model.simulate`."""
        return self.physics.simulate(inputs, self.values, start)

    def write(self, path: str | PathLike[str]) -> Path:
        """Write model.yaml and give its path."""
        model_file.write(Path(path), self.data)
        return Path(path)

    def export(self, kind: str, folder: str | PathLike[str]) -> tuple[Path, ...]:
        """Write it for other programs: 'casadi', 'c', 'json', 'fmu', 'rotorpy' or 'ardupilot'; gives the files written.

        InputError for another kind.
        """
        from flighttest.pipeline.identification.exporting import KINDS, export

        if kind not in KINDS:
            raise InputError(f"there is no export called {kind!r}", f"there are {', '.join(KINDS)}")
        return tuple(Path(file) for file in export(self.stored, kind, Path(folder)).data["files"])

    def to_frame(self) -> pd.DataFrame:
        """One row per parameter, indexed by name: value, std, low_95, high_95, unit, source, identifiable, why, fly."""
        import pandas as pd

        rows = [
            {
                "name": name, "value": p.value, "std": p.std,
                "low_95": p.interval_95[0] if p.interval_95 else None, "high_95": p.interval_95[1] if p.interval_95 else None,
                "unit": p.unit, "source": p.source, "identifiable": p.identifiable, "why": p.why, "fly": p.fly,
            }
            for name, p in self.parameters.items()
        ]  # fmt: skip
        return pd.DataFrame(rows).set_index("name")

    def plot(self) -> go.Figure:
        """Each parameter with its 95 % interval, one panel per unit."""
        units = dict.fromkeys(p.unit for p in self.parameters.values())
        panels = []
        for unit in units:
            mine = {n: p for n, p in self.parameters.items() if p.unit == unit}
            half = [(p.interval_95[1] - p.interval_95[0]) / 2.0 if p.interval_95 else 0.0 for p in mine.values()]
            values = [p.value for p in mine.values()]
            trace = Trace(list(mine), values, unit, "model", "errorbars", spread=half)  # type: ignore[arg-type]
            panels.append(Panel(unit, "", unit, (trace,)))
        return drawn([Figure("parameters", tuple(panels), "", 3, 260)])


def fitted_model(source: FittedModel | str | PathLike[str]) -> FittedModel:
    """A fitted model as it is, or read from model.yaml or the run or diagnosis folder that holds one. ModelError lists what is
    wrong."""
    if isinstance(source, FittedModel):
        return source
    path = model_file.held_by(Path(source))
    stored = model_file.read(path)
    root = YamlDocument(str(path), read_text(path, ModelError, "model file")).root
    return FittedModel(stored, root.plain() if root is not None else {})


def model_of(found: Fit, data: ModelData) -> FittedModel:
    """A fit as the model that later steps take. data: as model.yaml holds it."""
    stored = replace(model_file.from_fit(found), fingerprint=data["fingerprint"], fit_quality=data["fit_quality"])
    stored = replace(stored, vehicle=data.get("vehicle") or {})
    return FittedModel(stored, data)
