"""The tables of a diagnosis, row by row, as diagnosis.json carries them: dictionaries with known keys, SI units."""

from __future__ import annotations

from typing import NotRequired, Required, TypedDict

from flighttest.identify.models.model_blocks import FlightWindRow


class Regime(TypedDict, total=False):
    """Where a mismatch is: a variable, and the level below or above which it lies; empty where none orders it."""

    variable: str
    below: float
    above: float


class ParameterRow(TypedDict):
    """A parameter of a fit. std, interval_95: with what the equations may err; scatter: of like flights alone."""

    value: float
    std: float
    unit: str
    interval_95: list[float]
    scatter: float
    at_bound: NotRequired[bool]


class HeldOutRow(TypedDict, total=False):
    """RMS errors on groups of responses not used, without and with a change of the model; over a horizon without floor and gain."""

    rmse_before: Required[float]
    rmse_after: Required[float]
    floor: float
    gain_95: list[float]


class Place(TypedDict):
    """A channel (short name) in a kind of maneuver."""

    channel: str
    kind: str


class EvidenceRow(TypedDict):
    """Evidence for a term. heldout_gain: share of the mean square above the floor; floors: its size in noise floors, at `where`."""

    delta_bic: float
    log_evidence: float
    probability: float
    floors: float
    where: Place
    heldout_gain: float
    p_value: float
    rms_force_m_s2: float | None
    rms_force_left_m_s2: float | None


FloorRow = TypedDict("FloorRow", {"value": float, "from": str})
FloorRow.__doc__ = "The noise floor of a channel, and what it was estimated from."
FROM_REPEATS = "repeats"
FROM_RESIDUAL = "high-frequency residual and usual drift of estimates (weaker: no repeats were flown)"


# What it is a share of that a search removes or leaves: where nothing was repeated, nothing measures what gusts and noise are of it.
ABOVE_FLOOR = "error above the noise floor"
WITH_GUSTS = "error (gusts and noise included)"


class MapCell(TypedDict):
    """RMS error in noise floors, before and after, of one channel in one phase of one cell of steps."""

    channel: str
    kind: str
    cell: dict[str, float]
    phase: str
    samples: int
    before_floors: float
    after_floors: float


class RegimeCurve(TypedDict):
    """Mean residual in bins of the variable that explains a mismatch best, before and after."""

    channel: str
    maneuver: str
    kind: str
    variable: str
    label: str
    variable_unit: str
    unit: str
    x: list[float]
    before: list[float]
    after: list[float]
    floor: float


class Overlay(TypedDict):
    """One response over time since its step: measured, and both predictions."""

    channel: str
    unit: str
    segment: str
    kind: str
    t_s: list[float]
    measured: list[float]
    before: list[float]
    after: list[float]


class CandidateRow(TypedDict):
    """A candidate that was looked at, its verdict and why. floors: None where it was screened only."""

    term: str
    verdict: str
    delta_bic: float
    probability: float
    floors: float | None
    why: str


class Description(TypedDict):
    """A formula for what stays without a name. valid: variable to the range flown; heldout_share: of the mean square that it leaves."""

    channel: str
    port: str
    formula: str
    sentence: str
    functions: list[str]
    coefficients: list[float]
    heldout_share: float
    valid: dict[str, list[float]]
    symbols: dict[str, str]


class MassChange(TypedDict, total=False):
    """Whether thrust per mass changed against a previous model, and what of the two; empty where there is none."""

    thrust_ratio: float
    thrust_changed: bool
    common_ratio: float
    common_ratio_std: float
    answer: str
    same_ratio_p: float
    drag_unchanged_p: float | None
    sentence: str


class NextReason(TypedDict, total=False):
    """Why the next flight is proposed. size: of the shipped maneuver; fits_zone, zone: what was found when it was held against the zone."""

    maneuver: str
    separates: list[str]
    size: float
    odds_now: float
    expected_odds: float
    sentence: str
    fits_zone: bool | None
    zone: str


class SetAside(TypedDict, total=False):
    """Responses that something pushed once, by name, and a sentence on them; empty where there are none."""

    segments: list[str]
    sentence: str


class Unexplained(TypedDict):
    """Share of the error that stays; of: which error, in words (`answer.error_left`)."""

    excess_share: float
    of: str


class Cost(TypedDict, total=False):
    """What the improved model costs: parameters; and what its predictions were held out by."""

    added_parameters: int
    held_out_groups: str


class LocatedRow(TypedDict):
    """A `Located` as diagnosis.json has it."""

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
    peak: float
    explained: float
    p_value: float


class RivalRow(TypedDict):
    """A `Rival` as diagnosis.json has it."""

    term: str
    verdict: str
    cosine: float
    separated_by: str


class FindingRow(TypedDict):
    """A `Finding` as diagnosis.json has it."""

    term: str
    title: str
    family: str
    verdict: str
    equation: str
    plain: str
    parameters: dict[str, ParameterRow]
    heldout: dict[str, HeldOutRow]
    evidence: EvidenceRow
    rivals: list[RivalRow]
    sentence: str
    source: str
    doubt: str


class UntestableRow(TypedDict):
    """An `Untestable` as diagnosis.json has it."""

    term: str
    why: str
    fly: str
    recorded: bool


class DiagnosisData(TypedDict, total=False):
    """diagnosis.json (format diagnosis/1): a `Diagnosis` in plain JSON types, null for what is not a number. Older files lack keys.

    What an answer adds: next_path, next_options of the script of the next flight as a command names it; losses of the recordings;
    another_vehicle: what else differs from the model's.
    """

    format: str
    verdict: str
    sentence: str
    terms: list[str]
    located: list[LocatedRow]
    findings: list[FindingRow]
    not_needed: list[str]
    untestable: list[UntestableRow]
    unexplained: Unexplained
    smallest_detectable: dict[str, float]
    smallest_units: dict[str, str]
    accepted: list[str]
    before: dict[str, ParameterRow]
    after: dict[str, ParameterRow]
    heldout: dict[str, dict[str, HeldOutRow]]
    noise_floor: dict[str, FloorRow]
    baselines: dict[str, dict[str, float]]
    residual_map: list[MapCell]
    regimes: list[RegimeCurve]
    overlays: list[Overlay]
    candidates: list[CandidateRow]
    cost: Cost
    unknown: list[Description]
    mass: MassChange
    next_flight: str | None
    next_reason: NextReason
    next_path: str
    next_options: str
    losses: list[str]
    another_vehicle: str
    set_aside: SetAside
    notes: list[str]
    complete: bool
    runs: list[str]
    winds: list[FlightWindRow]
