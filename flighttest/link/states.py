"""The states of the link to a vehicle, the events that change them, and the table of transitions. docs/operations.md is drawn from it."""

from __future__ import annotations

from collections import deque
from enum import Enum
from itertools import product

_KEPT = 200  # changes: a link that comes and goes for an hour must not fill the memory


class LinkState(Enum):
    """What is known of the link. The value is the sentence shown to the reader."""

    SEARCHING = "nothing has been heard of an autopilot"
    HEARD = "the vehicle is heard; whether it receives anything is not known (it has answered no TIMESYNC question yet)"
    BOTH_WAYS = "the vehicle is heard, and answers"
    QUIET = "nothing has been heard for 1.5 s"
    LOST = "nothing has been heard for 6 s: what waits for an answer ends with an error"
    ONE_WAY = "the vehicle is heard, and has answered nothing for 10 s: what waits for an answer ends with an error"

    __hash__ = object.__hash__  # looked up at every message; Enum's own calculates it anew from the name


class LinkEvent(Enum):
    """What changes a link's state. The value is the sentence shown to the reader."""

    MESSAGE = "a message of the vehicle arrives"
    ANSWER = "an answer to a TIMESYNC question arrives"
    PAUSE = "no message for 1.5 s"
    SILENCE = "no message for 6 s"
    UNANSWERED = "heard, but no answer for 10 s"
    BOOTED = "the vehicle's clock began anew"

    __hash__ = object.__hash__


S, E = LinkState, LinkEvent
_CONNECTED = (S.HEARD, S.BOTH_WAYS, S.ONE_WAY)
_AWAY = (S.QUIET, S.LOST)


def _table() -> dict[tuple[LinkState, LinkEvent], LinkState]:
    table = {
        (S.SEARCHING, E.MESSAGE): S.HEARD,
        **{(s, E.MESSAGE): s for s in _CONNECTED},
        **{(s, E.MESSAGE): S.HEARD for s in _AWAY},  # it may have come back one way only
        **{(s, E.ANSWER): S.BOTH_WAYS for s in (*_CONNECTED, *_AWAY)},
        **{(s, E.PAUSE): S.QUIET for s in _CONNECTED},
        **{(s, E.PAUSE): s for s in _AWAY},
        **{
            (s, E.SILENCE): S.LOST for s in (*_CONNECTED, *_AWAY)
        },  # without QUIET before it, where the link was not checked in between
        **{(s, E.UNANSWERED): S.ONE_WAY for s in _CONNECTED},
        **{(s, E.UNANSWERED): s for s in _AWAY},  # what is not heard cannot show whether it receives
        **{(s, E.BOOTED): S.HEARD for s in (*_CONNECTED, *_AWAY)},
    }
    # Before the first message no other event changes the state.
    table |= {(S.SEARCHING, e): S.SEARCHING for e in LinkEvent if e is not E.MESSAGE}
    return {place: table[place] for place in product(LinkState, LinkEvent)}


TABLE = _table()
BROKEN = frozenset({S.LOST, S.ONE_WAY})
"""States in which no answer can be expected."""


class LinkMachine:
    """The state of one link. changes: (vehicle time s, state, event, next state), the newest ones."""

    def __init__(self) -> None:
        self.state = LinkState.SEARCHING
        self.changes: deque[tuple[float, LinkState, LinkEvent, LinkState]] = deque(maxlen=_KEPT)

    def on(self, event: LinkEvent, t_s: float) -> LinkState:
        """Take in an event and return the state that follows."""
        before, self.state = self.state, TABLE[self.state, event]
        if self.state is not before:
            self.changes.append((t_s, before, event, self.state))
        return self.state


def link_as_markdown() -> str:
    """The table of transitions, and what the words mean."""
    lines = ["| state | " + " | ".join(e.name for e in LinkEvent) + " |", "|---|" + "---|" * len(LinkEvent)]
    for state in LinkState:
        cells = [TABLE[state, e].name if TABLE[state, e] is not state else "stays" for e in LinkEvent]
        lines.append(f"| {state.name} | " + " | ".join(cells) + " |")
    lines += ["", "| name | kind | meaning |", "|---|---|---|"]
    lines += [f"| {s.name} | state | {s.value} |" for s in LinkState]
    lines += [f"| {e.name} | event | {e.value} |" for e in LinkEvent]
    return "\n".join(lines) + "\n"
