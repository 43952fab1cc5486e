"""What would fit, for a step that leaves the zone: a start height when only the height asked for is wrong, else a duration."""

from __future__ import annotations

from dataclasses import replace

from flighttest.plan.clearance import Placement, box, place
from flighttest.plan.fit_zone import FittedCell, Setting, fit_cells, recorded_s

SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2)


def remedy(
    f: FittedCell, setting: Setting, wish_m: tuple[float, float, float], headings_rad: list[float], placement: Placement
) -> str:
    """One sentence for the operator on what to change."""
    assert placement.excess is not None
    if f.cell.waypoints:
        return "move the waypoints inwards, or lower speed_m_s"
    if f.cell.height_m is not None:
        wish = (wish_m[0], wish_m[1], placement.start_m[2])
        free = place(f.nominal, f.lost, setting.clearance, wish, headings_rad)
        if free.excess is None:
            step = f.cell.height_m + free.start_m[2] - placement.start_m[2]
            return f"height_m {step:.1f} would fit"
    fit = _durations(f, setting, wish_m, headings_rad)
    if fit:
        return fit
    # What the flight itself needs, or what it takes to be lost in.
    lost = placement.excess.lost
    clearance = setting.clearance
    low, high = box([*f.nominal, *f.lost] if lost else f.nominal)
    need = high - low
    have = clearance.outer_high - clearance.outer_low if lost else clearance.inner_high - clearance.inner_low
    axis = placement.excess.axis
    if float(have.min()) <= 0.0:
        return "the zone with its margin and height_m leave no space at all: widen one of them"
    words = "with the link lost it needs" if lost else "it needs"
    if axis == 2 and need[2] < have[2]:
        return (
            "no start height suits both the flight and a lost link: make the step smaller, or give the zone more height"
        )
    if axis == 2:
        return f"{words} {need[2]:.1f} m of height where {have[2]:.1f} m are free: make the step smaller"
    return f"{words} {max(need[0], need[1]):.1f} m where {max(have[0], have[1]):.1f} m are free: make the step smaller"


def _durations(f: FittedCell, setting: Setting, wish_m: tuple[float, float, float], headings_rad: list[float]) -> str:
    """The longest shorter duration that fits, as a sentence; empty when none does."""
    wanted = recorded_s(f.cell.lead)
    shorter = []
    for share in SHARES:
        lead = tuple(replace(p, duration_s=round(p.duration_s * share, 1)) if p.record else p for p in f.cell.lead)
        shorter.append(replace(f.cell, lead=lead, shortest_s={}))
    for tried in fit_cells(shorter, setting):
        if (
            tried.complaint
            or place(tried.nominal, tried.lost, setting.clearance, wish_m, headings_rad, f.cell.height_m).excess
        ):
            continue
        return f"{recorded_s(tried.lead):.1f} s instead of {wanted:.1f} s would fit"
    return ""
