"""The paper's vehicle: Eq. 4 with Table 2, written out once more in plain numbers, independent of `physics`.

Nothing shapes the references and nothing boosts the throttle, so Table 2 can be recovered from what this vehicle sends. All three
channels answer T_d after a target's arrival. Physics beyond Eq. 4 comes from the catalogue: see `plant_terms`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import cos, sin, sqrt

from flighttest.errors import InputError
from flighttest.frames import G_M_S2
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import Command, Delays, Motion
from flighttest.sim.plants.weather import Air

TICK_S = 0.005
_STEP_MAX_S = 0.005  # the fastest loop turns 0.13 rad in it: the error of one Runge-Kutta step is below 1e-7
HOVER_CURRENT_A = 24.0
HARD_LANDING_M_S = 4.0
_LEVEL = Command()


@dataclass(frozen=True)
class PaperParameters:
    """The paper's twelve, Table 2, and U_n: rad/s, 1, 1/s, m/s^2, s, V."""

    omega_phi: float = 25.43
    omega_theta: float = 23.40
    zeta_phi: float = 0.44
    zeta_theta: float = 0.39
    sigma_r: float = 21.54
    sigma_t: float = 20.36
    K: float = 54.55
    alpha: float = 1.71
    d_x: float = 0.39
    d_y: float = 0.39
    d_z: float = 0.51
    T_d: float = 0.1
    nominal_voltage_v: float = 22.2

    def changed(self, values: Mapping[str, float]) -> PaperParameters:
        """These with some replaced by name; InputError for a name that is not one of them."""
        known = {f.name for f in fields(self)}
        for name in values:
            if name not in known:
                raise InputError(f"the paper vehicle has no parameter {name!r}", f"it has {', '.join(sorted(known))}")
        return replace(self, **values)


def hover_throttle(parameters: PaperParameters, voltage_v: float) -> float:
    """Throttle that carries the weight at a voltage, V."""
    gain: float = parameters.K * (voltage_v / parameters.nominal_voltage_v) ** parameters.alpha
    return G_M_S2 / gain


class PaperPlant:
    """Eq. 4 in motion (a `Plant`)."""

    tick_s = TICK_S

    def __init__(
        self, parameters: PaperParameters | None = None, battery: Battery | None = None, air: Air | None = None
    ):
        self.parameters = parameters or PaperParameters()
        self.battery = battery or Battery()
        self.motion = Motion(voltage=self.battery.voltage)
        t_d = self.parameters.T_d
        self.delays = Delays(t_d, t_d, t_d)
        self.hover_throttle = hover_throttle(self.parameters, self.battery.voltage)
        self._air = air
        # roll, roll rate, pitch, pitch rate, r, yaw, a_t, v (3), p (3)
        self._x: tuple[float, ...] = (0.0,) * 13
        self._frozen = False

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V."""
        self.battery.replace(voltage_v)

    def advance(self, dt_s: float, command: Command) -> None:
        """Move on by dt_s, s, under a constant command."""
        steps = int(dt_s / _STEP_MAX_S - 1e-9) + 1
        h = dt_s / steps
        for _ in range(steps):
            self._step(h, command)

    def _step(self, h: float, command: Command) -> None:
        m, battery, b = self.motion, self.battery, self.parameters
        throttle = command.throttle if command.spinning else 0.0
        ratio: float = (battery.voltage_ahead(0.5 * h) / b.nominal_voltage_v) ** b.alpha
        gain: float = b.K * ratio
        if self._air is not None:
            self._air.advance(h)
        self._fly(h, command if not m.on_ground else _LEVEL, gain * throttle)
        a_t = self._x[6]
        load = a_t / G_M_S2 if a_t > 0.0 else 0.0
        battery.draw((0.4 if command.spinning else 0.2) + HOVER_CURRENT_A * load * sqrt(load), h)
        m.voltage, m.current = battery.voltage, battery.current
        m.shaped_roll, m.shaped_pitch, m.shaped_yaw_rate = command.roll, command.pitch, command.yaw_rate

    def _fly(self, h: float, command: Command, thrust: float) -> None:
        b, m = self.parameters, self.motion
        wr, wp = b.omega_phi, b.omega_theta
        kr, kp, cr2, cp2 = wr * wr, wp * wp, 2.0 * b.zeta_phi * wr, 2.0 * b.zeta_theta * wp
        roll_ref, pitch_ref, r_ref, sr, st = command.roll, command.pitch, command.yaw_rate, b.sigma_r, b.sigma_t
        dx, dy, dz = b.d_x, b.d_y, b.d_z
        wx = wy = wz = 0.0
        if self._air is not None:
            wx, wy, wz = self._air.x, self._air.y, self._air.z

        def rates(x: tuple[float, ...]) -> tuple[float, ...]:
            phi, phi_d, th, th_d, r, psi, a_t, vx, vy, vz, _, _, _ = x
            sf, cf, s, c, sy, cy = sin(phi), cos(phi), sin(th), cos(th), sin(psi), cos(psi)
            # rows of R, body to world
            r00, r01, r02 = cy * c, cy * s * sf - sy * cf, cy * s * cf + sy * sf
            r10, r11, r12 = sy * c, sy * s * sf + cy * cf, sy * s * cf - cy * sf
            r20, r21, r22 = -s, c * sf, c * cf
            ax, ay, az = vx - wx, vy - wy, vz - wz
            ux = -dx * (r00 * ax + r10 * ay + r20 * az)
            uy = -dy * (r01 * ax + r11 * ay + r21 * az)
            uz = a_t - dz * (r02 * ax + r12 * ay + r22 * az)
            return (
                phi_d,
                kr * (roll_ref - phi) - cr2 * phi_d,
                th_d,
                kp * (pitch_ref - th) - cp2 * th_d,
                sr * (r_ref - r),
                (r / cf + sf / cf * th_d) / c,
                st * (thrust - a_t),
                r00 * ux + r01 * uy + r02 * uz,
                r10 * ux + r11 * uy + r12 * uz,
                r20 * ux + r21 * uy + r22 * uz - G_M_S2,
                vx,
                vy,
                vz,
                ux,
                uy,
                uz,
            )

        x = self._x
        half = 0.5 * h
        k1 = rates(x)
        k2 = rates(tuple([a + half * k for a, k in zip(x, k1, strict=False)]))
        k3 = rates(tuple([a + half * k for a, k in zip(x, k2, strict=False)]))
        k4 = rates(tuple([a + h * k for a, k in zip(x, k3, strict=False)]))
        sixth = h / 6.0
        x = tuple([a + sixth * (p + 2.0 * (q + s) + t) for a, p, q, s, t in zip(x, k1, k2, k3, k4, strict=False)])
        phi, phi_d, th, th_d, r, psi, a_t, vx, vy, vz, px, py, pz = x
        if m.on_ground and (vz <= 0.0 or self._frozen):
            # the ground holds everything but the thrust, which grows until it lifts
            old = self._x
            self._x = (*old[:6], a_t, *old[7:])
            return
        m.on_ground = False
        if pz <= 0.0 and vz < 0.0:
            m.impact_m_s = -vz
            self._touch_down(x)
            return
        self._x = x
        now = rates(x)
        sf, cf, s, c = sin(phi), cos(phi), sin(th), cos(th)
        psi_d = now[5]
        m.px, m.py, m.pz, m.vx, m.vy, m.vz = px, py, pz, vx, vy, vz
        m.roll, m.pitch, m.yaw = phi, th, psi
        m.p, m.q, m.r = phi_d - s * psi_d, cf * th_d + sf * c * psi_d, r
        m.fx, m.fy, m.fz = now[13], now[14], now[15]

    def _touch_down(self, x: tuple[float, ...]) -> None:
        """The ground stops everything; after a hard or tilted landing the vehicle lies where and as it fell."""
        m = self.motion
        roll, pitch, yaw, a_t, px, py = x[0], x[2], x[5], x[6], x[10], x[11]
        self._frozen = m.impact_m_s > HARD_LANDING_M_S or cos(roll) * cos(pitch) < 0.7
        if not self._frozen:
            roll = pitch = 0.0
        self._x = (roll, 0.0, pitch, 0.0, 0.0, yaw, a_t, 0.0, 0.0, 0.0, px, py, 0.0)
        m.px, m.py, m.pz, m.roll, m.pitch, m.yaw = px, py, 0.0, roll, pitch, yaw
        m.vx = m.vy = m.vz = m.p = m.q = m.r = 0.0
        m.fx, m.fy, m.fz = -sin(pitch) * G_M_S2, cos(pitch) * sin(roll) * G_M_S2, cos(roll) * cos(pitch) * G_M_S2
        m.on_ground = True
