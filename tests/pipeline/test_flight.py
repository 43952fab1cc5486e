"""`flighttest run` on the built-in vehicle over a real socket: what it prints, leaves behind, resumes and exits with."""

import io
import json
import re
import resource
import shlex
import shutil
import signal
import threading
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.cli import main as cli_main
from flighttest.errors import InputError
from flighttest.flight import FlightOutcome, FlightResult, FlightState, LegOutcome, LegResult
from flighttest.flight.preparation import preflight
from flighttest.flight.recorder import Recorder, first_manifest
from flighttest.link import parameters as params
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import open_transport
from flighttest.pipeline.flights import run as flying
from flighttest.pipeline.flights.missing import unflown_steps
from flighttest.pipeline.planning.checking import plans, predictor_for
from flighttest.pipeline.results import Status
from flighttest.pipeline.store import flown_with as repeating
from flighttest.pipeline.store import resuming
from flighttest.recording.store import is_remains, open_run, read_manifest
from flighttest.report.sections.diagnosis import diagnosis_sections
from flighttest.vehicle.model import DEFAULT_VEHICLE
from tests.flight.faulty import LANDS_M_S

SHORT = """
format: maneuver/1
name: short
doc: two yaw rate steps
identifies: [sigma_r]
mode: GUIDED_NOGPS
rate_hz: 50
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.6], height_m: [2, 10], speed_max_m_s: 8, voltage_min_v: 21.0}
reset: {to: [0, 0, 5], heading_deg: [0, 90], by: guided, settle_s: 1}
steps:
  - yaw_rate_step: {rate_rad_s: [1], sign: both, hold_s: 1.0}
repeat: {each: %d, order: sequential}
"""


@pytest.fixture
def script(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT % 2)
    return path


@pytest.fixture(autouse=True)
def _ready_at_once(monkeypatch):
    """The vehicle has its position 2 s after boot, and lands three times as fast as usual: the 41 s of a real one are waited for in the
    flight of `fitted`."""
    booted = flying.options

    def soon(*given, **named):
        options = booted(*given, **named)
        return replace(options, ready_s=1.0, gps_s=2.0, parameters={"LAND_SPD_MS": LANDS_M_S, **options.parameters})

    monkeypatch.setattr(flying, "options", soon)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A flight of the short script, fitted, with what the command printed: only read, and flown beside, by the tests."""
    folder = tmp_path_factory.mktemp("fitted")
    script = folder / "short.yaml"
    script.write_text(SHORT % 2)
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        words = ["run", script, "--out", folder / "runs", "--only", "fit", "--json"]
        code = cli_main.call([str(word) for word in words])
    (run,) = (folder / "runs").iterdir()
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue(), run=run, script=script)


def test_a_flight_leaves_a_whole_run_folder(call, fitted, tmp_path):
    code, out, err, run = fitted.code, fitted.out, fitted.err, fitted.run
    assert code == 0, err
    assert err.splitlines()[0].startswith("flying the built-in simulated copter")
    data = json.loads(out)
    assert data["runs"] == [str(run)]
    names = {p.name for p in run.iterdir()}
    assert {
        "manifest.yaml",
        "script.yaml",
        "plan.json",
        "raw.tlog",
        "events.jsonl",
        "channels",
        "segments.parquet",
        "fit.yaml",
        "report.html",
    } <= names
    copy = shutil.copytree(run, tmp_path / "copy")
    (copy / "manifest.yaml").unlink()
    assert is_remains(copy), "the list of what a run folder holds names all of it"
    assert data["segments"] == {"used": 4, "of": 4}
    assert data["model"]["parameters"]["sigma_r"]["value"] == pytest.approx(21.54, rel=0.06)
    # In lock-step both ends share one clock: half a millisecond off would show.
    assert data["model"]["parameters"]["T_d_yaw_rate"]["value"] == pytest.approx(0.1, abs=3e-4)
    assert data["model"]["parameters"]["T_d_yaw_rate"]["scatter"] < 3e-4
    assert data["model"]["fingerprint"]["components"]["propellers"]
    # raw.tlog is the truth: the same can be rebuilt from it.
    code, out, _ = call("import", run / "raw.tlog", "-o", tmp_path / "again", "--json")
    assert code == 0
    again = json.loads(call("segment", tmp_path / "again", "--json")[1])
    assert again["used"] == 4


@pytest.mark.slow
def test_a_seed_gives_the_same_flight_again(call, script, tmp_path):
    """Over a real socket, whatever the host does meanwhile; another seed has other noise."""
    script.write_text(SHORT % 1)
    flown = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        code, out, err = call("run", script, "--out", tmp_path / name, "--seed", seed, "--only", "fly")
        assert code == 0
        assert " ".join((out + err).split()).count("steps flown; the plan was flown to its end") == 1
        (run,) = (tmp_path / name).iterdir()
        flown.append(open_run(run).channel("r_rad_s"))
    (t_a, r_a), (t_b, r_b), (_, r_c) = flown
    assert np.array_equal(t_a, t_b)
    assert np.array_equal(r_a, r_b)
    assert not np.array_equal(r_a, r_c)


@pytest.mark.slow
def test_a_stopped_flight_is_resumed(call, script, tmp_path):
    out_dir = tmp_path / "runs"
    seen = []

    class Stopper:
        def stage(self, text):
            seen.append(text)

        def part(self, done, of):
            pass

        def flight(self, progress):
            if progress.leg >= 2 and not any(s == "stop" for s in seen):
                seen.append("stop")
                signal.raise_signal(signal.SIGINT)

    assert threading.current_thread() is threading.main_thread()
    request = flying.FlightRequest(scripts=(str(script),), out=out_dir, fly_only=True)
    first = flying.run(request, Stopper())
    flown = [leg.leg for leg in first.value[0].legs if leg.outcome.name == "FLOWN"]
    assert 1 <= len(flown) < 4
    assert first.status is Status.UNUSABLE, "stopped by the operator: steps are missing"
    assert first.document.verdict != "Recorded."
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    (run,) = out_dir.iterdir()
    code, out, err = call("run", "--resume", run, "--out", out_dir, "--only", "fit", "--json")
    assert code == 0, err
    data = json.loads(out)
    assert data["runs"][0] == str(run)
    assert data["segments"]["used"] == 4
    # Who goes on from the second run goes on from both.
    second = Path(data["runs"][1])
    assert resuming.resumed_runs(second) == [run, second]
    _, _, err = call("run", "--resume", second, "--out", out_dir)
    assert "nothing is missing" in err
    # A report of either run is one of the campaign they were fitted in.
    code, out, err = call("report", data["runs"][0], "--json")
    assert code == 0, err
    assert json.loads(out)["verdict"].startswith("4 responses fitted")


@pytest.mark.slow
def test_a_campaign_that_a_flight_ended_early_is_resumed_with_all_its_scripts(script, tmp_path):
    """What was printed flew the script that was cut short, and nothing named those after it."""
    second = script.with_name("second.yaml")
    second.write_text((SHORT % 1).replace("name: short", "name: second"))
    request = flying.FlightRequest(scripts=(str(script), str(second)), out=tmp_path / "runs", fit_only=True)
    first = flying.run(request, StopsIn(2))
    run = Path(first.data["runs"][0])
    command = f"flighttest run --resume {run} {script} {second}"
    (note,) = [n for n in first.data["notes"] if "second was not flown" in n]
    assert "steps are missing" in note
    assert f"`{command}` flies what is missing" in note
    assert first.document.facts["fly next"] == command
    resumed = replace(request, resume=run)
    again = flying.run(resumed, StopsIn(10**6))
    assert again.status is Status.DONE
    assert len(again.data["runs"]) == 3
    assert again.data["segments"]["used"] == 4 + 2
    # The last of them goes on from all before it, and what has been flown is not flown again.
    last = Path(again.data["runs"][-1])
    assert resuming.resumed_runs(last) == [Path(r) for r in again.data["runs"]]
    third = script.with_name("third.yaml")
    third.write_text((SHORT % 1).replace("name: short", "name: third"))
    scripts = (str(script), str(second), str(third))
    more = flying.run(replace(resumed, resume=last, scripts=scripts), StopsIn(10**6))
    assert more.status is Status.DONE
    assert len(more.data["runs"]) == 4


class StopsIn:
    """The operator's Ctrl-C in a step of a flight, once."""

    def __init__(self, leg):
        self.leg = leg

    def stage(self, text):
        pass

    def part(self, done, of):
        pass

    def flight(self, progress):
        if progress.leg >= self.leg:
            self.leg = 10**6
            signal.raise_signal(signal.SIGINT)


def test_a_flight_that_a_low_battery_ended_exits_1(call, script, tmp_path, monkeypatch):
    sagging = flying.options

    def empty(*given, **named):
        return replace(sagging(*given, **named), voltage_v=22.7)

    monkeypatch.setattr(flying, "options", empty)
    battery = script.with_name("battery.yaml")
    battery.write_text((SHORT % 2).replace("voltage_min_v: 21.0", "voltage_min_v: 22.5"))
    code, out, _ = call("run", battery, "--out", tmp_path / "runs", "--only", "fly", "--json")
    data = json.loads(out)
    assert (
        data["data"]["flights"][0]["outcome"] == "BATTERY"
        if "data" in data
        else data["flights"][0]["outcome"] == "BATTERY"
    )
    assert code == 1


@pytest.mark.slow
def test_a_flight_that_was_stopped_before_its_first_step_exits_1(script, tmp_path):
    class Stopper:
        stopped = False

        def stage(self, text):
            pass

        def part(self, done, of):
            pass

        def flight(self, progress):
            if not self.stopped and progress.height_m > 0.5:  # on its way up
                self.stopped = True
                signal.raise_signal(signal.SIGINT)

    ended = flying.run(flying.FlightRequest(scripts=(str(script),), out=tmp_path / "runs", fly_only=True), Stopper())
    assert not any(leg.outcome.name == "FLOWN" for leg in ended.value[0].legs)
    assert ended.status is Status.UNUSABLE


def test_a_dead_link_is_said_and_exits_1(call, script, tmp_path):
    code, _, err = call("run", script, "--connect", "tcp:127.0.0.1:1", "--out", tmp_path / "runs", "--yes")
    assert code == 1
    assert "127.0.0.1:1" in err


@pytest.mark.parametrize("url", ["http://x", "tcp:nowhere", "udpin:0.0.0.0:99999", "serial:"])
def test_bad_urls_are_bad_input(call, script, tmp_path, url):
    code, _, err = call("run", script, "--connect", url, "--out", tmp_path / "runs", "--yes")
    assert code == 2, err
    assert "error:" in err


def test_nothing_real_arms_without_a_yes(call, script, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    code, _, err = call("run", script, "--connect", "udpin:127.0.0.1:14555", "--out", tmp_path / "runs")
    assert code == 2
    assert "--yes" in err
    assert not (tmp_path / "runs").exists()


def test_the_first_line_names_what_flies(tmp_path):
    assert "built-in simulated copter" in flying.announce(flying.FlightRequest(("thrust",)))
    assert "tcp:1.2.3.4:5" in flying.announce(flying.FlightRequest(("thrust",), connect="tcp:1.2.3.4:5"))
    assert flying.needs_consent(flying.FlightRequest(("thrust",), connect="tcp:1.2.3.4:5"))
    assert not flying.needs_consent(flying.FlightRequest(("thrust",)))


def test_a_vehicle_without_a_connection_never_becomes_the_simulator(call, script, tmp_path):
    vehicle = tmp_path / "vehicle.yaml"
    vehicle.write_text(
        "format: vehicle/1\nname: x\nfirmware: ardupilot\nnominal_voltage_v: 22.2\nhover_throttle: 0.18\n"
        "zone: {origin: home, x_m: [-15, 15], y_m: [-7.5, 7.5], z_m: [1, 10]}\n"
    )
    code, _, err = call("run", script, "--vehicle", vehicle, "--out", tmp_path / "runs")
    assert code == 2
    assert "--connect" in err


def test_a_script_that_leaves_the_zone_is_not_flown(call, tmp_path):
    path = tmp_path / "wide.yaml"
    path.write_text(
        (SHORT % 1).replace(
            "yaw_rate_step: {rate_rad_s: [1], sign: both, hold_s: 1.0}",
            "attitude_step: {axis: roll, amplitude_rad: [0.5], sign: both, hold_s: 6.0, coast_s: 1.0}",
        )
    )
    code, _, err = call("run", path, "--out", tmp_path / "runs")
    assert code == 2
    assert "zone" in err
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_before_take_off_the_vehicle_is_compared_with_the_model_in_use(call, fitted, script, tmp_path):
    out_dir = tmp_path / "runs"
    text = (fitted.run / "fit.yaml").read_text()
    assert "MOT_SPIN_MIN: 0.15" in text
    other = tmp_path / "other.yaml"
    other.write_text(re.sub(r"MOT_SPIN_MIN: [0-9.]+", "MOT_SPIN_MIN: 0.1", text))
    script.write_text(SHORT % 1)
    code, out, _ = call("run", script, "--out", out_dir, "--model", other, "--only", "fly")
    assert code == 0
    lines = out.splitlines()
    (said,) = [i for i, line in enumerate(lines) if "the last model is stale: MOT_SPIN_MIN (0.1 is now 0.15)" in line]
    assert "touches thrust; fly roll_pitch, yaw_rate and thrust again (at least thrust)" in lines[said]
    assert said < next(i for i, line in enumerate(lines) if "writing the channels" in line)
    assert "GUID_OPTIONS" not in lines[said], "what the tool itself sets for a flight is no change"
    code, _, err = call("run", "--resume", fitted.run, "--out", out_dir)
    assert (code, "nothing is missing" in err) == (2, True)
    code, _, err = call("run", "thrust", "--resume", fitted.run, "--out", out_dir)
    assert (code, "a flight of short, not of thrust" in err) == (2, True)


def test_a_waiver_names_a_check(call, script, tmp_path):
    code, _, err = call("run", script, "--waive", "fense", "--out", tmp_path)
    assert code == 2
    assert "did you mean fence?" in err


def test_every_check_can_be_waived_by_a_name_that_is_known():
    source = "".join(p.read_text() for p in Path(preflight.__file__).parent.glob("*.py"))
    assert set(re.findall(r'Check\(\s*"([^"]+)"', source)) == set(preflight.NAMES)


def test_steps_that_were_not_flown_are_named_with_the_reason():
    high = "the vehicle is outside the height limits"
    legs = (
        LegResult("a/r1", LegOutcome.REFUSED, (high, "the vehicle went to BRAKE")),
        LegResult("b/r1", LegOutcome.NOT_SETTLED, ("gusts",)),
        LegResult("b/r1", LegOutcome.FLOWN),
        LegResult("a/r2", LegOutcome.REFUSED, (high,)),
        LegResult("a/r3", LegOutcome.LEFT_OUT),
    )
    ended = FlightResult(FlightOutcome.COMPLETED, Path("run"), legs, (), {})
    assert unflown_steps(ended) == [
        f"a/r1 and 1 more not flown: {LegOutcome.REFUSED.value}: {high}",
        f"a/r3 not flown: {LegOutcome.LEFT_OUT.value}",
    ]


def test_what_another_vehicle_flew_is_not_gone_on_with(call, script, tmp_path):
    plan = plans((str(script),), DEFAULT_VEHICLE, predictor_for(None, DEFAULT_VEHICLE))[0]
    run = tmp_path / "run"
    Recorder(run, lambda: 0.0, first_manifest(plan, "sim", "", None), plan).finish(
        SimpleNamespace(vehicle_system=1), plan
    )
    assert resuming.worth_resuming(run, [plan]) == []
    (note,) = resuming.worth_resuming(run, [replace(plan, script=replace(plan.script, sha256="other"))])
    assert "was changed since" in note
    with pytest.raises(InputError, match="a flight of the vehicle paper, not of mine"):
        resuming.worth_resuming(run, [replace(plan, vehicle=replace(plan.vehicle, name="mine"))])


@pytest.mark.slow
@pytest.mark.parametrize("only", ["fly", "fit"])
def test_a_disk_that_is_full_at_the_end_is_the_headline(call, script, tmp_path, monkeypatch, only):
    finish = Recorder.finish

    def full(recorder, *args):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))
        try:
            return finish(recorder, *args)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    monkeypatch.setattr(Recorder, "finish", full)
    code, out, _ = call("run", script, "--out", tmp_path / "runs", "--only", only)
    assert code == 1
    words = " ".join(out.replace("│", " ").split())
    assert "The record is not complete: the channels could not be written" in words
    assert "Recorded." not in words
    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "raw.tlog").stat().st_size > 100_000
    assert not list(run.rglob("*.part"))
    assert any("the channels could not be written" in line for line in read_manifest(run)["losses"])
    assert call("import", run / "raw.tlog", "-o", run)[0] == 0, "what is there can be used"


def declared(tmp_path, **changes):
    path = tmp_path / "my vehicle.yaml"
    fields = {"name": "x", "firmware": "ardupilot", "nominal_voltage_v": 22.2, "hover_throttle": 0.18, **changes}
    lines = [f"{k}: {v}" for k, v in fields.items()]
    zone = "zone: {origin: home, x_m: [-15, 15], y_m: [-7.5, 7.5], z_m: [1, 10]}"
    path.write_text("\n".join(["format: vehicle/1", *lines, zone, ""]))
    return path


@pytest.mark.parametrize("gone", [False, True], ids=["file there", "file gone"])
def test_a_run_is_resumed_as_printed(call, script, tmp_path, monkeypatch, gone):
    """Also of a vehicle that was given by file and link: both are kept in the run folder. What its preflight would have refused without is
    in the command: as printed it was refused on every vehicle whose parameters had been set for the flight."""
    vehicle, flown = declared(tmp_path), []

    def fly(plan, url, folder, options, **_link):
        flown.append((plan.vehicle.name, url, options.set_params, options.waive, options.system))
        Recorder(folder, lambda: 0.0, first_manifest(plan, url, "", None), plan)
        return FlightResult(FlightOutcome.OPERATOR_STOP, folder)

    monkeypatch.setattr(flying, "fly", fly)
    link = "udpin:127.0.0.1:14777"
    out_dir = tmp_path / "runs"
    asked = "--set-params", "--waive", "rc", "--waive", "fence", "--sysid", "42"
    _, out, _ = call(
        "run", script, "--vehicle", vehicle, "--connect", link, "--out", out_dir, *asked, "--yes", "--json"
    )
    printed = re.search(r"`(flighttest run --resume [^`]+)` flies them", out)
    assert printed, out
    if gone:
        vehicle.unlink()
    _, out, err = call(*shlex.split(printed[1])[1:], "--yes")
    assert f"flying the vehicle at {link}" in out + err, "and is asked for"
    assert flown == [("x", link, True, ("rc", "fence"), 42)] * 2, err
    assert len(list(out_dir.iterdir())) == 2, "beside the run that it goes on with"


@pytest.mark.parametrize("url", ["nonsense", "tcp:127.0.0.1:1", "serial:/dev/no-such-port:57600"])
def test_a_link_that_cannot_be_opened_leaves_no_run_folder(call, script, tmp_path, url):
    code, out, err = call("run", script, "--connect", url, "--out", tmp_path / "runs", "--yes")
    assert code in (1, 2)
    assert not list(tmp_path.glob("runs/*"))
    assert "recorded in" not in out + err, "a folder that is not there was named"


def test_what_a_take_over_left_out_can_be_flown_when_the_vehicle_is_down(call, script, tmp_path, monkeypatch):
    """No command was printed, though a run that ended so can be resumed."""

    def fly(plan, url, folder, _options, **_link):
        Recorder(folder, lambda: 0.0, first_manifest(plan, url, "", None), plan)
        return FlightResult(FlightOutcome.TAKE_OVER, folder, left=FlightState.WITH_PILOT, mode="LOITER")

    monkeypatch.setattr(flying, "fly", fly)
    _, out, _ = call("run", script, "--out", tmp_path / "runs", "--json")
    assert re.search(r"`flighttest run --resume \S+` flies them when the vehicle is down", out), out
    _, out, _ = call("run", script, "--out", tmp_path / "runs", "--only", "fly")
    assert " ".join(out.split()).count("nothing was sent after that") == 1, "it was said twice"


def test_the_next_flight_is_printed_with_its_vehicle(tmp_path):
    vehicle = declared(tmp_path)
    repeating.keep(tmp_path / "run", repeating.FlownWith("tcp:127.0.0.1:5760", vehicle))
    words = shlex.split(repeating.words_of(tmp_path / "run"))
    assert words == ["--vehicle", str(vehicle), "--connect", "tcp:127.0.0.1:5760"]
    repeating.keep(tmp_path / "rotor", repeating.FlownWith("sim", None, "rotor", ("ground_effect:R2_m2=0.1",)))
    assert repeating.words_of(tmp_path / "rotor") == " --airframe rotor --hide ground_effect:R2_m2=0.1"
    repeating.keep(tmp_path / "plain", repeating.FlownWith("sim"))
    assert repeating.words_of(tmp_path / "plain") == ""
    settings = {"set_params": True, "extend_fence": True, "signing_key": tmp_path / "a key", "sysid": 42}
    repeating.keep(tmp_path / "set", repeating.FlownWith("tcp:127.0.0.1:5760", **settings))
    words = shlex.split(repeating.words_of(tmp_path / "set"))
    assert words[2:] == ["--set-params", "--extend-fence", "--signing-key", str(tmp_path / "a key"), "--sysid", "42"]
    data = {"next_flight": "next.yaml", "next_path": "d/next.yaml", "next_options": " --vehicle v.yaml"}
    assert "flighttest run d/next.yaml --vehicle v.yaml" in repr(diagnosis_sections(data, ""))


@pytest.mark.slow
def test_a_speed_that_is_asked_for_is_kept(tmp_path):
    """In lock-step too: a flight could not be watched, or stop it by hand, at the pace of the host."""
    request = flying.FlightRequest(("thrust",), speed=4.0)
    with flying.connection(request) as url:
        session = Session(MavlinkPort(open_transport(url)))
        session.connect()
        params.write_parameter(session, "SIM_LOCKSTEP", 1.0, {"SIM_LOCKSTEP": 1.0}, stops_time=True)
        session.enter_lock_step()
        began, start_s = time.monotonic(), session.now_s()
        session.advance(start_s + 4.0)
        took_s = time.monotonic() - began
        session.port.close()
    assert took_s == pytest.approx(1.0, abs=0.3)
