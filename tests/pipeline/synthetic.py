"""A flight as a plain table, made here from the paper's equations in the plane (independent of the package's model)."""

from functools import cache
from math import cos, sin

import numpy as np

RATE_HZ = 50.0
SUB = 10  # integration steps per sample
OMEGA, ZETA, SIGMA_R, SIGMA_T, K, ALPHA, DRAG_Y, DRAG_Z, DELAY = 25.43, 0.44, 21.54, 20.36, 54.55, 1.71, 0.39, 0.51, 0.1
NOMINAL_V = 22.2
G = 9.81


def steps():
    """(start s, length s, roll, pitch, yaw rate, throttle) of every held reference, hover in between."""
    plan = []
    t = 2.0

    def hold(length, roll=0.0, pitch=0.0, rate=0.0, throttle=None):
        nonlocal t
        plan.append((t, length, roll, pitch, rate, throttle))
        t += length

    for _ in range(2):
        for tilt in (0.2, -0.2, 0.3, -0.3):
            hold(1.0, roll=tilt)
            hold(1.0, roll=-tilt)
            hold(2.5)
            hold(1.0, pitch=tilt)
            hold(1.0, pitch=-tilt)
            hold(2.5)
    for rate in (1.0, -1.0, 2.0, -2.0):
        hold(1.5, rate=rate)
        hold(2.0)
    for _ in range(3):
        for first, second in ((0.10, 0.25), (0.10, 0.30), (0.15, 0.25), (0.25, 0.10), (0.15, 0.30)):
            hold(0.6, throttle=first)
            hold(1.0, throttle=second)
            hold(0.6, throttle=0.18 - 0.5 * (second - 0.18))
            hold(2.5)
    return plan, t + 1.0


@cache
def course(gain):
    """What the vehicle does without noise, computed once: the measured columns (n, 13) and the references (n, 4)."""
    plan, total = steps()
    n = int(total * RATE_HZ)
    dt = 1.0 / RATE_HZ / SUB
    fine = np.arange(n * SUB) * dt
    volts = 24.5 - 3.0 * fine / total
    hover = G / (K * (volts / NOMINAL_V) ** ALPHA)
    u = np.zeros((fine.size, 4))
    u[:, 3] = hover
    for start, length, roll, pitch, rate, throttle in plan:
        at = (fine >= start) & (fine < start + length)
        u[at, :3] = roll, pitch, rate
        if throttle is not None:
            u[at, 3] = throttle
        elif roll or pitch:
            u[at, 3] = hover[at] / np.cos(roll) / np.cos(pitch)
    u = u.reshape(n, SUB, 4)[:, :1].repeat(SUB, axis=1).reshape(-1, 4)  # commands change at samples
    late = round(DELAY / dt)
    ud = np.concatenate([np.repeat(u[:1], late, axis=0), u[:-late]])
    thrust = gain * K * (volts / NOMINAL_V) ** ALPHA * ud[:, 3]
    phi = theta = dphi = dtheta = r = psi = v_x = v_y = v_z = 0.0
    a_t = G
    rows = np.zeros((n, 13))
    for k, (roll_ref, pitch_ref, rate_ref, _) in enumerate(ud.tolist()):
        cf, sf, ct, st, cp, sp = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
        # Columns of the rotation from body to world: its forward, left and up axes.
        forward = (cp * ct, sp * ct, -st)
        left = (cp * st * sf - sp * cf, sp * st * sf + cp * cf, ct * sf)
        up = (cp * st * cf + sp * sf, sp * st * cf - cp * sf, ct * cf)
        f_x = -DRAG_Y * (forward[0] * v_x + forward[1] * v_y + forward[2] * v_z)
        f_y = -DRAG_Y * (left[0] * v_x + left[1] * v_y + left[2] * v_z)
        f_z = a_t - DRAG_Z * (up[0] * v_x + up[1] * v_y + up[2] * v_z)
        psi_dot = (r / cf + sf / cf * dtheta) / ct
        if k % SUB == 0:
            p, q = dphi - st * psi_dot, cf * dtheta + sf * ct * psi_dot
            rows[k // SUB] = phi, theta, psi, p, q, r, f_x, f_y, f_z, v_x, v_y, v_z, volts[k]
        v_x += dt * (forward[0] * f_x + left[0] * f_y + up[0] * f_z)
        v_y += dt * (forward[1] * f_x + left[1] * f_y + up[1] * f_z)
        v_z += dt * (forward[2] * f_x + left[2] * f_y + up[2] * f_z - G)
        # Rates first, then angles: second-order accurate for an oscillator, up to half a step of delay.
        dphi += dt * (OMEGA**2 * (roll_ref - phi) - 2 * ZETA * OMEGA * dphi)
        dtheta += dt * (OMEGA**2 * (pitch_ref - theta) - 2 * ZETA * OMEGA * dtheta)
        phi, theta = phi + dt * dphi, theta + dt * dtheta
        r += dt * SIGMA_R * (rate_ref - r)
        psi += dt * psi_dot
        a_t += dt * SIGMA_T * (float(thrust[k]) - a_t)
    return rows, u.reshape(n, SUB, 4)[:, 0]


def flight(seed=0, gain=1.0):
    """Columns of a flight as a dict of arrays; gain scales K, as worn propellers would."""
    exact, refs = course(gain)
    rng = np.random.default_rng(seed)
    noise = np.array([2e-3] * 3 + [1e-2] * 3 + [0.1] * 3 + [0.02] * 3 + [0.01])
    rows = exact + noise * rng.normal(size=exact.shape)
    n = len(rows)
    names = [
        "roll_rad",
        "pitch_rad",
        "yaw_rad",
        "p_rad_s",
        "q_rad_s",
        "r_rad_s",
        "f_x_m_s2",
        "f_y_m_s2",
        "f_z_m_s2",
        "v_x_m_s",
        "v_y_m_s",
        "v_z_m_s",
        "voltage_v",
    ]
    table = {"t_s": np.arange(n) / RATE_HZ, **dict(zip(names, rows.T, strict=True))}
    table |= dict(zip(["roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle"], refs.T, strict=True))
    return table


def write_csv(path, until_s=np.inf, **options):
    """The flight as a CSV file, up to until_s."""
    whole = flight(**options)
    table = {name: column[whole["t_s"] < until_s] for name, column in whole.items()}
    header = ",".join(table)
    np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", header=header, comments="", fmt="%.6g")
    return path
