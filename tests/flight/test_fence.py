"""The fence polygon along the zone: uploaded, read back, taken away; a fence that the vehicle keeps is never lost."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import LinkError, PreflightError
from flighttest.flight import FlightOutcome, FlightState
from flighttest.flight.preparation.fence import (
    FenceSet,
    ZoneFence,
    corners_e7,
    fence_data,
    fence_set,
    inset_m,
    lies_along,
)
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.onboard.fence import Fence, FenceItem, polygon, same_fence
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.pipeline.store.resuming import fence_behind
from flighttest.plan import Plan
from flighttest.recording.store import read_manifest
from flighttest.vehicle.model import Zone
from tests.flight.faulty import GOOD, FaultyLink, fly, make_plan, options

HOME_E7 = (-353632621, 1491652374)
ORIGIN = dialect.MAVLink_gps_global_origin_message(*HOME_E7, 584090, 0)
ZONE = Zone(heading_rad=math.radians(-40.0), fence="polygon")
OWN = (
    FenceItem(dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 0, (5.0, 0.0, 0.0, 0.0), HOME_E7[0] + 3000, HOME_E7[1]),
    *polygon([(HOME_E7[0] + dx * 10000, HOME_E7[1] + dy * 10000) for dx, dy in ((1, 1), (1, -1), (-1, -1), (-1, 1))]),
)
"""As an operator draws one: a tree in it, and a field of 220 m about home."""


def with_zone(plan: Plan, zone: Zone = ZONE) -> Plan:
    return replace(plan, vehicle=replace(plan.vehicle, zone=zone))


def hand_over(link: FaultyLink, items: Sequence[FenceItem]) -> None:
    """The fence of another station, aboard before the flight."""
    other = parser(255, 190)
    kind = dialect.MAV_MISSION_TYPE_FENCE
    link.sim.send(bytes(dialect.MAVLink_mission_count_message(1, 1, len(items), kind).pack(other)))
    for k, i in enumerate(items):
        fields = (1, 1, k, i.frame, i.command, 0, 1, *i.params, i.x, i.y, i.z, kind)
        link.sim.send(bytes(dialect.MAVLink_mission_item_int_message(*fields).pack(other)))
    assert len(aboard(link)) == len(items)


def aboard(link: FaultyLink) -> tuple[FenceItem, ...]:
    kept = link.sim.vehicle.fence._items
    return tuple(FenceItem(m.command, m.frame, (m.param1, 0.0, 0.0, 0.0), m.x, m.y) for m in kept)


def in_flight(link: FaultyLink) -> list[tuple[FenceItem, ...]]:
    """The fence aboard at each step, filled while flying."""
    found: list[tuple[FenceItem, ...]] = []

    def hook(message: object, _t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            found.append(aboard(link))

    link.hook = hook
    return found


def test_the_polygon_lies_along_the_zone() -> None:
    """By hand: a zone of 30 by 15 m whose x axis points to 040; its left far corner is 16.31 m north and 3.90 m east."""
    north_east = corners_e7(with_zone(make_plan()), (0.0, 0.0, 0.0), ORIGIN)[0]
    m_per_e7 = math.radians(1e-7) * 6378100.0
    assert (north_east[0] - HOME_E7[0]) * m_per_e7 == pytest.approx(16.31, abs=0.02)
    east_m = (north_east[1] - HOME_E7[1]) * m_per_e7 * math.cos(math.radians(-35.3632621))
    assert east_m == pytest.approx(3.90, abs=0.02)
    inner = corners_e7(with_zone(replace(make_plan(), fenced=2)), (0.0, 0.0, 0.0), ORIGIN)
    assert inset_m(with_zone(replace(make_plan(), fenced=2))) == ZONE.margin_m
    assert abs(inner[0][0] - HOME_E7[0]) < abs(north_east[0] - HOME_E7[0])


@pytest.mark.parametrize(
    ("change", "along"),
    [
        (lambda c: c[2:] + c[:2], True),
        (lambda c: c[::-1], True),
        (lambda c: [(c[0][0] + 40, c[0][1]), *c[1:]], True),  # 0.4 m
        (lambda c: [(c[0][0] + 60, c[0][1]), *c[1:]], False),
        (lambda c: c[:3], False),
    ],
)
def test_a_polygon_that_is_there_already(change, along: bool) -> None:  # type: ignore[no-untyped-def]
    corners = corners_e7(with_zone(make_plan()), (0.0, 0.0, 0.0), ORIGIN)
    assert lies_along((OWN[0], *polygon(change(corners))), corners) is along


@pytest.mark.slow
@pytest.mark.parametrize(("fence", "follows"), [("polygon", False), ("circle", True)])
def test_the_zone_stays_along_its_polygon_when_home_moves_at_arming(
    fence: str, follows: bool, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = ArduPilot.home_m

    def moved(vehicle: ArduPilot):  # type: ignore[no-untyped-def]
        home = stated(vehicle)
        return home if home is None or not vehicle.armed else home + np.array([0.4, -0.3, 1.5])

    monkeypatch.setattr(ArduPilot, "home_m", moved)
    link = FaultyLink(options())
    fly(with_zone(make_plan(), replace(ZONE, fence=fence)), "sim", run_dir, transport=link)
    origin_m = read_manifest(run_dir)["zone_origin_local_m"]
    assert origin_m == pytest.approx([0.4, -0.3, 1.5] if follows else [0.0, 0.0, 1.5], abs=0.02)


def test_it_is_uploaded_for_the_flight_and_taken_away(run_dir: Path) -> None:
    link = FaultyLink(options())
    seen = in_flight(link)
    result = fly(with_zone(make_plan()), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [len(items) for items in seen] == [4]
    assert aboard(link) == ()
    record = read_manifest(run_dir)["fence_set"]
    assert record["left"] is False
    assert len(record["given"]) == 4
    assert any("read back" in note for note in result.notes)
    assert link.sim.vehicle.store["FENCE_ENABLE"] == 0.0


def test_a_fence_of_the_vehicles_own_is_left_alone_unless_asked(run_dir: Path) -> None:
    link = FaultyLink(options())
    hand_over(link, OWN)
    with pytest.raises(PreflightError, match="a fence of its own"):
        fly(with_zone(make_plan()), "sim", run_dir, transport=link)
    assert same_fence(aboard(link), OWN)


def test_it_is_added_to_the_vehicles_own_where_asked(run_dir: Path) -> None:
    link = FaultyLink(options())
    hand_over(link, OWN)
    seen = in_flight(link)
    result = fly(with_zone(make_plan()), "sim", run_dir, transport=link, extend_fence=True)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [(same_fence(items[:5], OWN), len(items)) for items in seen] == [(True, 9)]
    assert same_fence(aboard(link), OWN)


@pytest.mark.slow
def test_frames_lost_of_the_transfer(run_dir: Path) -> None:
    """Each kind of the vehicle's questions and answers: the first, the third and the sixth are lost."""
    link = FaultyLink(options())
    count: dict[str, int] = {}

    def lost(kind: str, _t_s: float) -> bool:
        if not kind.startswith("MISSION_"):
            return False
        count[kind] = count.get(kind, 0) + 1
        return count[kind] in (1, 3, 6)

    link.silenced = lost
    seen = in_flight(link)
    assert fly(with_zone(make_plan()), "sim", run_dir, transport=link).outcome is FlightOutcome.COMPLETED
    assert [len(items) for items in seen] == [4]
    assert aboard(link) == ()
    assert {"MISSION_COUNT", "MISSION_REQUEST", "MISSION_ITEM_INT", "MISSION_ACK"} <= count.keys()


def test_a_vehicle_that_crosses_it_is_braked(run_dir: Path) -> None:
    """The gate looks ahead to a farther zone here, so that it is the autopilot's fence that acts."""
    link = FaultyLink(options(parameters={"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0, "FENCE_ACTION": 4.0}))
    half_e7 = round(0.4 / 0.0111319)
    corners = [
        (HOME_E7[0] + dx * half_e7, HOME_E7[1] + dy * half_e7) for dx, dy in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    ]
    hand_over(link, polygon(corners))
    alarms: list[str] = []
    result = fly(make_plan(), "sim", run_dir, transport=link, on_progress=lambda p: alarms.append(p.alarm))
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert link.sim.vehicle.mode == CopterMode.BRAKE
    assert 'the mode became BRAKE after the vehicle\'s message "Polygon fence breached"' in result.notes, (
        "the answer names the fence"
    )
    assert result.sentence.endswith("in BRAKE, which holds it in the air until the mode switch is moved")
    assert any(a.startswith('in BRAKE (after the vehicle\'s message "Polygon fence breached")') for a in alarms)
    assert any("Polygon fence breached" in line for line in (run_dir / "events.jsonl").read_text().splitlines())


def test_a_kind_of_fence_that_was_set_is_in_force(run_dir: Path) -> None:
    """FENCE_ENABLE is 1 already, without the polygon's bit: as Copter 4.6 and newer, the vehicle goes on with the kinds it had."""
    link = FaultyLink(options(parameters={"FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0, "FENCE_ACTION": 4.0}))
    in_force: list[int] = []

    def hook(message: object, _t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            in_force.append(link.sim.vehicle.fence.in_force)

    link.hook = hook
    assert fly(with_zone(make_plan()), "sim", run_dir, transport=link).outcome is FlightOutcome.COMPLETED
    assert in_force == [7]
    assert link.sim.vehicle.fence.in_force == 3


def test_a_program_that_died_left_it(run_dir: Path) -> None:
    """The next flight takes it away, by a record of this vehicle whose fence is still as it was given."""
    corners = corners_e7(with_zone(make_plan()), (0.0, 0.0, 0.0), ORIGIN)
    behind = FenceSet(OWN, (*OWN, *polygon(corners)))
    link = FaultyLink(options())
    hand_over(link, behind.given)
    result = fly(make_plan(), "sim", run_dir, transport=link, fence_behind=behind)
    assert result.outcome is FlightOutcome.COMPLETED
    assert same_fence(aboard(link), OWN)
    assert any("left its fence polygon" in note for note in result.notes)


def test_a_fence_that_was_drawn_since_is_left_alone(run_dir: Path) -> None:
    behind = FenceSet((), polygon(corners_e7(with_zone(make_plan()), (0.0, 0.0, 0.0), ORIGIN)))
    link = FaultyLink(options())
    hand_over(link, OWN)
    fly(make_plan(), "sim", run_dir, transport=link, fence_behind=behind)
    assert same_fence(aboard(link), OWN)
    assert fence_behind(run_dir.parent, "paper") is None, "it is not taken away from a later flight, either"


def test_a_record_that_is_none() -> None:
    """Of another run, not left, or with an item that is no fence's: a manifest is a file, and anybody may have written it."""
    good = fence_data("run", FenceSet(OWN, (*OWN, *OWN)), left=True)
    assert fence_set(good, "run") == FenceSet(OWN, (*OWN, *OWN))
    assert fence_set(good, "other") is None
    assert fence_set(good | {"left": False}, "run") is None
    for row in (
        [16, 0, 0, 0, 0, 0, 0, 0, 0],
        [5001, 0, 4],
        [5001, 0, math.nan, 0, 0, 0, 0, 0, 0],
        "x",
        [5001] * 9,
        ["a"] * 9,
    ):
        assert fence_set(good | {"before": [row]}, "run") is None, row  # type: ignore[list-item]
    assert fence_set({"run": "run", "left": True, "before": 5, "given": []}, "run") is None  # type: ignore[typeddict-item]


def test_a_vehicle_in_the_air_keeps_it(run_dir: Path) -> None:
    """Ctrl-C twice: the vehicle is left in BRAKE, and keeps its fence."""
    link = FaultyLink(options())
    presses: list[int] = []
    in_flight(link)
    before = link.hook
    assert before is not None

    def press(message: object, t_s: float) -> None:
        before(message, t_s)
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            presses.append(2)

    link.hook = press
    result = fly(
        with_zone(make_plan()), "sim", run_dir, transport=link, stop_requested=lambda: presses[-1] if presses else 0
    )
    assert result.left is FlightState.IN_ABORT_MODE
    assert len(aboard(link)) == 4
    assert read_manifest(run_dir)["fence_set"]["left"] is True
    assert any("left on the vehicle" in note for note in result.notes)


def test_a_real_vehicle_without_set_params_is_given_the_remedy(run_dir: Path) -> None:
    link = FaultyLink(options())
    session = Session(MavlinkPort(link))
    session.connect()
    link.sim.advance(5.0)
    fence = ZoneFence(ArduPilot(session), "run", lambda _data: None)
    state = replace(GOOD, position_m=(0.0, 0.0, 0.0))
    with pytest.raises(PreflightError, match="is not on the vehicle"):
        fence.put(with_zone(make_plan()), state, (0.0, 0.0, 0.0), may_set=False, extend=False)
    far = replace(GOOD, position_m=(30.0, 0.0, 0.0))
    with pytest.raises(PreflightError, match="stands outside"):
        fence.put(with_zone(make_plan()), far, (0.0, 0.0, 0.0), may_set=True, extend=False)


def test_a_vehicle_that_refuses_the_fence_is_quoted() -> None:
    link = FaultyLink(options())
    session = Session(MavlinkPort(link))
    session.connect()
    broken = [replace(item, params=(5.0, 0.0, 0.0, 0.0)) for item in polygon([HOME_E7] * 4)]
    with pytest.raises(LinkError, match="MAV_MISSION_ERROR"):
        Fence(session).write(broken)
    assert Fence(session).read() == ()
