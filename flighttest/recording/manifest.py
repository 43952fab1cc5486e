"""What a run folder holds about itself, as typed data: manifest.yaml and the events of a flight (docs/formats.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

from flighttest.documents import PlainData

Component = Mapping[str, PlainData]  # what was declared of one part: id, model and whatever else somebody wrote down
Components = Mapping[str, Component]


class ClockData(TypedDict, total=False):
    """The ground's clock against the vehicle's: offset and its error, s, and how they were found; system: MAVLink id of the vehicle whose
    clock it is. An ArduPilot log adds, by the name of a message, which of several sensors was taken."""

    offset_s: float
    error_s: float
    method: str
    system: int


class VehicleData(TypedDict, total=False):
    """What was declared of the vehicle (vehicle.yaml), as a recording carries it."""

    name: str
    connect: str | None
    firmware: str
    nominal_voltage_v: float
    hover_throttle: float
    zone: ZoneData
    mass_kg: float | None
    rotor_height_m: float
    components: Components
    path: str
    signing_key: str | None
    flies: bool
    weather: str


class ZoneData(TypedDict, total=False):
    """The flight zone as in `vehicle.model.Zone`."""

    heading_rad: float
    x_m: Sequence[float]
    y_m: Sequence[float]
    z_m: Sequence[float]
    margin_m: float
    origin: Sequence[float] | None


class ScriptReference(TypedDict, total=False):
    """Which script was flown."""

    name: str
    sha256: str
    path: str


class ParametersSet(TypedDict, total=False):
    """Parameters that a flight set: in which run, name to the value given, and to the number of the autopilot it was set on."""

    run: str
    given: dict[str, float]
    hardware: dict[str, str]


class FenceData(TypedDict, total=False):
    """A fence that a flight gave its vehicle: in which run, on which autopilot, what it kept before and what it was given (command, frame,
    four parameters, x, y, z of each item), and whether it is still there."""

    run: str
    hardware: str
    before: list[list[float]]
    given: list[list[float]]
    left: bool


class LegData(TypedDict):
    """How one leg ended: the member of `LegOutcome` by name, and why."""

    id: str
    outcome: str
    why: list[str]


class Manifest(TypedDict, total=False):
    """manifest.yaml without its format. Of a flight: started to legs; of any recording: name to autopilot."""

    name: str
    source: str
    importer: str
    sha256: str
    firmware: str
    parameters: Mapping[str, float]
    components: Components
    vehicle: VehicleData
    clock: ClockData
    losses: Sequence[str]
    filters: Mapping[str, float]
    derived: Mapping[str, str]
    reference_clock: str
    autopilot: str
    started: str
    created: str
    versions: Mapping[str, str]
    script: ScriptReference
    connect: str
    weather: str
    resumes: str
    parameters_changed: Mapping[str, float]
    parameters_left: Mapping[str, float]
    parameters_set: ParametersSet
    fence_set: FenceData
    rates_hz: Mapping[str, float]
    zone_origin_local_m: Sequence[float]
    outcome: str
    outcome_name: str
    vehicle_left: str
    legs: Sequence[LegData]
    notes: list[str]


class EventData(TypedDict, total=False):
    """What an event carries beside its time, kind and label. leg, mark, outcome, why: of a leg's beginning and end (kind, maneuver, cell,
    repeat, heading_rad, t_step_s, duration_s, hover_throttle: of the step); record: whether a phase is to be cut; mode: number of a flight
    mode; step: number in a table; parameter, before, after: of a change; system, severity, from_vehicle: of a text; event, subsystem,
    code: the autopilot's own numbers; the rest: the vehicle's state when a flight was aborted."""

    leg: str
    mark: str
    maneuver: str
    kind: str
    cell: Mapping[str, float]
    repeat: int
    heading_rad: float
    t_step_s: float
    duration_s: float
    hover_throttle: float
    outcome: str
    why: list[str]
    record: bool
    mode: int
    step: float
    parameter: str
    before: float
    after: float
    system: int
    severity: int
    from_vehicle: bool
    event: int
    subsystem: int
    code: int
    modes: list[str]
    height_m: float | None
    climb_m_s: float | None
    position_m: Sequence[float] | None
    velocity_m_s: Sequence[float] | None
    tilt_rad: float | None
    voltage_v: float | None
    silence_s: float
