"""The switches of the rotor vehicle: every mechanism it can have beyond a clean multirotor, with keys and usual magnitudes.

Ids are the catalogue's where it has such physics, and keys are named alike, as they are typed; the forms are this
plant's own, from rotor aerodynamics and autopilot source. The rest no catalogue term describes. Where a default depends on the
vehicle, it is given in its terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches

from flighttest.errors import InputError
from flighttest.sim.plants.plant import Hidden
from flighttest.sim.plants.rotor_vehicle import RotorVehicle

Default = float | Callable[[RotorVehicle], float]


@dataclass(frozen=True)
class Effect:
    """One mechanism: keys with default values, and what it is. known: whether the catalogue has a term of this id, which states the
    values that can be; where it has none, signed: the keys that may be negative."""

    keys: dict[str, Default]
    doc: str
    known: bool = True
    signed: tuple[str, ...] = ()


EFFECTS: dict[str, Effect] = {
    "linear_drag": Effect(
        {"d_x": lambda v: v.drag_x_1_s, "d_y": lambda v: v.drag_y_1_s, "d_z": lambda v: v.drag_z_1_s},
        "linear drag of other size than the vehicle's own, 1/s per body axis",
    ),
    "quadratic_drag": Effect(
        {"k_x": 0.030, "k_y": 0.036, "k_z": 0.050}, "fuselage drag, 1/m per body axis (0.5 rho CdA / m)"
    ),
    "thrust_scaled_drag": Effect({"c_h": 0.025}, "H-force of each rotor: s/m times its thrust and in-plane airspeed"),
    "translational_lift": Effect({"k_lift": 0.005}, "thrust gain per in-plane airspeed squared, s^2/m^2"),
    "axial_inflow": Effect(
        {"k_inflow": 0.035}, "thrust loss per climb speed at hover, s/m, with the root of the thrust"
    ),
    "airflow_moment": Effect(
        {"m_u": 1.3, "l_v": 1.3, "m_w": 0.0, "l_w": 0.0},
        "moments of the hubs by forward, sideward and climb speed: rad/s^2 per m/s at hover thrust, with the root of the thrust",
    ),
    "vortex_ring": Effect(
        {
            "vortex_depth": 0.25,
            "vortex_centre": lambda v: 0.8 * v.induced_velocity_m_s,
            "vortex_width": lambda v: 0.35 * v.induced_velocity_m_s,
        },
        "thrust loss in descent near the induced velocity: share, m/s, m/s; blown away by forward speed",
    ),
    "ground_effect": Effect(
        {"R2_m2": lambda v: v.rotors * v.radius_m**2},
        "Cheeseman-Bennett at each rotor's own height; effective R^2, m^2",
    ),
    "steady_wind": Effect({"w_north": 2.0, "w_west": -1.5, "w_up": 0.0}, "the air moves, m/s, NWU"),
    "slung_payload": Effect(
        {"payload_ratio": 0.12, "cable_m": 0.8, "swing_damping": 0.05},
        "a load on a taut massless line below the centre of mass: mass ratio, m, damping ratio",
    ),
    "throttle_curve": Effect({"curvature": 0.15}, "static thrust T (1 + c (T / T_hover - 1)) instead of T"),
    "throttle_offset": Effect({"T_min": 0.03}, "throttle at which thrust starts"),
    "motor_saturation": Effect({"T_max": lambda v: 1.7 * v.hover_throttle}, "throttle above which nothing more comes"),
    "thrust_asymmetry": Effect({"ln_sigma_ratio": 0.6}, "ln of spin-up rate over spin-down rate"),
    "rotor_speed_lag": Effect({"rotor_lag": 1.0}, "the ESCs ramp speed instead of thrust: share 0..1"),
    "thrust_extra_lag": Effect({"thrust_extra_tau": 0.035}, "input filter of the ESCs, s"),
    "thrust_fade": Effect({"fade_depth": 0.10, "fade_tau": 120.0}, "gain lost to heat, and its time constant, s"),
    "voltage_sag": Effect(
        {"sag_v": 5.0, "sag_tau": 0.4},
        "a pack with so much more resistance (V at full throttle) behind a voltage reading that lags by s",
    ),
    "angle_boost": Effect({"boost": 1.0}, "throttle times 1/cos of the target's tilt, 0..1"),
    "rate_limit": Effect({"rate_max": 1.6}, "limit of roll and pitch rates, rad/s"),
    "reference_shaping": Effect(
        {"shaping_accel": 9.0, "shaping_tc": 0.15}, "square-root shaping of tilt targets, rad/s^2, s"
    ),
    "yaw_rate_shaping": Effect({"shaping_yaw_accel": 4.7}, "limit of the yaw rate target's change, rad/s^2"),
    "attitude_extra_pole": Effect(
        {"attitude_pole_tau": 0.025}, "slow differential thrust: a pole in the angle loops, s"
    ),
    "roll_pitch_coupling": Effect(
        {"pitch_to_roll": 0.10, "roll_to_pitch": 0.10, "moment_leak": 0.0},
        "tilt axes of controller and frame turned against each other; moment_leak: of one axis' moment into the other",
    ),
    "attitude_offset": Effect(
        {"offset_roll": 0.02, "offset_pitch": -0.025}, "thrust axis minus reported attitude, rad"
    ),
    "accelerometer_bias": Effect({"bias_x": 0.25, "bias_y": -0.2, "bias_z": 0.3}, "m/s^2, body FLU"),
    "imu_lever_arm": Effect({"arm_x": 0.06, "arm_y": -0.04, "arm_z": 0.05}, "IMU from the centre of mass, m, FLU"),
    "velocity_latency": Effect({"velocity_latency": 0.12}, "reported velocity is that of so long ago, s"),
    "channel_delay": Effect({"delay_attitude": 0.03, "delay_yaw_rate": 0.0}, "delay beyond the throttle's, s"),
    "tether": Effect(
        {"stiffness_1_s2": 0.5, "rest_m": 4.0},
        "a rubber band to the start: 1/s^2 beyond its rest length, m",
        known=False,
    ),
    "updraft": Effect(
        {"x_m": 0.0, "y_m": 0.0, "radius_m": 4.0, "speed_m_s": 2.5},
        "a rising column of air at a place",
        known=False,
        signed=("x_m", "y_m", "speed_m_s"),
    ),
    "gust_front": Effect(
        {"w_north": 3.0, "w_west": 2.0, "from_s": 120.0, "for_s": 60.0},
        "a rectangular gust, m/s, at a time",
        known=False,
        signed=("w_north", "w_west"),
    ),
    "sticking_esc": Effect({"band": 0.025}, "the ESCs ignore throttle changes smaller than this", known=False),
    "back_emf": Effect(
        {"resistance": 1.5},
        "motors without a governor: thrust from duty, voltage and back-EMF; resistive over back-EMF voltage at full throttle",
        known=False,
    ),
    "swirl": Effect(
        {"rate_1_s": 0.45},
        "a side force to the left of the flight, 1/s of the horizontal airspeed",
        known=False,
        signed=("rate_1_s",),
    ),
    "attitude_priority": Effect(
        {},
        "the mixer gives up thrust for attitude: a rotor that would stop or saturate lifts or lowers all of them",
        known=False,
    ),
    "resonance": Effect(
        {"gain": 0.25, "hz": 2.2, "damping": 0.08}, "thrust answers throttle changes with a ringing frame", known=False
    ),
}


def effects_on(hide: Hidden, vehicle: RotorVehicle) -> dict[str, dict[str, float]]:
    """Every key of the effects that are on, defaults filled in; InputError for ids and keys that do not exist, and negative values
    of what has no sign."""
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
            if not effect.known and key not in effect.signed and not values[key] >= 0.0:
                raise InputError(f"{key} of {name} cannot be {values[key]:g}", "give a value from 0 on")
        defaults = {k: float(d(vehicle)) if callable(d) else d for k, d in effect.keys.items()}
        found[name] = defaults | {k: float(v) for k, v in values.items()}
    return found
