"""A campaign of the paper's vehicle, made without our integrator: closed forms for the loops, 1 ms steps for the velocity."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.signal import lfilter

from flighttest.frames import rotation_from_euler
from flighttest.segments.model import Segment

TRUTH = {
    "omega_phi": 25.43, "omega_theta": 23.40, "zeta_phi": 0.44, "zeta_theta": 0.39, "sigma_r": 21.54, "sigma_t": 20.36,
    "K": 54.55, "alpha": 1.71, "d_x": 0.39, "d_y": 0.39, "d_z": 0.51, "T_d": 0.1037,
}  # fmt: skip
NOISE = {
    "attitude": 0.003,
    "rate": 0.02,
    "force": 0.3,
    "velocity": 0.05,
    "voltage": 0.01,
    "disturbance": 0.1,
    "gust": 0.1,
}
QUIET = dict.fromkeys(NOISE, 0.0)
COMBINATIONS = [*product((0.05, 0.10, 0.15), (0.20, 0.25, 0.30, 0.35, 0.40)), (0.20, 0.10), (0.25, 0.10), (0.30, 0.10)]
RECORD_S = {0.2: 2.0, 0.25: 1.2, 0.3: 0.9, 0.35: 0.7, 0.4: 0.55, 0.1: 1.0}  # what fits into the paper's zone
Refs = Mapping[str, list[tuple[float, float]]]
DT = 1e-3
BEFORE = 0.4


def second_order(t: np.ndarray, edges: list[tuple[float, float]], w: float, z: float) -> np.ndarray:
    """Exact response of w^2/(s^2 + 2 z w s + w^2) to a sequence of (time, value), at rest at the first value."""
    wd, value = w * np.sqrt(1 - z * z), np.full(t.shape, edges[0][1])
    for (_, a), (at, b) in pairwise(edges):
        s = np.clip(t - at, 0, None)
        value = value + (b - a) * (1 - np.exp(-z * w * s) * (np.cos(wd * s) + z * w / wd * np.sin(wd * s)))
    return value


def first_order(t: np.ndarray, edges: list[tuple[float, float]], sigma: float) -> np.ndarray:
    """Exact response of sigma/(s + sigma) to a sequence of (time, value)."""
    value = np.full(t.shape, edges[0][1])
    for (_, a), (at, b) in pairwise(edges):
        value = value + (b - a) * (1 - np.exp(-sigma * np.clip(t - at, 0, None)))
    return value


@dataclass
class Drawn:
    """A response before its velocity is known. t (n,), s; rotation (n, 3, 3) body to world; thrust (n,) and push (n, 3), world, m/s^2; drag
    (3,), 1/s; start (3,), m/s; segment: of the force (n, 3), body, and the velocity (n, 3), world."""

    t: np.ndarray
    rotation: np.ndarray
    thrust: np.ndarray
    push: np.ndarray
    drag: np.ndarray
    start: np.ndarray
    segment: Callable[[np.ndarray, np.ndarray], Segment]


def drawn(
    rng: np.random.Generator,
    name: str,
    kind: str,
    cell: Mapping[str, float],
    repeat: int,
    refs: Refs,
    after_s: float,
    voltage: float,
    truth: Mapping[str, float] = TRUTH,
    noise: Mapping[str, float] = NOISE,
    rate_hz: float = 50.0,
    heading: float = 0.0,
) -> Drawn:
    """One response; refs: channel to (time from the step, value) with the first entry before everything."""
    d = truth["T_d"]
    t = np.arange(-BEFORE, after_s, DT)
    late = {c: [(at + d, v) for at, v in e] for c, e in refs.items()}
    zero = [(-9.0, 0.0)]
    roll = second_order(t, late.get("roll_ref_rad", zero), truth["omega_phi"], truth["zeta_phi"])
    pitch = second_order(t, late.get("pitch_ref_rad", zero), truth["omega_theta"], truth["zeta_theta"])
    r = first_order(t, late.get("yaw_rate_ref_rad_s", zero), truth["sigma_r"])
    yaw = heading + np.cumsum(r) * DT
    gain = truth["K"] * (voltage / 22.2) ** truth["alpha"]
    a_t = gain * first_order(t, late["throttle"], truth["sigma_t"])
    rotation = rotation_from_euler(np.stack([roll, pitch, yaw], axis=1))
    push = noise["disturbance"] * rng.standard_normal(3)
    kick = noise["gust"] * np.sqrt(2 * DT / 0.5) * rng.standard_normal((t.size, 3))
    gust = lfilter(
        [1.0], [1.0, DT / 0.5 - 1.0], np.concatenate([[noise["gust"] * rng.standard_normal(3)], kick]), axis=0
    )
    at = 0.3 * rng.standard_normal(3) * (noise["disturbance"] > 0)
    step = round(1000 / rate_hz)
    some = slice(int(rng.integers(0, step)), None, step)
    n = t[some].size
    off = {
        name: std * rng.standard_normal(size)
        for name, std, size in (
            ("f", noise["force"], (n, 3)), ("v", noise["velocity"], (n, 3)),
            *((f"{angle}_rad", noise["attitude"], n) for angle in ("roll", "pitch", "yaw")),
            ("r_rad_s", noise["rate"], n), ("voltage_v", noise["voltage"], n),
        )
    }  # fmt: skip
    base = 10.0 * float(rng.uniform(1, 50))
    u = {c: (np.array([at for at, _ in e]) + base, np.array([v for _, v in e])) for c, e in refs.items()}
    for c in ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s"):
        u.setdefault(c, (np.array([base - 9.0]), np.array([0.0])))

    def segment(f: np.ndarray, v: np.ndarray) -> Segment:
        true = {
            "roll_rad": roll,
            "pitch_rad": pitch,
            "yaw_rad": yaw,
            "r_rad_s": r,
            "voltage_v": np.full(t.size, voltage),
        }
        y = {c: values[some] + off[c] for c, values in true.items()}
        y |= {c: (f[some] + off["f"])[:, k] for k, c in enumerate(("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"))}
        y |= {c: (v[some] + off["v"])[:, k] for k, c in enumerate(("v_x_m_s", "v_y_m_s", "v_z_m_s"))}
        return Segment(name, "run", kind, cell, repeat, base, t[some] + base, y, u, heading_rad=heading)

    drag = np.array([truth["d_x"], truth["d_y"], truth["d_z"]])
    return Drawn(t, rotation, a_t, push + gust[1:], drag, at, segment)


def flown(responses: Sequence[Drawn]) -> list[Segment]:
    """Their segments; all velocities are integrated side by side, the shorter with nothing behind their end."""
    m, most = len(responses), max(r.t.size for r in responses)
    rotation = np.zeros((most, m, 3, 3))
    lift, push, f = (np.zeros((most, m, 3)) for _ in range(3))
    for i, r in enumerate(responses):
        rotation[: r.t.size, i], lift[: r.t.size, i, 2], push[: r.t.size, i] = r.rotation, r.thrust, r.push
    drag, at = np.stack([r.drag for r in responses]), np.stack([r.start for r in responses])
    still = lift + np.einsum("kmji,kmj->kmi", rotation, push)
    for k in range(most):
        f[k] = still[k] - drag * np.einsum("mji,mj->mi", rotation[k], at)
        at = at + DT * (np.einsum("mij,mj->mi", rotation[k], f[k]) - [0.0, 0.0, 9.81])
    made = []
    for i, r in enumerate(responses):
        own = f[: r.t.size, i]
        # Velocity at second order: the mean of neighbouring accelerations.
        a = np.einsum("kij,kj->ki", r.rotation, own) - np.array([0, 0, 9.81])
        v = r.start + np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (a[1:] + a[:-1]), axis=0) * DT])
        made.append(r.segment(own, v))
    return made


def response(*given: Any, **options: Any) -> Segment:
    """The segment of one, as `drawn` is asked for it."""
    return flown([drawn(*given, **options)])[0]


def campaign(
    seed: int,
    truth: Mapping[str, float] = TRUTH,
    noise: Mapping[str, float] = NOISE,
    thrust_repeats: int = 4,
    tilt_repeats: int = 3,
    yaw_repeats: int = 2,
    rate_hz: float = 50.0,
) -> list[Segment]:
    """72 thrust, 36 attitude and 8 yaw responses, as in the paper."""
    rng = np.random.default_rng(seed)
    made: list[Drawn] = []

    def add(
        name: str, kind: str, cell: Mapping[str, float], repeat: int, refs: Refs, after_s: float, volts: float
    ) -> None:
        heading = np.pi / 2 * (repeat % 4)
        made.append(drawn(rng, name, kind, cell, repeat, refs, after_s, volts, truth, noise, rate_hz, heading))

    for repeat in range(thrust_repeats):
        for t0, t1 in COMBINATIONS:
            volts = 24.5 - 3.0 * ((len(made) * 29) % 72) / 71
            refs = {"throttle": [(-9.0, t0), (0.0, t1)]}
            add(
                f"t{len(made)}",
                "throttle_step",
                {"throttle_0": t0, "throttle_1": t1},
                repeat,
                refs,
                RECORD_S[t1],
                volts,
            )
    hover = 9.81 / (truth["K"] * (23 / 22.2) ** truth["alpha"])
    for axis in ("roll", "pitch"):
        for size, sign, repeat in product((0.2, 0.3, 0.5), (1, -1), range(tilt_repeats)):
            refs = {
                f"{axis}_ref_rad": [(-9.0, 0.0), (0.0, sign * size), (1.0, -sign * size), (2.0, 0.0)],
                "throttle": [(-9.0, hover), (0.0, hover / np.cos(size)), (2.0, hover)],
            }
            cell = {"amplitude_rad": sign * size}
            add(f"{axis}{size * sign}{repeat}", f"{axis}_step", cell, repeat, refs, 2.6, 23 + rng.uniform(-0.5, 0.5))
    for rate, sign, repeat in product((1.0, 2.0), (1, -1), range(yaw_repeats)):
        refs = {"yaw_rate_ref_rad_s": [(-9.0, 0.0), (0.0, sign * rate), (1.5, 0.0)], "throttle": [(-9.0, hover)]}
        add(f"yaw{rate * sign}{repeat}", "yaw_rate_step", {"rate_rad_s": sign * rate}, repeat, refs, 2.0, 23.0)
    return flown(made)
