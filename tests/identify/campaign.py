"""A campaign of the paper's vehicle, made without our integrator: closed forms for the loops, 1 ms steps for the velocity."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise, product

import numpy as np

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


def response(
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
) -> Segment:
    """One segment; refs: channel to (time from the step, value) with the first entry before everything."""
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
    constant = noise["disturbance"] * rng.standard_normal(3)
    kick = noise["gust"] * np.sqrt(2 * DT / 0.5) * rng.standard_normal((t.size, 3))
    drag = np.array([truth["d_x"], truth["d_y"], truth["d_z"]])
    v, f = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    gust = noise["gust"] * rng.standard_normal(3)
    at = 0.3 * rng.standard_normal(3) * (noise["disturbance"] > 0)
    for k in range(t.size):
        gust = gust * (1 - DT / 0.5) + kick[k]
        back = rotation[k].T
        v[k] = at
        f[k] = np.array([0, 0, a_t[k]]) - drag * (back @ at) + back @ (constant + gust)
        at = at + DT * (rotation[k] @ f[k] - np.array([0, 0, 9.81]))
    # Velocity at second order: the mean of neighbouring accelerations.
    a = np.einsum("kij,kj->ki", rotation, f) - np.array([0, 0, 9.81])
    v = v[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (a[1:] + a[:-1]), axis=0) * DT])
    step = round(1000 / rate_hz)
    some = slice(int(rng.integers(0, step)), None, step)
    n = t[some].size

    def noisy(x: np.ndarray, std: float) -> np.ndarray:
        return x[some] + std * rng.standard_normal(x[some].shape)

    fm, vm = noisy(f, noise["force"]), noisy(v, noise["velocity"])
    y = {
        "roll_rad": noisy(roll, noise["attitude"]), "pitch_rad": noisy(pitch, noise["attitude"]),
        "yaw_rad": noisy(yaw, noise["attitude"]),
        "r_rad_s": noisy(r, noise["rate"]), "voltage_v": voltage + noise["voltage"] * rng.standard_normal(n),
        "f_x_m_s2": fm[:, 0], "f_y_m_s2": fm[:, 1], "f_z_m_s2": fm[:, 2],
        "v_x_m_s": vm[:, 0], "v_y_m_s": vm[:, 1], "v_z_m_s": vm[:, 2],
    }  # fmt: skip
    base = 10.0 * float(rng.uniform(1, 50))
    u = {c: (np.array([at for at, _ in e]) + base, np.array([v for _, v in e])) for c, e in refs.items()}
    for c in ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s"):
        u.setdefault(c, (np.array([base - 9.0]), np.array([0.0])))
    return Segment(name, "run", kind, cell, repeat, base, t[some] + base, y, u, heading_rad=heading)


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
    made: list[Segment] = []

    def add(
        name: str, kind: str, cell: Mapping[str, float], repeat: int, refs: Refs, after_s: float, volts: float
    ) -> None:
        heading = np.pi / 2 * (repeat % 4)
        made.append(response(rng, name, kind, cell, repeat, refs, after_s, volts, truth, noise, rate_hz, heading))

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
    return made
