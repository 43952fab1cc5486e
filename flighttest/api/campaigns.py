"""What the verbs about runs and the tool answer: campaign, imported log, the runs of a folder, checks, demonstration, proof."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from flighttest.api.answers import Answer
from flighttest.report.document import Figure, Panel, Trace

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from flighttest.api.fitted_model import FittedModel
    from flighttest.diagnose.records import FindingRow
    from flighttest.pipeline.flights.after_landing import Analysis
    from flighttest.proof.outcome import Outcome
    from flighttest.recording.model import Recording


@dataclass(frozen=True, kw_only=True, repr=False)
class Campaign(Answer):
    """`run`: scripts flown, fitted, compared with the model in use and diagnosed.

    runs: the run folders; analysis: everything found, typed, None where nothing could be analysed; model: the improved one, else the
    fitted one.
    """

    runs: tuple[Path, ...]
    analysis: Analysis | None
    model: FittedModel | None

    @property
    def page(self) -> Path | None:
        """The report."""
        return Path(self.data["report"]) if "report" in self.data else None

    def to_frame(self) -> pd.DataFrame:
        """One row per parameter of the model; see `FittedModel.to_frame`."""
        import pandas as pd

        return self.model.to_frame() if self.model is not None else pd.DataFrame()


@dataclass(frozen=True, kw_only=True, repr=False)
class Imported(Answer):
    """`import_log`: a log as a run folder. run: the folder; recording: what is in it."""

    run: Path
    recording: Recording

    def to_frame(self) -> pd.DataFrame:
        """One row per group of channels: columns, rate_hz, samples, and the largest share missing in a column."""
        import pandas as pd

        rows = [
            {"group": g, "columns": tuple(c["columns"]), "rate_hz": c["rate_hz"], "samples": c["samples"]}
            | {"missing": max(c["missing"].values(), default=0.0)}
            for g, c in self.data["channels"].items()
        ]
        return pd.DataFrame(rows, columns=["group", "columns", "rate_hz", "samples", "missing"]).set_index("group")

    def plot(self, *ids: str) -> go.Figure:
        """Channels over time: these groups, else all."""
        return self.recording.plot(*ids)


@dataclass(frozen=True, kw_only=True, repr=False)
class Runs(Answer):
    """`runs`: the runs of a folder, oldest first, with what was fitted to each."""

    def to_frame(self) -> pd.DataFrame:
        """One row per run, indexed by name: when, vehicle, script, outcome, and a column per known parameter."""
        import pandas as pd

        rows = [
            {k: r[k] for k in ("run", "when", "vehicle", "script", "outcome")}
            | {name: p["value"] for name, p in r["parameters"].items()}
            for r in self.data["runs"]
        ]
        return pd.DataFrame(rows).set_index("run") if rows else pd.DataFrame()

    def _figures(self) -> dict[str, Figure]:
        names = dict.fromkeys(name for r in self.data["runs"] for name in r["parameters"])
        panels = []
        for name in names:
            known = {r["run"]: r["parameters"][name] for r in self.data["runs"] if name in r["parameters"]}
            half = [p["half_width_95"] for p in known.values()]
            values = [p["value"] for p in known.values()]
            trace = Trace(list(known), values, name, "model", "errorbars", spread=half)  # type: ignore[arg-type]
            panels.append(Panel(name, "", name, (trace,)))
        return {"parameters": Figure("parameters", tuple(panels), "", 3, 230)}


@dataclass(frozen=True, kw_only=True, repr=False)
class Checks(Answer):
    """`doctor`: what the tool needs, what was found, and what to do about the rest."""

    @property
    def ok(self) -> bool:
        """Whether everything that is needed was found."""
        return all(c["ok"] for c in self.data["checks"] if c["needed"])

    def to_frame(self) -> pd.DataFrame:
        """One row per check, indexed by what was looked for: found, ok, needed, remedy."""
        import pandas as pd

        return pd.DataFrame(self.data["checks"]).set_index("what")


@dataclass(frozen=True, kw_only=True, repr=False)
class Demonstrated(Answer):
    """`demo`: a concealed effect found, modelled, and a flight predicted that was not used. page: the report. Where the flights were of no
    use nothing was named or predicted, which `status` shows."""

    page: Path

    @property
    def findings(self) -> tuple[FindingRow, ...]:
        """What was named, as in diagnosis.json."""
        return tuple(self.data.get("findings", ()))

    def to_frame(self) -> pd.DataFrame:
        """One row per channel of the predicted flight: rmse before and after the improvement, and the noise floor, SI."""
        import pandas as pd

        rows = [{"channel": c} | dict(v) for c, v in self.data.get("prediction", {}).items()]
        return pd.DataFrame(rows, columns=["channel", "before", "after", "floor"]).set_index("channel")


@dataclass(frozen=True, kw_only=True, repr=False)
class Proved(Answer):
    """`prove`: sealed trials diagnosed blind, and their scoreboard. outcomes: one per trial."""

    outcomes: tuple[Outcome, ...]

    def to_frame(self) -> pd.DataFrame:
        """One row per trial: index, kind, hidden, named, verdict, error."""
        import pandas as pd

        rows = [
            {"index": o.index, "kind": o.kind, "hidden": tuple(o.hide), "named": o.named, "verdict": o.verdict, "error": o.error}
            for o in self.outcomes
        ]  # fmt: skip
        columns = ["index", "kind", "hidden", "named", "verdict", "error"]
        return pd.DataFrame(rows, columns=columns).set_index("index")
