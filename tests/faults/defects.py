"""Defects that were seen on the link once, the tests that guard against each, and what of the code keeps it away.

python -m tests.faults.defects                # takes each cure out in a copy of the project, and sees its tests fail
python -m tests.faults.defects D6 D13         # of these
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEADING = "## Defects seen once, and their tests"
_FOLDERS = ("flighttest", "tests", "maneuvers", "sitl", "docs", "benchmarks", "examples", "pyproject.toml", "README.md")
_CONTROL, _MACHINE = "flight/execution/control.py", "flight/execution/machine.py"


@dataclass(frozen=True)
class Cure:
    """A place of the code (file below flighttest/, its text, what stands there without the cure) and the tests that then fail."""

    file: str
    text: str
    without: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Defect:
    """name: D1 to D19 as reported first, D20 and on as found later; what: as it was seen."""

    name: str
    what: str
    cures: tuple[Cure, ...]


def _one(name: str, what: str, file: str, text: str, without: str, *tests: str) -> Defect:
    return Defect(name, what, (Cure(file, text, without, tests),))


DEFECTS: tuple[Defect, ...] = (
    _one(
        "D1", "the client's own late mode change is taken for a pilot's take-over",
        "link/requests.py", "ours = int(mode) in self._sent_s", "ours = False",
        "tests/flight/test_late_modes.py::test_a_mode_of_ours_that_is_seen_late_is_not_taken_for_a_pilots",
    ),
    _one(
        "D2", "uplink lost, downlink fine: the flight never ends",
        _CONTROL, "if self.state.uplink_silence_s > UPLINK_GIVE_UP_S:", "if False:",
        "tests/flight/test_one_way_links.py::test_a_lost_uplink_ends_the_step_at_once_and_the_flight_in_time",
    ),
    _one(
        "D3", "link lost while landing: a landing is claimed",
        _MACHINE, "(S.LANDING, E.DOWNLINK_GONE): Next(S.LANDING_UNSEEN, Out.LINK_LOST)",
        "(S.LANDING, E.DOWNLINK_GONE): Next(S.LANDED)",
        "tests/flight/test_one_way_links.py::test_a_link_lost_while_landing_claims_no_landing",
    ),
    _one(
        "D4", "a planted manifest writes any parameter",
        "flight/preparation/changes.py", "if name not in SETS or not math.isfinite(entry.value):",
        "if not math.isfinite(entry.value):",
        "tests/flight/test_changes.py::test_a_record_is_taken_for_what_a_flight_sets_on_the_autopilot_it_was_set_on",
        "tests/flight/test_changes.py::test_a_planted_manifest_changes_nothing_on_the_vehicle",
    ),
    _one(
        "D5", "two vehicles of one system id go unnoticed",
        "link/session.py", "self.others.add(self.vehicle_system)", "pass",
        "tests/link/test_link.py::test_two_vehicles_of_one_system_id_are_distinguished",
    ),
    Defect("D6", "anyone who reaches the UDP port is the vehicle; one false frame ends the flight", (
        Cure("link/port.py", "self._transport.keep_to(peer)", "pass",
             ("tests/link/test_transport.py::test_a_connected_vehicle_is_who_first_spoke_as_it",)),
        Cure(_CONTROL, "if self._unconfirmed is None or replace(self._unconfirmed, t_s=t_s) != shown:", "if False:",
             ("tests/faults/test_faults.py::test_a_fault_in_a_state",)),
        Cure("link/clock.py", "_LEAP_STAMPS = 5", "_LEAP_STAMPS = 1",
             ("tests/link/test_link.py::test_one_false_stamp_in_flight_moves_no_clock",)),
    )),
    _one(
        "D7", "a jump of the vehicle's clock counts as silence",
        "link/clock.py", "_LEAP_S = 5.0", "_LEAP_S = 1e9",
        "tests/link/test_link.py::test_a_leap_of_the_vehicles_clock_in_flight_is_no_silence",
    ),
    _one(
        "D8", "link dead before arming: said after minutes, with the wrong cause",
        "link/session.py", "                if not found:\n                    self.require_link()",
        "                if not found:\n                    pass",
        "tests/flight/test_one_way_links.py::test_a_link_that_dies_before_arming_is_said_at_once_and_with_its_cause",
        "tests/link/test_link.py::test_a_link_that_is_lost_is_said_instead_of_what_was_asked_for",
    ),
    _one(
        "D9", "a YAML bomb in a manifest",
        "datafiles.py", 'if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):', "if False:",
        "tests/documents/test_limits.py",
    ),
    _one(
        "D10", "disk full while landing or writing: exit 0",
        "pipeline/flights/run.py", "all(e.as_planned and not e.incomplete for e in ends)",
        "all(e.as_planned for e in ends)",
        "tests/pipeline/test_flight.py::test_a_disk_that_is_full_at_the_end_is_the_headline",
    ),
    _one(
        "D11", "PARAM_REQUEST_LIST is sent once",
        "link/parameters.py", "            if count:\n                break", "            break",
        "tests/link/test_link.py::test_one_lost_request_for_the_parameters_is_sent_again",
    ),
    _one(
        "D12", "another station switches a stream off, and rates are never asked for again",
        _CONTROL, 'text = self.streams.keep() if self.machine.ours else ""', 'text = ""',
        "tests/flight/test_one_way_links.py::test_a_stream_that_another_station_switches_off_is_asked_for_again",
    ),
    Defect("D13", "wrong words: landed where it never armed; a climb ended by old telemetry is a refused command", (
        Cure(_MACHINE, "(S.ARMING, E.OVER): Next(S.NOT_ARMED)", "(S.ARMING, E.OVER): Next(S.LANDED)",
             ("tests/flight/test_one_way_links.py::test_a_vehicle_that_is_asked_to_stop_before_it_arms_has_not_landed",
              "tests/flight/test_machine.py::test_a_landing_is_only_claimed_where_land_and_then_disarmed_were_seen")),
    )),
    _one(
        "D14", "deeply nested files: RecursionError",
        "datafiles.py", "if depth > MAX_DEPTH:", "if False:",
        "tests/documents/test_limits.py",
    ),
    _one(
        "D15", "the client's memory grows in flight",
        "link/clock.py", "del self._asked[next(iter(self._asked))]", "pass",
        "tests/link/test_link.py::test_what_is_kept_of_the_clock_does_not_grow",
    ),
    _one(
        "D16", "exit 0 for a flight ended by a low battery or by the operator",
        "flight/result.py", "self.outcome.complete and self.left.is_safe", "self.left.is_safe",
        "tests/pipeline/test_flight.py::test_a_flight_that_a_low_battery_ended_exits_1",
    ),
    Defect("D17", "--resume as printed fails; --speed 1 does nothing on the built-in vehicle", (
        Cure("pipeline/flights/run.py",
             "before = flown_with(request.resume) if request.resume is not None and not named else None", "before = None",
             ("tests/pipeline/test_flight.py::test_a_run_is_resumed_as_printed",)),
        Cure("pipeline/flights/run.py", "paced=request.speed is not None", "paced=False",
             ("tests/pipeline/test_flight.py::test_a_speed_that_is_asked_for_is_kept",)),
    )),
    _one(
        "D18", "57600 baud is refused, 115200 drops frames: rates are fixed",
        "flight/preparation/rates.py", "if capacity_bytes_s is None or full <= floor:", "if True:",
        "tests/flight/test_slow_links.py::test_rates_fit_into_what_a_link_carries",
        "tests/flight/test_slow_links.py::test_a_slow_link_flies_with_fewer_messages",
    ),
    Defect("D19", "targets leave late on a loaded host, and the flight does not report it", (
        Cure("flight/execution/legs.py", "if start + t_s - sent_s + port.late_s > control.gate.held_up_max_s:", "if False:",
             ("tests/flight/test_two_faults.py::test_a_step_whose_targets_left_too_late_is_flown_again_and_says_so",)),
        Cure("link/port.py", "if self._sender is None or self.muted:\n            return self.send(message)",
             "return self.send(message)",
             ("tests/link/test_sender.py::test_a_target_leaves_on_time_while_the_program_computes",)),
    )),
    Defect("D20", "repeated mode requests under way overrule a pilot's take-over; the flight goes on, or calls it the pilot's", (
        Cure("flight/execution/supervisor.py",
             "return state.t_s - state.mode_age_s > self._handled_s or now - self._asked_s >= ASK_ANYWAY_S", "return True",
             ("tests/flight/test_pilot_first.py::test_no_repeated_request_overrules_a_pilot",)),
        Cure(_MACHINE, "table[S.WITH_PILOT, E.OVERRULED] = Next(S.TO_AUTOPILOT)", "pass",
             ("tests/flight/test_pilot_first.py::test_a_request_that_was_under_way_is_said_where_it_overrules_a_pilot",)),
    )),
    _one(
        "D21", "a vehicle that the pilot armed after the preflight is commanded",
        "flight/execution/scheduler.py", "if vehicle.armed:  # since", "if False:  # since",
        "tests/flight/test_pilot_first.py::test_a_pilot_who_arms_while_the_operator_is_asked_keeps_the_vehicle",
    ),
    _one(
        "D22", "a vehicle that does not confirm to be disarmed is called not armed",
        "flight/execution/scheduler.py", "self.control.on(Event.OVER if confirmed else Event.ARMED)", "self.control.on(Event.OVER)",
        "tests/flight/test_pilot_first.py::test_a_vehicle_that_does_not_confirm_to_be_disarmed_is_not_called_so",
    ),
    _one(
        "D23", "a vehicle that is armed while a command before it is refused ends the program with a traceback",
        "flight/execution/scheduler.py",
        "is FlightState.ARMING and (silent or control.vehicle.armed):", "is FlightState.ARMING and silent:",
        "tests/flight/test_pilot_first.py::test_a_mode_that_is_refused_to_an_armed_vehicle_ends_in_an_outcome",
    ),
    _one(
        "D24", "one false HEARTBEAT hands a vehicle back that a pilot flies",
        "flight/execution/reset.py", "elif first is None:\n            first = beats\n        elif beats > first:", "else:",
        "tests/flight/test_pilot_first.py::test_one_frame_hands_no_vehicle_back",
    ),
    _one(
        "D25", "a vehicle that arms after a take-over by a request that was under way is called not armed",
        _MACHINE, "table[S.NOT_ARMED, E.ARMED] = Next(S.WITH_PILOT)", "pass",
        "tests/flight/test_pilot_first.py::test_a_vehicle_that_arms_after_a_take_over_is_not_called_unarmed",
    ),
    _one(
        "D26", "a host that stands still between reading and looking at the link abandons the vehicle",
        _CONTROL, "has waited first.\n            self.session.advance(self.session.now_s() + self.period_s)", "has waited first.",
        "tests/flight/test_unseen.py::test_a_program_that_stood_still_after_it_had_read_reads_first",
    ),
)  # fmt: skip


def table() -> str:
    """The page's part: each defect and its tests."""
    lines = [
        HEADING, "",
        "Each of them failed with the cure taken out (`python -m tests.faults.defects` takes one after the other out and runs them).", "",
        "| | defect | tests |", "|---|---|---|",
    ]  # fmt: skip
    for defect in DEFECTS:
        named = dict.fromkeys(test for cure in defect.cures for test in cure.tests)
        cells = "<br>".join(f"`{test.removeprefix('tests/')}`" for test in named)
        lines.append(f"| {defect.name} | {defect.what} | {cells} |")
    return "\n".join(lines) + "\n"


def survives(project: Path, cure: Cure) -> bool:
    """Whether all its tests still pass in a copy of the project without a cure."""
    path = project / "flighttest" / cure.file
    before = path.read_text(encoding="utf-8")
    path.write_text(before.replace(cure.text, cure.without, 1), encoding="utf-8")
    try:
        words = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *cure.tests]
        environment = {**os.environ, "PYTHONPATH": str(project)}
        done = subprocess.run(words, cwd=project, env=environment, capture_output=True, timeout=300, check=False)
        return done.returncode == 0
    except subprocess.TimeoutExpired:
        return False  # it never ends: that is how some were seen
    finally:
        path.write_text(before, encoding="utf-8")


def main() -> int:
    """Take cures out; 1 where a test does not notice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    found = 0
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in _FOLDERS:
            source, target = ROOT / name, Path(folder) / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, target)
        for defect in DEFECTS:
            for cure in defect.cures if not words.names or defect.name in words.names else ():
                passes = survives(Path(folder), cure)
                found += passes
                sys.stderr.write(f"{defect.name} without {cure.text!r}: {'NOT NOTICED' if passes else 'fails'}\n")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
