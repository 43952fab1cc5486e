"""Sounds and texts for the operator at the terminal: the bell, the answer to Ctrl-C, short names of links."""

from __future__ import annotations

import io
import os
import re
import signal
import tempfile
import time

import pytest

from flighttest.cli.live import SHOWN_FROM_S, LiveProgress, without_echoed_controls
from flighttest.cli.show import Show
from flighttest.flight import FlightProgress
from flighttest.link.transport import full_url
from flighttest.pipeline.flights.interrupts import LEAVING, STOPPING, counted_interrupts

_DRAWN_S = 0.3  # a picture is drawn eight times a second


@pytest.mark.parametrize("view", ["normal", "large"])
def test_an_alarm_rings_once_and_stays_on_the_screen(view: str) -> None:
    out = io.StringIO()
    with LiveProgress(Show(out=out, colour=True, width=80), view=view) as progress:
        for k in range(3):
            progress.flight(FlightProgress(1, 2, "flying", "", "", 1.0, float(k), alarm="Radio Failsafe", alarms=1))
    assert out.getvalue().count("\a") == 1
    assert "Radio Failsafe" in out.getvalue()


def test_a_log_file_gets_the_alarm_as_a_line_without_a_bell() -> None:
    out = io.StringIO()
    with LiveProgress(Show(out=out)) as progress:
        progress.flight(FlightProgress(1, 2, "flying", "", "", 1.0, 1.0, alarm="abort", alarms=1))
    assert "abort" in out.getvalue()
    assert "\a" not in out.getvalue()


def test_a_terminal_that_cannot_erase_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """With TERM=dumb nothing of a flight was shown until its end, and the next text began in a line that had not ended."""
    monkeypatch.setenv("TERM", "dumb")
    out = io.StringIO()
    with LiveProgress(Show(out=out, colour=True, width=200)) as progress:
        progress.stage("checking the vehicle")
        progress.flight(FlightProgress(1, 2, "flying", "", "", 1.0, 1.0))
    assert [line.strip() == "" for line in out.getvalue().split("\n")] == [False, False, True]
    assert "\x1b[?25" not in out.getvalue()


def test_nothing_is_drawn_over_the_question_before_arming(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen: the bar of "checking the vehicle" was drawn again four times a second in the question's place."""
    out, err = io.StringIO(), io.StringIO()
    show = Show(out=out, err=err, colour=True, width=80)
    written: list[int] = []

    class Operator:
        def readline(self) -> str:
            written.append(len(out.getvalue()))
            time.sleep(0.6)  # two pictures of a stage
            written.append(len(out.getvalue()))
            return "y\n"

    monkeypatch.setattr("sys.stdin", Operator())
    with LiveProgress(show) as progress:
        progress.stage("checking the vehicle")
        time.sleep(SHOWN_FROM_S)
        assert progress.ask("the list")
    assert written[0] == written[1]
    assert "Arm and take off?" in err.getvalue()


def test_ctrl_c_while_a_live_line_begins_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen once in six presses: the line that had not begun was ended by an IndexError."""

    def interrupted(_console: object, _hook: object) -> None:
        raise KeyboardInterrupt

    out = io.StringIO()
    show = Show(out=out, colour=True, width=80)
    monkeypatch.setattr(type(show.side), "push_render_hook", interrupted)
    with pytest.raises(KeyboardInterrupt), LiveProgress(show) as progress:
        progress.stage("connecting")


class Screen:
    """What a terminal shows of what is written to it: text, new lines, and the control sequences of a live picture."""

    def __init__(self) -> None:
        self.rows = [""]
        self._row, self._column = 0, 0

    def write(self, data: str) -> None:
        for control, text in re.findall(r"\x1b\[([?\d;]*[A-Za-z])|([^\x1b])", data):
            if control == "2K":
                self.rows[self._row] = ""
            elif control.endswith("A"):
                self._row = max(self._row - int(control[:-1]), 0)
            elif text == "\r":
                self._column = 0
            elif text == "\n":
                self._row, self._column = self._row + 1, 0
                self.rows += [""] * (self._row + 1 - len(self.rows))
            elif text and text != "\a":
                row = self.rows[self._row].ljust(self._column)
                self.rows[self._row] = row[: self._column] + text + row[self._column + 1 :]
                self._column += 1


@pytest.mark.parametrize("view", ["normal", "large"])
def test_the_answer_to_ctrl_c_leaves_no_line_of_the_picture_before(view: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen in tmux: two lines of the old picture stayed above the new one until the flight's end."""
    out, screen = io.StringIO(), Screen()
    monkeypatch.setattr(os, "isatty", lambda _file: True)
    monkeypatch.setattr(os, "get_terminal_size", lambda *_file: os.terminal_size((60, 24)))
    monkeypatch.setattr(os, "write", lambda _file, data: out.write(data.decode()))
    with LiveProgress(Show(out=out, colour=True, width=80), view=view) as progress, counted_interrupts() as presses:
        progress.flight(FlightProgress(1, 2, "before it", "", "", 1.0, 1.0))
        time.sleep(_DRAWN_S)
        os.kill(os.getpid(), signal.SIGINT)
        while not presses():
            pass
        screen.write(answered := out.getvalue())
        assert sum("Ctrl-C: stopping" in row for row in screen.rows) == 1
        progress.flight(FlightProgress(1, 2, "after it", "", "", 1.0, 2.0, stopping=True))
        time.sleep(_DRAWN_S)
        screen.write(out.getvalue()[len(answered) :])
        assert sum("after it" in row for row in screen.rows) == 1
        assert not [row for row in screen.rows if "before it" in row]


def test_the_terminal_echoes_no_control_character_into_a_live_picture() -> None:
    """ "^C" at the end of the picture's last line moved the cursor, and one line of the old picture stayed until the flight's end."""
    termios = pytest.importorskip("termios")
    _, terminal = os.openpty()

    def echoes() -> bool:
        return bool(termios.tcgetattr(terminal)[3] & termios.ECHOCTL)

    assert echoes()
    with without_echoed_controls(terminal):
        assert not echoes()
        assert termios.tcgetattr(terminal)[3] & termios.ECHO, "an answer is typed"
    assert echoes()
    with tempfile.TemporaryFile() as file, without_echoed_controls(file.fileno()):
        pass


def test_the_answers_to_ctrl_c_fit_a_line_of_80_columns() -> None:
    """What does not is cut: the half that was lost was what a second press does."""
    assert max(map(len, (STOPPING, LEAVING))) < 80


def test_ctrl_c_is_answered_before_anything_looks_at_it(capfd: pytest.CaptureFixture[str]) -> None:
    with counted_interrupts() as presses:
        for words in ("stopping", "with the mode switch"):
            began = time.monotonic()
            os.kill(os.getpid(), signal.SIGINT)
            while words not in (said := capfd.readouterr().err) and time.monotonic() < began + 0.5:
                pass
            assert words in said
    assert presses() == 2


@pytest.mark.parametrize(
    ("short", "full"),
    [
        ("udp:", "udpin:0.0.0.0:14550"),
        ("udp:14551", "udpin:0.0.0.0:14551"),
        ("/dev/ttyACM0", "serial:/dev/ttyACM0:115200"),
        ("/dev/ttyUSB0", "serial:/dev/ttyUSB0:57600"),
        ("/dev/ttyUSB0:921600", "serial:/dev/ttyUSB0:921600"),
        ("COM7", "serial:COM7:57600"),
        ("tcp://host:5760", "tcp:host:5760"),
        ("serial:/dev/x", "serial:/dev/x"),
    ],
)
def test_short_names_of_links(short: str, full: str) -> None:
    assert full_url(short) == full
