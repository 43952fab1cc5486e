"""The fence (geofence) polygon along the flight zone: added to what the vehicle keeps, verified, and taken away again after the flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from flighttest.errors import FlighttestError, PreflightError
from flighttest.flight.outcome import FlightEnded
from flighttest.flight.state import VehicleState
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.onboard.fence import MOST_ITEMS, Fence, FenceItem, polygon, same_fence
from flighttest.mavlink.dialect import Message, dialect
from flighttest.mavlink.telemetry import offset_m, place_deg
from flighttest.plan import Plan
from flighttest.recording.manifest import FenceData

ALONG_M = 0.5  # between the corners of a polygon on the vehicle and the zone's that are taken for one
_KINDS = 1 | 2 | 4  # ceiling, circle, polygon; the floor would be breached on the ground
_ITEM_NUMBERS = 9
_OURS = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION


@dataclass(frozen=True)
class FenceSet:
    """A fence that a flight gave a vehicle. before: what it kept until then; hardware: the autopilot's own number."""

    before: tuple[FenceItem, ...]
    given: tuple[FenceItem, ...]
    hardware: str = ""


def fence_data(run: str, entry: FenceSet, *, left: bool) -> FenceData:
    """For the manifest: without it no later flight puts the fence back. left: whether the vehicle still has it."""
    return {
        "run": run,
        "hardware": entry.hardware,
        "before": [_numbers(item) for item in entry.before],
        "given": [_numbers(item) for item in entry.given],
        "left": left,
    }


def fence_set(data: FenceData, run: str) -> FenceSet | None:
    """The reverse of `fence_data`; None where the record is of another run, of nothing that is left, or no fence."""
    lists = data.get("before"), data.get("given")
    if data.get("run") != run or data.get("left") is not True or not all(isinstance(found, list) for found in lists):
        return None
    before, given = (tuple(map(_from_numbers, found or ())) for found in lists)
    if None in (*before, *given) or max(len(before), len(given)) > MOST_ITEMS:
        return None
    return FenceSet(_items(before), _items(given), str(data.get("hardware", "")))


def _items(found: Sequence[FenceItem | None]) -> tuple[FenceItem, ...]:
    return tuple(item for item in found if item is not None)


def _numbers(item: FenceItem) -> list[float]:
    return [item.command, item.frame, *item.params, item.x, item.y, item.z]


def _from_numbers(row: object) -> FenceItem | None:
    """None where it is no item of a fence: nothing else of a mission is ever written."""
    if not isinstance(row, list) or len(row) != _ITEM_NUMBERS:
        return None
    if not all(isinstance(value, (int, float)) and np.isfinite(value) for value in row):
        return None
    command, frame, *params, x, y, z = row
    fences = dialect.MAV_CMD_NAV_FENCE_RETURN_POINT, dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
    inside = fences[0] <= command <= fences[1] and abs(x) <= 90e7 and abs(y) <= 180e7 and 0 <= frame <= 255
    four = (float(params[0]), float(params[1]), float(params[2]), float(params[3]))
    return FenceItem(int(command), int(frame), four, int(x), int(y), float(z)) if inside else None


def inset_m(plan: Plan) -> float:
    """How far inside the zone's walls the polygon lies, m: at its margin where steps count on it with the link lost, else at the walls."""
    return plan.vehicle.zone.margin_m if plan.fenced else 0.0


def corners_e7(plan: Plan, zone_origin_m: ArrayLike, origin: Message) -> list[tuple[int, int]]:
    """The polygon's corners as latitude and longitude, degE7. zone_origin_m: in the local frame whose origin is a GPS_GLOBAL_ORIGIN."""
    zone, inset = plan.vehicle.zone, inset_m(plan)
    (x0, x1), (y0, y1) = ((low + inset, high - inset) for low, high in (zone.x_m, zone.y_m))
    corners = np.array([[x1, y1, 0.0], [x1, y0, 0.0], [x0, y0, 0.0], [x0, y1, 0.0]])
    places = zone.to_world(corners) + np.asarray(zone_origin_m, dtype=float)
    found = [place_deg(origin.latitude * 1e-7, origin.longitude * 1e-7, float(n), float(w)) for n, w, _ in places]
    return [(round(lat * 1e7), round(lon * 1e7)) for lat, lon in found]


def lies_along(items: Sequence[FenceItem], corners: Sequence[tuple[int, int]]) -> bool:
    """Whether a fence holds a polygon with these corners, begun anywhere and drawn either way, each within ALONG_M."""
    for k in range(len(items) - len(corners) + 1):
        part = items[k : k + len(corners)]
        if any(item.command != _OURS or item.params[0] != len(corners) for item in part):
            continue
        there = [(item.x, item.y) for item in part]
        for turned in (there, there[::-1]):
            if any(
                all(_apart_m(a, b) <= ALONG_M for a, b in zip(turned[i:] + turned[:i], corners, strict=True))
                for i in range(len(turned))
            ):
                return True
    return False


def _apart_m(one: tuple[int, int], other: tuple[int, int]) -> float:
    north, west = offset_m(one[0] * 1e-7, one[1] * 1e-7, other[0] * 1e-7, other[1] * 1e-7)
    return float(np.hypot(north, west))


class ZoneFence:
    """The fence of one flight. keep: called with the manifest's record before anything is written, and whenever it changes."""

    def __init__(self, vehicle: ArduPilot, run: str, keep: Callable[[FenceData], None]) -> None:
        self._vehicle = vehicle
        self._fence = Fence(vehicle.session)
        self._run = run
        self._keep = keep
        self._set: FenceSet | None = None
        self._restores = True

    def inherit(self, behind: FenceSet | None, *, restoring: bool) -> str:
        """What an earlier flight gave this vehicle and did not take back: a sentence, '' where there is nothing. restoring: whether it may
        be put back after this flight."""
        if behind is None:
            return ""
        if behind.hardware != self._vehicle.hardware:
            return "by its record an earlier flight left a fence polygon, but on another autopilot: it is left alone"
        seen = self._fence.read()
        if not same_fence(seen, behind.given):
            self._keep(fence_data(self._run, behind, left=False))
            if same_fence(seen, behind.before):
                return ""
            return "an earlier flight left a fence polygon, but the vehicle keeps another one now: it is left alone"
        self._set, self._restores = behind, restoring
        self._record(left=True)
        after = "it is taken away after this flight" if restoring else "fly with --set-params to have it taken away"
        return f"an earlier flight left its fence polygon on the vehicle: {after}"

    def put(self, plan: Plan, state: VehicleState, origin_m: ArrayLike, *, may_set: bool, extend: bool) -> str:
        """Bring the zone's polygon onto the vehicle and read it back; a sentence for the record.

        state: its position about the zone's origin, which lies at origin_m in the local frame. PreflightError where the vehicle has no
        position or stands outside, and where its fence may not be changed. may_set: the operator lets things be set; extend: also where
        the vehicle keeps a fence of its own.
        """
        origin = self._vehicle.request("GPS_GLOBAL_ORIGIN", dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if state.position_m is None or not state.position_ok or origin is None:
            raise _refused("the zone's polygon cannot be placed without a position", "wait for a satellite fix")
        self._require_inside(plan, state)
        corners = corners_e7(plan, origin_m, origin)
        seen = self._fence.read()
        before = self._set.before if self._set is not None else seen
        if lies_along(before, corners):
            return "the vehicle keeps a fence polygon along the zone: it was read and is used as it is"
        if not may_set:
            raise _refused(
                "the zone needs a fence polygon that is not on the vehicle",
                "use --set-params to have it uploaded for the flight, or draw it with a ground station",
            )
        if before and not extend:
            raise _refused(
                f"the vehicle keeps a fence of its own ({len(before)} items) without the zone's polygon",
                "add the polygon with a ground station, or use --extend-fence: it is added for the flight and taken away afterwards",
            )
        given = (*before, *polygon(corners))
        self._set, self._restores = FenceSet(before, given, self._vehicle.hardware), True
        self._record(left=True)
        self._fence.write(given)
        where = f"{inset_m(plan):g} m inside the zone's walls" if inset_m(plan) else "at the zone's walls"
        kept = f" beside {len(before)} items of the vehicle's own fence" if before else ""
        return f"a fence polygon was uploaded {where}{kept} and read back; it is taken away after the flight"

    def switch_on(self) -> None:
        """Bring the kinds of FENCE_TYPE into force: since Copter 4.6 a change of it alone does not, while FENCE_ENABLE stays 1 (flown).

        PreflightError where the vehicle refuses.
        """
        answer = self._vehicle.command(dialect.MAV_CMD_DO_FENCE_ENABLE, 1.0, float(_KINDS))
        if not answer.accepted:
            raise _refused(
                f"the vehicle does not switch its fence on ({answer.sentence})", "check its fence with a ground station"
            )

    @staticmethod
    def _require_inside(plan: Plan, state: VehicleState) -> None:
        zone, inset = plan.vehicle.zone, inset_m(plan)
        x, y, _ = zone.from_world(state.position_m)  # type: ignore[arg-type]
        for value, (low, high) in ((x, zone.x_m), (y, zone.y_m)):
            if not low + inset < value < high - inset:
                raise _refused("the vehicle stands outside the zone's polygon", "carry it into the zone")

    def restore(self, *, may: bool) -> str:
        """Put the fence back that the vehicle kept, verified; a sentence where it could not be, else ''. may: whether anything may be set
        on the vehicle now: one that is left in the air keeps the zone's."""
        if self._set is None:
            return ""
        if self._restores and may:
            try:
                self._fence.write(self._set.before)
            except FlighttestError as error:
                return (
                    f"the zone's fence polygon is left on the vehicle ({error.message}): the next flight takes it away"
                )
            except FlightEnded as ended:  # a pilot takes over the released vehicle
                return f"the zone's fence polygon may be left on the vehicle: {ended.why or ended.outcome.value}"
            self._record(left=False)
            self._set = None
            return ""
        return "the zone's fence polygon is left on the vehicle: the next flight with --set-params takes it away"

    def _record(self, *, left: bool) -> None:
        assert self._set is not None
        self._keep(fence_data(self._run, self._set, left=left))


def _refused(what: str, remedy: str) -> PreflightError:
    return PreflightError([(f"fence: {what}", remedy)])
