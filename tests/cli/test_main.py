"""Words to exit code: mistakes give one clear message and a number, in both languages; a fault of ours gives a traceback."""

import ast
import io
import json
import os
import signal
import subprocess
import sys
import threading

import click
import pytest
from click.shell_completion import ShellComplete
from pymavlink import mavutil

from flighttest.cli import main as cli_main
from flighttest.cli.durations import Durations
from flighttest.cli.live import LiveProgress
from flighttest.cli.show import Show
from flighttest.errors import FileProblem, FitError, InputError, LinkError, PreflightError
from flighttest.flight import FlightProgress
from flighttest.pipeline import info as about
from flighttest.pipeline.flights.interrupts import counted_interrupts


def call(capsys, *argv):
    code = cli_main.call(list(argv))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def raising(monkeypatch, error):
    def fail(ids):
        raise error

    monkeypatch.setattr(about, "terms", fail)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("bad file", "mend it"), 2),
        (LinkError("silent", "plug it in"), 1),
        (FitError("no data", "fly more"), 3),
    ],
)
def test_an_error_is_one_message_with_its_remedy(capsys, monkeypatch, error, code):
    raising(monkeypatch, error)
    got, out, err = call(capsys, "terms")
    assert got == code
    assert out == ""
    assert error.message in err
    assert error.hint in err
    assert "Traceback" not in err
    got, out, err = call(capsys, "terms", "--json")
    assert got == code
    assert json.loads(out)["error"]["message"] == error.message
    assert err == ""


def test_all_problems_and_refusals_reach_json(capsys, monkeypatch):
    raising(
        monkeypatch,
        InputError.of(
            [FileProblem("a.yaml", 3, "limits", "too high", "lower it"), FileProblem("a.yaml", 9, "", "odd")]
        ),
    )
    _, out, _ = call(capsys, "terms", "--json")
    assert [p["line"] for p in json.loads(out)["error"]["problems"]] == [3, 9]
    raising(monkeypatch, PreflightError([("no fence", "set FENCE_ENABLE 1")]))
    code, out, _ = call(capsys, "terms", "--json")
    assert code == 1
    assert json.loads(out)["error"]["refusals"] == [{"what": "no fence", "remedy": "set FENCE_ENABLE 1"}]


def test_our_own_faults_are_tracebacks(capsys, monkeypatch):
    raising(monkeypatch, RuntimeError("a bug"))
    with pytest.raises(RuntimeError):
        call(capsys, "terms")


def test_files_that_cannot_be_written_are_no_traceback(capsys, monkeypatch):
    raising(monkeypatch, PermissionError(13, "Permission denied", "/root/x"))
    code, _, err = call(capsys, "terms")
    assert code == 2
    assert "/root/x: Permission denied" in err


@pytest.mark.parametrize(
    "argv", [("bogus",), ("fit",), ("fit", "--nope", "x"), ("run",), ("export", "m.yaml", "--to", "fortran")]
)
def test_usage_mistakes(capsys, argv):
    code, _, err = call(capsys, *argv)
    assert code == 2
    assert "error:" in err
    code, out, _ = call(capsys, *argv, "--json")
    assert code == 2
    assert json.loads(out)["error"]["kind"] == "usage"


def test_no_arguments_print_the_help(capsys):
    code, out, _ = call(capsys)
    assert code == 0
    assert "Commands:" in out


@pytest.mark.parametrize("name", sorted(cli_main.cli.commands))
def test_every_command_explains_itself(capsys, name):
    code, out, _ = call(capsys, name, "--help")
    assert code == 0
    assert "--json" in out


def test_ctrl_c_is_not_a_traceback(capsys, monkeypatch):
    raising(monkeypatch, click.Abort())
    assert call(capsys, "terms")[0] == 1


def test_terms_in_both_languages(capsys):
    code, out, _ = call(capsys, "terms", "--json")
    assert code == 0
    listed = {t["id"]: t for t in json.loads(out)["terms"]}
    assert listed["linear_drag"]["parameters"][0]["unit"] == "1/s"
    code, out, _ = call(capsys, "terms", "ground_efect")
    assert code == 2


def test_doctor_says_what_is_here(capsys):
    _, out, _ = call(capsys, "doctor", "--json")
    checks = {c["what"]: c for c in json.loads(out)["checks"]}
    assert checks["casadi"]["ok"]


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="this system has no real-time priority")
@pytest.mark.parametrize("allowed", [True, False])
def test_doctor_shows_whether_targets_come_before_other_programs(capsys, monkeypatch, allowed):
    def schedule(*_words):
        if not allowed:
            raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    _, out, _ = call(capsys, "doctor", "--json")
    (check,) = [c for c in json.loads(out)["checks"] if c["what"] == "real-time priority"]
    assert (check["ok"], check["needed"]) == (allowed, False)
    assert ("rtprio" in check["remedy"]) is not allowed


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "Input/output error"), SystemExit(1)])
def test_a_flight_goes_on_where_its_progress_is_not_read(error):
    """`flighttest run | tee log`: Ctrl-C ends tee as well, and the vehicle must still be landed."""

    class Gone:
        live = False
        everything = False

        def say(self, *_words, **_style):
            raise error

    with LiveProgress(Gone()) as progress:
        progress.stage("landing")
        progress.flight(FlightProgress(1, 2, "landing", "", "", 1.0, 1.0))


def test_a_closed_terminal_lands_and_ctrl_c_twice_stops_sending():
    with counted_interrupts() as presses:
        os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGHUP)
        assert presses() == 1
        os.kill(os.getpid(), signal.SIGINT)
        assert presses() == 2
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


@pytest.mark.slow
def test_sim_shows_a_program_where_it_is():
    argv = [sys.executable, "-m", "flighttest.cli.main", "sim", "--json", "--port", "0", "--seed", "4", "--speed", "2"]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    late = threading.Timer(60.0, process.kill)
    late.start()
    try:
        reported = json.loads(process.stdout.readline())
        assert (reported["airframe"], reported["seed"], reported["speed"], reported["backend"]) == (
            "paper",
            4,
            2.0,
            "builtin",
        )
        assert reported["url"] == f"tcp:127.0.0.1:{reported['port']}"
        client = mavutil.mavlink_connection(reported["url"])
        heartbeat = client.wait_heartbeat(timeout=20)
        client.close()
        assert heartbeat.get_srcSystem() == reported["system_id"]
        process.send_signal(signal.SIGINT)
        assert process.stdout.read() == "", "one line, and no more"
        assert process.wait(20) == 1
    finally:
        late.cancel()
        process.kill()
        process.wait()


def test_a_printed_command_works_as_printed(capsys, tmp_path):
    path = tmp_path / "on the ground.csv"
    rows = "\n".join(f"{k / 50:.2f},0.0,0.0,0.0,0.0,0.2,0.0,0.0" for k in range(60))
    path.write_text(f"t_s,roll_rad,pitch_rad,yaw_rad,v_z_m_s,throttle,roll_ref_rad,pitch_ref_rad\n{rows}\n")
    code, out, err = call(capsys, "fit", str(path))
    assert code == 3
    assert f"`flighttest segment '{path}'`" in out + err
    assert call(capsys, "segment", str(path))[0] in (0, 1)


def test_a_model_in_the_place_of_a_recording_is_reported_where_it_goes(capsys, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("format: model/1\n")
    code, out, err = call(capsys, "fit", str(path))
    assert code == 2
    assert "--model" in out + err


def test_a_stage_shows_its_share_and_the_time_left(tmp_path):
    now_s = [0.0]
    out = io.StringIO()
    show = Show(out=out, width=80)
    kept = Durations(tmp_path / "durations.json")
    with LiveProgress(show, lambda: now_s[0], kept) as progress:
        progress.stage("reading 4 recordings")
        assert progress.words() == ""
        now_s[0] = 12.0
        assert progress.words() == "12 s so far", "how much is left is not known"
        progress.part(1, 4)
        assert progress.words() == "25%, about 36 s left"
        progress.stage("fitting 10 responses")
        now_s[0] = 32.0
    assert "reading 4 recordings: 25%, about 36 s left" in out.getvalue()
    with LiveProgress(show, lambda: now_s[0], Durations(tmp_path / "durations.json")) as progress:
        progress.stage("fitting 5 responses")
        now_s[0] = 37.0
        assert progress.words() == "50%, about 5 s left", "ten took 20 s last time"
        now_s[0] = 60.0
        assert progress.words() == "28 s so far", "longer than last time: how much is left is not known any more"


def test_on_a_terminal_stages_stay_only_where_they_are_asked_for():
    for keep, everything, stays in ((False, False, False), (True, False, True), (False, True, True)):
        out = io.StringIO()
        show = Show(out=out, width=80, colour=True)
        show.everything = everything
        with LiveProgress(show, keep=keep) as progress:
            progress.stage("reading 4 recordings")
        last = out.getvalue().rpartition("\x1b[2K")[2] if not stays else out.getvalue()
        assert ("reading 4 recordings" in last) is stays


def test_no_answer_is_printed_while_progress_is_drawn():
    """The last stage of a diagnosis stood below its answer: progress has to end first."""
    seen = 0
    for name in sorted(os.listdir(os.path.dirname(cli_main.__file__))):
        if not name.endswith(".py"):
            continue
        with open(os.path.join(os.path.dirname(cli_main.__file__), name), encoding="utf-8") as file:
            tree = ast.parse(file.read())
        for block in (
            n for n in ast.walk(tree) if isinstance(n, ast.With) and "LiveProgress(" in ast.unparse(n.items[0])
        ):
            seen += 1
            called = {
                c.func.attr for c in ast.walk(block) if isinstance(c, ast.Call) and isinstance(c.func, ast.Attribute)
            }
            assert "finish" not in called, f"{name}:{block.lineno}"
    assert seen >= 8


def test_a_damaged_list_of_durations_is_no_error(tmp_path):
    path = tmp_path / "durations.json"
    for text in ("{", "[1]", '{"a": "b"}'):
        path.write_text(text)
        kept = Durations(path)
        assert kept.expected_s("a") is None
    kept.took("reading /a/b 3", 3.0)
    assert Durations(path).expected_s("reading /c 6") == 6.0


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("flighttest run thrust", ["thrust", "thrust_hover"]),
        ("flighttest check spot", ["spot_check"]),
        ("flighttest terms ground", ["ground_effect"]),
        ("flighttest fit x --term vortex", ["vortex_ring"]),
        ("flighttest diag", ["diagnose"]),
        ("flighttest diagnose --ag", ["--against"]),
    ],
)
def test_a_shell_completes_commands_options_maneuvers_and_terms(words, completed):
    *before, begun = words.split()[1:]
    complete = ShellComplete(cli_main.cli, {}, "flighttest", "_FLIGHTTEST_COMPLETE")
    assert [item.value for item in complete.get_completions(before, begun)] == completed


@pytest.mark.parametrize("width", [80, 120])
def test_the_list_of_commands_cuts_no_sentence(width):
    context = click.Context(cli_main.cli, info_name="flighttest", terminal_width=width)
    shown = cli_main.cli.get_help(context)
    assert max(map(len, shown.splitlines())) <= width
    listed = " ".join(shown.partition("Commands:")[2].split())
    for name, command in cli_main.cli.commands.items():
        assert f"{name} {' '.join(command.help.split(chr(10) * 2)[0].split())}" in listed
