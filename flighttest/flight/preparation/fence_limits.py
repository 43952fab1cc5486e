"""Whether the autopilot's fence brakes at the flight zone, by its parameters."""

from __future__ import annotations

import math

from flighttest.flight.preparation.situation import Check, Situation
from flighttest.plan import CellPlan, Plan

_BRAKE = 4
_ALTITUDE, _CIRCLE, _POLYGON = 1, 2, 4
_UNION = 2  # of FENCE_OPTIONS
_MARGIN_M = 10.0  # between the zone and a fence that is still one for it
_LEAST_M = 30.0  # the smallest circle the firmware is meant for


def fence_checks(s: Situation) -> list[Check]:
    """Whether the autopilot has a fence that brakes at the zone: by its parameters (see `preparation.fence` for a polygon's corners)."""
    zone = s.plan.vehicle.zone
    along = zone.fence == "polygon"
    reach = max(math.ceil(_corner_m(s.plan)) + 1.0, _LEAST_M)
    kinds = int(s.value("FENCE_TYPE") or 0)
    # A circle is about home; one about a zone elsewhere is the pilot's to draw.
    near = _drawn(s) or zone.origin is not None or (s.value("FENCE_RADIUS") or 0.0) <= reach + _MARGIN_M
    around = bool(kinds & _POLYGON) if along else bool(kinds & _CIRCLE or _drawn(s)) and near
    good = (
        int(s.value("FENCE_ENABLE") or 0) == 1
        and kinds & _ALTITUDE
        and around
        and int(s.value("FENCE_ACTION") or 0) == _BRAKE
        and (s.value("FENCE_ALT_MAX") or 0.0) <= zone.z_m[1] + _MARGIN_M
    )
    if along and int(s.value("FENCE_OPTIONS") or 0) & _UNION:
        what = "by FENCE_OPTIONS the inside of any one polygon is enough: the zone's would not hold beside others"
        return [Check("fence", what, f"set FENCE_OPTIONS to {int(s.value('FENCE_OPTIONS') or 0) & ~_UNION}")]
    if good:
        return []
    wanted_fence = {
        "FENCE_ENABLE": 1.0,
        "FENCE_TYPE": float(kinds | _ALTITUDE | (_POLYGON if along else _CIRCLE)),
        "FENCE_ACTION": float(_BRAKE),
        # What the pilot has drawn tighter stays as tight.
        "FENCE_ALT_MAX": min(float(round(zone.z_m[1] + 5.0)), s.value("FENCE_ALT_MAX") or math.inf),
    }
    if not along:
        wanted_fence["FENCE_RADIUS"] = min(reach, s.value("FENCE_RADIUS") or math.inf)
    text = ", ".join(f"{k} {v:g}" for k, v in wanted_fence.items())
    what = "no fence that brakes at the height and distance of the flight zone"
    return [Check("fence", what, f"set {text} (or use --set-params)", wanted_fence)]


def inside_checks(s: Situation) -> list[Check]:
    """Whether the steps themselves leave the fence that will be in force: the vehicle's, with what `fence_checks` asks for. No pilot has to
    fly worse than planned for that. A simulator's fence is left as it is."""
    asked = [] if s.simulator and s.plan.vehicle.zone.fence != "polygon" else fence_checks(s)
    given = {name: value for check in asked for name, value in check.set.items()}
    enabled, kinds, ceiling_m, radius_m = (
        given.get(name, s.value(name)) for name in ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_ALT_MAX", "FENCE_RADIUS")
    )
    if enabled != 1.0 or not s.plan.cells:
        return []
    found, in_force = [], int(kinds or 0)
    high_m, highest = max((c.start_m[2] + c.high_m[2], c.label) for c in s.plan.cells)
    if in_force & _ALTITUDE and ceiling_m is not None and high_m > ceiling_m:
        what = f"FENCE_ALT_MAX is {ceiling_m:g} m, and {highest} gets up to {high_m:.1f} m high"
        found.append(_inside(what, "FENCE_ALT_MAX"))
    far_m, farthest = max((_away_m(c), c.label) for c in s.plan.cells)
    about_home = s.plan.vehicle.zone.origin is None
    if in_force & _CIRCLE and about_home and radius_m is not None and far_m > radius_m:
        what = f"FENCE_RADIUS is {radius_m:g} m, and {farthest} gets {far_m:.1f} m away from home"
        found.append(_inside(what, "FENCE_RADIUS"))
    return found


def _inside(what: str, parameter: str) -> Check:
    remedy = f"raise {parameter} as far as the place allows, or fly a script of smaller steps"
    return Check("fence", f"{what}: there the fence would take the vehicle out of the step", remedy)


def _away_m(cell: CellPlan) -> float:
    """How far from the zone's origin a step gets at least: it touches each side of its envelope, which lies about its start."""
    start_m = math.hypot(*cell.start_m[:2])
    reach_m = max(map(abs, (*cell.low_m[:2], *cell.high_m[:2])))
    return max(start_m, reach_m - start_m)


def _corner_m(plan: Plan) -> float:
    """From the zone's origin to its farthest corner."""
    zone = plan.vehicle.zone
    return math.hypot(max(map(abs, zone.x_m)), max(map(abs, zone.y_m)))


def _drawn(s: Situation) -> bool:
    """Whether there is a polygon: its kind alone, without points, stops nothing. Where it lies is not read."""
    return bool(int(s.value("FENCE_TYPE") or 0) & _POLYGON) and s.value("FENCE_TOTAL") != 0.0


def fence_words(s: Situation) -> str:
    """Where the plan counts on a fence along the zone, and the vehicle's is a circle beyond it: how far; else ''."""
    zone, radius_m = s.plan.vehicle.zone, s.value("FENCE_RADIUS")
    if (
        s.simulator
        or not s.plan.fenced
        or zone.fence == "polygon"
        or _drawn(s)
        or zone.origin is not None
        or radius_m is None
    ):
        return ""
    beyond_m = radius_m - min(map(abs, (*zone.x_m, *zone.y_m)))
    if beyond_m <= 0:
        return ""
    return (
        f"{s.plan.fenced} kinds of steps count on a fence along the zone where the link is lost; the circle of {radius_m:.0f} m lies up to "
        f"{beyond_m:.0f} m beyond it, and so far such a vehicle may get (a polygon fence along the zone keeps it inside)"
    )
