"""The flight while it happens: one line for a log file, a picture for a terminal. Pure functions of the progress."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

from rich.console import RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

ZONE_NEAR_M = 1.0
VOLTAGE_NEAR_V = 0.5
SILENCE_LONG_S = 0.5
UNANSWERED_LONG_S = 1.5  # six questions
LOSS_HIGH = 0.05


class FlightFacts(Protocol):
    """What is shown of a flight in progress (`flight.FlightProgress` has all of it)."""

    leg: int
    legs: int
    doing: str
    next: str
    phase: str
    time_left_s: float
    t_s: float
    zone_margin_m: float
    height_m: float
    speed_m_s: float
    voltage_v: float
    voltage_min_v: float
    link_loss: float
    silence_s: float
    uplink_silence_s: float
    rates_hz: Mapping[str, float]
    mode: str
    stopping: bool
    how_to_stop: str
    alarm: str


def line(facts: FlightFacts) -> str:
    """One plain line: what moves now, margins, time left, what comes next."""
    parts = [f"step {facts.leg}/{facts.legs} {facts.doing}" + (f" ({facts.phase})" if facts.phase else "")]
    if math.isfinite(facts.height_m):
        parts.append(f"{facts.height_m:z.1f} m up")
    if math.isfinite(facts.zone_margin_m):
        parts.append(f"zone {facts.zone_margin_m:.1f} m")
    if math.isfinite(facts.voltage_v):
        parts.append(f"{facts.voltage_v:.1f} V")
    parts.append(_health(facts))
    if math.isfinite(facts.time_left_s):
        parts.append(f"{_clock(facts.time_left_s)} left")
    if facts.next:
        parts.append(f"next {facts.next}")
    return ", ".join(parts)


def _health(facts: FlightFacts) -> str:
    """Both directions of the link: what comes down, and whether what goes up is answered, where either is not well."""
    down = f"link {100 * (1 - facts.link_loss):.0f} %"
    if facts.silence_s > SILENCE_LONG_S:
        down += f", down silent for {facts.silence_s:.0f} s"
    return (
        f"{down}, up unanswered for {facts.uplink_silence_s:.0f} s"
        if facts.uplink_silence_s > UNANSWERED_LONG_S
        else down
    )


def picture(facts: FlightFacts) -> RenderableType:
    """What moves now, what comes next, progress, margins, link, and how to stop."""
    grid = Table.grid(padding=(0, 2), expand=True)
    grid.add_column(style="dim", no_wrap=True, width=9)
    grid.add_column(ratio=1)
    now = Text(facts.doing or "-", style="bold")
    if facts.phase:
        now.append(f"  {facts.phase}", style="cyan")
    grid.add_row("now", now)
    grid.add_row("next", Text(facts.next or "-"))
    bar = Table.grid(padding=(0, 1))
    bar.add_column(width=32)
    bar.add_column(no_wrap=True)
    done = max(facts.leg - 1, 0)
    bar.add_row(
        ProgressBar(total=max(facts.legs, 1), completed=done, width=32),
        f"step {facts.leg} of {facts.legs}"
        + (f", {_clock(facts.time_left_s)} left" if math.isfinite(facts.time_left_s) else ""),
    )
    grid.add_row("flight", bar)
    grid.add_row("clearance", _clearance(facts))
    grid.add_row("battery", _battery(facts))
    grid.add_row("link", _link(facts))
    if facts.alarm:
        grid.add_row("alarm", Text(facts.alarm, style="bold red"))
    grid.add_row("stop", Text(facts.how_to_stop))
    title = f"{'stopping' if facts.stopping else 'flying'}{f' ({facts.mode})' if facts.mode else ''}"
    style = "yellow" if facts.stopping else "cyan"
    return Panel(
        grid,
        title=title,
        title_align="left",
        border_style=style,
        padding=(0, 1),
    )


def _clearance(facts: Any) -> Text:
    text = Text()
    near = math.isfinite(facts.zone_margin_m) and facts.zone_margin_m < ZONE_NEAR_M
    text.append(f"{_number(facts.zone_margin_m)} m to the wall", style="bold red" if near else "green")
    text.append(f"   height {_number(facts.height_m)} m   speed {_number(facts.speed_m_s)} m/s")
    return text


def _battery(facts: Any) -> Text:
    low = (
        math.isfinite(facts.voltage_v)
        and math.isfinite(facts.voltage_min_v)
        and facts.voltage_v < facts.voltage_min_v + VOLTAGE_NEAR_V
    )
    text = Text(f"{_number(facts.voltage_v, 2)} V", style="bold red" if low else "green")
    if math.isfinite(facts.voltage_min_v):
        text.append(f"   lands at {facts.voltage_min_v:.1f} V", style="dim")
    return text


def link_is_bad(facts: Any) -> bool:
    """Whether either direction of the link is not well."""
    return bool(
        facts.link_loss > LOSS_HIGH or facts.silence_s > SILENCE_LONG_S or facts.uplink_silence_s > UNANSWERED_LONG_S
    )


def link_words(facts: Any) -> str:
    """Both directions of the link in words."""
    return _link(facts).plain


def _link(facts: Any) -> Text:
    down_bad = facts.link_loss > LOSS_HIGH or facts.silence_s > SILENCE_LONG_S
    text = Text(f"down {100 * (1 - facts.link_loss):.1f} %", style="bold red" if down_bad else "green")
    if facts.silence_s > SILENCE_LONG_S:
        text.append(f", silent for {facts.silence_s:.1f} s", style="bold red")
    if facts.uplink_silence_s > UNANSWERED_LONG_S:
        text.append(f"   up: no answer for {facts.uplink_silence_s:.1f} s", style="bold red")
    else:
        text.append("   up: answered", style="green")
    fastest = sorted(facts.rates_hz.items(), key=lambda item: -item[1])[:3]
    if fastest:
        text.append("   " + ", ".join(f"{name.lower()} {rate:.0f} Hz" for name, rate in fastest), style="dim")
    return text


def _number(value: float, places: int = 1) -> str:
    return f"{value:z.{places}f}" if math.isfinite(value) else "-"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(round(seconds), 0), 60)
    return f"{minutes}:{rest:02d}"
