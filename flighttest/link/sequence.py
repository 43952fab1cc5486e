"""Frames of two senders under one system id, told apart by their sequence numbers: each MAVLink sender counts its own frames."""

from __future__ import annotations

from collections import deque

# Frames of one sender lost in a row (0.2 s of a full link), or overtaken. As many either way: a frame of another sender that is taken for
# the next one must not make foreign ones of those that follow.
_NEAR = 64
_ALIVE_S = 0.3  # a sender that is silent for longer may have counted on past that
_RECENT = 1024  # frames among which a repeated one is looked for
ENOUGH = 3  # foreign frames: one or two may be a router's or a restarted link's


class Sequence:
    """Follows the sender that was heard first. foreign_frames: frames of another one, since that one went on counting where it was."""

    def __init__(self) -> None:
        self.foreign_frames = 0
        self._last: int | None = None
        self._heard_s = 0.0
        self._apart = 0  # frames that do not follow, since the last one that does
        self._recent: deque[int] = deque(maxlen=_RECENT)
        self._known: set[int] = set()

    def foreign(self, sequence: int, frame: bytes, t_s: float) -> bool:
        """Whether a frame is another sender's, as far as can be told at t_s."""
        if self._repeated(frame):
            return False
        step = 1 if self._last is None else (sequence - self._last + 128) % 256 - 128
        if 1 <= step <= _NEAR:
            self.foreign_frames += self._apart
        elif -_NEAR <= step <= 0:
            return False  # overtaken on the way
        elif 0.0 <= t_s - self._heard_s <= _ALIVE_S:
            self._apart += 1
            return True
        self._last, self._heard_s, self._apart = sequence, t_s, 0
        return False

    def _repeated(self, frame: bytes) -> bool:
        """Whether the same bytes came before: a link that doubles frames, or two ways to here."""
        key = hash(frame)
        if key in self._known:
            return True
        if len(self._recent) == _RECENT:
            self._known.discard(self._recent[0])
        self._recent.append(key)
        self._known.add(key)
        return False
