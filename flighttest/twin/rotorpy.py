"""An identified model as a vehicle of RotorPy: quad_params, and a class that makes thrust and moments of references and throttle."""

from __future__ import annotations

import math
import pprint
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.documents import PlainData
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Contribution, Param, Port, Signals, Term
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate
from flighttest.twin.vehicle import fly_able

NAME = "rotorpy_vehicle.py"
FloatArray = NDArray[np.float64]

KNOWN = ("body", "linear_drag", "quadratic_drag", "steady_wind")
MASS_KG = 1.0  # where none is known: forces per mass are all that was identified
ARM_M = 0.02  # short: with it the inertia, and what rotor drag at the hubs brakes rotations by
ROTOR_RAD_S = 1000.0  # in hover; what drag and thrust are stated by
MOTOR_S = 0.001  # the identified lag is in the commands
STEPS_RAD = 0.015  # what RotorPy's own motors and steps of 2 ms leave of the attitude on the test maneuver (flown with RotorPy 3.0)
STEPS_M_S = 0.01  # the same of the velocity (flown: 0.006)


def write_vehicle(stored: ModelFile, folder: Path) -> Path:
    """Write rotorpy_vehicle.py. ModelError where the model has no attitude loops."""
    fly_able(stored)
    folder.mkdir(parents=True, exist_ok=True)
    identified, parameters = vehicle(stored)
    source = resources.files("flighttest.twin").joinpath("rotorpy_commands.py").read_text(encoding="utf-8")
    wind = [stored.values.get(n, 0.0) for n in ("w_north", "w_west", "w_up")]
    text = (
        f"{source}\n\nIDENTIFIED: dict[str, Any] = {pprint.pformat(identified, width=110)}\n\n"
        f"quad_params: dict[str, Any] = {_formatted(parameters)}\n\n"
        f"WIND_M_S = {wind}  # for rotorpy.wind.default_winds.ConstantWind\n"
    )
    path = folder / NAME
    path.write_text(text, encoding="utf-8")
    return path


def vehicle(stored: ModelFile) -> tuple[dict[str, PlainData], dict[str, PlainData]]:
    """(IDENTIFIED, quad_params)."""
    v, model = stored.values, stored.model
    weighed = stored.fingerprint.get("mass_kg")
    mass = float(weighed) if isinstance(weighed, int | float) else MASS_KG
    # Enough moment for a reference step of half a radian while the rotors carry half the weight.
    fastest = max(0.5 * v["omega_phi"] ** 2, 0.5 * v["omega_theta"] ** 2, 4.0 * v["sigma_r"])
    inertia = 0.25 * mass * model.g_m_s2 * ARM_M / fastest
    hover = mass * model.g_m_s2 / 4.0
    eta = hover / ROTOR_RAD_S**2
    identified: dict[str, PlainData] = {
        n: float(v[n])
        for n in ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r", "sigma_t", "K", "alpha")
    }
    identified |= {
        "delays_s": {c: max(float(d), 0.0) for c, d in stored.delays_s.items()},
        "mass_kg": mass,
        "inertia_kg_m2": [inertia] * 3,
        "nominal_voltage_v": model.nominal_voltage_v,
        "g": model.g_m_s2,
        "motor_s": MOTOR_S,
    }
    d = [v.get(n, 0.0) for n in ("d_x", "d_y", "d_z")]
    level = 0.5 * (d[0] + d[1])
    identified["spin_drag"] = [0.5 * mass * d[2] * ARM_M**2] * 2 + [mass * level * ARM_M**2]
    k = [v.get(p.name, 0.0) for p in catalogue()["quadratic_drag"].params]
    place = ARM_M / math.sqrt(2.0)
    corners = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    parameters: dict[str, PlainData] = {
        "mass": mass, "Ixx": inertia, "Iyy": inertia, "Izz": inertia, "Ixy": 0.0, "Iyz": 0.0, "Ixz": 0.0,
        "num_rotors": 4,
        "rotor_pos": {f"r{i + 1}": [place * x, place * y, 0.0] for i, (x, y) in enumerate(corners)},
        "rotor_directions": [1, -1, 1, -1],
        "rI": [0.0, 0.0, 0.0],
        "c_Dx": mass * k[0], "c_Dy": mass * k[1], "c_Dz": mass * k[2],
        "k_eta": eta, "k_m": ARM_M * eta,
        "k_d": mass * level / (4.0 * ROTOR_RAD_S), "k_z": mass * d[2] / (4.0 * ROTOR_RAD_S),
        "k_h": 0.0, "k_flap": 0.0,
        "tau_m": MOTOR_S, "rotor_speed_min": 0.0, "rotor_speed_max": 5.0 * ROTOR_RAD_S, "motor_noise_std": 0.0,
        "k_w": 1.0, "k_v": 10.0, "kp_att": v["omega_phi"] ** 2, "kd_att": 2 * v["zeta_phi"] * v["omega_phi"],
    }  # fmt: skip
    return identified, parameters


def _formatted(parameters: Mapping[str, PlainData]) -> str:
    text = pprint.pformat(parameters, width=110, sort_dicts=False)
    for key in ("rotor_directions", "rI"):
        text = text.replace(f"'{key}': {parameters[key]}", f"'{key}': np.array({parameters[key]})")
    places = parameters["rotor_pos"]
    assert isinstance(places, Mapping)
    for name, place in places.items():
        text = text.replace(f"'{name}': {place}", f"'{name}': np.array({place})")
    return text


def lacking(stored: ModelFile) -> tuple[str, ...]:
    """Terms that RotorPy's vehicle has not."""
    return tuple(t for t in stored.model.terms if t not in KNOWN)


def left_error(stored: ModelFile) -> dict[str, float]:
    """What the export leaves on a test maneuver of 3 s (tilt steps of 0.3 rad, throttle steps of a fifth): largest difference of velocity,
    m/s, and of roll and pitch, rad, from the model's own simulation."""
    model, values = stored.model, stored.values
    kept = model.without_terms(*lacking(stored), *({"quadratic_drag"} & {*model.terms})).with_terms(_SPEED_DRAG)
    d = [values.get(n, 0.0) for n in ("d_x", "d_y", "d_z")]
    other = kept.start(values) | {"rotorpy_d_xy": 0.5 * (d[0] + d[1]), "rotorpy_d_z": d[2]}
    other |= {f"rotorpy_{n}": values.get(n, 0.0) for n in _QUADRATIC}
    other |= {n: 0.0 for n in ("d_x", "d_y", "d_z") if n in other}
    runs = [test_maneuver(m, v, model.nominal_voltage_v) for m, v in ((model, values), (kept, other))]
    return {
        "velocity_m_s": max(float(np.abs(runs[0][c] - runs[1][c]).max()) for c in ("v_x_m_s", "v_y_m_s", "v_z_m_s"))
        + STEPS_M_S,
        "attitude_rad": max(float(np.abs(runs[0][c] - runs[1][c]).max()) for c in ("roll_rad", "pitch_rad"))
        + STEPS_RAD,
    }


def test_maneuver(model: Model, values: Mapping[str, float], voltage_v: float) -> dict[str, FloatArray]:
    """States and outputs (301,) of a model on the test maneuver, every 10 ms for 3 s, at a voltage."""
    t: FloatArray = 0.01 * np.arange(301, dtype=float)
    references = maneuver(float(model.hover_throttle(values, voltage_v)))
    volts = {"voltage_v": (t, np.full(t.size, voltage_v))}
    return simulate(model, values, t, {"p_z_m": 5.0}, references, volts)


def maneuver(hover: float) -> dict[str, tuple[Any, Any]]:
    """Edges of the test maneuver by input."""
    steps = {
        "roll_ref_rad": ((-1.0, 0.0), (0.2, 0.3), (1.0, -0.3), (1.8, 0.0)),
        "pitch_ref_rad": ((-1.0, 0.0), (0.6, -0.3), (1.6, 0.3), (2.4, 0.0)),
        "yaw_rate_ref_rad_s": ((-1.0, 0.0), (0.4, 1.0), (2.0, 0.0)),
        "throttle": ((-1.0, hover), (0.8, 1.2 * hover), (1.4, 0.9 * hover), (2.2, hover)),
    }
    return {n: (np.array([e[0] for e in some]), np.array([e[1] for e in some])) for n, some in steps.items()}


_QUADRATIC = tuple(p.name for p in catalogue()["quadratic_drag"].params)


def _drag(s: Signals, p: Any, _x: Any) -> Contribution:
    """Drag as RotorPy has it: of the rotors in proportion to the rotor speed, the square root of thrust; of the body with the speed of the
    whole airflow, where `quadratic_drag` has that along each axis."""
    speed = ca.sqrt(ca.fmax(s.a_t, 0.01) / s.g)
    d = ca.vertcat(p["rotorpy_d_xy"], p["rotorpy_d_xy"], p["rotorpy_d_z"])
    k = ca.vertcat(*(p[f"rotorpy_{n}"] for n in _QUADRATIC))
    airspeed = ca.sqrt(ca.sumsqr(s.v_air_body) + 1e-12)
    return Contribution(-(speed * d + airspeed * k) * s.v_air_body)


_SPEED_DRAG = Term(
    id="rotorpy_drag", title="Rotor drag of RotorPy", family="aerodynamics", port=Port.FORCE,
    params=tuple(
        Param(n, n, "1/s", 0.3, 0.0, 5.0, 0.1, "drag in hover", "RotorPy, Multirotor.compute_body_wrench")
        for n in ("rotorpy_d_xy", "rotorpy_d_z")
    ) + tuple(
        Param(f"rotorpy_{n}", n, "1/m", 0.03, 0.0, 1.0, 0.01, "drag of the body", "RotorPy, Multirotor.compute_body_wrench")
        for n in _QUADRATIC
    ),
    build=_drag,
    equation="f = -sqrt(a_t / g) diag(d_xy, d_xy, d_z) v_air_body - |v_air_body| diag(k_x, k_y, k_z) v_air_body",
    plain="", source="RotorPy", doubt="",
    hides_in=(), told_apart_by="", reveals="", needs=(),
)  # fmt: skip
