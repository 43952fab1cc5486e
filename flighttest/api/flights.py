"""The verbs that fly: `fly`, `run`, and what both are made of, a `Flight` that was asked for and has not begun."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from flighttest.api.inputs import (
    AnyPath,
    CampaignOptions,
    FlightOptions,
    HiddenEffects,
    ProgressLike,
    as_hidden,
    as_model,
    as_path,
    as_progress,
    paths_in,
)
from flighttest.errors import InputError

if TYPE_CHECKING:
    from flighttest.api.answers import Flown
    from flighttest.api.campaigns import Campaign
    from flighttest.pipeline.flights.run import FlightRequest
    from flighttest.pipeline.results import Result

Consent = bool | Callable[[str], bool]


@dataclass(frozen=True)
class Flight:
    """A flight that was asked for, before anything is connected to. sentence: what is about to fly; real: it may be a real vehicle, which
    arms only with somebody's consent."""

    sentence: str
    real: bool
    request: FlightRequest = field(repr=False)

    def fly(self, arm: Consent = False, progress: ProgressLike | None = None) -> Campaign:
        """Fly it, and do what follows. arm: for a real vehicle, or a function that is asked with a sentence when everything is ready.

        InputError for a real vehicle that may not arm; LinkError, PreflightError; how a flight ended is an outcome, not an error.
        """
        from flighttest.api.campaigns import Campaign
        from flighttest.api.fitted_model import model_of
        from flighttest.identify.models import model_file
        from flighttest.pipeline.flights.after_landing import Analysis

        result = self._flown(arm, progress)
        found = result.value if isinstance(result.value, Analysis) else None
        fitted = None if found is None else found.improved or found.fit
        model = None if fitted is None else model_of(fitted, model_file.as_data(fitted))
        folders = tuple(Path(folder) for folder in result.data["runs"])
        return Campaign(
            document=result.document, data=result.data, status=result.status, runs=folders, analysis=found, model=model
        )

    def record(self, arm: Consent = False, progress: ProgressLike | None = None) -> Flown:
        """Fly and record it; nothing is fitted. Otherwise as `fly`."""
        from flighttest.api.answers import Flown

        result = replace(self, request=replace(self.request, fly_only=True))._flown(arm, progress)
        folders = tuple(Path(run) for run in result.data["runs"])
        return Flown(
            document=result.document, data=result.data, status=result.status, runs=folders, flights=tuple(result.value)
        )

    def _flown(self, arm: Consent, progress: ProgressLike | None) -> Result:
        from flighttest.pipeline.flights import run as flights

        if self.real and arm is False:
            raise InputError(
                f"{self.request.connect} may be a real vehicle, which would arm and take off", "give arm=True"
            )
        confirm = arm if self.real and not isinstance(arm, bool) else None
        return flights.run(replace(self.request, confirm=confirm), as_progress(progress))


def flight(
    *scripts: AnyPath,
    connect: str | None = None,
    vehicle: AnyPath | None = None,
    runs: AnyPath = "runs",
    hide: HiddenEffects = (),
    seed: int = 1,
    **options: Unpack[CampaignOptions],
) -> Flight:
    """A flight as it would be flown; arguments as of `run`. connect: else what the vehicle file names, else the built-in vehicle."""
    from flighttest.pipeline.flights import run as flights

    further = paths_in(options, "resume", "signing_key")
    if further.get("model") is not None:
        further["model"] = as_model(further["model"])
    only = further.pop("only", None)
    request = flights.as_before(
        flights.FlightRequest(
            tuple(str(script) for script in scripts),
            vehicle=as_path(vehicle),
            connect=connect,
            out=Path(runs),
            hide=as_hidden(hide),
            seed=seed,
            fly_only=only == "fly",
            fit_only=only == "fit",
            **further,
        )
    )
    return Flight(flights.announce(request), flights.needs_consent(request), request)


def fly(
    *scripts: AnyPath,
    connect: str = "sim",
    vehicle: AnyPath | None = None,
    runs: AnyPath = "runs",
    arm: Consent = False,
    hide: HiddenEffects = (),
    progress: ProgressLike | None = None,
    seed: int = 1,
    **options: Unpack[FlightOptions],
) -> Flown:
    """Fly maneuver scripts and record them; nothing is fitted.

    connect: URL of the vehicle; 'sim' is the built-in one. A real vehicle flies only with arm=True: set it when the area is clear and a
    pilot is ready; or a function that is called then. runs: folder for the run folders. hide: effects concealed in the built-in vehicle,
    {"ground_effect": {"R2_m2": 0.1}} or ["ground_effect:R2_m2=0.1"]. options: `flighttest.api.inputs.FlightOptions`. LinkError,
    PreflightError; how a flight ended is an outcome, not an error.
    """
    asked = flight(*scripts, connect=connect, vehicle=vehicle, runs=runs, hide=hide, seed=seed, **options)
    return asked.record(arm, progress)


def run(
    *scripts: AnyPath,
    connect: str = "sim",
    vehicle: AnyPath | None = None,
    runs: AnyPath = "runs",
    arm: Consent = False,
    hide: HiddenEffects = (),
    progress: ProgressLike | None = None,
    seed: int = 1,
    **options: Unpack[CampaignOptions],
) -> Campaign:
    """Fly maneuver scripts, record, cut, fit, compare with the vehicle's model in use, diagnose and report.

    As `fly`, which stops after recording. options: `flighttest.api.inputs.CampaignOptions`, as accept=True.
    """
    asked = flight(*scripts, connect=connect, vehicle=vehicle, runs=runs, hide=hide, seed=seed, **options)
    return asked.fly(arm, progress)
