"""The blocks of model.yaml that are no parameters: read or checked one by one, so that everything wrong with a file is reported at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NotRequired, TypedDict, cast

import yaml

from flighttest.documents import Node, PlainData, YamlDocument, kind_of, require
from flighttest.identify.diagnostics.parameter_diagnostics import FitChecks
from flighttest.physics.catalogue import catalogue
from flighttest.vehicle.fingerprint import FingerprintData
from flighttest.vehicle.identity import IdentityData

_CONSTANTS = {"g": (0.1, 100.0, "m/s^2"), "nominal_voltage_v": (0.1, 2000.0, "V"), "rotor_height_m": (0.0, 5.0, "m")}
_VALID = {"voltage_v": (0.1, 2000.0)}
_STEP = {"size": (1e-4, 100.0), "period_s": (1e-3, 0.2), "voltage_v": (0.1, 2000.0)}  # of `FlownStepBlock`


class ValidBlock(TypedDict, total=False):
    """The range that a fit was made in, as `quality.ValidRange`; [lowest, highest] where two numbers bound it."""

    tilt_max_rad: float
    speed_max_m_s: float
    voltage_v: list[float]
    height_m: list[float]
    yaw_rate_max_rad_s: float
    throttle: list[float]


class NoiseBlock(TypedDict, total=False):
    """Standard deviations that residuals were measured against, SI: of each channel, and of each disturbance; correlations: samples of a
    channel that count as one, 1 where it is not given."""

    channels: dict[str, float]
    disturbances: dict[str, float]
    correlations: dict[str, float]


class FlightWindRow(TypedDict):
    """Velocity of the air in one flight, m/s, world NWU, with standard errors; factor_95: half a 95 % interval in these (files before it
    have none). verdict: 'wind', 'none seen' or 'still' (declared)."""

    flight: str
    w_north: float
    w_west: float
    w_north_std: float
    w_west_std: float
    speed_m_s: float
    speed_std: float
    factor_95: NotRequired[float]
    from_deg: float
    verdict: str
    declared: str


class LeftRow(TypedDict):
    """The error of one channel in one kind of step of a model's own flights: mean over its responses, in the channel's unit, in bins of
    0.1 s since the step, the first of which is `first`; variance: of one response about it."""

    channel: str
    kind: str
    cell: dict[str, float]
    responses: int
    first: int
    variance: float
    mean: list[float | None]


class DiagnosedBlock(TypedDict, total=False):
    """What was looked for in a model's own flights beside its terms. smallest_detectable: by term, in the unit of its parameter; left:
    where steps were repeated; winds: of each flight, m/s, which are no property of the vehicle."""

    verdict: str
    complete: bool
    not_needed: list[str]
    untestable: list[str]
    smallest_detectable: dict[str, float]
    left: list[LeftRow]
    winds: list[FlightWindRow]


class ParameterBlock(TypedDict, total=False):
    """One parameter of model.yaml; std: with what the equations may err; scatter: of like flights alone; fly: what would make it known."""

    value: float | None
    unit: str
    std: float | None
    interval_95: list[float | None] | None
    scatter: float | None
    source: str
    identifiable: bool
    why: str
    fly: str


class DelayBlock(TypedDict):
    """The delay of one channel, s."""

    value: float | None
    unit: str
    std: float | None


class OnsetBlock(TypedDict):
    """The paper's estimate of the delay, s: mean and standard deviation over `count` steps, and by channel."""

    mean_s: float | None
    std_s: float | None
    count: int
    channels_s: dict[str, float | None]


class CovarianceBlock(TypedDict):
    """Covariance of the estimates in this order."""

    order: list[str]
    matrix: Sequence[Sequence[float | None]]


class ChannelBlock(TypedDict):
    """How well one channel is described, in its unit; residual: in words."""

    rmse: float | None
    noise_floor: float | None
    r2: float | None
    residual: str


class HoverBlock(TypedDict):
    """The throttle that held height: its standard error with degrees of freedom, and ln(U / U_n)."""

    throttle: float
    std: float
    dof: float
    log_voltage: float | None


class MotorsBlock(TypedDict):
    """How the four motors shared the load: mean over the flights of each command over the mean of all, and what one flight's share
    differs by from it (standard deviation, with degrees of freedom)."""

    shares: list[float]
    spread: float
    dof: float
    flights: int


class BatteryBlock(TypedDict):
    """The internal resistance of the battery and its standard error, Ohm."""

    resistance_ohm: float
    std: float


class StepsBlock(TypedDict):
    """Mean scores of each kind of step by the parameters in `order`; a row holds kind, responses, log_voltage, seconds and held_s (how
    long after the step its records end, and its command is held), score and its cell."""

    order: list[str]
    flown: list[dict[str, PlainData]]


class FlownStepBlock(TypedDict):
    """The mean answer to steps of one size, both signs taken as one: rad or rad/s, from the step on every period_s; voltage_v: at them,
    None where it was not recorded."""

    size: float
    responses: int
    voltage_v: float | None
    period_s: float
    answer: list[float]


class QualityBlock(FitChecks, total=False):
    """The block fit_quality: how good the fit is; what later flights are compared with (discrepancy, steps, hover, motors, battery); and
    the steps of roll, pitch and yaw rate as they were flown (flown_steps), by which a twin under the real firmware gets its frame."""

    status: str
    iterations: int
    responses: int
    channels: dict[str, ChannelBlock]
    outliers: list[str]
    ties: list[str]
    voltage_spread_at_equal_throttle_v: float | None
    discrepancy: dict[str, float]
    steps: StepsBlock
    hover: HoverBlock
    motors: MotorsBlock
    battery: BatteryBlock
    flown_steps: dict[str, list[FlownStepBlock]]


class ModelData(TypedDict, total=False):
    """model.yaml (format model/1) as plain data."""

    format: str
    vehicle: IdentityData
    terms: list[str]
    parameters: dict[str, ParameterBlock]
    constants: dict[str, float]
    attitude_loops: bool
    channel_delays: bool
    delays: dict[str, DelayBlock]
    onset_delay: OnsetBlock
    covariance: CovarianceBlock
    valid: ValidBlock
    fingerprint: FingerprintData
    runs: list[str]
    noise: NoiseBlock
    fit_quality: QualityBlock
    notes: list[str]
    diagnosed: DiagnosedBlock


def constants_of(document: YamlDocument, node: Node | None) -> dict[str, float]:
    """Gravity, nominal voltage and height of the rotors, as far as they are stated."""
    if node is None:
        return {}
    children = document.mapping(node, _CONSTANTS)
    read = {name: document.number(child, *_CONSTANTS[name]) for name, child in children.items()}
    return {name: value for name, value in read.items() if value is not None}


def noise_of(document: YamlDocument, node: Node | None) -> NoiseBlock:
    """Standard deviations of channels and disturbances, and correlations; one that is not known (null) is left out."""
    found: dict[str, dict[str, float]] = {}
    for part, block in children_of(document, node).items():
        read = {n: document.number(c, 0.0, 1e9) for n, c in children_of(document, block).items() if c.value is not None}
        found[part] = {n: value for n, value in read.items() if value is not None}
    return cast(NoiseBlock, found)


def check_plain(document: YamlDocument, root: Mapping[str, Node]) -> None:
    """Kinds of the blocks that are kept as they are written: mappings, lists, true or false."""
    _check_valid(document, root.get("valid"))
    _check_fingerprint(document, root.get("fingerprint"))
    _check_quality(document, root.get("fit_quality"))
    _check_diagnosed(document, root.get("diagnosed"))
    children_of(document, root.get("vehicle"))
    for key in ("runs", "notes"):
        for element in elements_of(document, root.get(key)):
            if not isinstance(element.value, str):
                document.wrong(element, f"expected text, found {kind_of(element.value)}", "put it into quotes")
    for key in ("attitude_loops", "channel_delays"):
        if key in root and not isinstance(root[key].value, bool):
            document.wrong(root[key], "expected true or false")


def _check_valid(document: YamlDocument, node: Node | None) -> None:
    """Each range of validity is a number or [low, high]."""
    for name, child in children_of(document, node).items():
        if isinstance(child.value, list):
            document.vector(child, 2, *_VALID.get(name, (-1e9, 1e9)))
        elif child.value is not None:
            document.number(child, -1e9, 1e9)


def _check_fingerprint(document: YamlDocument, node: Node | None) -> None:
    """Components are blocks of what was declared of each, parameters and sizes are numbers; what else is there is text."""
    parts = children_of(document, node)
    for child in children_of(document, parts.get("components")).values():
        children_of(document, child)
    numbers = dict(children_of(document, parts.get("shaping_parameters")))
    numbers |= {
        key: parts[key] for key in ("nominal_voltage_v", "mass_kg") if key in parts and parts[key].value is not None
    }
    for child in numbers.values():
        document.number(child, -1e12, 1e12)


def _check_quality(document: YamlDocument, node: Node | None) -> None:
    """What later flights are compared with, and the steps as they were flown, are numbers, lists of numbers, or not known (null)."""
    parts = children_of(document, node)
    blocks: list[tuple[Node | None, Mapping[str, tuple[float, float]]]] = [
        (parts.get(key), {}) for key in ("hover", "motors", "battery")
    ]
    for steps in children_of(document, parts.get("flown_steps")).values():
        for step in elements_of(document, steps):
            stated = {k: n for k, n in children_of(document, step).items() if n.value not in (None, [])}
            require(document, stated, ("size", "period_s", "answer"), step.line, step.path)
            blocks.append((step, _STEP))
    for block, ranges in blocks:
        for name, child in children_of(document, block).items():
            for value in child.value if isinstance(child.value, list) else (child,):
                if value.value is not None:
                    document.number(value, *ranges.get(name, (-1e9, 1e9)))


def _check_diagnosed(document: YamlDocument, node: Node | None) -> None:
    """The verdict is text, terms are listed, and the smallest sizes that would have been detected are by term."""
    parts = children_of(document, node)
    children_of(document, parts.get("smallest_detectable"))
    for key in ("not_needed", "untestable", "winds"):
        elements_of(document, parts.get(key))
    for step in elements_of(document, parts.get("left")):
        _check_left(document, step)
    if "verdict" in parts:
        document.text(parts["verdict"])


def _check_left(document: YamlDocument, step: Node) -> None:
    row = children_of(document, step)
    require(document, row, LeftRow.__annotations__, step.line, step.path)
    for key in ("channel", "kind"):
        if key in row:
            document.text(row[key])
    known = [n for n in elements_of(document, row.get("mean")) if n.value is not None]
    for number in (*children_of(document, row.get("cell")).values(), *known):
        document.number(number, -1e9, 1e9)
    for key, least in (("responses", 1), ("first", -1000), ("variance", 0.0)):
        if key in row:
            document.number(row[key], least, 1e9)


def elements_of(document: YamlDocument, node: Node | None) -> Sequence[Node]:
    """What a list holds; nothing where there is none."""
    if node is None or node.value is None:
        return ()
    if not isinstance(node.value, list):
        document.wrong(node, f"expected a list, found {kind_of(node.value)}")
        return ()
    return node.value


def children_of(document: YamlDocument, node: Node | None) -> Mapping[str, Node]:
    """What a block of any keys holds; nothing where there is none."""
    if node is None or node.value is None:
        return {}
    if not isinstance(node.value, dict):
        document.wrong(node, f"expected a block of keys, found {kind_of(node.value)}")
        return {}
    return node.value


def plain_block(document: YamlDocument, node: Node | None) -> dict[str, PlainData]:
    """A block of any keys and values as plain data."""
    return {name: child.plain() for name, child in children_of(document, node).items()}


def list_elements(plain: PlainData) -> Sequence[Any]:
    """The elements of a list; none of anything else."""
    return cast(Sequence[Any], plain) if isinstance(plain, list) else ()


def terms_of(document: YamlDocument, node: Node | None) -> list[str]:
    """Names of terms; body alone where none are listed."""
    if node is None:
        return ["body"]
    if not isinstance(node.value, list):
        document.wrong(
            node, f"expected a list of terms, found {kind_of(node.value)}", "for example [body, linear_drag]"
        )
        return ["body"]
    known = {"body", *catalogue()}
    for child in node.value:
        if not isinstance(child.value, str) or child.value not in known:
            document.wrong(child, f"no term is called {child.plain()!r}", "see `flighttest terms`")
    return [str(child.plain()) for child in node.value]


class ModelDumper(yaml.SafeDumper):
    """Block style with short lists and small mappings on one line."""

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> Any:
        """On one line where nothing in it is nested."""
        flat = all(not isinstance(v, dict | list | tuple) for v in sequence)
        return super().represent_sequence(tag, sequence, flow_style=flat if flow_style is None else flow_style)

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> Any:
        """On one line where it is small and flat."""
        short = len(mapping) <= 8 and not any(_deep(v) for v in mapping.values())
        return super().represent_mapping(tag, mapping, flow_style=short if flow_style is None else flow_style)

    def ignore_aliases(self, data: Any) -> bool:
        """Write every value out."""
        return True


def _deep(value: Any) -> bool:
    """Whether a value does not read well on one line."""
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(v, list | dict) for v in value))
