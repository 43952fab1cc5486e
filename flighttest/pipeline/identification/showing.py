"""`flighttest show`: a recording as it is, on one page, before anything is fitted."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from flighttest.datafiles import check_writable
from flighttest.errors import FlighttestError
from flighttest.identify.dead_time import onset_delay, start_values
from flighttest.identify.diagnostics.identifiability import (
    allowance,
    maneuver_for,
    throttle_varies,
    too_few_responses,
    voltage_varies,
)
from flighttest.identify.expected_information import Expected, expected_of
from flighttest.identify.fit import has_attitude_references
from flighttest.identify.selection import NOTHING_ASKED, nothing_asked
from flighttest.physics.body import DELAY
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.identification.reporting import provenance
from flighttest.pipeline.recordings.batteries import battery_of
from flighttest.pipeline.recordings.sources import open_recording, unreported
from flighttest.pipeline.recordings.time_budget import in_the_air_s, time_data, time_section
from flighttest.pipeline.results import SILENT, Progress, Result
from flighttest.recording import Recording
from flighttest.report.document import Document, Tone
from flighttest.report.numbers import duration, join, number
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.sections import fit as fit_sections
from flighttest.report.sections.show import Look, ParameterOutlook, excitation_sentence, sections
from flighttest.segments import Segment, cut
from flighttest.segments.airborne import flights, takeoffs
from flighttest.segments.health import at_limits, battery_course, following, in_flight, modes, sampling, spectra
from flighttest.version import __version__

GROUP_WORDS = {"reference": "command"}
STEPS_OF_A_MANEUVER = 6  # fewer steps happen in a flight by hand, too
SLOW_M_S, LEVEL_RAD = 0.3, 0.1  # of hovering
MOST_WINDOWS = 24  # of free flight, that the outlook rests on: more would take longer and show the same
PAGE = "show.html"
SUFFIXES = re.compile(r"\.\w+(\.(gz|xz))?$")  # of a log's name


def show(log: Path, output: Path | None = None, columns: Path | None = None, progress: Progress = SILENT) -> Result:
    """Write the page of a log or run folder; the terminal gets its main lines."""
    page = output or (log / PAGE if log.is_dir() else Path(f"{SUFFIXES.sub('', log.name)}-{PAGE}"))
    check_writable(page.parent)
    progress.stage(f"reading {log}")
    recording = open_recording(log, columns)
    progress.stage("cutting the responses")
    segments = cut(recording)
    progress.stage(f"judging {len(segments)} responses")
    look = looked(recording, segments, shlex.quote(str(log)), columns)
    verdict, tone = _verdict(look, segments)
    shown = list(sections(look))
    at = next(i for i, s in enumerate(shown) if s.id == "identify") + 1
    shown[at:at] = [time_section([recording], segments)]
    if segments:
        shown.insert(at + 1, fit_sections.segments(_views(segments)))
    facts = {**provenance([recording]), **dict(look.figures)}
    document = Document(
        f"flighttest: {recording.name}", verdict, tone, tuple(shown), facts, f"flighttest {__version__}."
    )
    progress.stage("writing the page")
    html.write_html(document, page)
    brief = [replace(s, detail=s.id not in ("identify", "next")) for s in shown if s.id != "channels"]
    short = Document("show", verdict, tone, tuple(brief), {"page": str(page), **dict(look.figures)})
    return Result(short, _data(look, page, verdict, unreported(log, recording)), value=document)


def looked(recording: Recording, segments: Sequence[Segment], named: str, columns: Path | None = None) -> Look:
    """What the page shows of a recording and its segments."""
    outlook, why = _outlook(recording, segments)
    resistance = battery_of([recording])
    compatible = next((s.context.compatibility for s in segments), None)
    resistance_text = (
        resistance if isinstance(resistance, str) else f"internal resistance {number(1000 * resistance[0], 3)} mΩ"
    )
    return Look(
        recording, sampling(recording), at_limits(recording), following(recording), spectra(recording), compatible,
        battery_course(recording), resistance_text, modes(recording), flights(recording), _figures(recording, segments), outlook, why,
        _commands(outlook, named, columns),
    )  # fmt: skip


def _views(segments: Sequence[Segment]) -> Any:
    from flighttest.pipeline.presenters.fit_view import segment_views

    return segment_views(segments)


def _outlook(recording: Recording, segments: Sequence[Segment]) -> tuple[tuple[ParameterOutlook, ...], str]:
    """Expected errors at nominal parameters, and where there are none why."""
    steps = [s for s in segments if s.usable and s.kind != "free"]
    free = [s for s in segments if s.usable and s.kind == "free"]
    usable = [*steps, *free[:: max(1, len(free) // MOST_WINDOWS)]]
    if not segments:
        flown = round(_air_s(recording, segments)) > 0
        nothing = "No response can be cut from" if flown else "There is no flight in"
        return (), f"{nothing} this recording: the time budget (--all shows it) says what became of its time."
    if nothing_asked(segments):
        return (), f"What it determines was not computed: {NOTHING_ASKED}."
    if not usable:
        return (), "No response of this recording can be used; the reasons are in the table of responses."
    model = base_model([recording], None)
    model = replace(model, attitude_loops=has_attitude_references(usable))
    try:
        values = model.start(start_values(usable, model, onset_delay(usable)))
        expected = expected_of(usable, model, values)
    except FlighttestError as error:
        return (), f"What it determines was not computed: {error.message}."
    blind = () if voltage_varies(usable, model.nominal_voltage_v) else ("alpha",)
    if not throttle_varies(usable):
        blind = (*blind, "sigma_t", "T_d_thrust")
    expected = tuple(replace(one, std=None) if one.name in blind else one for one in expected)
    return tuple(_judged(model, one) for one in expected), ""


def _judged(model: Any, one: Expected) -> ParameterOutlook:
    """Excited: within what a fit calls known, by as many responses as a fit asks for."""
    param = DELAY if one.name == DELAY.name else model.param[one.name]
    reveals = {p.name: t.reveals for t in model.built_terms for p in t.params}
    if one.std is None:
        why = "nothing in this recording depends on it"
    elif one.std > allowance(param, one.value):
        why = "its error would be too large"
    else:
        why = too_few_responses(one.responses)
    return ParameterOutlook(one, not why, maneuver_for(param, reveals.get(one.name, "")) if why else "", why)


def _air_s(recording: Recording, segments: Sequence[Segment]) -> float:
    """As `import` counts it."""
    return in_the_air_s(time_data([recording], segments))


def _figures(recording: Recording, segments: Sequence[Segment]) -> tuple[tuple[str, str], ...]:
    """Times, hover throttle, highest speed, tilt and height of the flights."""
    count, air = len(takeoffs(recording)), duration(_air_s(recording, segments))
    found = [("in the air", air + (f" in {count} flights" if count > 1 else ""))]

    def flown(name: str) -> tuple[Any, Any]:
        t, values = recording.channel(name)
        keep = in_flight(recording, t) & np.isfinite(values)
        return t[keep], values[keep]

    if recording.has("throttle"):
        t, throttle = flown("throttle")
        level = np.ones(t.size, dtype=bool)
        for name, most in (("v_z_m_s", SLOW_M_S), ("roll_rad", LEVEL_RAD), ("pitch_rad", LEVEL_RAD)):
            if recording.has(name):
                at, values = flown(name)
                if at.size:
                    level &= np.abs(np.interp(t, at, values)) < most
        level &= throttle > 0.0
        if level.sum() > 10:
            found.append(("hover throttle", number(float(np.median(throttle[level])), 3)))
    speeds = [flown(n)[1] for n in ("v_x_m_s", "v_y_m_s", "v_z_m_s") if recording.has(n)]
    if len(speeds) == 3 and speeds[0].size and speeds[0].size == speeds[1].size == speeds[2].size:
        found.append(("highest speed", f"{number(float(np.sqrt(sum(v**2 for v in speeds)).max()), 3)} m/s"))
    tilts = [flown(n)[1] for n in ("roll_rad", "pitch_rad") if recording.has(n)]
    if tilts and all(v.size for v in tilts):
        found.append(("largest tilt", f"{number(float(np.degrees(max(np.abs(v).max() for v in tilts))), 2)}°"))
    for name in ("height_m", "p_z_m"):
        if recording.has(name) and (values := flown(name)[1]).size:
            found.append(("height", f"{number(float(values.min()), 2)} to {number(float(values.max()), 3)} m"))
            break
    return tuple(found)


def _commands(outlook: Sequence[ParameterOutlook], named: str, columns: Path | None) -> tuple[tuple[str, str], ...]:
    more = "" if columns is None else f" --columns {shlex.quote(str(columns))}"
    found = []
    if any(one.expected.std is not None for one in outlook):
        found.append(("The model's parameters from this recording:", f"flighttest fit {named}{more} -o model.yaml"))
        found.append(("What physics the model lacks:", f"flighttest diagnose {named}{more} -o diagnosis"))
    scripts = list(dict.fromkeys(one.fly for one in outlook if one.fly))
    if scripts:
        words = " ".join(scripts)
        found.append(
            (
                "Steps for what it cannot determine (with --vehicle and --connect, on this vehicle):",
                f"flighttest run {words}",
            )
        )
    if not found:
        found.append(("Why nothing of it can be used:", f"flighttest segment {named}{more} --all"))
    return tuple(found)


def _verdict(look: Look, segments: Sequence[Segment]) -> tuple[str, Tone]:
    """What kind of flight, and what it is good for."""
    air_s = _air_s(look.recording, segments)
    used = [s for s in segments if s.usable]
    steps = [s for s in used if s.kind != "free"]
    recording = look.recording
    if not segments:
        begin, end = recording.t_span_s
        kind = f"A recording of {duration(end - begin)} with no flight in it"
        if round(air_s) > 0:  # as `import` says
            kind = f"A recording of {duration(end - begin)}, {duration(air_s)} of it in the air, from which no response can be cut"
    elif len(steps) >= STEPS_OF_A_MANEUVER:
        marked = any(m.kind == "leg" for m in recording.markers)
        kind = f"A {'maneuver ' if marked else ''}flight of {duration(air_s)} with {len(steps)} usable steps"
    elif any(recording.has(n) for n in ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle")):
        kind = f"A free flight of {duration(air_s)} with recorded commands"
        kind += f" and {len(steps)} step{'' if len(steps) == 1 else 's'}" if steps else ""
    else:
        kind = f"{duration(air_s)} of motion without recorded commands"
    worst = max(look.sampling, key=lambda s: s.lost, default=None)
    doubts = []
    if worst is not None and worst.lost > 0.02:
        group = GROUP_WORDS.get(worst.group, worst.group.replace("_", " "))
        doubts.append(f"samples of {group} are missing for {100 * worst.lost:.0f} % of the time")
    if recording.provenance.losses:
        count = len(recording.provenance.losses)
        doubts.append(f"reading the log gave {count} remark{'s' if count > 1 else ''} (listed under its health)")
    if not any(one.expected.std is not None for one in look.outlook):
        outlook, tone = "Nothing in it can be used for a fit.", "bad"
    else:
        outlook, tone = excitation_sentence(look.outlook), "good" if all(o.excited for o in look.outlook) else "warn"
    return f"{kind}{'; ' + join(doubts) if doubts else ''}. {outlook}", tone  # type: ignore[return-value]


def _data(look: Look, page: Path, verdict: str, losses: Sequence[str]) -> dict[str, Any]:
    return {
        "page": str(page),
        "verdict": verdict,
        "sampling": plain([asdict(s) for s in look.sampling]),
        "limits": plain([asdict(s) for s in look.limits]),
        "followed": plain([asdict(s) for s in look.followed]),
        "vibration": [{"channel": s.channel, "rms": plain(s.rms), "peak_hz": s.peak_hz} for s in look.spectra],
        "compatibility": plain(look.compatibility),
        "battery": plain(look.battery),
        "modes": [{"start_s": a, "end_s": b, "mode": name} for a, b, name in look.modes],
        "flights": [list(span) for span in look.flights],
        "outlook": [
            {"parameter": o.expected.name, "least_std": o.expected.std, "excited": o.excited, "why": o.why}
            for o in look.outlook
        ],
        "losses": [*look.recording.provenance.losses] or list(losses),
        "commands": [command for _, command in look.commands],
    }
