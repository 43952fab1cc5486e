"""The page of a recording before anything is fitted: its health, its course, its channels, and what it could determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.channels import CHANNELS, HELD_GROUPS, WORDS
from flighttest.identify.expected_information import Expected
from flighttest.recording import Recording
from flighttest.report.document import (
    Bullets,
    Cell,
    Code,
    Figure,
    Mark,
    PageBlock,
    Panel,
    Paragraph,
    Role,
    Section,
    Table,
    Trace,
    Viewer,
)
from flighttest.report.numbers import duration, number, percent, unit
from flighttest.report.packing import coarse
from flighttest.segments.compatibility import AccelerometerBias, Compatibility
from flighttest.segments.health import FOLLOWED, AtLimit, BatteryCourse, Followed, Sampling, Spectrum

# Standard deviation of vibration: "below 30 m/s/s normally acceptable, above 60 nearly always problems" (ArduPilot, Measuring Vibration).
VIBRATION_M_S2 = 30.0
FIRST = ("roll_ref_rad", "roll_rad", "pitch_ref_rad", "pitch_rad", "r_rad_s", "yaw_rate_ref_rad_s", "throttle", "f_z_m_s2", "a_z_m_s2",
         "v_x_m_s", "v_y_m_s", "v_z_m_s", "height_m", "p_z_m")  # fmt: skip
MOST_STRIPS = 6
AXES: tuple[Role, ...] = ("other", "model", "no_battery")  # colours of forward, left and up
SPECTRUM_POINTS, MAP_POINTS = 600, 3000


@dataclass(frozen=True)
class ParameterOutlook:
    """expected: of the error of a parameter from this recording no fit is below; excited: whether that is within what a fit calls known;
    fly, why: the maneuver that would excite it and what is missing, empty where it is excited."""

    expected: Expected
    excited: bool
    fly: str = ""
    why: str = ""


@dataclass(frozen=True)
class Look:
    """All that the page shows."""

    recording: Recording
    sampling: tuple[Sampling, ...]
    limits: tuple[AtLimit, ...]
    followed: tuple[Followed, ...]
    spectra: tuple[Spectrum, ...]
    compatibility: Compatibility | None
    battery: BatteryCourse | None
    resistance: str
    modes: tuple[tuple[float, float, str], ...]
    flights: tuple[tuple[float, float], ...]
    figures: tuple[tuple[str, str], ...]  # hover throttle, highest speed and the like: name and value
    outlook: tuple[ParameterOutlook, ...]
    outlook_why: str
    commands: tuple[tuple[str, str], ...]  # what for, and the command


def sections(look: Look) -> tuple[Section, ...]:
    """In the order of the page."""
    found = [viewer(look), what(look), timeline(look), track(look), health(look), spectrum(look), next_steps(look)]
    return tuple(section for section in found if section is not None)


def word(name: str) -> str:
    """What people call a channel."""
    return WORDS.get(
        name, name.rsplit("_ref_", 1)[0].replace("_", " ") + " command" if "_ref_" in name else _plain(name)
    )


def _plain(name: str) -> str:
    ends = ("_m_s2", "_rad_s", "_m_s", "_rad", "_m", "_v", "_a")
    end = next((e for e in ends if name.endswith(e)), "")
    short = {
        "p": "roll rate",
        "q": "pitch rate",
        "p_x": "position north",
        "p_y": "position west",
        "p_z": "height above origin",
    }
    base = name.removesuffix(end)
    return short.get(base, base.replace("_", " "))


def _strip(name: str) -> str:
    """Channels of one strip: a command beside what answers it, components of one vector together."""
    channel = CHANNELS[name]
    for start in ("roll", "pitch", "yaw", "throttle"):
        if name.startswith(start):
            return "yaw rate" if name.startswith("yaw_rate") else start
    if name == "r_rad_s":
        return "yaw rate"
    if name in ("height_m", "p_z_m"):
        return "height"
    return channel.group + channel.unit


def viewer(look: Look) -> Section:
    """Every channel, the ones that a fit looks at first."""
    groups = {g: (s.t_s, s.columns) for g, s in look.recording.series.items() if len(s) > 1}
    names = [n for _, columns in groups.values() for n in columns]
    shown: list[str] = []
    for name in (n for n in FIRST if n in names):
        if len({_strip(n) for n in (*shown, name)}) <= MOST_STRIPS:
            shown.append(name)
    words = {n: (word(n), unit(CHANNELS[n].unit) or "1", CHANNELS[n].group in HELD_GROUPS, _strip(n)) for n in names}
    marks = [Mark(a, b, label, "mode") for a, b, label in look.modes]
    marks += [
        Mark(m.t_s, m.t_s, m.label, m.kind)
        for m in look.recording.markers
        if m.kind in ("leg", "note", "abort", "take_over")
    ]
    caption = (
        "Click a name to add or remove a channel; drag across to zoom all of them, double click for the whole flight. Shaded: modes; "
        "dotted lines: marks. Held commands are dotted."
    )
    shown_marks = tuple(marks[:400])
    return Section(
        "channels", "Channels", (Viewer("channels", groups, words, shown_marks, tuple(shown or names[:3]), caption),)
    )


def excitation_sentence(outlook: Sequence[ParameterOutlook]) -> str:
    """How many parameters the recording excites, and what that means."""
    excited = sum(one.excited for one in outlook)
    every = f"all {len(outlook)}" if excited == len(outlook) else f"{excited or 'none'} of {len(outlook)}"
    more = "" if excited == 0 else "; which of them a fit determines depends on how well the model follows the vehicle"
    return f"What was flown excites {every} parameters{more}."


def what(look: Look) -> Section:
    """What each parameter's error would be at least, and what this recording holds no information on."""
    blocks: list[PageBlock] = []
    if look.outlook:
        rows = []
        for one in look.outlook:
            e = one.expected
            share = e.std / abs(e.value) if e.std is not None and e.value else None
            state = Cell("yes", "good") if one.excited else Cell("no", "bad" if e.std is None else "warn")
            least = "-" if e.std is None else number(e.std, 2)
            rows.append((e.name, least, unit(e.unit), percent(share, 1), str(e.responses), state, one.fly))
        blocks.append(
            Table(
                ("parameter", "least error", "unit", "of its value", "responses", "excited", "fly"), tuple(rows),
                ("left", "right", "left", "right", "right", "left", "left"),
                "Excited: by three responses or more, and to within what a fit calls known. Least error: the lower bound of Cramér and Rao "
                "from the sensitivities of the responses at nominal parameters, with the noise of a usual outdoor vehicle. A fit has larger"
                " errors where repeats differ or the model lacks something.",
            )
        )  # fmt: skip
    if look.outlook_why:
        blocks.append(Paragraph(look.outlook_why, "warn"))
    return Section("identify", "What can be identified from it", tuple(blocks))


def timeline(look: Look) -> Section | None:
    """Flights and modes with their times."""
    blocks: list[PageBlock] = []
    start = look.recording.t_span_s[0]
    totals: dict[str, list[float]] = {}
    for a, b, name in look.modes:
        totals.setdefault(name, []).append(b - a)
    if len(look.flights) > 1:
        words = tuple(
            f"flight {i}: {duration(a - start)} to {duration(b - start)}" for i, (a, b) in enumerate(look.flights, 1)
        )
        blocks.append(Bullets(words))
    if totals:
        rows = tuple((name, duration(sum(spans)), str(len(spans))) for name, spans in totals.items())
        blocks.append(Table(("mode", "time in it", "entered"), rows, ("left", "right", "right")))
    marks = [m for m in look.recording.markers if m.kind != "mode"]
    if marks:
        rows_of = tuple((f"{m.t_s - start:.1f}", m.kind, m.label) for m in marks)
        blocks.append(
            Table(
                ("t s", "kind", "mark"),
                rows_of,
                ("right", "left", "left"),
                "Marks of the recording.",
                fold=len(marks) > 8,
            )
        )
    return Section("timeline", "Timeline", tuple(blocks)) if blocks else None


def track(look: Look) -> Section | None:
    """The path over the ground with its height, None without positions."""
    recording = look.recording
    if not recording.has("p_x_m", "p_y_m"):
        return None
    t, north = recording.channel("p_x_m")
    west = recording.channel("p_y_m")[1]
    name = "p_z_m" if recording.has("p_z_m") else "height_m" if recording.has("height_m") else ""
    high = np.zeros(t.size)
    if name:
        th, zh = recording.channel(name)
        known = np.isfinite(zh)
        high = np.interp(t, th[known], zh[known])
    keep = np.isfinite(north) & np.isfinite(west)
    every = max(1, -(-int(keep.sum()) // MAP_POINTS))
    east, north, high, t = -west[keep][::every], north[keep][::every], high[keep][::every], t[keep][::every]
    above = Panel(
        "Seen from above",
        "east, m",
        "north, m",
        (Trace(east, north, "height, m", "model", "track", z=high),),
        equal=True,
    )
    tall = coarse(t, high, SPECTRUM_POINTS)
    over = Panel("Height over time", "time, s", "height, m", (Trace(*tall, "height", "model"),))
    caption = "The path over the ground, coloured by height; the same height over time."
    return Section("map", "Map", (Figure("map", (above, over), caption, 2, 380),))


def health(look: Look) -> Section:
    """Rates and gaps, clock, limits, battery."""
    rows = tuple(
        (
            s.group.replace("_", " "), f"{number(s.rate_hz, 3)}", str(s.samples), str(s.gaps) if s.gaps else "-",
            Cell(f"{s.longest_s:.2f}" if s.gaps else "-", "warn" if s.gaps else "plain"),
            Cell(percent(s.lost) if s.gaps else "-", "bad" if s.lost > 0.02 else "plain"), percent(s.jitter, 0),
            Cell(percent(s.missing, 0), "warn") if s.missing > 0.005 else "-", ", ".join(s.channels),
        )
        for s in look.sampling
    )  # fmt: skip
    table = Table(
        ("group", "rate Hz", "samples", "gaps", "longest s", "lost", "jitter", "missing", "channels"), rows,
        ("left", *("right",) * 7, "left"),
        "Gaps: more than five usual intervals. Lost: of the time. Jitter: standard deviation of the other intervals. Missing: of "
        "the samples.",
        detail=(8,),
    )  # fmt: skip
    lines: list[str] = []
    clock = look.recording.provenance.clock
    if clock.get("error_s") is not None:
        how = str(clock.get("method", "")) or "its own"
        lines.append(f"clock: {how}, error {float(clock['error_s']) * 1000:.2g} ms")
    if look.compatibility is not None:
        lines += [_compatible(look.compatibility), _biased(look.compatibility.bias)]
    for one in look.limits:
        lines.append(
            f"{word(one.channel)} is at {number(one.limit, 3)} {unit(CHANNELS[one.channel].unit)}".rstrip()
            + f" for {percent(one.share)} of the flight, at the longest {number(one.longest_s, 2)} s from {one.at_s:.1f} s on"
        )
    if not look.limits:
        lines.append("no command and no sensor stays at a limit in flight")
    lines += [_not_followed(one) for one in look.followed if one.correlation < FOLLOWED]
    b = look.battery
    if b is None:
        lines.append("battery: no voltage was recorded")
    else:
        drawn = f", {number(b.drawn_ah, 3)} Ah drawn, at most {number(b.most_a, 3)} A" if b.drawn_ah else ""
        lines.append(
            f"battery: {number(b.first_v, 4)} V at take-off, {number(b.last_v, 4)} V at landing, lowest {number(b.lowest_v, 4)} V{drawn}"
        )
        lines.append(look.resistance)
    blocks: list[PageBlock] = [table, Bullets(tuple(line for line in lines if line))]
    source = look.recording.provenance
    if source.losses:
        blocks.append(Bullets(tuple(source.losses)))
    if source.derived:
        blocks.append(Bullets(tuple(f"{name}: {how}" for name, how in source.derived.items())))
    return Section("health", "Health of the recording", tuple(blocks))


def _not_followed(one: Followed) -> str:
    """What is said of a channel that does not do what was asked for."""
    when = f"{number(one.delay_s, 2)} s later, over {number(one.span_s, 2)} s of flight"
    return (
        f"{word(one.channel)} follows its command with a correlation of {one.correlation:.2f} at best ({when}), a sound vehicle with more "
        "than 0.95: before a fit look at both in the plot of channels (a motor at its limit or damaged, gusts, or a command that the "
        "autopilot shapes before it acts)"
    )


def _compatible(found: Compatibility) -> str:
    """What kinematics shows of stamps and scale."""

    def late(value_s: float, std_s: float) -> str:
        return f"{number(1000 * abs(value_s), 2)} ± {number(2000 * std_s, 1)} ms {'late' if value_s > 0 else 'early'}"

    far = found.velocity_has_latency
    done = "too much for time stamps, and left as it is" if far else "corrected before anything is fitted"
    if not found.determined:
        done = "what was flown does not determine the stamps, and nothing is corrected"
    return (
        f"compatibility with the attitude by kinematics: velocity {late(found.velocity_late_s, found.velocity_late_std_s)} and "
        f"{number(100 * abs(found.velocity_scale), 2)} ± {number(200 * found.velocity_scale_std, 1)} % too "
        f"{'large' if found.velocity_scale > 0 else 'small'}, accelerometer {late(found.force_late_s, found.force_late_std_s)}; {done}"
    )


def _biased(bias: AccelerometerBias | None) -> str:
    """The accelerometer's bias, with 95 % intervals."""
    if bias is None:
        return ""
    std = [bias.covariance[k][k] ** 0.5 for k in range(3)]
    each = (f"{number(b, 2)} ± {number(2 * s, 1)}" for b, s in zip(bias.value_m_s2, std, strict=True))
    return f"accelerometer bias by kinematics, forward, left and up: {', '.join(each)} m/s²"


def spectrum(look: Look) -> Section | None:
    """Spectra of vibration, accelerometer and gyro apart."""
    panels = []
    for title, label, ends in (
        ("Specific force", "density, (m/s²)²/Hz", "_m_s2"),
        ("Angular rate", "density, (rad/s)²/Hz", "_rad_s"),
    ):
        traces: list[Trace] = []
        for s in (one for one in look.spectra if one.channel.endswith(ends)):
            step = max(1, -(-s.frequency_hz.size // SPECTRUM_POINTS))
            role = AXES[len(traces) % len(AXES)]
            traces.append(
                Trace(s.frequency_hz[::step], s.density[::step], word(s.channel), role, group=word(s.channel))
            )
        if traces:
            panels.append(Panel(title, "frequency, Hz", label, tuple(traces), log="xy"))
    if not panels:
        return None
    rows = tuple(
        (
            word(s.channel), number(s.rms, 2), unit(CHANNELS[s.channel].unit),
            "-" if s.peak_hz is None else number(s.peak_hz, 3), number(float(s.frequency_hz[-1]), 3),
        )
        for s in look.spectra
    )  # fmt: skip
    forces = [s.rms for s in look.spectra if s.channel.startswith("f_") and np.isfinite(s.rms)]
    blocks: list[PageBlock] = [
        Figure(
            "spectrum",
            tuple(panels),
            "Power spectral density in flight, over the longest stretch without a gap (Welch 1967).",
            2,
            320,
        ),
        Table(
            ("channel", "rms above 5 Hz", "unit", "strongest Hz", "seen to Hz"),
            rows,
            ("left", "right", "left", "right", "right"),
        ),
    ]
    if forces and max(forces) > VIBRATION_M_S2:
        blocks.append(
            Paragraph(
                "Above 30 m/s² vibration disturbs an autopilot's estimates (ArduPilot, Measuring Vibration).", "bad"
            )
        )
    blocks.append(
        Paragraph(
            "Vibration above half the recorded rate is folded below it and cannot be distinguished here.", "quiet"
        )
    )
    return Section("vibration", "Vibration", tuple(blocks))


def next_steps(look: Look) -> Section:
    """What to do with it now."""
    blocks: Sequence[PageBlock] = [Code(command, what_for) for what_for, command in look.commands]
    return Section("next", "Go on", tuple(blocks))
