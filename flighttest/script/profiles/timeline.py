"""`Piece` and `Timeline`: a response as a row of pieces, and the pure function of time they make.

A piece whose throttle is None flies level: the throttle that holds height at the present voltage, over the cosine of the tilt
unless the autopilot does that by itself. Everything else is as in the script, to the letter.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from flighttest.script.model import AttitudeTarget


@dataclass(frozen=True)
class Ramp:
    """From `start` to `end` over `duration_s`, then `end`."""

    start: float
    end: float
    duration_s: float

    def __call__(self, t_s: float) -> float:
        """Value at t_s from the piece's start."""
        share = min(max(t_s / self.duration_s, 0.0), 1.0)
        return self.start + share * (self.end - self.start)


@dataclass(frozen=True)
class Chirp:
    """A sine about `centre` whose frequency rises linearly from `from_hz` to `to_hz` over `duration_s`."""

    amplitude: float
    from_hz: float
    to_hz: float
    duration_s: float
    centre: float = 0.0

    def __call__(self, t_s: float) -> float:
        """Value at t_s from the piece's start."""
        slope = (self.to_hz - self.from_hz) / self.duration_s
        return self.centre + self.amplitude * math.sin(2.0 * math.pi * (self.from_hz + 0.5 * slope * t_s) * t_s)


Wave = float | Ramp | Chirp


def at(wave: Wave, t_s: float) -> float:
    """Value of a constant or a wave at t_s from its piece's start."""
    return wave(t_s) if isinstance(wave, (Ramp, Chirp)) else wave


@dataclass(frozen=True)
class Piece:
    """A stretch of a response: what is asked for `duration_s`. record: part of the response that is cut and fitted."""

    name: str
    duration_s: float
    roll_rad: Wave = 0.0
    pitch_rad: Wave = 0.0
    yaw_rate_rad_s: Wave = 0.0
    throttle: Wave | None = None
    record: bool = False


@dataclass(frozen=True)
class Timeline:
    """A pure function of time: call it with seconds from the leg's start.

    hover_throttle: the throttle that holds height now; angle_boost: the autopilot divides throttle by the cosine of the tilt
    by itself. Only pieces that fly level use them. After the last piece the target is level flight.
    """

    pieces: tuple[Piece, ...]
    hover_throttle: float
    angle_boost: bool = False
    _level: Piece = field(default=Piece("level", 0.0), repr=False)

    @cached_property
    def ends_s(self) -> tuple[float, ...]:
        """End of each piece, s from the start."""
        return tuple(accumulate(piece.duration_s for piece in self.pieces))

    @property
    def duration_s(self) -> float:
        """Length of all pieces, s."""
        return self.ends_s[-1] if self.pieces else 0.0

    def __call__(self, t_s: float) -> AttitudeTarget:
        """The target at t_s; an edge belongs to the piece that starts there."""
        # A nanosecond of slack, so that a scheduler's 0.30000000000000004 and 0.3 fall on the same side of an edge.
        index = bisect_right(self.ends_s, t_s + 1e-9)
        piece = self.pieces[index] if index < len(self.pieces) else self._level
        local = t_s - (self.ends_s[index - 1] if index else 0.0)
        roll, pitch = at(piece.roll_rad, local), at(piece.pitch_rad, local)
        if piece.throttle is None:
            tilt_cosine = 1.0 if self.angle_boost else math.cos(roll) * math.cos(pitch)
            throttle = self.hover_throttle / tilt_cosine
        else:
            throttle = at(piece.throttle, local)
        return AttitudeTarget(t_s, roll, pitch, at(piece.yaw_rate_rad_s, local), throttle)

    def table(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Targets (m, 4) at many rising times: roll rad, pitch rad, yaw rate rad/s, throttle."""
        targets = np.zeros((t_s.size, 4))
        targets[:, 3] = self.hover_throttle
        start = 0.0
        for piece, end in zip(self.pieces, self.ends_s, strict=True):
            low, high = np.searchsorted(t_s, (start - 1e-9, end - 1e-9))
            if high > low:
                local = t_s[low:high] - start
                turns = (piece.roll_rad, piece.pitch_rad, piece.yaw_rate_rad_s)
                for column, wave in enumerate(turns):
                    if wave != 0.0:
                        targets[low:high, column] = _over(wave, local)
                if piece.throttle is not None:
                    targets[low:high, 3] = _over(piece.throttle, local)
                elif not self.angle_boost and turns[:2] != (0.0, 0.0):
                    targets[low:high, 3] /= np.cos(targets[low:high, 0]) * np.cos(targets[low:high, 1])
            start = end
        return targets


def _over(wave: Wave, local_s: NDArray[np.float64]) -> NDArray[np.float64] | float:
    return np.array([at(wave, float(t)) for t in local_s]) if isinstance(wave, (Ramp, Chirp)) else wave
