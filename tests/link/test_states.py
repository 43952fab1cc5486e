"""The table of the link: complete, every transition, and the session that follows it."""

from __future__ import annotations

from itertools import product

import pytest

from flighttest.link.clock import FollowedClock
from flighttest.link.port import MavlinkPort
from flighttest.link.session import LOST_S, QUIET_S, UNANSWERED_S, LinkSilent, Session
from flighttest.link.states import BROKEN, TABLE, LinkEvent, LinkMachine, LinkState, link_as_markdown
from flighttest.mavlink.dialect import dialect, parser

S, E = LinkState, LinkEvent
CHANGES = {
    (S.SEARCHING, E.MESSAGE): S.HEARD,
    (S.HEARD, E.ANSWER): S.BOTH_WAYS,
    (S.HEARD, E.PAUSE): S.QUIET,
    (S.HEARD, E.SILENCE): S.LOST,
    (S.HEARD, E.UNANSWERED): S.ONE_WAY,
    (S.BOTH_WAYS, E.PAUSE): S.QUIET,
    (S.BOTH_WAYS, E.SILENCE): S.LOST,
    (S.BOTH_WAYS, E.UNANSWERED): S.ONE_WAY,
    (S.BOTH_WAYS, E.BOOTED): S.HEARD,
    (S.QUIET, E.MESSAGE): S.HEARD,
    (S.QUIET, E.ANSWER): S.BOTH_WAYS,
    (S.QUIET, E.SILENCE): S.LOST,
    (S.QUIET, E.BOOTED): S.HEARD,
    (S.LOST, E.MESSAGE): S.HEARD,
    (S.LOST, E.ANSWER): S.BOTH_WAYS,
    (S.LOST, E.BOOTED): S.HEARD,
    (S.ONE_WAY, E.ANSWER): S.BOTH_WAYS,
    (S.ONE_WAY, E.PAUSE): S.QUIET,
    (S.ONE_WAY, E.SILENCE): S.LOST,
    (S.ONE_WAY, E.BOOTED): S.HEARD,
}
"""Written by hand: what the table is held to. Everything else changes nothing."""


@pytest.mark.parametrize(("state", "event"), list(product(LinkState, LinkEvent)))
def test_every_transition(state: LinkState, event: LinkEvent) -> None:
    machine = LinkMachine()
    machine.state = state
    wanted = CHANGES.get((state, event), state)
    assert machine.on(event, 1.0) is wanted
    assert list(machine.changes) == ([(1.0, state, event, wanted)] if wanted is not state else [])


def test_an_answer_ends_every_loss_and_nothing_else_calls_it_both_ways() -> None:
    assert all(TABLE[s, E.ANSWER] is S.BOTH_WAYS for s in BROKEN)
    assert {e for (s, e), n in TABLE.items() if n is S.BOTH_WAYS and s is not S.BOTH_WAYS} == {E.ANSWER}


def test_the_table_of_the_docs_has_every_change() -> None:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in link_as_markdown().splitlines()]
    events = rows[0][1:]
    shown = {row[0]: dict(zip(events, row[1:], strict=True)) for row in rows[2 : 2 + len(LinkState)]}
    for (state, event), following in CHANGES.items():
        assert shown[state.name][event.name] == following.name


class Vehicle:
    """Sends once a second and answers TIMESYNC, where it may. sends, answers: whether it does now."""

    def __init__(self) -> None:
        self.now_s, self.sends, self.answers = 1000.0, True, True
        self._mav, self._ours, self._next_s, self._out = parser(1, 1), parser(1, 1), 0.0, b""

    def send(self, data: bytes) -> None:
        for message in self._ours.parse_buffer(data) or []:
            if message.get_type() == "TIMESYNC" and not message.tc1 and self.answers:
                self._say(dialect.MAVLink_timesync_message(int(self.now_s * 1e9), message.ts1))

    def _say(self, message: object) -> None:
        if self.sends:
            self._out += bytes(message.pack(self._mav))  # type: ignore[attr-defined]
            self._mav.seq = (self._mav.seq + 1) % 256

    def receive(self, timeout_s: float) -> bytes:
        self.now_s += max(timeout_s, 1e-3)
        if self.now_s >= self._next_s:
            self._next_s = self.now_s + 1.0
            self._say(dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3))
        data, self._out = self._out, b""
        return data if timeout_s > 0.0 else b""

    def close(self) -> None:
        pass


def test_a_session_goes_through_the_states_and_shows_who_waits() -> None:
    vehicle = Vehicle()
    session = Session(MavlinkPort(vehicle), FollowedClock(lambda: vehicle.now_s, lambda: vehicle.now_s))
    assert session.link.state is S.SEARCHING

    def pass_s(span_s: float) -> LinkState:
        session.advance(session.now_s() + span_s)
        return session.look_at_link()

    session.connect()
    assert pass_s(2.0) is S.BOTH_WAYS
    vehicle.sends = False
    assert pass_s(QUIET_S + 1.2) is S.QUIET
    session.require_link()
    assert pass_s(LOST_S) is S.LOST
    with pytest.raises(LinkSilent, match="nothing has been heard"):
        session.require_link()
    vehicle.sends, vehicle.answers = True, False
    assert pass_s(2.0) is S.HEARD
    assert pass_s(UNANSWERED_S + 2.0) is S.ONE_WAY
    with pytest.raises(LinkSilent, match="one direction"):
        session.require_link()
    vehicle.answers = True
    assert pass_s(3.0) is S.BOTH_WAYS
    session.require_link()
    assert [n for *_, n in session.link.changes][-5:] == [S.QUIET, S.LOST, S.HEARD, S.ONE_WAY, S.BOTH_WAYS]
