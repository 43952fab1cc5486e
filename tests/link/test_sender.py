"""Targets leave at their times from a thread of their own, and not at all once they are cancelled."""

from __future__ import annotations

import threading
import time

from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink.dialect import Message, dialect

WAIT_S = 0.04


class Kept:
    """A transport that keeps what is sent, and when."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, int]] = []

    def send(self, data: bytes) -> None:
        self.sent.append((time.monotonic(), threading.get_ident()))

    def receive(self, timeout_s: float) -> bytes:
        time.sleep(timeout_s)
        return b""

    def close(self) -> None:
        pass


def target() -> Message:
    return dialect.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.2)


def test_a_target_leaves_on_time_while_the_program_computes() -> None:
    kept = Kept()
    port = MavlinkPort(kept)
    shown: list[float] = []
    port.tap(lambda _frame, _message, ago_s=0.0: shown.append(time.monotonic() - ago_s))
    end = port.send_on_time()
    due_s = time.monotonic() + WAIT_S
    port.send_at(WAIT_S, target())
    while time.monotonic() < due_s + 0.1:
        sum(k * k for k in range(2000))  # no wait, no input or output
    port.receive(0.0)
    end()
    [(sent_s, thread)] = kept.sent
    assert 0.0 <= sent_s - due_s < 0.05  # some tenths of a millisecond on an idle machine
    assert thread != threading.get_ident()
    assert abs(shown[0] - sent_s) < 0.02, "recorded when it left, not when the program looked"
    assert port.late_s == 0.0, "nothing waits"


def test_nothing_leaves_after_a_take_over() -> None:
    for stop in (lambda session: session.port.mute(), lambda session: setattr(session, "held", True)):
        kept = Kept()
        session = Session(MavlinkPort(kept))
        session.port.send_on_time()
        session.send_at(session.now_s() + WAIT_S, target())
        stop(session)
        time.sleep(2.0 * WAIT_S)
        session.send_at(session.now_s(), target())
        time.sleep(0.5 * WAIT_S)
        session.port.close()
        assert kept.sent == []


def test_how_late_is_known_of_one_that_still_waits() -> None:
    kept = Kept()
    held_up = threading.Event()
    kept.send = lambda _data: held_up.wait(1.0)  # type: ignore[method-assign]
    port = MavlinkPort(kept)
    end = port.send_on_time()
    port.send_at(0.0, target())
    port.send_at(0.01, target())
    time.sleep(0.1)
    held_up_for_s = port.late_s
    held_up.set()
    time.sleep(0.05)
    assert held_up_for_s > 0.05
    assert port.late_s > 0.05
    port.forget_late()
    assert port.late_s == 0.0
    end()
