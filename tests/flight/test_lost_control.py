"""What controls no tilt, or lies on the ground, is landed: it is never flown to the start of another step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from flighttest.flight import FlightOutcome, FlightProgress, FlightState, LegOutcome
from flighttest.flight.execution import supervisor
from flighttest.flight.execution.landing import ARMED_ON_GROUND, rests_on_ground
from flighttest.flight.gate import Refusal, lost_control
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, is_armed, parser
from flighttest.script.model import Limits
from tests.flight.faulty import GATE, GOOD, LIMITS, FaultyLink, fly, make_leg, make_plan, options

TIPPED_RAD = 1.0


class Tipping(FaultyLink):
    """tips_s: when the vehicle begins to report that it lies on its side, for half a second."""

    tips_s = float("inf")

    def receive(self, timeout_s: float) -> bytes:
        data = super().receive(timeout_s)
        if not self.tips_s <= self.sim.time_s < self.tips_s + 0.5:
            return data
        found = b""
        for message in self._read.parse_buffer(data) or []:
            if message.get_type() == "ATTITUDE":
                message.roll = TIPPED_RAD
            found += bytes(message.pack(self._again))
        return found

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read, self._again = parser(1, 1), parser(1, 1)


def tips_over(link: Tipping) -> None:
    """The vehicle reports that it lies on its side."""
    link.tips_s = link.sim.time_s


def loses_thrust(link: Tipping) -> None:
    """Propellers break: the motors cannot carry the vehicle any more."""
    plant = link.sim.vehicle.plant
    plant.parameters = replace(plant.parameters, K=0.25 * plant.parameters.K)


def at(link: Tipping, word: str, then: Callable[[Tipping], None]) -> list[tuple[float, str, int]]:
    """Let something happen at the first mark of that name, or at the first command of that number; what is sent after it."""
    sent: list[tuple[float, str, int]] = []
    done: list[str] = []

    def look(message: object, t_s: float) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        mode = -1
        if kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_DO_SET_MODE:  # type: ignore[attr-defined]
            mode = int(message.param2)  # type: ignore[attr-defined]
        if done:
            sent.append((t_s, kind, mode))
        here = kind == "STATUSTEXT" and message.text.endswith(f" {word}")  # type: ignore[attr-defined]
        if not done and (here or (kind == "COMMAND_LONG" and str(message.command) == word)):  # type: ignore[attr-defined]
            done.append(kind)
            then(link)

    link.hook = look
    return sent


def modes_of(sent: list[tuple[float, str, int]]) -> set[int]:
    return {mode for _, _, mode in sent if mode >= 0}


class Damaged(FaultyLink):
    """Some frames are damaged and pass the checksum all the same, as one of 65536 damaged ones does. count: how many in a row, after
    `skip` that are whole."""

    count, skip, what = 1, 0, "tilt"

    def receive(self, timeout_s: float) -> bytes:
        found = b""
        for message in self._read.parse_buffer(super().receive(timeout_s)) or []:
            kind = message.get_type()
            if self.began and self.count and kind == ("ATTITUDE" if self.what == "tilt" else "LOCAL_POSITION_NED"):
                self.skip -= 1
                if self.skip < 0:
                    self.count -= 1
                    message.roll, message.z = TIPPED_RAD, -0.1  # each has one of them
            found += bytes(message.pack(self._again))
        return found

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read, self._again, self.began = parser(1, 1), parser(1, 1), False


@pytest.mark.parametrize("what", ["tilt", "height"])
@pytest.mark.parametrize("word", ["step", "end"])
@pytest.mark.parametrize(
    ("count", "skip", "outcome"),
    [
        (1, 0, FlightOutcome.COMPLETED),
        (1, 1, FlightOutcome.COMPLETED),
        (4, 0, FlightOutcome.ABORTED_BY_GATE),
    ],
)
def test_one_damaged_frame_ends_no_flight(
    count: int, skip: int, outcome: FlightOutcome, word: str, what: str, run_dir: Path
) -> None:
    """As one HEARTBEAT ends none. Two in a row do: of ATTITUDE at 100 Hz every second one is looked at."""
    link = Damaged(options())
    link.count, link.skip, link.what = count, skip, what
    at(link, word, lambda there: setattr(there, "began", True))  # type: ignore[arg-type]
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert link.count == 0
    assert result.outcome is outcome, result.sentence


@pytest.mark.parametrize(
    ("now", "before", "lost"), [(1.0, None, True), (1.0, 0.5, False), (0.5, 1.0, False), (1.0, 1.0, True)]
)
def test_two_messages_in_a_row_show_a_lost_control(now: float, before: float | None, lost: bool) -> None:
    """now, before: share of what is lost, of tilt beyond its limit and of height below its own."""
    tilted = replace(GOOD, attitude_rad=(now, 0.0, 0.0), tilt_before_rad=before)
    assert lost_control(tilted, GATE) == ((Refusal.MEASURED_TILT,) if lost else ())
    low = replace(GOOD, height_m=1.5 - now, height_before_m=None if before is None else 1.5 - before)
    assert lost_control(low, GATE) == ((Refusal.ON_GROUND,) if lost else ())


def test_a_tilt_beyond_the_limit_ends_the_flight_with_land(run_dir: Path) -> None:
    link = Tipping(options())
    sent = at(link, "step", tips_over)
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.ABORTED_BY_GATE
    assert [leg.outcome for leg in result.legs] == [LegOutcome.REFUSED]
    assert modes_of(sent) == {CopterMode.BRAKE, CopterMode.LAND}
    assert result.left is FlightState.LANDED


@pytest.mark.parametrize("by", ["guided", "attitude"])
def test_what_has_fallen_is_not_flown_to_the_next_start(by: str, run_dir: Path) -> None:
    """It was asked for GUIDED, and positions 5 m above it were sent to it for 34 s, twice for each step left."""
    link = Tipping(options())
    sent = at(link, "step", loses_thrust)
    legs = (make_leg("a", duration_s=4.0), make_leg("b"), make_leg("c"))
    result = fly(make_plan(*legs, by=by), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.ABORTED_BY_GATE
    assert Refusal.ON_GROUND in result.legs[-1].refused
    assert modes_of(sent) == {CopterMode.BRAKE, CopterMode.LAND}
    assert "SET_POSITION_TARGET_LOCAL_NED" not in {kind for _, kind, _ in sent}
    assert not link.sim.vehicle.armed


@pytest.mark.parametrize(("by", "then"), [("guided", tips_over), ("guided", loses_thrust), ("attitude", tips_over)])
def test_the_way_to_a_start_ends_where_control_is_lost(by: str, then: Callable[[Tipping], None], run_dir: Path) -> None:
    link = Tipping(options())
    lost_s: list[float] = []

    def away(there: Tipping) -> None:
        then(there)
        lost_s.append(there.sim.time_s)

    sent = at(link, "end", away)
    far = replace(make_leg("b"), start_m=(5.0, 0.0, 5.0))
    result = fly(make_plan(make_leg("a"), far, make_leg("c"), by=by), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.ABORTED_BY_GATE
    assert result.left is FlightState.LANDED
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN, LegOutcome.REFUSED]
    assert max(t for t, kind, _ in sent if kind.startswith("SET_")) < lost_s[0] + 10.0
    assert CopterMode.BRAKE not in modes_of(sent), "it would lift what lies on the ground"


def test_a_vehicle_that_tips_over_in_the_climb_is_landed_at_once(run_dir: Path) -> None:
    link = Tipping(options())
    sent = at(link, str(dialect.MAV_CMD_NAV_TAKEOFF), tips_over)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.CLIMB_ENDED
    assert any(Refusal.MEASURED_TILT.value in note for note in result.notes)
    assert modes_of(sent) == {CopterMode.LAND}


class StaysArmed(FaultyLink):
    """A vehicle whose HEARTBEAT shows armed for ever once it has been: it does not notice that it lies on the ground."""

    def receive(self, timeout_s: float) -> bytes:
        found = b""
        for message in self._read.parse_buffer(super().receive(timeout_s)) or []:
            if message.get_type() == "HEARTBEAT":
                self._was |= is_armed(message)
                message.base_mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if self._was else 0
            found += bytes(message.pack(self._again))
        return found

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read, self._again, self._was = parser(1, 1), parser(1, 1), False


@pytest.mark.slow
def test_a_vehicle_that_stays_armed_on_the_ground_is_said_and_how_it_is_disarmed(run_dir: Path) -> None:
    """Seen on a real ArduCopter with a dead motor: two minutes of "landing", then "whether it is down is not known"."""
    link = StaysArmed(options())
    seen: list[FlightProgress] = []
    result = fly(make_plan(), "sim", run_dir, transport=link, on_progress=seen.append)
    assert result.outcome is FlightOutcome.NOT_LANDED
    assert result.left is FlightState.STILL_ARMED
    assert "disarm it with the transmitter" in result.sentence
    down_s = next(p.t_s for p in seen if p.doing == "landing" and p.height_m < 0.1 and p.speed_m_s < 0.1)
    said = [p for p in seen if p.alarm == ARMED_ON_GROUND]
    assert said[0].t_s - down_s < 8.0
    assert len(said) > 0.9 * len([p for p in seen if p.t_s > said[0].t_s]), "it stays on the screen"


@pytest.mark.parametrize("descent_m_s", [0.3, 0.5])
def test_no_vehicle_that_lands_is_said_to_lie_on_the_ground(descent_m_s: float, run_dir: Path) -> None:
    """Down to the slowest descent that ArduCopter's LAND_SPEED allows."""
    seen: list[FlightProgress] = []
    link = FaultyLink(options(parameters={"LAND_SPD_MS": descent_m_s}))
    result = fly(make_plan(), "sim", run_dir, transport=link, on_progress=seen.append)
    assert result.left is FlightState.LANDED
    assert ARMED_ON_GROUND not in {p.alarm for p in seen}


@pytest.mark.parametrize(("climb_m_s", "rests"), [(0.14, True), (-0.16, False), (0.16, False), (None, False)])
def test_what_sinks_does_not_lie_on_the_ground(climb_m_s: float | None, rests: bool) -> None:
    control = SimpleNamespace(gate=GATE)
    assert rests_on_ground(replace(GOOD, height_m=0.1, climb_m_s=climb_m_s), control) is rests  # type: ignore[arg-type]
    assert not rests_on_ground(replace(GOOD, height_m=5.0, climb_m_s=0.0), control)  # type: ignore[arg-type]


@pytest.mark.parametrize(("by_itself", "words"), [(True, "landing: the flight ended early"), (False, "")])
def test_a_landing_that_was_not_planned_is_an_alarm_with_its_cause(by_itself: bool, words: str, run_dir: Path) -> None:
    """A battery at its limit: the vehicle came down without a word until it was down."""
    link = FaultyLink(options())
    seen: list[FlightProgress] = []
    limits = replace(LIMITS, voltage_min_v=30.0 if by_itself else 0.0)
    fly(make_plan(limits=limits), "sim", run_dir, transport=link, on_progress=seen.append, waive=("battery",))
    found = {p.alarm for p in seen if p.alarm}
    assert bool(found) is by_itself
    assert all(text.startswith(words) and "battery" in text for text in found)


@pytest.mark.parametrize(
    ("script_m", "zone_m", "height_m", "lost"),
    [(2.0, 1.0, 0.99, True), (2.0, 1.0, 1.01, False), (0.4, 1.0, 0.49, True), (0.4, 0.4, 0.21, False)],
)
def test_the_ground_ends_halfway_to_the_lowest_height(
    script_m: float, zone_m: float, height_m: float, lost: bool
) -> None:
    limits: Limits = replace(LIMITS, height_m=(script_m, 10.0))
    gate = replace(GATE, limits=limits, zone=replace(GATE.zone, z_m=(zone_m, 10.0)))
    found = lost_control(replace(GOOD, height_m=height_m), gate)
    assert found == ((Refusal.ON_GROUND,) if lost else ())
    assert lost_control(replace(GOOD, height_m=None), gate) == (), "what is not known ends nothing"


@pytest.mark.parametrize(("height_m", "waits"), [(0.1, False), (4.0, True)])
def test_what_moves_on_the_ground_is_not_waited_for_in_brake(height_m: float, waits: bool) -> None:
    """BRAKE holds a height: it would lift what has fallen."""
    state = replace(GOOD, mode=int(CopterMode.BRAKE), height_m=height_m, velocity_m_s=(1.0, 0.0, 0.0))
    cycles: list[float] = []
    session = SimpleNamespace(now_s=lambda: float(len(cycles)))
    control = SimpleNamespace(
        state=state, gate=GATE, session=session, stop_asked=False, cycle=lambda: cycles.append(1.0)
    )
    supervisor.come_to_rest(control)  # type: ignore[arg-type]
    assert bool(cycles) is waits
