"""The switches of the rotor vehicle: every mechanism it can have beyond a clean multirotor, with keys and usual magnitudes.

Ids are the catalogue's where the catalogue has such physics (nothing here has read it: keys and forms are this plant's own, from rotor
aerodynamics and autopilot source); the rest no catalogue term describes. Where a default depends on the vehicle, it is given in its terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches

from flighttest.errors import InputError
from flighttest.sim.plant import Hidden
from flighttest.sim.rotor_vehicle import RotorVehicle

Default = float | Callable[[RotorVehicle], float]


@dataclass(frozen=True)
class Effect:
    """One mechanism: keys with default values, and what it is. known: whether the catalogue has a term of this id."""

    keys: dict[str, Default]
    doc: str
    known: bool = True


EFFECTS: dict[str, Effect] = {
    "linear_drag": Effect(
        {"d_x": lambda v: v.drag_x_1_s, "d_y": lambda v: v.drag_y_1_s, "d_z": lambda v: v.drag_z_1_s},
        "linear drag of other size than the vehicle's own, 1/s per body axis",
    ),
    "quadratic_drag": Effect(
        {"k_x": 0.030, "k_y": 0.036, "k_z": 0.050}, "fuselage drag, 1/m per body axis (0.5 rho CdA / m)"
    ),
    "thrust_scaled_drag": Effect({"k": 0.025}, "H-force of each rotor: k s/m times its thrust and in-plane airspeed"),
    "translational_lift": Effect({"k": 0.005}, "thrust gain per in-plane airspeed squared, s^2/m^2"),
    "axial_inflow": Effect({"k": 0.035}, "thrust loss per climb speed at hover, s/m, with the root of the thrust"),
    "vortex_ring": Effect(
        {
            "strength": 0.25,
            "centre": lambda v: 0.8 * v.induced_velocity_m_s,
            "width": lambda v: 0.35 * v.induced_velocity_m_s,
        },
        "thrust loss in descent near the induced velocity: share, m/s, m/s; blown away by forward speed",
    ),
    "ground_effect": Effect(
        {"R2_m2": lambda v: v.rotors * v.radius_m**2}, "Cheeseman-Bennett at each rotor's own height; effective R^2, m^2"
    ),
    "steady_wind": Effect({"w_north": 2.0, "w_west": -1.5, "w_up": 0.0}, "the air moves, m/s, NWU"),
    "slung_payload": Effect(
        {"mass_ratio": 0.12, "length_m": 0.8, "damping": 0.05}, "a load on a taut massless line below the centre of mass"
    ),
    "throttle_curve": Effect({"curvature": 0.4}, "static thrust (1 - c) T + c T^2 instead of T"),
    "throttle_offset": Effect({"T_min": 0.03}, "throttle at which thrust starts"),
    "motor_saturation": Effect({"T_max": lambda v: 1.7 * v.hover_throttle}, "throttle above which nothing more comes"),
    "thrust_asymmetry": Effect({"ln_ratio": 0.6}, "ln of spin-up rate over spin-down rate"),
    "rotor_speed_lag": Effect({"blend": 1.0}, "the ESC ramps speed instead of thrust: share 0..1"),
    "thrust_extra_lag": Effect({"tau_s": 0.035}, "input filter of the ESCs, s"),
    "thrust_fade": Effect({"depth": 0.10, "tau_s": 120.0}, "gain lost to heat, with its time constant of turning motors, s"),
    "voltage_sag": Effect(
        {"volts": 5.0, "tau_s": 0.25}, "drop behind the voltage sensor at full throttle, V, and its time constant, s"
    ),
    "angle_boost": Effect({"gain": 1.0}, "throttle times 1/cos of the target's tilt, gain 0..1"),
    "rate_limit": Effect({"rate_rad_s": 1.6}, "limit of roll and pitch rates, rad/s"),
    "reference_shaping": Effect({"accel_rad_s2": 9.0, "tc_s": 0.15}, "square-root shaping of roll and pitch targets"),
    "attitude_extra_pole": Effect({"tau_s": 0.025}, "slow differential thrust: a pole in the angle loops, s"),
    "roll_pitch_coupling": Effect({"pitch_to_roll": 0.15, "roll_to_pitch": 0.15}, "moments that leak into the other axis"),
    "attitude_offset": Effect({"roll_rad": 0.02, "pitch_rad": -0.025}, "reported attitude minus that of the thrust axis"),
    "accelerometer_bias": Effect({"b_x": 0.25, "b_y": -0.2, "b_z": 0.3}, "m/s^2, body FLU"),
    "imu_lever_arm": Effect({"x": 0.06, "y": -0.04, "z": 0.05}, "place of the IMU from the centre of mass, m, FLU"),
    "velocity_latency": Effect({"tau_s": 0.12}, "reported velocity is that of so long ago, s"),
    "channel_delay": Effect({"thrust_s": 0.04, "yaw_rate_s": 0.0}, "delay beyond that of the attitude channel, s"),
    "tether": Effect({"stiffness_1_s2": 0.5, "rest_m": 4.0}, "a rubber band to the start: 1/s^2 beyond its rest length, m", known=False),
    "updraft": Effect(
        {"x_m": 0.0, "y_m": 0.0, "radius_m": 4.0, "speed_m_s": 2.5}, "a rising column of air at a place", known=False
    ),
    "gust_front": Effect(
        {"w_north": 3.0, "w_west": 2.0, "from_s": 120.0, "for_s": 60.0}, "a rectangular gust, m/s, at a time", known=False
    ),
    "sticking_esc": Effect({"band": 0.025}, "the ESCs ignore throttle changes smaller than this", known=False),
    "swirl": Effect(
        {"rate_1_s": 0.45}, "a side force to the left of the flight, 1/s of the horizontal airspeed", known=False
    ),
    "resonance": Effect(
        {"gain": 0.25, "hz": 2.2, "damping": 0.08}, "thrust answers throttle changes with a ringing frame", known=False
    ),
}  # fmt: skip


def resolve(hide: Hidden, vehicle: RotorVehicle) -> dict[str, dict[str, float]]:
    """Every key of the effects that are on, defaults filled in; InputError for ids and keys that do not exist."""
    found: dict[str, dict[str, float]] = {}
    for name, values in hide.items():
        effect = EFFECTS.get(name)
        if effect is None:
            near = get_close_matches(name, EFFECTS, 1)
            raise InputError(
                f"the rotor vehicle has no effect {name!r}",
                f"did you mean {near[0]!r}?" if near else f"it has {', '.join(EFFECTS)}",
            )
        for key in values:
            if key not in effect.keys:
                raise InputError(f"effect {name} has no key {key!r}", f"it has {', '.join(effect.keys)}")
        defaults = {k: float(d(vehicle)) if callable(d) else d for k, d in effect.keys.items()}
        found[name] = defaults | {k: float(v) for k, v in values.items()}
    return found
