"""Rotor-level vehicles: masses, moments of inertia, lengths, motors, battery and inner loops, by hand or drawn at random from a seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from flighttest.errors import InputError
from flighttest.frames import G_M_S2

RHO_KG_M3 = 1.225


@dataclass(frozen=True)
class RotorVehicle:
    """One multirotor with `rotors` equal rotors on a circle, motors canted a little for yaw authority.

    mass_kg; arm_m from the centre to a rotor; radius_m of a rotor; rotor_height_m of the rotor plane above the feet;
    inertia_*_kg_m2; hover_throttle: static, at nominal_voltage_v; alpha: exponent of the voltage in static thrust (what the ESCs leave
    of it); ramp_1_s: rate at which the ESCs let the common throttle follow; rotor_lag_s: of a single rotor around its speed; yaw_arm_m:
    yaw torque per thrust (reaction torque and cant); omega_*, zeta_*: angle loops; sigma_r_1_s: yaw rate loop; drag_*_1_s: linear drag;
    delay_s: from a target's arrival to the loops; cells, capacity_ah, resistance_ohm, hover_current_a: battery.
    """

    rotors: int = 4
    mass_kg: float = 2.9
    arm_m: float = 0.29
    radius_m: float = 0.17
    rotor_height_m: float = 0.20
    inertia_x_kg_m2: float = 0.036
    inertia_y_kg_m2: float = 0.039
    inertia_z_kg_m2: float = 0.062
    hover_throttle: float = 0.19
    nominal_voltage_v: float = 22.2
    alpha: float = 1.6
    ramp_1_s: float = 16.0
    rotor_lag_s: float = 0.005
    yaw_arm_m: float = 0.055
    omega_roll: float = 14.0
    omega_pitch: float = 13.0
    zeta_roll: float = 0.62
    zeta_pitch: float = 0.58
    sigma_r_1_s: float = 6.0
    drag_x_1_s: float = 0.32
    drag_y_1_s: float = 0.30
    drag_z_1_s: float = 0.42
    delay_s: float = 0.06
    cells: int = 6
    capacity_ah: float = 5.0
    resistance_ohm: float = 0.006
    hover_current_a: float = 24.0

    @property
    def thrust_max_n(self) -> float:
        """Static thrust of all rotors at full throttle and nominal voltage, N."""
        return self.mass_kg * G_M_S2 / self.hover_throttle

    @property
    def induced_velocity_m_s(self) -> float:
        """Induced velocity in hover by momentum theory, m/s."""
        area = self.rotors * math.pi * self.radius_m**2
        return math.sqrt(self.mass_kg * G_M_S2 / (2.0 * RHO_KG_M3 * area))

    def changed(self, values: Mapping[str, float]) -> RotorVehicle:
        """This vehicle with some constants replaced by name; InputError for a name that is not one of them."""
        known = {f.name for f in fields(self)}
        for name in values:
            if name not in known:
                raise InputError(f"the rotor vehicle has no constant {name!r}", f"it has {', '.join(sorted(known))}")
        whole = {name: int(v) if name in ("rotors", "cells") else v for name, v in values.items()}
        return replace(self, **whole)  # type: ignore[arg-type]


def random_rotor(seed: int) -> RotorVehicle:
    """A plausible multirotor of 1 to 7 kg: sizes follow the mass as they do on real frames, everything else is drawn."""
    rng = np.random.default_rng([seed & 0xFFFFFFFF, 0x526F746F])

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    rotors = 4 if rng.random() < 0.7 else 6
    mass = math.exp(draw(math.log(1.0), math.log(7.0)))
    size = (mass / 2.9) ** (1.0 / 3.0)
    radius = 0.17 * size * (1.0 if rotors == 4 else 0.85) * draw(0.9, 1.1)
    arm = max(0.29 * size * draw(0.9, 1.15), 1.6 * radius)
    inertia = 0.15 * mass * arm * arm * draw(0.85, 1.15)
    pitch_share = draw(1.0, 1.12)
    omega = draw(9.0, 15.0)
    drag = draw(0.15, 0.5)
    current = 24.0 * (mass / 2.9) ** 1.1 * draw(0.85, 1.15)
    return RotorVehicle(
        rotors=rotors,
        mass_kg=mass,
        arm_m=arm,
        radius_m=radius,
        rotor_height_m=draw(0.10, 0.28) * size,
        inertia_x_kg_m2=inertia,
        inertia_y_kg_m2=inertia * pitch_share,
        inertia_z_kg_m2=inertia * draw(1.6, 1.8),
        hover_throttle=draw(0.15, 0.34),
        alpha=draw(1.2, 1.9),
        ramp_1_s=draw(9.0, 22.0),
        rotor_lag_s=draw(0.003, 0.006),
        yaw_arm_m=draw(0.16, 0.22) * arm,
        omega_roll=omega,
        omega_pitch=omega * draw(0.88, 1.0),
        zeta_roll=draw(0.5, 0.85),
        zeta_pitch=draw(0.5, 0.85),
        sigma_r_1_s=draw(4.0, 7.0),
        drag_x_1_s=drag * draw(0.9, 1.1),
        drag_y_1_s=drag * draw(0.9, 1.1),
        drag_z_1_s=drag * draw(1.0, 1.5),
        delay_s=draw(0.03, 0.12),
        capacity_ah=current * draw(7.0, 9.0) / 60.0,
        resistance_ohm=0.15 / current,
        hover_current_a=current,
    )
