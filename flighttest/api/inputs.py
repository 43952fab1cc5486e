"""What verbs take: paths, recordings, models as files or values, a receiver of progress, and the further options of each, typed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from flighttest.errors import InputError
from flighttest.pipeline.results import Progress
from flighttest.recording.model import Recording

if TYPE_CHECKING:
    from flighttest.api.fitted_model import FittedModel
    from flighttest.identify.models.model_file import ModelFile
    from flighttest.physics.model import Model

AnyPath = str | PathLike[str]
Source = str | PathLike[str] | Recording
ProgressLike = Callable[[str], object] | Progress
HiddenEffects = Mapping[str, Mapping[str, float]] | Iterable[str]
Weather = Literal["still", "unknown"] | Mapping[str, Literal["still", "unknown"]]


class Stages:
    """Progress that hands each stage's words to a function."""

    def __init__(self, report: Callable[[str], object] | None) -> None:
        self._report = report

    def stage(self, text: str) -> None:
        """A new step begins."""
        if self._report is not None:
            self._report(text)

    def part(self, done: float, of: float) -> None:
        """So many pieces are done; a stage's words are all that is handed on."""

    def flight(self, progress: Any) -> None:
        """The flight went on; its words are in the stages."""


def as_progress(report: ProgressLike | None) -> Progress:
    """A receiver of progress: a function gets each stage's words, an object of `Progress` everything."""
    return report if isinstance(report, Progress) else Stages(report)


def as_path(path: AnyPath | None) -> Path | None:
    """A path, where one is given."""
    return None if path is None else Path(path)


def as_sources(sources: Source | Iterable[Source]) -> list[Path | Recording]:
    """One recording or several, as the pipeline takes them; InputError where there is none."""
    given = [sources] if isinstance(sources, str | PathLike | Recording) else list(sources)
    if not given:
        raise InputError("no recording was given", "name a run folder, a log, or what `read` returned")
    for source in given:
        if not isinstance(source, str | PathLike | Recording):
            raise InputError(
                f"a {type(source).__name__} is not a recording",
                "give each run folder, log or `Recording` as an argument of its own, a list of them as *runs",
            )
    return [source if isinstance(source, Recording) else Path(source) for source in given]


def as_model(model: FittedModel | AnyPath) -> Path | ModelFile:
    """A model as the pipeline takes it: its file, or what is in it. InputError for a model without numbers."""
    if isinstance(model, str | PathLike):
        return Path(model)
    if not hasattr(model, "stored"):
        raise InputError(
            f"a {type(model).__name__} is not a fitted model", "give `fit(...).model`, `read_model(...)` or a path"
        )
    return model.stored


def as_physics(model: Model | FittedModel | None) -> Model | None:
    """The terms of a model, without its numbers. InputError for a path."""
    if isinstance(model, str | PathLike):
        raise InputError(
            f"{str(model)!r} is not a model", "give a `Model`, or `read_model(path)`: its terms are fitted anew"
        )
    from flighttest.api.fitted_model import FittedModel

    return model.physics if isinstance(model, FittedModel) else model


def as_hidden(hide: HiddenEffects) -> tuple[str, ...]:
    """Effects to conceal, each as id:key=value,key=value. hide: id to its values, SI, or such words."""
    if isinstance(hide, Mapping):
        return tuple(f"{i}:{','.join(f'{key}={float(v)!r}' for key, v in given.items())}" for i, given in hide.items())
    return (hide,) if isinstance(hide, str) else tuple(hide)


class ReadingOptions(TypedDict, total=False):
    """How recordings are read. weather: "still" of all flights, or {"FLIGHT": "still"} of those whose name holds FLIGHT: a prior for their
    winds. workers: processes of this machine."""

    weather: Weather
    workers: int


class FitOptions(ReadingOptions, total=False):
    """Further options of `fit`. terms: ids beside those of `model`; scheduler: an existing Dask cluster, tcp://...; output: model.yaml to
    write."""

    terms: Sequence[str]
    scheduler: str | None
    output: AnyPath | None


class DiagnoseOptions(ReadingOptions, total=False):
    """Further options of `diagnose`. accept: make the improved model the vehicle's in use."""

    accept: bool


class FlightOptions(TypedDict, total=False):
    """Further options of `fly`. speed: of the built-in vehicle, times real time; airframe: the built-in vehicle's; resume: folder of an
    interrupted run whose missing steps are flown; set_params: set what the preflight asks for, and restore it; waive: names of
    preflight checks; extend_fence: add the zone's polygon to a fence that the vehicle keeps; weather: kept with the run; signing_key: file
    with the key of MAVLink 2 signing; sysid: our own MAVLink system id."""

    speed: float | None
    airframe: Literal["paper", "rotor"]
    resume: AnyPath | None
    set_params: bool
    waive: Sequence[str]
    extend_fence: bool
    weather: str
    signing_key: AnyPath | None
    sysid: int | None


class CampaignOptions(FlightOptions, total=False):
    """Further options of `run`. model: to compare with, else the vehicle's in use; accept: make the improved model the vehicle's in use;
    only: 'fly' stops after recording, 'fit' after the fit."""

    model: FittedModel | AnyPath | None
    accept: bool
    only: Literal["fly", "fit"] | None


class ProofOptions(TypedDict, total=False):
    """Further options of `prove`. generator: what flies; kind: only trials that hide nothing, one effect, two, or one that no term of the
    catalogue describes, or, of real flights, a natural pair; clean: draw on until so many trials hide nothing; scheduler: an existing Dask
    cluster, tcp://...; recordings, data: list (recordings/1) and folder of real flights: 'recorded' adds effects to them,
    'rotor' takes the noise of half its trials from them."""

    generator: Literal["rotor", "sitl", "recorded"]
    kind: Literal["clean", "single", "pair", "outside", "natural"] | None
    clean: int
    scheduler: str | None
    recordings: AnyPath | None
    data: AnyPath | None


class SimulateOptions(TypedDict, total=False):
    """Further options of `simulate`. vehicle_seed: a random rotor vehicle; vehicle: constants of the airframe by name; noise: factor on all
    sensor noise; drift: on the accelerometer's bias, 0.05 m/s^2 RMS, none by default; gust_rms_m_s: horizontal gusts; paced: in lock-step,
    no sooner than `speed` allows; ready_s, gps_s: when it can arm and has a position, s after boot; parameters: autopilot parameters;
    voltage_v: at which the battery rests; capacity_ah: of the battery; signing_key: hexadecimal, of MAVLink 2."""

    vehicle_seed: int | None
    vehicle: Mapping[str, float]
    noise: float
    drift: float
    gust_rms_m_s: float
    paced: bool
    ready_s: float
    gps_s: float
    parameters: Mapping[str, float]
    voltage_v: float | None
    capacity_ah: float | None
    signing_key: str


class ServeOptions(TypedDict, total=False):
    """Further options of `serve`. backend: the built-in autopilot, or ArduPilot's SITL; model: flies instead of an airframe; frame: with
    the SITL, the folder that an export to ArduPilot wrote; lockstep: wait for the client's clock."""

    airframe: Literal["paper", "rotor"]
    backend: Literal["builtin", "sitl"]
    hide: HiddenEffects
    seed: int
    port: int
    speed: float
    lockstep: bool
    model: AnyPath | None
    frame: AnyPath | None


def paths_in(options: Mapping[str, object], *names: str) -> Any:
    """Options with those of these names, where they are given, as paths, and sequences as tuples."""
    found: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in options.items()}
    found |= {k: (found[k],) for k in ("terms", "waive") if isinstance(found.get(k), str)}
    return found | {name: as_path(found[name]) for name in names if name in found}


def reading_options(options: ReadingOptions, *names: str) -> Any:
    """`paths_in` of options that hold `ReadingOptions`, with the weather by part of a flight's name."""
    found = paths_in(options, *names)
    return found | {"weather": {"": found["weather"]}} if isinstance(found.get("weather"), str) else found
