"""The quick part of the table of faults and states; the whole is `make faults`."""

from pathlib import Path

import pytest

from flighttest.flight import LegOutcome
from flighttest.sim import SimOptions
from tests.faults.cells import CHANGES, FAULTS, QUICK, fly_cell
from tests.faults.changes import PROVOKED
from tests.faults.defects import DEFECTS, Defect
from tests.faults.interrupts import measure
from tests.faults.proxy import Fault, Proxy, When
from tests.flight.faulty import fly, make_leg, make_plan

BY_NAME = {fault.name: fault for fault in FAULTS}


@pytest.mark.parametrize(("name", "when"), QUICK, ids=[f"{name}, {when.value}" for name, when in QUICK])
def test_a_fault_in_a_state(name: str, when: When, tmp_path: Path) -> None:
    cell = fly_cell(BY_NAME[name], when, tmp_path / "run")
    assert cell.ok, f"{cell.ended}: {cell.wrong}"


def test_the_page_has_every_fault_and_none_is_wrong(repository: Path) -> None:
    text = (repository / "docs" / "faults.md").read_text(encoding="utf-8")
    rows = {line.split("|")[1].strip() for line in text.splitlines() if line.startswith("|")}
    assert not {fault.name for fault in FAULTS} - rows, "run `make faults`"
    assert "**wrong:**" not in text


def test_the_page_has_a_flight_for_every_change_of_state(repository: Path) -> None:
    text = (repository / "docs" / "faults.md").read_text(encoding="utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith("Not in them"))
    no_cell_makes = set(line.rpartition(":")[2].strip(" .").split(", "))
    rows = {tuple(cell.strip() for cell in line.split("|")[1:3]) for line in text.splitlines() if line.startswith("|")}
    flown = {" ".join(row) for row in rows}
    assert not {f"{state.name} {event.name}" for state, event in CHANGES} & no_cell_makes - flown
    assert not {f"{p.state.name} {p.event.name}" for p in PROVOKED} - flown, "run `make faults-changes`"


@pytest.mark.parametrize("name", ["ARMING REBOOTED", "CLIMBING OVER", "OFFERED REBOOTED"])
def test_a_change_of_state_that_no_cell_makes(name: str) -> None:
    """Some that cost little; all of them by `make faults`."""
    (provoked,) = (p for p in PROVOKED if f"{p.state.name} {p.event.name}" == name)
    cell = provoked.fly()
    assert cell.ok, f"{cell.ended}: {cell.wrong}"


@pytest.mark.slow
def test_ctrl_c_is_answered_at_a_terminal() -> None:
    """In the state that takes least to reach; all of them by `make faults-interrupts`."""
    (found,) = measure(("connecting to fetch a log",))
    assert found.ok, found
    assert found.code == 1


def test_two_vehicles_of_one_system_id_are_refused_before_one_arms(tmp_path: Path) -> None:
    cell = fly_cell(Fault("twin", 1e6, twin=True), When.CONNECTING, tmp_path / "run")
    assert cell.ok
    assert cell.ended.startswith("REFUSED")
    assert "other vehicles on this link (system 1)" in cell.ended


def test_the_tool_sees_a_vehicle_that_is_called_landed_in_the_air(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A check of the check: a flight that takes LAND for the landing."""
    from flighttest.flight.execution.machine import TABLE, Event, FlightState, Next

    monkeypatch.setitem(TABLE, (FlightState.ASKING, Event.LANDS), Next(FlightState.LANDED))
    cell = fly_cell(BY_NAME["nothing"], When.LANDING, tmp_path / "run")
    assert not cell.ok


def test_a_second_vehicle_heard_in_flight_costs_a_step_and_not_all_of_its_kind(tmp_path: Path) -> None:
    """Its HEARTBEAT shows another mode, and disarmed: what one frame shows is no fault of the step."""
    proxy = Proxy(
        SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0), Fault("twin", 2.0, twin=True), When.FLYING, after_s=0.05
    )
    plan = make_plan(*(make_leg(f"s{k}") for k in range(6)))
    result = fly(plan, "proxy", tmp_path / "run", transport=proxy, clock=proxy.clock())
    flown = [leg.leg for leg in result.legs if leg.outcome is LegOutcome.FLOWN]
    assert (result.outcome.name, result.left.name) == ("COMPLETED", "LANDED")
    assert len(flown) == 6


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
def test_each_defect_that_was_seen_has_its_tests(defect: Defect, repository: Path) -> None:
    """By name, on the page; and what would take its cure out is in the code still."""
    page = (repository / "docs" / "faults.md").read_text(encoding="utf-8")
    for cure in defect.cures:
        assert cure.text in (repository / "flighttest" / cure.file).read_text(encoding="utf-8")
        for test in cure.tests:
            file, _, name = test.partition("::")
            assert not name or f"def {name}(" in (repository / file).read_text(encoding="utf-8")
            assert test.removeprefix("tests/") in page


def test_ctrl_c_while_arming_restores_at_once_what_was_set(tmp_path: Path) -> None:
    """The first HEARTBEAT that showed it disarmed held everything back for good: 90 s of parameters that were not written."""
    cell = fly_cell(BY_NAME["Ctrl-C"], When.ARMING, tmp_path / "run")
    assert cell.ok, f"{cell.ended}: {cell.wrong}"
    assert cell.seconds < 15.0
