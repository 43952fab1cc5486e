"""Recordings of a known vehicle with a concealed effect, in plain numpy: Eq. 4 and the effect written out here once more.

Nothing of `physics` is used. All responses are integrated side by side (Euler at 1 kHz, an arbitrary choice unlike the fit's).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flighttest.frames import rotation_from_euler
from flighttest.segments.model import Segment

TRUE = {
    "w": (25.43, 23.4), "zeta": (0.6, 0.55), "sigma_r": 21.54, "sigma_t": 20.36, "K": 54.55, "alpha": 1.71,
    "d": (0.39, 0.39, 0.51), "T_d": 0.1, "U_n": 22.2, "g": 9.81,
}  # fmt: skip
DT = 0.001
RATE_HZ = 50


@dataclass
class Step:
    """One response to be flown."""

    kind: str
    cell: dict[str, float]
    duration: float
    roll: float = 0.0
    pitch: float = 0.0
    yaw_rate: float = 0.0
    throttle: tuple[float, float] | None = None
    height: float = 5.0
    repeat: int = 0
    heading: float = 0.0
    voltage: float = 23.0
    v0: tuple[float, float, float] = (0.0, 0.0, 0.0)
    context: dict[str, float] = field(default_factory=dict)


def campaign(repeats: int = 3, throttles: bool = True, tilts: bool = True, yaws: bool = True) -> list[Step]:
    """A short form of the paper's campaign."""
    steps: list[Step] = []
    headings = (0.0, np.pi / 2, np.pi, -np.pi / 2)
    for r in range(repeats):
        if tilts:
            for axis in ("roll", "pitch"):
                for size in (0.2, 0.3, 0.5):
                    for sign in (1, -1):
                        value = sign * size
                        steps.append(
                            Step(
                                f"{axis}_step", {"amplitude_rad": value}, 1.6, repeat=r, height=3.0 + r, **{axis: value}
                            )
                        )
        if yaws:
            for rate in (1.0, 2.0):
                for sign in (1, -1):
                    steps.append(
                        Step("yaw_rate_step", {"rate_rad_s": sign * rate}, 1.0, yaw_rate=sign * rate, repeat=r)
                    )
        if throttles:
            pairs = [(a, b) for a in (0.05, 0.1, 0.15) for b in (0.2, 0.3, 0.4)] + [(a, 0.1) for a in (0.2, 0.25, 0.3)]
            for a, b in pairs:
                height = 4.0 if r % 2 else 1.5
                steps.append(
                    Step("throttle_step", {"throttle_0": a, "throttle_1": b}, 1.1, throttle=(a, b), repeat=r, height=height,
                         v0=(0.0, 0.0, -2.0 if b > 0.15 else 1.5))
                )  # fmt: skip
    rng = np.random.default_rng(len(steps))
    order = rng.permutation(len(steps))
    for at, k in enumerate(order):
        steps[k].voltage = 24.5 - 3.0 * at / len(steps)
        steps[k].context["since"] = 20.0 + 6.0 * at
    for k, s in enumerate(steps):
        s.heading = headings[(s.repeat + k) % 4]
    return steps


def fly(steps: list[Step], seed: int = 0, noise: float = 1.0, pre: float = 0.3, **hidden) -> list[Segment]:
    """Segments of the steps. hidden: wind=(n,w,u), bias=(x,y,z), ground=R2, quadratic=k, lift=k, boost=b, sag=(V,s), offset=(r,p),
    asymmetry=ln, gust=(responses, m/s^2), rate_limit=rad/s, rotor_lag=1, latency=s, payload=(ratio, length), fade=(depth, s), curve=c,
    hubs=(m_u, l_v, m_w, 1/s of integrators), integral=1/s of the rate loop, strange=gain (no catalogue entry)."""
    rng = np.random.default_rng(seed)
    m = len(steps)
    longest = max(s.duration for s in steps) + pre
    n = int(longest / DT) + 1
    p = TRUE
    every = int(1 / RATE_HZ / DT)
    hover_t = p["g"] / p["K"]

    volts = np.array([s.voltage for s in steps])
    since = np.array([s.context.get("since", 60.0) for s in steps])
    hover = hover_t * (p["U_n"] / volts) ** p["alpha"]
    t0 = np.array([s.throttle[0] if s.throttle else np.nan for s in steps])
    t1 = np.array([s.throttle[1] if s.throttle else np.nan for s in steps])
    boosted = hidden.get("boost", 0.0)
    tilt = np.array([s.roll for s in steps]), np.array([s.pitch for s in steps])
    cosine = np.cos(tilt[0]) * np.cos(tilt[1])
    # The companion computer holds height by the tilt: hover / cos(tilt) where the autopilot does not boost.
    level = np.where(np.isnan(t1), hover, t1)
    after = np.where(np.isnan(t1), hover / (1.0 if boosted else cosine), t1)
    before = np.where(np.isnan(t0), level, t0)

    heading = np.array([s.heading for s in steps])
    v = np.array([s.v0 for s in steps]) + rng.normal(0, 0.1, (m, 3))
    a_d = rng.normal(0, 0.05 * noise, (m, 3))
    if "gust" in hidden:
        a_d[list(hidden["gust"][0]), 0] += hidden["gust"][1]
    pos = np.stack([np.zeros(m), np.zeros(m), [s.height for s in steps]], axis=1)
    ang, rate = np.zeros((m, 2)), np.zeros((m, 2))
    yaw, r = heading.copy(), np.zeros(m)
    u_factor = (volts / p["U_n"]) ** p["alpha"]
    gain = p["K"] * u_factor
    a_t = gain * before
    omega_sqrt = np.sqrt(np.maximum(a_t, 1e-3))
    load = a_t / p["K"]
    swing, swing_rate = np.zeros((m, 2)), np.zeros((m, 2))
    w, zeta = np.array(p["w"]), np.array(p["zeta"])
    d = np.array(p["d"])
    wind = np.array(hidden.get("wind", (0.0, 0.0, 0.0)))
    keep = {k: [] for k in ("t", "ang", "yaw", "r", "rate", "f", "v", "p", "v_dot", "u")}
    v_dot, trimmed, integral = np.zeros((m, 3)), np.zeros((m, 2)), np.zeros((m, 2))
    for i in range(n):
        t = i * DT - pre
        on = t >= p["T_d"]
        ref = np.stack([tilt[0], tilt[1]], axis=1) * on
        r_ref = np.array([s.yaw_rate for s in steps]) * on
        throttle = np.where(on, after, before)
        if boosted:
            throttle = throttle * (1 + boosted * (1 / np.cos(ref[:, 0]) / np.cos(ref[:, 1]) - 1))
        rot = rotation_from_euler(np.stack([ang[:, 0], ang[:, 1], yaw], axis=1))
        air = np.einsum("mji,mj->mi", rot, v - wind)
        u_acting = volts
        if "sag" in hidden:
            volt, tau = hidden["sag"]
            load = load + DT / tau * (a_t / p["K"] - load)
            u_acting = volts - volt * (a_t / p["K"] - load)
        command = p["K"] * (u_acting / p["U_n"]) ** p["alpha"] * throttle
        if "curve" in hidden:
            command = command * (1 + hidden["curve"] * (throttle * p["K"] / p["g"] - 1))
        if "fade" in hidden:
            depth, tau = hidden["fade"]
            command = command * (1 - depth * (1 - np.exp(-(since + t) / tau)))
        sigma = p["sigma_t"]
        if "asymmetry" in hidden:
            sigma = sigma * np.exp(0.5 * hidden["asymmetry"] * np.sign(command - a_t))
        if hidden.get("rotor_lag"):
            omega_sqrt = omega_sqrt + DT * sigma * (np.sqrt(np.maximum(command, 0)) - omega_sqrt)
            a_t = omega_sqrt**2
        else:
            a_t = a_t + DT * sigma * (command - a_t)
        aero = np.ones(m)
        if "ground" in hidden:
            z = pos[:, 2] + 0.2
            aero = aero / (1 - np.minimum(hidden["ground"] / (16 * z**2), 0.4))
        if "lift" in hidden:
            aero = aero * (1 + hidden["lift"] * (air[:, 0] ** 2 + air[:, 1] ** 2))
        if "inflow" in hidden:
            aero = aero * (1 - hidden["inflow"] * air[:, 2] * np.sqrt(p["g"] / np.maximum(a_t, 0.05)))
        force = np.stack([np.zeros(m), np.zeros(m), a_t * aero], axis=1) - d * air
        if "quadratic" in hidden:
            force = force - hidden["quadratic"] * np.abs(air) * air
        if "offset" in hidden:
            o_r, o_p = hidden["offset"]
            force = force + (a_t * aero)[:, None] * np.array([np.sin(o_p), -np.sin(o_r), np.cos(o_p) * np.cos(o_r) - 1])
        if "strange" in hidden:
            force[:, 2] += hidden["strange"] * np.sin(1.2 * pos[:, 2])
        force = force + np.einsum("mji,mj->mi", rot, a_d)
        if "payload" in hidden:
            ratio, length = hidden["payload"]
            f_world = np.einsum("mij,mj->mi", rot, force)
            g_eff = f_world[:, 2] / (1 + ratio)
            pull = np.concatenate([ratio * g_eff[:, None] * swing, -(ratio * g_eff)[:, None]], axis=1)
            accel = f_world[:, :2] + pull[:, :2]
            swing_acc = -(g_eff[:, None] * swing + accel) / length - 2 * 0.03 * np.sqrt(9.81 / length) * swing_rate
            swing_rate = swing_rate + DT * swing_acc
            swing = swing + DT * swing_rate
            force = force + np.einsum("mji,mj->mi", rot, pull)
        v_dot = np.einsum("mij,mj->mi", rot, force) - np.array([0, 0, p["g"]])
        if i % every == 0:
            yaw_dot = (r / np.cos(ang[:, 0]) + np.tan(ang[:, 0]) * rate[:, 1]) / np.cos(ang[:, 1])
            body_p = rate[:, 0] - np.sin(ang[:, 1]) * yaw_dot
            body_q = np.cos(ang[:, 0]) * rate[:, 1] + np.sin(ang[:, 0]) * np.cos(ang[:, 1]) * yaw_dot
            keep["t"].append(t)
            keep["ang"].append(ang.copy())
            keep["yaw"].append(yaw.copy())
            keep["r"].append(r.copy())
            keep["rate"].append(np.stack([body_p, body_q], axis=1))
            keep["f"].append(force + np.array(hidden.get("bias", (0.0, 0.0, 0.0))))
            keep["v"].append(v - hidden.get("latency", 0.0) * v_dot)
            keep["p"].append(pos.copy())
        wanted = w / (2 * zeta) * (ref - ang)
        limit = hidden.get("rate_limit", np.inf)
        acc = 2 * zeta * w * (np.clip(wanted, -limit, limit) - rate)
        if "integral" in hidden:
            integral, acc = integral + DT * acc, acc + hidden["integral"] * integral
        if "hubs" in hidden:
            m_u, l_v, m_w, trim = hidden["hubs"]
            moments = np.stack([l_v * air[:, 1], m_w * air[:, 2] - m_u * air[:, 0]], axis=1)
            acc = acc + moments - trimmed
            trimmed = trimmed + DT * trim * (moments - trimmed)
        yaw = yaw + DT * (r / np.cos(ang[:, 0]) + np.tan(ang[:, 0]) * rate[:, 1]) / np.cos(ang[:, 1])
        ang, rate = ang + DT * rate, rate + DT * acc
        r = r + DT * p["sigma_r"] * (r_ref - r)
        pos, v = pos + DT * v, v + DT * v_dot

    data = {k: np.array(x) for k, x in keep.items() if x}
    found = []
    for j, s in enumerate(steps):
        use = data["t"] <= s.duration
        t = data["t"][use] + since[j]
        size = t.size

        def noisy(values, std):
            return values + rng.normal(0, std * noise, values.shape)

        y = {
            "roll_rad": noisy(data["ang"][use, j, 0], 0.002), "pitch_rad": noisy(data["ang"][use, j, 1], 0.002),
            "yaw_rad": noisy(data["yaw"][use, j], 0.002), "p_rad_s": noisy(data["rate"][use, j, 0], 0.01),
            "q_rad_s": noisy(data["rate"][use, j, 1], 0.01), "r_rad_s": noisy(data["r"][use, j], 0.01),
            "voltage_v": np.full(size, s.voltage) + rng.normal(0, 0.01, size), "height_m": noisy(data["p"][use, j, 2], 0.01),
        }  # fmt: skip
        for k, axis in enumerate("xyz"):
            y[f"f_{axis}_m_s2"] = noisy(data["f"][use, j, k], 0.1)
            y[f"v_{axis}_m_s"] = noisy(data["v"][use, j, k], 0.03)
        u = {}
        edge = np.array([since[j] - 2.0, since[j]])
        for name, a, b in (
            ("roll_ref_rad", 0.0, s.roll), ("pitch_ref_rad", 0.0, s.pitch), ("yaw_rate_ref_rad_s", 0.0, s.yaw_rate),
            ("throttle", before[j], after[j]),
        ):  # fmt: skip
            u[name] = (edge, np.array([a, b]))
        found.append(
            Segment(
                name=f"{s.kind}-{j}", run="synthetic", kind=s.kind, cell=s.cell, repeat=s.repeat, t_step_s=float(since[j]), t_s=t,
                y=y, u=u, maneuver={"r": "roll_pitch", "p": "roll_pitch", "y": "yaw_rate", "t": "thrust"}[s.kind[0]],
                heading_rad=s.heading, time_since_takeoff_s=float(since[j]),
            )
        )  # fmt: skip
    return found
