"""What the verbs that compare answer: simulator against reality, twin against recordings, change against none, model against model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flighttest.api.answers import Answer
from flighttest.api.fitted_model import FittedModel
from flighttest.diagnose.against import Against, Difference
from flighttest.diagnose.model import Diagnosis
from flighttest.identify.models.compare import ParameterDifference
from flighttest.report.document import Figure, Panel, Role, Trace
from flighttest.twin.replay import ChangeEffect, Replay

if TYPE_CHECKING:
    import pandas as pd


_ROLES: tuple[Role, ...] = ("model", "measured", "simulated")


def _frame(rows: Sequence[Mapping[str, Any]], index: str, columns: Sequence[str]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(list(rows), columns=list(columns)).set_index(index)


def _markers(title: str, unit: str, traces: Mapping[str, Mapping[str, float | None]]) -> Panel:
    """One point per name and trace."""
    drawn = [
        Trace(list(known), list(known.values()), name, role, "markers")
        for (name, values), role in zip(traces.items(), _ROLES, strict=False)
        if (known := {n: v for n, v in values.items() if v is not None})
    ]
    return Panel(title, "", unit, tuple(drawn))


@dataclass(frozen=True, kw_only=True, repr=False)
class Opposed(Answer):
    """`against`: a simulator's recordings opposed to real ones. found: fits of both sides, differences and predictions, typed."""

    found: Against
    model: FittedModel

    @property
    def differences(self) -> tuple[Difference, ...]:
        """Every parameter on both sides, those that differ first; `kind`: missing in the simulator, or too much of it there."""
        return self.found.differences

    @property
    def lacks(self) -> tuple[str, ...]:
        """Ids of the terms that the simulator lacks."""
        return tuple(self.data["lacks"])

    def to_frame(self) -> pd.DataFrame:
        """One row per parameter, indexed by name: term, unit, kind, real, real_std, simulated, simulated_std, difference, std, p_value,
        detectable, why."""
        columns = (
            "name", "term", "unit", "kind", "real", "real_std", "simulated", "simulated_std", "difference", "std", "p_value", "detectable",
            "why",
        )  # fmt: skip
        return _frame([{c: getattr(d, c) for c in columns} for d in self.differences], "name", columns)

    def _figures(self) -> dict[str, Figure]:
        z = {d.name: d.difference / d.std if d.difference is not None and d.std else None for d in self.differences}
        errors = {
            name: {c: getattr(p, which) / p.floor for c, p in self.found.prediction.items() if p.floor}
            for name, which in (("corrected", "after"), ("real, fitted", "fitted"), ("simulator", "before"))
        }
        return {
            "differences": Figure("differences", (_markers("Real minus simulated", "z-score", {"z": z}),), "", 1, 300),
            "prediction": Figure(
                "prediction", (_markers("Prediction error on real flights", "noise floors", errors),), "", 1, 300
            ),
        }


@dataclass(frozen=True, kw_only=True, repr=False)
class Twin(Answer):
    """`twin`: what still differs between a model, flown as a vehicle, and the recordings. diagnosis: of the recordings, from that model;
    flown: the twin's run folders, where they were kept."""

    diagnosis: Diagnosis
    flown: tuple[Path, ...]

    @property
    def nothing_missing(self) -> bool:
        """Whether no parameter differs, and the error is near the noise floor in every channel."""
        return bool(self.data["verdict"] == "NOTHING_MISSING")

    def to_frame(self) -> pd.DataFrame:
        """One row per channel: rmse of the twin and noise floor, SI; ratio of the two; fitted: that of a fit to these very recordings."""
        rows = [{"channel": c} | dict(v) for c, v in self.data["channels"].items()]
        return _frame(rows, "channel", ("channel", "rmse", "floor", "ratio", "fitted"))

    def _figures(self) -> dict[str, Figure]:
        channels = self.data["channels"].items()
        errors = {"twin": {c: v["ratio"] for c, v in channels}, "refitted": {c: v["fitted"] for c, v in channels}}
        return {"channels": Figure("channels", (_markers("Error of the twin", "noise floors", errors),), "", 1, 300)}


@dataclass(frozen=True, kw_only=True, repr=False)
class Replayed(Answer):
    """`replay`: recorded commands on a changed vehicle. found: effects by channel and the stretches where the change shows most."""

    found: Replay

    @property
    def effects(self) -> Mapping[str, ChangeEffect]:
        """By channel: error of the twin, and mean shift, size and uncertainty of the change, SI."""
        return self.found.effects

    def to_frame(self) -> pd.DataFrame:
        """One row per channel: error, shift, size, uncertainty, SI."""
        rows = [{"channel": c} | asdict(e) for c, e in self.effects.items()]
        return _frame(rows, "channel", ("channel", "error", "shift", "size", "uncertainty"))


@dataclass(frozen=True, kw_only=True, repr=False)
class Compared(Answer):
    """`compare`: two models side by side. differences: every parameter of either, those that differ first."""

    differences: tuple[ParameterDifference, ...]

    @property
    def differing(self) -> tuple[str, ...]:
        """Names of the parameters that differ beyond chance."""
        return tuple(d.name for d in self.differences if d.differs)

    def to_frame(self) -> pd.DataFrame:
        """One row per parameter, indexed by name: unit, first, second, difference, std, z, p_value, differs, sentence."""
        columns = ("name", "unit", "first", "second", "difference", "std", "z", "p_value", "differs", "sentence")
        return _frame([asdict(d) for d in self.differences], "name", columns)

    def _figures(self) -> dict[str, Figure]:
        panel = _markers("Second minus first", "z-score", {"z": {d.name: d.z for d in self.differences}})
        return {"differences": Figure("differences", (panel,), "", 1, 300)}
