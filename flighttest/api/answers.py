"""What the verbs answer: the sentence a person reads, the typed thing behind it, a table and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flighttest.errors import InputError
from flighttest.pipeline.results import Status
from flighttest.report.document import Document, Figure, Panel, Trace

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from flighttest.api.fitted_model import FittedModel
    from flighttest.diagnose.model import Diagnosis, Located, Verdict
    from flighttest.flight.result import FlightResult
    from flighttest.identify.fit import Estimate, Fit
    from flighttest.identify.validation.validate import Validation
    from flighttest.pipeline.store.lineage import Lineage
    from flighttest.plan.check import CheckResult
    from flighttest.plan.model import Plan
    from flighttest.recording.model import Recording
    from flighttest.segments.model import Segment
    from flighttest.validity.model import Assessment, ValidityVerdict

STEPPED = {"roll_step": "roll_rad", "pitch_step": "pitch_rad", "yaw_rate_step": "r_rad_s"}
PLAN_RATE_HZ = 50.0


@dataclass(frozen=True, kw_only=True, repr=False)
class Answer:
    """What every verb gives back. document: what the command line shows, as pure data; data: what it prints with --json; status: how it
    ended, which the command line gives as its exit code."""

    document: Document
    data: Mapping[str, Any]
    status: Status = Status.DONE

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        return self.document.verdict

    def __str__(self) -> str:
        return self.sentence

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.sentence}>"

    def _figures(self) -> dict[str, Figure]:
        from flighttest.report.render.plotly_figure import figures_of

        return figures_of(self.document)

    def plot(self, *ids: str) -> go.Figure:
        """The figures of the page as one plotly figure: those of these ids, else all. InputError where there is none of an id."""
        from flighttest.report.render.plotly_figure import drawn

        known = self._figures()
        for i in ids:
            if i not in known:
                raise InputError(f"there is no figure {i!r}", f"there are {', '.join(known) or 'none'}")
        return drawn([known[i] for i in ids or known])

    def write_page(self, path: str | PathLike[str]) -> Path:
        """Write it as one self-contained HTML page and give its path."""
        from flighttest.report.render import html

        return html.write_html(self.document, Path(path))


@dataclass(frozen=True, kw_only=True, repr=False)
class Written(Answer):
    """What verbs answer that write files: `report`, `show`, `fetch_log`, `export`. files: all of them; usable as the path of the first."""

    files: tuple[Path, ...]

    def __fspath__(self) -> str:
        return str(self.files[0])


@dataclass(frozen=True, kw_only=True, repr=False)
class Responses(Answer):
    """`segment`: step responses and windows of free flight, accepted or rejected with their reasons."""

    segments: tuple[Segment, ...]

    @property
    def usable(self) -> tuple[Segment, ...]:
        """Those that may be fitted."""
        return tuple(s for s in self.segments if s.usable)

    def to_frame(self) -> pd.DataFrame:
        """One row per response, indexed by name: run, maneuver, kind, repeat, t_step_s, duration_s, usable, flaws, its cell and its metrics
        (s, rad, m/s², NaN where there is none)."""
        import pandas as pd

        rows = []
        for s in self.data["segments"]:
            row = {k: s[k] for k in ("name", "run", "maneuver", "kind", "repeat", "t_step_s", "duration_s", "usable")}
            row["flaws"] = "; ".join(flaw["sentence"] for flaw in s["flaws"])
            rows.append(row | s["cell"] | s["metrics"])
        return pd.DataFrame(rows).set_index("name") if rows else pd.DataFrame()

    def _figures(self) -> dict[str, Figure]:
        panels = []
        for kind in dict.fromkeys(s.kind for s in self.usable):
            channel = STEPPED.get(kind, "f_z_m_s2")
            mine = [s for s in self.usable if s.kind == kind and channel in s.y]
            traces = [Trace(s.t_s - s.t_step_s, s.y[channel], s.name, "measured", group=kind) for s in mine]
            panels.append(Panel(kind.replace("_", " "), "time since the step, s", channel, tuple(traces)))
        return {"responses": Figure("responses", tuple(panels), "", 2, 300)}


@dataclass(frozen=True, kw_only=True, repr=False)
class Fitted(Answer):
    """`fit`: parameters with their intervals. fit: everything identification found; model: what later steps take."""

    fit: Fit
    model: FittedModel

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """By name: value, std, interval_95, unit, identifiable, and what would make it known."""
        return self.fit.estimates

    @property
    def good(self) -> bool:
        """Whether the fit converged to something that can be used."""
        return self.fit.status.good

    def to_frame(self) -> pd.DataFrame:
        """One row per parameter; see `FittedModel.to_frame`."""
        return self.model.to_frame()


@dataclass(frozen=True, kw_only=True, repr=False)
class Validated(Answer):
    """`validate`: open-loop errors of the model and its simplifications over horizons of 0.1 to 3 s."""

    validation: Validation

    def to_frame(self) -> pd.DataFrame:
        """One row per model, group of channels and horizon: horizon_s, rmse in `unit`, starts counted, separate stretches of flight."""
        import pandas as pd

        from flighttest.identify.validation.ablations import UNITS

        return pd.DataFrame(
            [
                {
                    "model": e.variation.name, "group": e.group, "unit": UNITS[e.group], "horizon_s": e.horizon_s, "rmse": e.rmse,
                    "count": e.count, "stretches": e.stretches,
                }
                for e in self.validation.errors
            ]
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, repr=False)
class Diagnosed(Answer):
    """`diagnose`: where model and recordings differ, what physics is missing, and what to fly next.

    diagnosis: everything found, typed; model: the base model with the accepted terms, refitted; None where there was no fit.
    """

    diagnosis: Diagnosis
    model: FittedModel | None

    @property
    def verdict(self) -> Verdict:
        """The answer as a whole; its value is a sentence."""
        return self.diagnosis.verdict

    @property
    def accepted(self) -> tuple[str, ...]:
        """Ids of the terms that the recordings need beside the base model's."""
        return self.diagnosis.accepted

    @property
    def located(self) -> tuple[Located, ...]:
        """Where the mismatch is, the largest share first."""
        return self.diagnosis.located

    def to_frame(self) -> pd.DataFrame:
        """One row per finding and parameter: term, title, verdict, sentence, parameter, value, std, unit."""
        import pandas as pd

        rows: list[dict[str, object]] = []
        for f in self.diagnosis.findings:
            head = {"term": f.term, "title": f.title, "verdict": f.verdict.name, "sentence": f.sentence}
            rows += [
                head | {"parameter": name, "value": p["value"], "std": p["std"], "unit": p["unit"]}
                for name, p in f.parameters.items()
            ] or [head | {"parameter": "", "value": None, "std": None, "unit": None}]
        columns = ["term", "title", "verdict", "sentence", "parameter", "value", "std", "unit"]
        return pd.DataFrame(rows, columns=columns)


@dataclass(frozen=True, kw_only=True, repr=False)
class Validity(Answer):
    """`check_validity`: does the stored model still hold for this vehicle. assessment: all the evidence, typed."""

    assessment: Assessment

    @property
    def verdict(self) -> ValidityVerdict:
        """CURRENT, STALE or UNKNOWN; its value is a sentence."""
        return self.assessment.verdict

    @property
    def fly(self) -> tuple[str, ...]:
        """Scripts that must be flown again, in order."""
        return self.assessment.fly

    def to_frame(self) -> pd.DataFrame:
        """One row per tested subset of parameters: subset, statistic, dof, p_value, level, alarm, sentence."""
        import pandas as pd

        names = ["subset", "statistic", "dof", "p_value", "level", "alarm", "sentence"]
        return pd.DataFrame([{n: getattr(t, n) for n in names} for t in self.assessment.tests], columns=names)

    def _figures(self) -> dict[str, Figure]:
        shifts = {n: s for t in self.assessment.tests for n, s in t.shifts.items()}
        z = Trace(list(shifts), [s[1] for s in shifts.values()], "z", "model", "markers")
        return {"shifts": Figure("shifts", (Panel("Change of each parameter", "", "z-score", (z,)),), "", 1, 300)}


@dataclass(frozen=True, kw_only=True, repr=False)
class Planned(Answer):
    """`plan`: scripts compiled for a vehicle. plans: what would be flown."""

    plans: tuple[Plan, ...]

    @cached_property
    def checks(self) -> tuple[CheckResult, ...]:
        """What each plan asks of zone, time and battery."""
        from flighttest.plan import check

        return tuple(check(one) for one in self.plans)

    @property
    def ok(self) -> bool:
        """Whether every step may be flown."""
        return all(check.ok for check in self.checks)

    def to_frame(self) -> pd.DataFrame:
        """One row per step in flying order: script, leg, kind, start_s from take-off, duration_s, start x_m, y_m, z_m in the zone,
        heading_rad, voltage_v."""
        import pandas as pd

        return pd.DataFrame(
            [
                {
                    "script": check.name, "leg": row.leg, "kind": row.kind, "start_s": row.start_s, "duration_s": row.duration_s,
                    **dict(zip(("x_m", "y_m", "z_m"), row.start_m, strict=True)), "heading_rad": row.heading_rad,
                    "voltage_v": row.voltage_v,
                }
                for check in self.checks
                for row in check.timeline
            ]
        )  # fmt: skip

    def _figures(self) -> dict[str, Figure]:
        axes = (("roll_rad", "rad"), ("pitch_rad", "rad"), ("yaw_rate_rad_s", "rad/s"), ("throttle", "1"))
        figures = {}
        for plan, check in zip(self.plans, self.checks, strict=True):
            starts = {row.leg: row.start_s for row in check.timeline}
            t_s: list[float] = []
            asked: dict[str, list[float]] = {name: [] for name, _ in axes}
            for leg in plan.legs:
                if leg.profile is None:
                    continue
                for k in range(round(leg.duration_s * PLAN_RATE_HZ)):
                    target = leg.profile(k / PLAN_RATE_HZ)
                    t_s.append(starts[leg.id] + k / PLAN_RATE_HZ)
                    for name in asked:
                        asked[name].append(getattr(target, name))
            panels = [Panel(n, "time, s", unit, (Trace(t_s, asked[n], n, "reference", "markers"),)) for n, unit in axes]
            figures[plan.script.name] = Figure(plan.script.name, tuple(panels), "", 2, 240)
        return figures


@dataclass(frozen=True, kw_only=True, repr=False)
class Flown(Answer):
    """`fly`: how each flight ended. runs: the run folders; flights: the outcomes, typed, one per script."""

    runs: tuple[Path, ...]
    flights: tuple[FlightResult, ...]

    @property
    def as_planned(self) -> bool:
        """Whether every flight was flown to its end and left the vehicle on the ground, or with the pilot."""
        return all(flight.as_planned for flight in self.flights)

    def recordings(self) -> tuple[Recording, ...]:
        """What was recorded, read from the run folders."""
        from flighttest.pipeline.recordings.sources import open_recordings

        return open_recordings(self.runs)

    def to_frame(self) -> pd.DataFrame:
        """One row per step: run, leg, outcome, flown, why."""
        import pandas as pd

        from flighttest.flight.outcome import LegOutcome

        return pd.DataFrame(
            [
                {
                    "run": flight.run_dir.name, "leg": leg.leg, "outcome": leg.outcome.name,
                    "flown": leg.outcome is LegOutcome.FLOWN, "why": "; ".join(leg.why),
                }
                for flight in self.flights
                for leg in flight.legs
            ]
        )  # fmt: skip

    def _figures(self) -> dict[str, Figure]:
        panels = []
        for recording in self.recordings():
            names = ("p_x_m", "p_y_m", "p_z_m")
            traces = [Trace(*recording.channel(n), n) for n in names if recording.has(n)]
            panels.append(Panel(recording.name, "time, s", "position, m", tuple(traces)))
        return {"flights": Figure("flights", tuple(panels), "", 2, 260)}


@dataclass(frozen=True, kw_only=True, repr=False)
class Models(Answer):
    """`models`: those accepted for each vehicle. lineages: by vehicle, oldest model first."""

    lineages: tuple[Lineage, ...]

    def in_use(self, vehicle: str = "") -> FittedModel:
        """The model in use of a vehicle; of the only one where none is named. InputError where there is none."""
        from flighttest.api.fitted_model import fitted_model

        found = [one for one in self.lineages if one.current is not None and vehicle in ("", one.vehicle)]
        if len(found) != 1 or found[0].current is None:
            known = ", ".join(one.vehicle for one in self.lineages)
            raise InputError(
                "several vehicles have a model" if found else f"no model of {vehicle or 'any vehicle'} is in use",
                f"name one of {known}"
                if known
                else "make the model of a run its vehicle's with `flighttest accept RUN`",
            )
        return fitted_model(found[0].current)

    def to_frame(self) -> pd.DataFrame:
        """One row per accepted model: vehicle, number, accepted, file, in_use, runs, terms, joined, left, ended."""
        import pandas as pd

        columns = ["vehicle", "number", "accepted", "file", "in_use", "runs", "terms", "joined", "left", "ended"]
        rows = [
            {
                "vehicle": one.vehicle, "number": g.number, "accepted": g.accepted, "file": str(one.folder / g.file),
                "in_use": g is one.generations[-1], "runs": g.runs, "terms": g.terms, "joined": g.joined, "left": g.left,
                "ended": "; ".join(g.ended),
            }
            for one in self.lineages
            for g in one.generations
        ]  # fmt: skip
        return pd.DataFrame(rows, columns=columns)

    def _figures(self) -> dict[str, Figure]:
        from flighttest.api.fitted_model import fitted_model

        figures = {}
        for one in self.lineages:
            held = {g.number: fitted_model(one.folder / g.file).parameters for g in one.generations}
            names = dict.fromkeys(name for parameters in held.values() for name in parameters)
            panels = []
            for name in names:
                mine = {number: p[name] for number, p in held.items() if name in p}
                half = [(p.interval_95[1] - p.interval_95[0]) / 2.0 if p.interval_95 else 0.0 for p in mine.values()]
                values = [p.value for p in mine.values()]
                unit = next(p.unit for p in mine.values())
                trace = Trace(list(mine), values, name, "model", "errorbars", spread=half)  # type: ignore[arg-type]
                panels.append(Panel(name, "model", unit, (trace,)))
            figures[one.vehicle] = Figure(one.vehicle, tuple(panels), "", 3, 230)
        return figures
