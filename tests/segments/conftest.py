"""Synthetic recordings whose edges are known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from flighttest.frames import rotation_from_euler
from flighttest.recording import Marker, Provenance, Recording, Series

G = 9.81


@dataclass
class Flight:
    """Build a recording from references given as pieces; the vehicle follows with a delay and a lag.

    pieces: (duration s, roll, pitch, yaw rate, throttle). Rates in Hz of each group.
    """

    pieces: list[tuple[float, float, float, float, float]]
    rates: Mapping[str, float] = field(
        default_factory=lambda: {"attitude": 100.0, "specific_force": 100.0, "velocity": 25.0, "battery": 10.0}
    )
    target_hz: float = 50.0
    t0_s: float = 100.0
    delay_s: float = 0.05
    lag_s: float = 0.06
    markers: list[Marker] = field(default_factory=list)
    derived: dict[str, str] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        return sum(p[0] for p in self.pieces)

    def edges_s(self) -> list[float]:
        return [self.t0_s + float(t) for t in np.cumsum([p[0] for p in self.pieces])[:-1]]

    def reference(self, t_s: np.ndarray) -> np.ndarray:
        ends = np.cumsum([p[0] for p in self.pieces])
        index = np.minimum(np.searchsorted(ends, t_s - self.t0_s + 1e-9, side="right"), len(self.pieces) - 1)
        return np.array([p[1:] for p in self.pieces])[index]

    def response(self, t_s: np.ndarray) -> np.ndarray:
        """Second order with damping one, by superposition of the edges."""
        out = np.tile(np.array(self.pieces[0][1:]), (t_s.size, 1))
        for edge, before, after in zip(self.edges_s(), self.pieces[:-1], self.pieces[1:], strict=True):
            x = np.maximum(t_s - edge - self.delay_s, 0.0) / self.lag_s
            out += np.outer(1.0 - (1.0 + x) * np.exp(-x), np.array(after[1:]) - np.array(before[1:]))
        return out

    def recording(self) -> Recording:
        def times(hz: float, shift: float = 0.0) -> np.ndarray:
            return self.t0_s + shift + np.arange(round(self.duration_s * hz)) / hz

        series: dict[str, Series] = {}
        targets = times(self.target_hz)
        values = self.reference(targets)
        series["reference"] = Series(
            targets,
            dict(zip(("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle"), values.T, strict=True)),
        )
        for group, hz in self.rates.items():
            t = times(hz, 0.0003)
            y = self.response(t)
            yaw = np.cumsum(y[:, 2]) / hz + 3.0
            if group == "attitude":
                series[group] = Series(
                    t, {"roll_rad": y[:, 0], "pitch_rad": y[:, 1], "yaw_rad": (yaw + np.pi) % (2 * np.pi) - np.pi}
                )
                dt = 1.0 / hz
                series["rates"] = Series(
                    t, {"p_rad_s": np.gradient(y[:, 0], dt), "q_rad_s": np.gradient(y[:, 1], dt), "r_rad_s": y[:, 2]}
                )
            elif group == "specific_force":
                f = y[:, 3] * G / 0.25
                series[group] = Series(t, {"f_x_m_s2": 0 * f, "f_y_m_s2": 0 * f, "f_z_m_s2": f})
            elif group == "velocity":
                series[group] = Series(t, {"v_x_m_s": np.sin(t), "v_y_m_s": 0 * t, "v_z_m_s": 0 * t})
            elif group == "battery":
                series[group] = Series(t, {"voltage_v": 24.0 - 0.01 * (t - self.t0_s)})
        provenance = Provenance("made up", "table", derived=self.derived, filters={"specific_force": 20.0})
        return Recording("flight", series, tuple(sorted(self.markers, key=lambda m: m.t_s)), provenance)


HOVER = (0.0, 0.0, 0.0, 0.25)


def hover(seconds: float) -> tuple[float, float, float, float, float]:
    return (seconds, *HOVER)


@pytest.fixture
def fly() -> Callable[..., Flight]:
    return Flight


@pytest.fixture
def campaign() -> Flight:
    """Hover, roll step with counter-step, yaw rate step, throttle pair up, throttle pair down; no marks."""
    return Flight(
        [
            hover(1.0),
            (1.0, 0.3, 0.0, 0.0, 0.2617),
            (1.0, -0.3, 0.0, 0.0, 0.2617),
            hover(2.0),
            (1.5, 0.0, 0.0, -1.0, 0.25),
            hover(2.0),
            (0.6, 0.0, 0.0, 0.0, 0.1),
            (0.9, 0.0, 0.0, 0.0, 0.4),
            (0.7, 0.0, 0.0, 0.0, 0.1),
            hover(1.0),
            (1.0, 0.0, -0.2, 0.0, 0.255),
            hover(1.5),
        ]
    )


__all__ = ["Flight", "G", "rotation_from_euler"]
