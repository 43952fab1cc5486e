"""What a recording is worth before anything is fitted: rates and gaps, limits reached, vibration, battery, flights and modes.

Takes a `Recording`, gives plain records; times are s on the recording's clock. Nothing here is a model, and nothing is repaired.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import HELD_GROUPS
from flighttest.recording import Recording
from flighttest.segments.airborne import flights

FloatArray = NDArray[np.float64]

GAP_TIMES = 5.0  # an interval of so many usual ones is a gap
EQUAL_SAMPLES = 4  # so many equal values at the extreme of a noisy sensor: its limit, not its noise
LEAST_SHARE = 1e-3  # of the flight
SLOW_HZ = 5.0  # motion of the vehicle below, vibration above
LEAST_SAMPLES = 256
WINDOW_S = 4.0  # of the spectrum's averaged pieces: 0.25 Hz apart
SENSORS = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "p_rad_s", "q_rad_s", "r_rad_s")
COMMANDS = ("throttle", "throttle_out")
# A reference, what answers it, and how much of it must be asked for (standard deviation) to stand out from noise: 1 degree, 3 degrees/s.
ANSWERS = (
    ("roll_ref_rad", "roll_rad", 0.0175),
    ("pitch_ref_rad", "pitch_rad", 0.0175),
    ("yaw_rate_ref_rad_s", "r_rad_s", 0.052),
)
# Sound vehicles that are asked for so much have 0.965 to 1.00 (4 logs); after a mechanical failure in flight 0.78, with a firmware of 2014,
# whose log has what the pilot asked for before its own shaping, 0.77 to 0.83.
FOLLOWED = 0.9
LATEST_S = 1.0  # of an answer to its reference
HELD_S = 0.5  # for which a reference stands that no other follows
_GRID_S = 0.02


@dataclass(frozen=True)
class Sampling:
    """How one group of channels was sampled. gaps: intervals above GAP_TIMES usual ones; lost: share of the span inside them; jitter:
    standard deviation of the other intervals, of the usual one; missing: largest share of a channel that is not a number."""

    group: str
    channels: tuple[str, ...]
    rate_hz: float
    samples: int
    gaps: int
    longest_s: float
    longest_at_s: float
    lost: float
    jitter: float
    missing: float


@dataclass(frozen=True)
class AtLimit:
    """A channel at its limit in flight: share of the samples, longest stretch, and when that begins."""

    channel: str
    limit: float
    share: float
    longest_s: float
    at_s: float


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density of one channel in flight (Welch 1967). rms: above SLOW_HZ, in the channel's unit; peak_hz: the strongest
    frequency there, None where the rate shows none."""

    channel: str
    frequency_hz: FloatArray
    density: FloatArray
    rms: float
    peak_hz: float | None


@dataclass(frozen=True)
class BatteryCourse:
    """Voltage at the start and end of flight, the lowest; the largest current and the charge drawn, where a current was recorded."""

    first_v: float
    last_v: float
    lowest_v: float
    most_a: float | None
    drawn_ah: float | None


@dataclass(frozen=True)
class Followed:
    """How a channel follows its reference in flight: their correlation at the delay at which it is largest, over span_s."""

    channel: str
    reference: str
    correlation: float
    delay_s: float
    span_s: float


def sampling(recording: Recording) -> tuple[Sampling, ...]:
    """Of every group with at least two samples."""
    found = []
    for group, series in recording.series.items():
        if len(series) < 2 or group == "state":  # written when it changes
            continue
        steps = np.diff(series.t_s)
        usual = float(np.median(steps))
        gap = steps > GAP_TIMES * usual
        worst = int(np.argmax(steps))
        quiet = steps[~gap]
        found.append(
            Sampling(
                group, tuple(series.columns), 1.0 / usual, len(series), int(gap.sum()), float(steps[worst]),
                float(series.t_s[worst]), float((steps[gap] - usual).sum() / (series.t_s[-1] - series.t_s[0])),
                float(quiet.std() / usual), max((float(np.isnan(v).mean()) for v in series.columns.values()), default=0.0),
            )
        )  # fmt: skip
    return tuple(found)


def in_flight(recording: Recording, t_s: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether each time lies in a flight."""
    inside = np.zeros(t_s.size, dtype=bool)
    for start, end in flights(recording):
        inside |= (t_s >= start) & (t_s <= end)
    return inside


def at_limits(recording: Recording) -> tuple[AtLimit, ...]:
    """Commands at 0 or 1, and sensors that repeat their extreme value, in flight; the worst first."""
    found = []
    for name in (*COMMANDS, *SENSORS):
        if not recording.has(name):
            continue
        t, values = recording.channel(name)
        keep = in_flight(recording, t) & np.isfinite(values)
        t, values = t[keep], values[keep]
        if values.size < EQUAL_SAMPLES:
            continue
        command = name in COMMANDS
        for limit in (0.0, 1.0) if command else (float(values.min()), float(values.max())):
            at = values <= limit if limit == 0.0 and command else values >= limit if command else values == limit
            runs = _runs(at)
            runs = [(a, b) for a, b in runs if command or b - a >= EQUAL_SAMPLES]
            share = sum(b - a for a, b in runs) / values.size
            if share >= LEAST_SHARE and share < 1.0:
                a, b = max(runs, key=lambda run: t[run[1] - 1] - t[run[0]])
                found.append(AtLimit(name, limit, share, float(t[b - 1] - t[a]), float(t[a])))
    return tuple(sorted(found, key=lambda one: -one.share))


def following(recording: Recording) -> tuple[Followed, ...]:
    """Of each attitude or yaw rate whose reference moves enough for it."""
    return tuple(
        f for f in (_followed(recording, *pair) for pair in ANSWERS if recording.has(*pair[:2])) if f is not None
    )


def _followed(recording: Recording, reference: str, channel: str, least: float) -> Followed | None:
    t_ref, ref = recording.channel(reference)
    t_is, values = recording.channel(channel)
    known = np.isfinite(values)
    if known.sum() < 2 or t_ref.size < 2:
        return None
    t = np.arange(max(t_ref[0], t_is[known][0]), min(t_ref[-1], t_is[known][-1]), _GRID_S)
    at = np.searchsorted(t_ref, t, side="right") - 1
    asked, answer = ref[at], np.interp(t, t_is[known], values[known])
    keep = in_flight(recording, t) & np.isfinite(asked) & (t - t_ref[at] <= HELD_S)
    if keep.sum() < LEAST_SAMPLES or asked[keep].std() < least:
        return None
    found = []
    for late in range(round(LATEST_S / _GRID_S) + 1):
        both = keep[: keep.size - late] & keep[late:]
        a, b = asked[: keep.size - late][both], answer[late:][both]
        if a.size >= LEAST_SAMPLES and a.std() > 0.0 and b.std() > 0.0:
            found.append((float(np.corrcoef(a, b)[0, 1]), late * _GRID_S))
    if not found:
        return None
    correlation, delay_s = max(found)
    return Followed(channel, reference, correlation, delay_s, float(keep.sum() * _GRID_S))


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Stretches (first, behind last) where the mask holds."""
    turns = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(turns[::2], turns[1::2], strict=True)]


def spectra(recording: Recording, names: Sequence[str] = SENSORS) -> tuple[Spectrum, ...]:
    """Of sensors, over the longest stretch of flight without a gap; none where that is too short."""
    from scipy.signal import welch  # brings scipy.stats, which a fit need not wait for

    found = []
    for name in names:
        if not recording.has(name):
            continue
        t, values = recording.channel(name)
        keep = in_flight(recording, t) & np.isfinite(values)
        t, values = t[keep], values[keep]
        if t.size < LEAST_SAMPLES:
            continue
        usual = float(np.median(np.diff(t)))
        pieces = np.split(np.arange(t.size), np.flatnonzero(np.diff(t) > GAP_TIMES * usual) + 1)
        longest = max(pieces, key=len)
        if longest.size < LEAST_SAMPLES:
            continue
        even = np.arange(t[longest[0]], t[longest[-1]], usual)
        sampled = np.interp(even, t[longest], values[longest])
        size = min(even.size, max(LEAST_SAMPLES, round(WINDOW_S / usual)))
        f, density = welch(sampled, fs=1.0 / usual, nperseg=size)
        fast = f >= SLOW_HZ
        rms = float(np.sqrt(np.trapezoid(density[fast], f[fast]))) if fast.sum() > 1 else float("nan")
        peak = float(f[fast][np.argmax(density[fast])]) if fast.sum() > 4 else None
        found.append(Spectrum(name, f[1:], density[1:], rms, peak))
    return tuple(found)


def battery_course(recording: Recording) -> BatteryCourse | None:
    """None where no voltage was recorded."""
    if not recording.has("voltage_v"):
        return None
    t, volts = recording.channel("voltage_v")
    keep = in_flight(recording, t) & np.isfinite(volts)
    t, volts = t[keep], volts[keep]
    if volts.size < 2:
        return None
    most = drawn = None
    if recording.has("current_a"):
        amps = np.nan_to_num(recording.channel("current_a")[1][keep])
        most, drawn = float(amps.max()), float(np.trapezoid(amps, t) / 3600.0)
    return BatteryCourse(float(volts[0]), float(volts[-1]), float(volts.min()), most, drawn)


def modes(recording: Recording) -> tuple[tuple[float, float, str], ...]:
    """(start, end, name) of each mode in time order, from the marks of kind mode."""
    marks = [m for m in recording.markers if m.kind == "mode"]
    if not marks:
        return ()
    ends = [*(m.t_s for m in marks[1:]), recording.t_span_s[1]]
    return tuple((m.t_s, end, m.label) for m, end in zip(marks, ends, strict=True) if end > m.t_s)


def held(group: str) -> bool:
    """Whether values of the group hold until the next sample."""
    return group in HELD_GROUPS
