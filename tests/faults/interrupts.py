"""How soon Ctrl-C is answered in every state of a flight, measured at a terminal: `make faults-interrupts`.

The program runs in a process of its own on a pty; the key is pressed when its words, or its record, show the state.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from flighttest.sim import SimOptions, start_simulator

HEADING = "## Ctrl-C in every state"
LIMIT_S = 0.5
ANSWER = re.compile(rb"Ctrl-C: stopping|Ctrl-C again|stopped")
_KEY = b"\x03"
_REACHED_WITHIN_S = 600.0  # the state, also on a busy computer
_OVER_WITHIN_S = 120.0  # the program, after the key


@dataclass(frozen=True)
class Press:
    """One measurement. reached: whether the state was, and the key pressed; answered_s: from the key to the words, None where they did not
    come; ended_s: to the end of the program."""

    state: str
    answered_s: float | None
    ended_s: float | None
    code: int | None
    reached: bool = True

    @property
    def ok(self) -> bool:
        """Whether the operator was answered in time, and the program ended."""
        return self.answered_s is not None and self.answered_s < LIMIT_S and self.code is not None


def press(state: str, words: list[str], begun: Callable[[bytes], bool], folder: Path) -> Press:
    """Start the program, wait until `begun` says of its output so far that the state has come, press Ctrl-C once."""
    first, second = pty.openpty()
    fcntl.ioctl(first, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))

    def own_terminal() -> None:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    command = [sys.executable, "-m", "flighttest", *words]
    environment = dict(
        os.environ, TERM="xterm-256color", COLUMNS="120", PYTHONPATH=os.pathsep.join([*sys.path[:1], os.getcwd()])
    )
    program = subprocess.Popen(
        command, stdin=second, stdout=second, stderr=second, preexec_fn=own_terminal, cwd=folder, env=environment
    )
    os.close(second)
    said, pressed_s, answered_s, at = b"", None, None, 0
    deadline = time.monotonic() + _REACHED_WITHIN_S
    while time.monotonic() < deadline:
        ready, _, _ = select.select([first], [], [], 0.01)
        if ready:
            try:
                said += os.read(first, 65536)
            except OSError:  # the program has ended
                break
        now = time.monotonic()
        if pressed_s is None and begun(said):
            os.write(first, _KEY)
            pressed_s, at = now, len(said)
            deadline = now + _OVER_WITHIN_S
        if pressed_s is not None and answered_s is None and ANSWER.search(said, at):
            answered_s = now - pressed_s
    code = None
    with contextlib.suppress(subprocess.TimeoutExpired):
        code = program.wait(5.0)
    ended_s = time.monotonic() - pressed_s if pressed_s is not None and code is not None else None
    if code is None:
        program.kill()
        program.wait()
    os.close(first)
    (folder / "said.txt").write_bytes(said)
    return Press(state, answered_s, ended_s, code, reached=pressed_s is not None)


def shown(pattern: str) -> Callable[[bytes], bool]:
    """Whether the program has said that."""
    found = re.compile(pattern.encode())
    return lambda said: found.search(said) is not None


@contextlib.contextmanager
def keeper_of_logs() -> Iterator[str]:
    """A vehicle's onboard log behind a TCP port, read slowly enough to be interrupted."""
    from tests.link.test_onboard import Keeper

    keeper, over = Keeper(0.0), threading.Event()
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError):
            line, _ = server.accept()
            line.setblocking(False)
            while not over.wait(0.02):
                with contextlib.suppress(BlockingIOError):
                    keeper.send(line.recv(65536))
                line.sendall(keeper.receive(0.02))

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
    finally:
        over.set()
        server.close()


_UNUSED_PORT = 14999
_READY, _NO_POSITION, _NOT_READY = (1.0, 3.0), (1.0, 1e6), (1e6, 1.0)
"""When the vehicle can arm and has a position, s."""
IN_REAL_TIME: tuple[tuple[str, tuple[float, float], list[str], str], ...] = (
    ("reading parameters", _READY, ["--yes"], "reading parameters"),
    ("asking for telemetry", _READY, ["--yes"], "asking for telemetry"),
    ("waiting for a position", _NO_POSITION, ["--yes"], "position estimate"),
    ("preflight", _READY, ["--yes"], "checking the vehicle"),
    ("asking the operator", _READY, [], "disarmed, props clear"),
    ("arming", _NOT_READY, ["--yes"], "arming"),
    ("take-off", _READY, ["--yes"], "taking off"),
    ("on the way to a start", _READY, ["--yes"], "going to the start"),
    ("step", _READY, ["--yes"], "flying: "),
)
FAST = ["run", "spot_check", "--connect", "sim", "--speed", "20"]
AFTERWARDS: tuple[tuple[str, list[str], str], ...] = (
    ("connecting", ["run", "spot_check", "--connect", f"udpin:127.0.0.1:{_UNUSED_PORT}", "--yes"], "connecting"),
    ("landing", [*FAST, "--only", "fly"], "landing "),
    ("restoring parameters", [*FAST, "--only", "fly"], "restoring parameters"),
    ("writing", [*FAST, "--only", "fly"], "writing the channels"),
    ("cutting", FAST, "cutting the responses"),
    ("fitting", FAST, "fitting [0-9]+ responses"),
    ("writing the report", FAST, "writing the report"),
)
IN_DOWNLOADS = (("connecting to fetch a log", "connecting to"), ("log download", "downloading: [1-9]0 %"))


def measure(names: Collection[str] = ()) -> list[Press]:
    """Every state, or those named; a program of its own for each."""
    found = []

    def look(state: str, words: list[str], pattern: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            found.append(press(state, words, shown(pattern), Path(folder)))
        sys.stderr.write(f"{found[-1]}\n")

    for state, (ready_s, gps_s), yes, pattern in IN_REAL_TIME:
        if not names or state in names:
            with start_simulator(SimOptions(lockstep=False, paced=True, ready_s=ready_s, gps_s=gps_s)) as vehicle:
                look(state, ["run", "spot_check", "--connect", vehicle.url, *yes], pattern)
    for state, words, pattern in AFTERWARDS:
        if not names or state in names:
            look(state, words, pattern)
    for state, pattern in IN_DOWNLOADS:
        if not names or state in names:
            with keeper_of_logs() as url:
                look(state, ["fetch-log", "--connect", url, "-o", "a.BIN"], pattern)
    return found


def of_interrupts(found: list[Press]) -> str:
    """The page's part."""
    right = sum(p.ok for p in found)
    lines = [
        HEADING, "",
        "Written by `make faults-interrupts`: the program at a terminal of its own (a pty), the built-in vehicle in real time up to the",
        "first step, 20 times faster after it; the key is pressed once, when the state is shown. `answered` is the time until the terminal",
        f"shows an answer (at most {LIMIT_S:g} s), `over` until the program has ended: what is in the air is landed first.", "",
        f"{right} of {len(found)} are right.", "",
        "| state | answered, s | over, s | exit code |", "|---|---|---|---|",
    ]  # fmt: skip
    for p in found:
        answered = f"{p.answered_s:.3f}" if p.answered_s is not None else "no answer" if p.reached else "not reached"
        answered = answered if p.ok else f"**wrong:** {answered}"
        over = "never" if p.ended_s is None else f"{p.ended_s:.1f}"
        lines.append(f"| {p.state} | {answered} | {over} | {p.code} |")
    return "\n".join(lines) + "\n"
