"""Pictures of a diagnosis: where (heat map), over what (regimes), and the worst responses before and after."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from flighttest.diagnose.model import channel_words
from flighttest.diagnose.records import DiagnosisData, MapCell, Overlay
from flighttest.report.document import Figure, Panel, Role, Trace
from flighttest.report.numbers import unit
from flighttest.report.sections.fit import KIND_WORDS

MAX_OVERLAYS = 6
_Curve = Literal["measured", "before", "after"]


def heat_map(data: DiagnosisData) -> Figure | None:
    """RMS error in noise floors by kind of step, phase and channel, before and after; one colour scale."""
    cells = [c for c in data.get("residual_map") or () if c.get("phase") != "before"]
    if not cells:
        return None
    channels = list(dict.fromkeys(str(c["channel"]) for c in cells))
    columns = list(dict.fromkeys(_column(c) for c in cells))
    panels, words = [], [channel_words(c) for c in channels]
    for key, title in (("before_floors", "base model"), ("after_floors", "improved model")):
        if key == "after_floors" and not data.get("findings"):
            continue
        worst: dict[tuple[str, str], float] = {}
        for c in cells:
            place = str(c["channel"]), _column(c)
            worst[place] = max(worst.get(place, 0.0), _number(c.get(key)))
        table = [[worst.get((ch, col), float("nan")) for col in columns] for ch in channels]
        panels.append(Panel(title, "", "", (Trace(columns, words, "noise floors", "other", "heat", z=table),)))
    caption = "RMS error in units of the noise floor, the worst step of each kind and phase: noise alone is 1, the worst of many above it."
    return Figure("where", tuple(panels), caption, 2, max(280, 190 + 24 * len(channels)))


def _column(cell: MapCell) -> str:
    kind = KIND_WORDS.get(str(cell.get("kind")), str(cell.get("kind")))
    phase = str(cell.get("phase", ""))
    return kind if phase == "flight" else f"{kind}, {phase}".rstrip(", ")


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def regimes(data: DiagnosisData) -> Figure | None:
    """Mean residual over the variable that explains it, before and after."""
    panels = []
    for curve in data.get("regimes") or ():
        x = np.asarray(curve["x"], dtype=float)
        label = f"{curve.get('label', curve.get('variable'))}, {unit(str(curve.get('variable_unit', '')))}".rstrip(", ")
        traces = [Trace(x, np.asarray(curve["before"], dtype=float), "before", "before")]
        if data.get("findings"):
            traces.append(Trace(x, np.asarray(curve["after"], dtype=float), "after", "after"))
        floor = curve.get("floor")
        if isinstance(floor, int | float):
            for sign in (1.0, -1.0):
                level = np.full(x.size, sign * float(floor))
                traces.append(Trace(x, level, "noise floor", "limit"))
        flown = str(curve.get("maneuver", ""))
        channel = channel_words(str(curve.get("channel")))
        title = f"{channel} in {KIND_WORDS.get(flown, flown.replace('_', ' '))}"
        panels.append(Panel(title, label, f"mean error, {unit(str(curve.get('unit', '')))}", tuple(traces)))
    if not panels:
        return None
    return Figure("regimes", tuple(panels), "Mean error over the variable that explains it best.", 2, 260)


def before_after(data: DiagnosisData) -> Figure | None:
    """The worst responses, in noise floors of their channels: measured, before, and after where something was found."""
    found = bool(data.get("findings"))
    lines: list[tuple[_Curve, str, Role]] = [("before", "before" if found else "simulated", "before")]
    lines += [("after", "after", "after")] if found else []
    lines += [("measured", "measured", "measured")]
    panels = []
    for o in sorted(data.get("overlays") or (), key=lambda o: -_floors(o, data))[:MAX_OVERLAYS]:
        t = np.asarray(o["t_s"], dtype=float)
        traces = tuple(Trace(t, np.asarray(o[key], dtype=float), name, role) for key, name, role in lines)
        units = unit(str(o.get("unit", "")))
        panels.append(Panel(str(o["segment"]), "time, s", f"{channel_words(o['channel'])}, {units}", traces))
    if not panels:
        return None
    caption = "The responses that were worst before." if found else "The responses that fit worst."
    return Figure("before-after", tuple(panels), caption, 2, 270)


def _floors(overlay: Overlay, data: DiagnosisData) -> float:
    """RMS error before, in noise floors of its channel."""
    error = np.asarray(overlay["before"], dtype=float) - np.asarray(overlay["measured"], dtype=float)
    floor = data.get("noise_floor", {}).get(overlay["channel"])
    made = float(np.sqrt(np.nanmean(error**2))) / (_number(floor and floor.get("value")) or float("nan"))
    return made if np.isfinite(made) else 0.0
