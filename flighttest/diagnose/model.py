"""`Diagnosis` and its parts: pure data, one section per verb (locate, name, model, show, fly next)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from enum import Enum, StrEnum
from typing import Any, cast

from flighttest.channels import WORDS
from flighttest.diagnose.records import (
    CandidateRow,
    Cost,
    Description,
    DiagnosisData,
    EvidenceRow,
    FloorRow,
    HeldOutRow,
    MapCell,
    MassChange,
    NextReason,
    Overlay,
    ParameterRow,
    Regime,
    RegimeCurve,
    SetAside,
    Unexplained,
)
from flighttest.diagnose.step_error import StepError
from flighttest.identify.fit import Fit
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.identify.models.model_blocks import FlightWindRow
from flighttest.physics.model import Model
from flighttest.script.model import ScriptData

EXPLAINED_SHARE = 0.2  # of the error of a part of the model may stay when its mismatch counts as explained


class Verdict(Enum):
    """The answer as a whole. The value is the sentence shown to the reader."""

    EXPLAINED = (
        "what the model missed is named, and with it the model predicts what it has not seen down to the noise floor"
    )
    PARTLY = "part of what the model missed is named; the rest is located but has no name yet"
    NOTHING_MISSING = "nothing is seen to be missing: what the model leaves is no more than the noise floor"
    UNKNOWN_PHYSICS = (
        "something is missing that no entry of the catalogue fits; it is located and its shape is given, without a name"
    )


class TermVerdict(StrEnum):
    """The answer about one candidate, as it stands in diagnosis.json.

    SUPPORTED: the recording needs it, since held-out predictions improve and no rival does the same. NOT_NEEDED: the recording would
    have shown it and does not. CONFUSABLE: it explains the recording, and so does another candidate; a further flight must separate them
    apart. UNTESTABLE: this recording could not have shown it.
    """

    SUPPORTED = "SUPPORTED"
    NOT_NEEDED = "NOT_NEEDED"
    CONFUSABLE = "CONFUSABLE"
    UNTESTABLE = "UNTESTABLE"


@dataclass(frozen=True)
class Located:
    """Where the mismatch is. channel: short name (f_z, v_x, roll, ...); maneuver: the script most of these steps are of; kind: as
    `Segment.kind`; regime: {"variable": ..., "below" or "above": ...} or {}; shares of the excess over the noise floor (of the error,
    where none of it is over the floor) and of the samples; peak: largest mean residual in the regime, in `unit`; repeated: whether repeats
    measured the floor, which else is known to a factor of two."""

    channel: str
    maneuver: str
    kind: str
    regime: Regime
    excess_share: float
    sample_share: float
    sentence: str
    rmse: float
    floor: float
    unit: str
    peak: float = 0.0
    explained: float = 0.0
    p_value: float = 1.0
    repeated: bool = False


@dataclass(frozen=True)
class Rival:
    """A candidate that looks like another one. cosine: of what is left of both beside the rest of the model."""

    term: str
    verdict: TermVerdict
    cosine: float
    separated_by: str


@dataclass(frozen=True)
class Finding:
    """A candidate with a verdict of its own. parameters: name to {value, std, unit, interval_95}; heldout: channel to {rmse_before,
    rmse_after, floor, gain_95} without and with this term; floors: its size in noise floors; where: channel and kind of maneuver."""

    term: str
    title: str
    family: str
    verdict: TermVerdict
    equation: str
    plain: str
    parameters: Mapping[str, ParameterRow]
    heldout: Mapping[str, HeldOutRow]
    evidence: EvidenceRow
    rivals: tuple[Rival, ...]
    sentence: str
    source: str
    doubt: str


@dataclass(frozen=True)
class Untestable:
    """What could not be seen. fly: the maneuver script that would show it; recorded: whether all channels were that it needs, without which
    no flight would show it."""

    term: str
    why: str
    fly: str
    recorded: bool = True


@dataclass(frozen=True)
class Diagnosis:
    """Everything the terminal, the JSON and the report show. No reader of it computes a number.

    model, values: the accepted model; accepted: its new terms; before: base parameters of the model without them, after: of the
    accepted model, name to {value, std, unit, interval_95, scatter}; heldout: channel to horizon or 'all' to {rmse_before, rmse_after,
    floor, gain_95}; set_aside: responses that something pushed once, by name, and a sentence on them; baselines: name to channel to RMSE;
    residual_map: cells of the heat map; regimes: residual against the variable that explains it; overlays: worst responses,
    measured, before, after; complete: False when it was interrupted; fit: of the accepted model, what model.yaml is written from;
    held: what of it output error did not estimate; winds: of each flight, where free flight shows one; errors, left: what the base model
    and the accepted one get wrong of each step.
    """

    verdict: Verdict
    sentence: str
    located: tuple[Located, ...]
    findings: tuple[Finding, ...]
    not_needed: tuple[str, ...]
    untestable: tuple[Untestable, ...]
    unexplained: Unexplained
    smallest_detectable: Mapping[str, float]
    model: Model
    values: Mapping[str, float]
    accepted: tuple[str, ...]
    before: Mapping[str, ParameterRow]
    after: Mapping[str, ParameterRow]
    heldout: Mapping[str, Mapping[str, HeldOutRow]]
    noise_floor: Mapping[str, FloorRow]
    baselines: Mapping[str, Mapping[str, float]]
    residual_map: tuple[MapCell, ...]
    regimes: tuple[RegimeCurve, ...]
    overlays: tuple[Overlay, ...]
    smallest_units: Mapping[str, str] = field(default_factory=dict)
    candidates: tuple[CandidateRow, ...] = ()
    cost: Cost = field(default_factory=Cost)
    unknown: tuple[Description, ...] = ()
    mass: MassChange = field(default_factory=MassChange)
    next_flight: str | None = None
    next_script: ScriptData | None = None
    next_reason: NextReason = field(default_factory=NextReason)
    set_aside: SetAside = field(default_factory=SetAside)
    notes: tuple[str, ...] = ()
    complete: bool = True
    runs: tuple[str, ...] = ()
    winds: tuple[FlightWindRow, ...] = ()
    errors: tuple[StepError, ...] = field(default=(), repr=False)
    left: tuple[StepError, ...] = field(default=(), repr=False)
    fit: Fit | None = field(default=None, repr=False)
    held: tuple[HeldEstimate, ...] = field(default=(), repr=False)

    def to_json(self) -> DiagnosisData:
        """As in diagnosis.json (format diagnosis/1): plain JSON types only, null for what is not a number."""
        data = {
            k: getattr(self, k)
            for k in self.__dataclass_fields__
            if k not in ("model", "values", "verdict", "next_script", "errors", "left", "fit", "held")
        }
        head = {"format": "diagnosis/1", "verdict": self.verdict.name, "terms": list(self.model.terms)}
        return cast(DiagnosisData, head | _plain(data))


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def short(channel: str) -> str:
    """Channel name without its unit: f_z_m_s2 to f_z, roll_rad to roll, r_rad_s to r."""
    for unit in ("_m_s2", "_m_s", "_rad_s", "_rad", "_m"):
        if channel.endswith(unit):
            return channel.removesuffix(unit)
    return channel


def channel_words(channel: str) -> str:
    """A channel as diagnosis.json names it (v_x, r) as people read it: velocity north, yaw rate."""
    return next((words for name, words in WORDS.items() if channel in (name, short(name))), channel)


def flown(kind: str) -> str:
    """A kind of segment in words, plural: 'roll steps', 'free flight'."""
    return "free flight" if kind == "free" else kind.replace("_", " ") + "s"


def brief(value: float) -> str:
    """Two digits, without an exponent where it is of the size that people count in."""
    return f"{value:.0f}" if 10.0 <= abs(value) < 1e5 else f"{value:.2g}"
