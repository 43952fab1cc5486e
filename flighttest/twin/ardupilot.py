"""An identified model as a vehicle of ArduPilot's own SITL physics: a frame file (SIM_Frame) and the parameters that go with it.

SIM_Frame has thrust with the square of the voltage and no motor lag, one momentum drag for all axes that goes with the root of the thrust,
one fuselage drag, wind, and inertia. The lag of thrust is set as the firmware's throttle filter, the attitude loops by inertia. Thrust and
moments are those of the model in the middle of its voltages. `frame_model` is the model with these equations: what the frame differs by
from the model is computed with it.
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
from flighttest.physics.model import Model
from flighttest.sim.plants.plant_paper import HOVER_CURRENT_A
from flighttest.twin.firmware import FirmwareFrame, frame_of, step_error
from flighttest.twin.rotorpy import MASS_KG, test_maneuver
from flighttest.twin.vehicle import fly_able, simulated_battery

FRAME_NAME, PARAMETERS_NAME = "vehicle.json", "vehicle.parm"
KNOWN = ("body", "linear_drag", "quadratic_drag", "steady_wind", "angle_boost", "channel_delay")
DIAGONAL_M = 2e-4  # so short that momentum drag at the rotors brakes no rotation: a yaw rate by 11 1/s with 0.24 m, by 0.01 with this
DISC_M2, RHO_KG_M3 = 0.456, 1.225  # the area only scales mdrag_coef
REFERENCE_DEG = 20.0  # lean angle that the frame's drag is stated at
FULL_CELL_V = 4.2
# Delay of the thrust in the firmware and its instruments, s. Measured in the onboard logs of frames behind a throttle filter of 60.3 ms and
# of 50.7 ms, each flown with six throttle steps: a lag of 61.5 ms and a delay of 8.4 ms, of 51.9 and 9.5 ms.
FIRMWARE_THRUST_DELAY_S = 0.010
LEAST_LAG_S = 0.005  # two loops of the firmware
# Of a step, RMS, by which the firmware differs from `firmware_loops`. Flown, beyond what the fit left: 0.2, 0.35 % in roll and pitch with
# the gains of a vehicle, 0.8 and 0.9 % with chosen ones; 0.7 to 2.1 % in yaw rate, in three flights.
TILT_SHARE, YAW_SHARE = 0.01, 0.025


@dataclass(frozen=True)
class Exported:
    """frame: of SIM_Frame's file; parameters: of the firmware; loops: what was fitted; lacking: terms that it has not; thrust_share: most
    that thrust is off over the valid voltages; tilt_share, yaw_share: RMS error of tilt and of yaw rate steps as a share of them, at the
    voltage where it is largest; velocity_m_s, force_m_s2: most that velocity and specific force along a body axis are off on the test
    maneuver in the middle of the voltages."""

    frame: Mapping[str, float | list[float]]
    parameters: dict[str, float]
    loops: FirmwareFrame
    lacking: tuple[str, ...]
    thrust_share: float
    tilt_share: float
    yaw_share: float
    velocity_m_s: float
    force_m_s2: float


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
    mass = _mass_kg(stored)
    loops = frame_of(stored, motor_lag=False)
    battery = simulated_battery(stored)
    full_v = FULL_CELL_V * battery["cells"]
    low, middle, high = _voltages(stored)
    to_middle = middle / stored.model.nominal_voltage_v
    at_middle = g / (v["K"] * to_middle ** v["alpha"])
    hover = at_middle * (middle / full_v) ** 2  # at a full pack, thrust going with the square of the voltage
    linear, square = _drags(stored)
    coefficient = linear * mass / math.sqrt(RHO_KG_M3 * DISC_M2 * mass * g)
    top = mass * g / at_middle  # N, at full throttle and the middle voltage
    side = 0.5 * DIAGONAL_M * math.sqrt(0.5) * top  # N m of a full output in roll
    twist = 0.05 * DIAGONAL_M * top * at_middle  # of a small one in yaw, as a full one
    gain = {n: a.gain * to_middle ** v["alpha"] for n, a in loops.axes.items()}
    frame: dict[str, float | list[float]] = {
        "mass": mass, "diagonal_size": DIAGONAL_M, "num_motors": 4,
        "moment_inertia": [side / gain["roll"], side / gain["pitch"], twist / gain["yaw"]],
        "refSpd": _speed(mass, g, coefficient, square), "refAngle": REFERENCE_DEG, "mdrag_coef": coefficient, "disc_area": DISC_M2,
        "refVoltage": stored.model.nominal_voltage_v, "refCurrent": HOVER_CURRENT_A,
        "refAlt": 0, "refTempC": 25, "refBatRes": battery["resistance_ohm"], "maxVoltage": full_v, "battCapacityAh": 5.0,
        "hoverThrOut": hover, "propExpo": 0.0, "refRotRate": 1e6, "pwmMin": 1000, "pwmMax": 2000, "spin_min": 0.0, "spin_max": 1.0,
        "slew_max": 0,
    }  # fmt: skip
    lag, _ = _thrust_lag(stored, loops)
    parameters = {
        **loops.parameters, "PILOT_THR_FILT": 1.0 / (math.tau * lag), "MOT_HOVER_LEARN": 0.0, "BATT_MONITOR": 4.0, "BATT_CAPACITY": 5000.0,
        "SIM_BATT_VOLTAGE": full_v, **sim_wind(stored),
    }  # fmt: skip
    ratios = [u / middle for u in (low, middle, high)]
    thrust = max(abs(r ** (2.0 - v["alpha"]) - 1.0) for r in ratios)
    tilt = max(step_error(stored, n, loops, r ** (2.0 - v["alpha"])) for n in ("roll", "pitch") for r in ratios)
    yaw = max(
        step_error(stored, "yaw", loops, r ** -v["alpha"]) for r in ratios
    )  # drag torque of a hovering frame has no voltage in it
    tilt, yaw = math.hypot(tilt, TILT_SHARE), math.hypot(yaw, YAW_SHARE)
    return Exported(frame, parameters, loops, not_in_frame(stored), thrust, tilt, yaw, *_left(stored, loops))


def not_in_frame(stored: ModelFile) -> tuple[str, ...]:
    """Terms that SIM_Frame has not."""
    own = {t.id for t in catalogue().values() if block_of(t) == "attitude" and t.family == "autopilot"}
    return tuple(t for t in stored.model.terms if t not in KNOWN and t not in own)


def frame_model(stored: ModelFile, loops: FirmwareFrame) -> tuple[Model, dict[str, float]]:
    """The model as SIM_Frame behind the firmware has it, and its values: without what it lacks, with its own drag, dependence on the
    voltage and lag of the thrust; the attitude loops are the model's."""
    model, v = stored.model, stored.values
    replaced = [t for t in ("linear_drag", "quadratic_drag") if t in model.terms]
    kept = model.without_terms(*not_in_frame(stored), *replaced).with_terms(_FRAME_DRAG)
    nominal = model.nominal_voltage_v
    blown = 2.0 * HOVER_CURRENT_A * nominal / (_mass_kg(stored) * model.g_m_s2)  # m/s, out of the rotors in hover
    linear, square = _drags(stored)
    frame = {"frame_d": linear, "frame_k": square, "frame_inflow": model.g_m_s2 / blown**2}
    _, middle, _ = _voltages(stored)
    lag, delay = _thrust_lag(stored, loops)
    thrust = {
        "K": v["K"] * (middle / nominal) ** (v["alpha"] - 2.0),
        "alpha": 2.0,
        "sigma_t": 1.0 / lag,
        "T_d_thrust": delay,
    }
    return kept, kept.start(v) | frame | {n: value for n, value in thrust.items() if n in kept.names}


def _thrust_lag(stored: ModelFile, loops: FirmwareFrame) -> tuple[float, float]:
    """Time constant of the firmware's throttle filter and delay of the thrust behind it, s: in sum the model's, whose delay holds that of
    the recorded link."""
    delay = stored.delays_s["thrust"]
    own = max(delay - loops.link_delay_s, 0.0)
    lag = max(1.0 / stored.values["sigma_t"] + own - FIRMWARE_THRUST_DELAY_S, LEAST_LAG_S)
    return lag, delay - own + FIRMWARE_THRUST_DELAY_S


def _mass_kg(stored: ModelFile) -> float:
    weighed = stored.fingerprint.get("mass_kg")
    return float(weighed) if isinstance(weighed, int | float) else MASS_KG


def _voltages(stored: ModelFile) -> tuple[float, float, float]:
    """Lowest, middle and highest voltage of the model's flights, V; the nominal one where none is known."""
    low, high = (float(u) for u in stored.valid.get("voltage_v") or (stored.model.nominal_voltage_v,) * 2)
    return low, 0.5 * (low + high), high


def _drags(stored: ModelFile) -> tuple[float, float]:
    """Drag of all axes, linear 1/s and quadratic 1/m: the mean of forward and left."""
    return max(_mean(stored.values, ("d_x", "d_y")), 0.0), max(_mean(stored.values, ("k_x", "k_y")), 0.0)


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


def _left(stored: ModelFile, loops: FirmwareFrame) -> tuple[float, float]:
    """Largest difference of velocity, m/s, and of specific force, m/s^2, on the test maneuver in the middle of the voltages between the
    model and what SIM_Frame makes of it."""
    _, middle, _ = _voltages(stored)
    made = [test_maneuver(m, v, middle) for m, v in ((stored.model, stored.values), frame_model(stored, loops))]
    velocity, force = (
        max(float(np.abs(made[0][c] - made[1][c]).max()) for c in some)
        for some in (("v_x_m_s", "v_y_m_s", "v_z_m_s"), ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"))
    )
    return velocity, force


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
