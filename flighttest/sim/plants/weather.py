"""Moving air: gusts as coloured noise (first-order Dryden spectra), off by default, the same for the same seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flighttest.sim.noise import NoiseStream


@dataclass(frozen=True)
class Gusts:
    """rms_m_s: of the horizontal gust speed per axis (vertical: 0.6 of it); scale_s: correlation time at hover, s."""

    rms_m_s: float = 0.0
    scale_s: float = 2.0


class Air:
    """The air's velocity over the ground beyond any steady wind, m/s, NWU: `x`, `y`, `z`."""

    def __init__(self, gusts: Gusts, noise: NoiseStream) -> None:
        self._gusts, self._noise = gusts, noise
        self.calm = gusts.rms_m_s <= 0.0
        self.x = self.y = self.z = 0.0

    def advance(self, dt_s: float) -> None:
        """Let the gusts change for dt_s, s."""
        if self.calm:
            return
        keep = math.exp(-dt_s / self._gusts.scale_s)
        kick = self._gusts.rms_m_s * math.sqrt(1.0 - keep * keep)
        draw = self._noise.draw
        self.x = keep * self.x + kick * draw()
        self.y = keep * self.y + kick * draw()
        self.z = keep * self.z + 0.6 * kick * draw()
