"""An identified model as a vehicle of ArduPilot's own SITL physics: a frame file (SIM_Frame) and the parameters that go with it.

SIM_Frame has thrust with the square of the voltage and no motor lag, one momentum drag for all axes that goes with the root of the thrust,
one fuselage drag, wind, and inertia. The lag of thrust is set as the firmware's throttle filter, the attitude loops by inertia.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Contribution, Param, Port, Signals, Term
from flighttest.sim.plants.plant_paper import HOVER_CURRENT_A
from flighttest.twin.firmware import FirmwareFrame, frame_of
from flighttest.twin.rotorpy import MASS_KG, test_maneuver
from flighttest.twin.vehicle import fly_able, simulated_battery

FRAME_NAME, PARAMETERS_NAME = "vehicle.json", "vehicle.parm"
KNOWN = ("body", "linear_drag", "quadratic_drag", "steady_wind", "angle_boost", "channel_delay")
DIAGONAL_M = 0.02  # short arms: momentum drag at the rotors brakes rotations, with 0.24 m a yaw rate by 11 1/s
DISC_M2, RHO_KG_M3 = 0.456, 1.225  # the area only scales mdrag_coef
REFERENCE_DEG = 20.0  # lean angle that the frame's drag is stated at
FULL_CELL_V = 4.2


@dataclass(frozen=True)
class Exported:
    """frame: of SIM_Frame's file; parameters: of the firmware; loops: what was fitted; lacking: terms that it has not; thrust_share: most
    that thrust is off over the valid voltages; velocity_m_s: most that velocity is off on the test maneuver at nominal voltage."""

    frame: Mapping[str, float | list[float]]
    parameters: dict[str, float]
    loops: FirmwareFrame
    lacking: tuple[str, ...]
    thrust_share: float
    velocity_m_s: float

    @property
    def attitude_share(self) -> float:
        """RMS error of tilt steps as a share of them."""
        return max(a.error for n, a in self.loops.axes.items() if n != "yaw")


def write_frame(stored: ModelFile, folder: Path) -> tuple[tuple[Path, Path], Exported]:
    """Write vehicle.json and vehicle.parm. ModelError where the model has no attitude loops."""
    made = exported(stored)
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / FRAME_NAME, folder / PARAMETERS_NAME
    paths[0].write_text(json.dumps(made.frame, indent=1) + "\n", encoding="utf-8")
    paths[1].write_text("".join(f"{n} {v:.7g}\n" for n, v in sorted(made.parameters.items())), encoding="utf-8")
    return paths, made


def exported(stored: ModelFile) -> Exported:
    """The vehicle, and what it cannot be."""
    fly_able(stored)
    v, g = stored.values, stored.model.g_m_s2
    weighed = stored.fingerprint.get("mass_kg")
    mass = float(weighed) if isinstance(weighed, int | float) else MASS_KG
    loops = frame_of(stored, motor_lag=False)
    battery = simulated_battery(stored)
    full_v = FULL_CELL_V * battery["cells"]
    low, high = (float(u) for u in stored.valid.get("voltage_v") or (stored.model.nominal_voltage_v,) * 2)
    middle = 0.5 * (low + high)
    at_middle = g / (v["K"] * (middle / stored.model.nominal_voltage_v) ** v["alpha"])
    hover = at_middle * (middle / full_v) ** 2  # at a full pack, thrust going with the square of the voltage
    linear, square = _mean(v, ("d_x", "d_y")), max(_mean(v, ("k_x", "k_y")), 0.0)
    coefficient = max(linear, 0.0) * mass / math.sqrt(RHO_KG_M3 * DISC_M2 * mass * g)
    top = (
        mass * g / at_middle * (stored.model.nominal_voltage_v / middle) ** 2
    )  # N, at full throttle and nominal voltage
    side = 0.5 * DIAGONAL_M * math.sqrt(0.5) * top  # N m of a full output in roll
    twist = 0.05 * DIAGONAL_M * top * at_middle  # of a small one in yaw, as a full one
    frame: dict[str, float | list[float]] = {
        "mass": mass, "diagonal_size": DIAGONAL_M, "num_motors": 4,
        "moment_inertia": [side / loops.axes["roll"].gain, side / loops.axes["pitch"].gain, twist / loops.axes["yaw"].gain],
        "refSpd": _speed(mass, g, coefficient, square), "refAngle": REFERENCE_DEG, "mdrag_coef": coefficient, "disc_area": DISC_M2,
        "refVoltage": stored.model.nominal_voltage_v, "refCurrent": HOVER_CURRENT_A,
        "refAlt": 0, "refTempC": 25, "refBatRes": battery["resistance_ohm"], "maxVoltage": full_v, "battCapacityAh": 5.0,
        "hoverThrOut": hover, "propExpo": 0.0, "refRotRate": 1e6, "pwmMin": 1000, "pwmMax": 2000, "spin_min": 0.0, "spin_max": 1.0,
        "slew_max": 0,
    }  # fmt: skip
    parameters = {
        **loops.parameters, "PILOT_THR_FILT": v["sigma_t"] / math.tau, "MOT_HOVER_LEARN": 0.0, "BATT_MONITOR": 4.0, "BATT_CAPACITY": 5000.0,
        "SIM_BATT_VOLTAGE": full_v, **sim_wind(stored),
    }  # fmt: skip
    lacking = tuple(t for t in stored.model.terms if t not in KNOWN and block_of(catalogue()[t]) != "attitude")
    off = max(abs((u / middle) ** (2.0 - v["alpha"]) - 1.0) for u in (low, high))
    return Exported(frame, parameters, loops, lacking, off, _left(stored, mass, lacking, linear, square))


def _mean(values: Any, names: tuple[str, ...]) -> float:
    return float(np.mean([values.get(n, 0.0) for n in names]))


def _speed(mass: float, g: float, coefficient: float, square: float) -> float:
    """The speed at which this lean angle balances both drags: SIM_Frame takes the fuselage's from it."""
    lean = math.radians(REFERENCE_DEG)
    momentum = coefficient * math.cos(lean) ** 2 * math.sqrt(mass * g / math.cos(lean) * RHO_KG_M3 * DISC_M2)
    force = mass * g * math.tan(lean)
    if square <= 0.0:
        return force / momentum * (1.0 + 1e-6) if momentum > 0.0 else 1e3
    a = mass * square
    return (-momentum + math.sqrt(momentum**2 + 4.0 * a * force)) / (2.0 * a)


def sim_wind(stored: ModelFile) -> dict[str, float]:
    """SIM_WIND_*: speed, the compass direction it comes from, and how it points up; the same at every height."""
    north, west, up = (stored.values.get(n, 0.0) for n in ("w_north", "w_west", "w_up"))
    speed = math.hypot(north, west, up)
    if speed <= 0.0:
        return {}
    return {
        "SIM_WIND_SPD": speed,
        "SIM_WIND_DIR": math.degrees(math.atan2(west, -north)) % 360.0,
        "SIM_WIND_DIR_Z": math.degrees(math.asin(up / speed)),
        "SIM_WIND_T": 1.0,
    }


def _left(stored: ModelFile, mass: float, lacking: tuple[str, ...], linear: float, square: float) -> float:
    """Largest difference of velocity, m/s, on the test maneuver at nominal voltage between the model and what SIM_Frame makes of it."""
    model, values = stored.model, stored.values
    replaced = [t for t in ("linear_drag", "quadratic_drag") if t in model.terms]
    kept = model.without_terms(*lacking, *replaced).with_terms(_FRAME_DRAG)
    g = model.g_m_s2
    blown = 2.0 * HOVER_CURRENT_A * model.nominal_voltage_v / (mass * g)  # m/s, out of the rotors in hover
    other = kept.start(values) | {"frame_d": linear, "frame_k": square, "frame_inflow": g / blown**2}
    runs = [test_maneuver(m, v) for m, v in ((model, values), (kept, other))]
    return max(float(np.abs(runs[0][c] - runs[1][c]).max()) for c in ("v_x_m_s", "v_y_m_s", "v_z_m_s"))


def _drag(s: Signals, p: Any, _x: Any) -> Contribution:
    """Drag and climb as SIM_Frame has them."""
    v = s.v_air_body
    momentum = p["frame_d"] * ca.sqrt(ca.fmax(s.a_t, 0.01) / s.g) * v
    climb = p["frame_inflow"] * ca.fmax(v[2], 0.0) ** 2
    return Contribution(-momentum - p["frame_k"] * ca.fabs(v) * v - ca.vertcat(0, 0, climb))


_FRAME_DRAG = Term(
    id="ardupilot_drag", title="Drag of ArduPilot's SIM_Frame", family="aerodynamics", port=Port.FORCE,
    params=tuple(
        Param(n, n, unit, 0.3, 0.0, 5.0, 0.1, what, "ArduPilot, SIM_Frame.cpp and SIM_Motor.cpp")
        for n, unit, what in (
            ("frame_d", "1/s", "momentum drag in hover"), ("frame_k", "1/m", "fuselage drag"),
            ("frame_inflow", "1/m", "thrust lost in climb"),
        )
    ),
    build=_drag, equation="f = -(d sqrt(a_t / g) + k |v|) v_air_body - c max(v_z, 0)^2 e_z", plain="", source="ArduPilot", doubt="",
    hides_in=(), told_apart_by="", reveals="", needs=(),
)  # fmt: skip
