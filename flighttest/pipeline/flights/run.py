"""`flighttest run`: compile, connect, preflight, fly, then everything that follows from the recording."""

from __future__ import annotations

import datetime
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from flighttest.documents import nearest
from flighttest.errors import FlighttestError, InputError, ScriptError
from flighttest.flight import FlightOutcome, FlightResult, FlightSettings, LegOutcome, fly
from flighttest.flight.preparation import preflight
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.link.transport import open_transport
from flighttest.pipeline.flights.after_landing import Landed, analyse
from flighttest.pipeline.flights.interrupts import counted_interrupts
from flighttest.pipeline.flights.missing import first_news, resume_command, unlike_the_plan
from flighttest.pipeline.planning.checking import plans, prior_model
from flighttest.pipeline.planning.predictor import ScriptReplanner
from flighttest.pipeline.recordings.fingerprints import of_vehicle
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import FlownWith, flown_with, keep
from flighttest.pipeline.store.history import DEFAULT_RUNS
from flighttest.pipeline.store.lineage import model_of
from flighttest.pipeline.store.resuming import (
    fence_behind,
    flown_in,
    left_behind,
    resumed_runs,
    script_of,
    worth_resuming,
)
from flighttest.pipeline.validity.reflights import SPOT_CHECK
from flighttest.pipeline.validity.status import flown_until
from flighttest.pipeline.vehicles.live import BUILTIN, key_for
from flighttest.pipeline.vehicles.simulator import options
from flighttest.plan import Plan
from flighttest.report.document import Bullets, Document, PageBlock, Section
from flighttest.report.numbers import join
from flighttest.report.render.plain import plain
from flighttest.sim import start_simulator
from flighttest.validity.declared import declared_changes, scripts_for
from flighttest.validity.model import ALL_SCRIPTS, SUBSETS
from flighttest.vehicle.fingerprint import FingerprintData
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import DEFAULT_VEHICLE, Vehicle

BUILTIN_SPEED = 20.0
MOST_CHANGES_SAID = 3  # in a line before take-off; the report and `status` list them all


@dataclass(frozen=True)
class FlightRequest:
    """What is to be flown, where, and what follows."""

    scripts: tuple[str, ...]
    vehicle: Path | None = None
    connect: str | None = None
    out: Path = Path("runs")
    speed: float | None = None
    seed: int = 1
    airframe: str = "paper"
    hide: tuple[str, ...] = ()
    model: Path | ModelFile | None = None
    fly_only: bool = False
    fit_only: bool = False
    resume: Path | None = None
    set_params: bool = False
    waive: tuple[str, ...] = ()
    extend_fence: bool = False
    weather: str = ""
    accept: bool = False
    signing_key: Path | None = None
    sysid: int | None = None
    confirm: Callable[[str], bool] | None = None


def as_before(request: FlightRequest) -> FlightRequest:
    """The request; where it resumes a run, beside that run and, where it names no vehicle and no link, with those of that run."""
    if request.resume is not None and request.out == DEFAULT_RUNS:
        request = replace(request, out=request.resume.parent)
    named = request.vehicle or request.connect or request.hide or request.airframe != DEFAULT_VEHICLE.name
    before = flown_with(request.resume) if request.resume is not None and not named else None
    if before is None:
        return request
    return replace(request, vehicle=before.vehicle, connect=before.link, airframe=before.airframe, hide=before.hide)


def target(request: FlightRequest) -> str:
    """The URL that will be flown: --connect, else the vehicle file's, else the built-in vehicle. Never anything by default."""
    if request.connect is not None:
        return request.connect
    if request.vehicle is not None:
        declared = load_vehicle(request.vehicle)
        if declared.connect is None:
            raise InputError(f"{request.vehicle} names no connection", "add `connect:` to it, or give --connect URL")
        return declared.connect
    return BUILTIN


def announce(request: FlightRequest) -> str:
    """The first line of a run: what is about to fly."""
    url = target(request)
    if url == BUILTIN:
        effects = f", hiding {', '.join(request.hide)}" if request.hide else ""
        chosen = "" if request.connect or request.vehicle else "; a real one needs --vehicle or --connect"
        return f"flying the built-in simulated copter ({request.airframe} airframe{effects}){chosen}"
    return f"flying the vehicle at {url}"


def needs_consent(request: FlightRequest) -> bool:
    """A person must confirm before anything real arms."""
    return target(request) != BUILTIN


def declared_vehicle(request: FlightRequest) -> Vehicle:
    """The vehicle file, the built-in one's, or one without a name in the built-in one's zone."""
    if request.vehicle is not None:
        return load_vehicle(request.vehicle)
    if target(request) != BUILTIN:  # another vehicle than the built-in one, and it is not known which
        return replace(DEFAULT_VEHICLE, name="", mass_kg=None, components={})
    # The other built-in airframe is another vehicle: its runs must not be compared with the first one's model.
    return (
        DEFAULT_VEHICLE if request.airframe == DEFAULT_VEHICLE.name else replace(DEFAULT_VEHICLE, name=request.airframe)
    )


@contextmanager
def connection(request: FlightRequest) -> Iterator[str]:
    """The URL to fly at; starts the built-in vehicle, with a fresh battery, where that is what flies."""
    url = target(request)
    if url != BUILTIN:
        given = {"--hide": bool(request.hide), "--airframe": request.airframe != DEFAULT_VEHICLE.name}
        for option in (name for name, is_given in given.items() if is_given):
            raise InputError(
                f"{option} is for the built-in vehicle", "leave out --connect and --vehicle, or use --connect sim"
            )
        yield url
        return
    # In lock-step from the first moment: a seed gives the same flight again, whatever the host was doing meanwhile.
    speed = request.speed or BUILTIN_SPEED
    made = options(request.airframe, request.hide, request.seed, speed, lockstep=True)
    key = key_of(request)
    made = replace(made, paced=request.speed is not None, signing_key=key.hex() if key is not None else "")
    with start_simulator(made) as simulation:
        yield simulation.url


def key_of(request: FlightRequest) -> bytes | None:
    """The key that frames are signed with: --signing-key, else the vehicle file's."""
    return key_for(request.signing_key, request.vehicle)


def new_run(out: Path, script: str, now: datetime.datetime) -> Path:
    """A run folder that does not exist yet, named by time and script."""
    base = out / f"{now:%Y-%m-%dT%H-%M-%S}-{script}"
    folder, count = base, 2
    while folder.exists():
        folder, count = base.with_name(f"{base.name}-{count}"), count + 1
    return folder


def run(request: FlightRequest, progress: Progress = SILENT) -> Result:
    """Fly the scripts, then analyse what was recorded."""
    request = as_before(request)
    vehicle = declared_vehicle(request)
    _known_waivers(request.waive)
    names = request.scripts or (str(script_of(request.resume)),)
    previous = request.model
    if previous is None:
        previous = model_of(request.out, vehicle.name)
    elif isinstance(previous, Path):
        previous = model_file.read(previous)
    prior, _ = prior_model(request.model, request.out, vehicle)
    compiled = plans(names, vehicle, prior)
    for plan in compiled:
        _all_flyable(plan)
    notes = worth_resuming(request.resume, compiled) if request.resume is not None else []
    for note in notes:
        progress.stage(note)
    earlier = resumed_runs(request.resume)
    reported: set[str] = set()

    def compare(firmware: str, parameters: Mapping[str, float]) -> None:
        if previous is not None:
            _report_changes(previous, of_vehicle(vehicle, firmware, dict(parameters)), reported, progress)

    compare("", {})
    folders = list(earlier)
    ends: list[FlightResult] = []
    before = flown_in(earlier)
    due = [(k, plan) for k, plan in enumerate(compiled) if not {leg.id for leg in plan.legs} <= before]
    resume = ""
    asked_again = _flown_with(request).settings + "".join(f" --waive {shlex.quote(name)}" for name in request.waive)
    for count, (index, plan) in enumerate(due):
        try:
            behind = left_behind(request.out, plan.vehicle.name)
            folder = new_run(request.out, plan.script.name, datetime.datetime.now())
            number = f"{count + 1} of {len(due)}"
            begins = f"{plan.script.name} ({number}): {len(plan.legs)} steps, recorded in {folder}"
            asked = FlightSettings(
                left_behind=behind,
                fence_behind=fence_behind(request.out, plan.vehicle.name),
                skip=before,
                resume=folders[-1] if folders else None,
                replanner=ScriptReplanner(plan, prior),
                on_vehicle=compare,
            )
            ended = _one(replace(request, seed=request.seed + index), plan, folder, asked, progress, begins)
        except FlighttestError as error:
            if not folders:
                raise
            notes.append(f"{plan.script.name} was not flown: {error}")
            break
        ends.append(ended)
        folders.append(ended.run_dir)
        over = ended.outcome is not FlightOutcome.COMPLETED or not ended.left.is_safe
        if not (request.fly_only and (over or plan is due[-1][1])):  # the answer that follows begins with it
            progress.stage(f"{plan.script.name}: {_how_it_ended(plan, ended)}")
        notes += [n for n in ended.notes if n not in notes]
        lacking = [one.script.name for _, one in due[count + 1 :]] if over else []
        resume = resume_command(
            plan, ended, earlier, [names[k] for k, _ in due[count:]] if lacking else [], asked_again
        )
        notes += unlike_the_plan(plan, ended, earlier, lacking, resume)
        if over:
            break
    usable = len(ends) == len(due) and all(e.as_planned and not e.incomplete for e in ends)
    # Each step once, to compare with a model: too little to look for unnamed physics in.
    wanted = not request.fit_only and any(plan.script.name != SPOT_CHECK for plan in compiled)
    if request.fly_only:
        return _flown(compiled, folders, ends, notes, usable)
    try:
        landed = Landed(folders, request.out, vehicle, notes, usable, resume)
        found = analyse(landed, previous, diagnose=wanted, keep=request.accept, progress=progress)
    except (FlighttestError, OSError) as error:
        if usable and not isinstance(error, OSError):
            raise
        why = f"not analysed: {error.message if isinstance(error, FlighttestError) else error.strerror or error}"
        progress.stage(why)
        return _flown(compiled, folders, ends, [*notes, why], False)
    first = first_news(ends)
    if not first:
        return found
    page = replace(found.document, verdict=f"{first} {found.document.verdict}", tone="bad")
    return replace(found, document=page)


def _flown_with(request: FlightRequest) -> FlownWith:
    return FlownWith(
        target(request),
        request.vehicle,
        request.airframe,
        request.hide,
        set_params=request.set_params,
        extend_fence=request.extend_fence,
        signing_key=request.signing_key,
        sysid=request.sysid,
    )


def _known_waivers(names: Sequence[str]) -> None:
    for name in names:
        if name not in preflight.NAMES:
            guess = nearest(name, preflight.NAMES)
            raise InputError(
                f"waive {name}: there is no preflight check of this name",
                f"did you mean {guess}?" if guess else f"there are {', '.join(preflight.NAMES)}",
            )


def _all_flyable(plan: Plan) -> None:
    """ScriptError when any step is refused: what is flown is what was written."""
    if not plan.refusals:
        return
    reasons: dict[str, list[str]] = {}
    for leg, what, remedy in plan.refusals:
        reasons.setdefault(f"{what}; {remedy}" if remedy else what, []).append(leg)
    lines = [
        f"{legs[0]}{f' and {len(legs) - 1} more' if len(legs) > 1 else ''}: {why}" for why, legs in reasons.items()
    ]
    message = f"{plan.script.name}: {len(plan.refusals)} steps cannot be flown here\n" + "\n".join(lines)
    raise ScriptError(message, f"see `flighttest check {plan.script.path or plan.script.name}`")


def _report_changes(previous: ModelFile, today: FingerprintData, reported: set[str], progress: Progress) -> None:
    """Before take-off: what differs from the vehicle of the model in use, each change once, and what it touches."""
    changes = [c for c in declared_changes(previous.fingerprint, today)[0] if c.name not in reported]
    reported.update(c.name for c in changes)
    if not changes:
        return
    since = flown_until(previous)
    words = [f"{c.name} ({c.before} is now {c.after})" for c in changes[:MOST_CHANGES_SAID]]
    if len(changes) > MOST_CHANGES_SAID:
        words.append(f"{len(changes) - MOST_CHANGES_SAID} more")
    subsets = [s for s in SUBSETS if any(s in c.touches for c in changes)]
    least = scripts_for(tuple(subsets))
    again = join(list(ALL_SCRIPTS)) + (
        f" again (at least {join(list(least))})" if set(least) < set(ALL_SCRIPTS) else " again"
    )
    progress.stage(
        f"the last model is stale: {join(words)}{f'; changed {since}' if since else ''}; touches {join(subsets)}; fly {again}"
    )


def _one(
    request: FlightRequest, plan: Plan, folder: Path, asked: FlightSettings, progress: Progress, begins: str
) -> FlightResult:
    """One script, flown and recorded in a folder. asked: what the flight needs beside the request; begins: said once the link is open."""
    with connection(request) as url, counted_interrupts() as stops:
        link = open_transport(url)  # before the run has a folder: one that cannot be opened leaves none behind
        progress.stage(begins)
        keep(folder, _flown_with(request))
        wanted = replace(
            asked,
            set_params=request.set_params,
            waive=request.waive,
            extend_fence=request.extend_fence,
            on_progress=progress.flight,
            on_stage=progress.stage,
            stop_requested=stops,
            weather=request.weather,
            signing_key=key_of(request),
            system=request.sysid or asked.system,
            confirm=request.confirm,
        )
        return fly(plan, url, folder, wanted, transport=link)


def _how_it_ended(plan: Plan, ended: FlightResult) -> str:
    flown = sum(leg.outcome is LegOutcome.FLOWN for leg in ended.legs)
    return f"{flown} of {len(plan.legs)} steps flown; {ended.sentence}"


def _flown(
    plans: Sequence[Plan], folders: Sequence[Path], ends: Sequence[FlightResult], notes: Sequence[str], usable: bool
) -> Result:
    """What `--only fly` shows: how the flights ended and where they are."""
    lines = [f"{ended.run_dir}: {_how_it_ended(plan, ended)}" for plan, ended in zip(plans, ends, strict=False)]
    blocks: list[PageBlock] = [Bullets(tuple(lines))]
    said = {f"{plan.script.name}: {ended.sentence}" for plan, ended in zip(plans, ends, strict=False)}  # above
    more = tuple(note for note in notes if note not in said)
    if more:
        blocks.append(Bullets(more))
    verdict = "Recorded." if usable else "The flight did not end as planned; what was recorded is kept."
    verdict = first_news(ends) or verdict
    data = {
        "runs": [str(f) for f in folders],
        "flights": [
            {"run": str(e.run_dir), "outcome": e.outcome.name, "left": e.left.name, "legs": [plain(r) for r in e.legs]}
            for e in ends
        ],
        "notes": list(notes),
    }
    document = Document("flight", verdict, "good" if usable else "bad", (Section("flights", "", tuple(blocks)),))
    return Result(document, data, Status.DONE if usable else Status.UNUSABLE, tuple(ends))
