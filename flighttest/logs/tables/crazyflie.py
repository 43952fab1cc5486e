"""What the log variables of a Crazyflie are called and measure, for logs that come without a column map.

Source: the Crazyflie firmware's log groups (bitcraze.io, "list of logs"). Angles are in degrees in its legacy body frame, in which pitch
is positive nose up, as is controller.r_pitch (minus gyro.y), in rad/s; gyro in deg/s and acc in g are in the body frame, z up;
stateEstimate's accelerations are in g without gravity in the world frame; thrust runs from 0 to 65535. stateEstimateZ has the same state
as integers, mm, mm/s and mrad/s, its pitch rate minus gyro.y (stabilizer.c); ctrlLee's angles and rates are in rad and rad/s, FLU, its
thrust in newtons (controller_lee.c).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.tables.columns import ColumnMap, ColumnSource
from flighttest.logs.tables.sheet import Sheet

FloatArray = NDArray[np.float64]

_DEG = 0.017453292519943295
_G = 9.80665
_THRUST = 1.0 / 65535.0
_MILLI = 1e-3
# Four motors of 0.2 N, more than the 0.16 N of the strongest flight read so far: the scale of a throttle is arbitrary, K takes it.
_NEWTONS = 1.0 / 0.8


def _rates(controller: str, sign: float, gyro: str, lee: str, integers: str, unit: float) -> tuple[ColumnSource, ...]:
    return (
        ColumnSource((controller,), sign),
        ColumnSource((gyro,), _DEG),
        ColumnSource((lee,)),
        ColumnSource((integers,), unit),
    )


# The first that was logged.
_KNOWN: dict[str, tuple[ColumnSource, ...]] = {
    "t_s": (ColumnSource(("timestamp",), 1e-3),),
    "roll_rad": (ColumnSource(("stateEstimate.roll",), _DEG), ColumnSource(("ctrlLee.rpyx",))),
    "pitch_rad": (ColumnSource(("stateEstimate.pitch",), -_DEG), ColumnSource(("ctrlLee.rpyy",))),
    "yaw_rad": (ColumnSource(("stateEstimate.yaw",), _DEG), ColumnSource(("ctrlLee.rpyz",))),
    "p_rad_s": _rates("controller.r_roll", 1.0, "gyro.x", "ctrlLee.omegax", "stateEstimateZ.rateRoll", _MILLI),
    "q_rad_s": _rates("controller.r_pitch", -1.0, "gyro.y", "ctrlLee.omegay", "stateEstimateZ.ratePitch", -_MILLI),
    "r_rad_s": _rates("controller.r_yaw", 1.0, "gyro.z", "ctrlLee.omegaz", "stateEstimateZ.rateYaw", _MILLI),
    "roll_ref_rad": (ColumnSource(("controller.roll",), _DEG), ColumnSource(("ctrlLee.rpydx",))),
    "pitch_ref_rad": (ColumnSource(("controller.pitch",), -_DEG), ColumnSource(("ctrlLee.rpydy",))),
    "f_x_m_s2": (ColumnSource(("acc.x",), _G),),
    "f_y_m_s2": (ColumnSource(("acc.y",), _G),),
    "f_z_m_s2": (ColumnSource(("controller.accelz",), _G), ColumnSource(("acc.z",), _G)),
    "a_x_m_s2": (ColumnSource(("stateEstimate.ax",), _G),),
    "a_y_m_s2": (ColumnSource(("stateEstimate.ay",), _G),),
    "a_z_m_s2": (ColumnSource(("stateEstimate.az",), _G),),
    "v_x_m_s": (ColumnSource(("stateEstimate.vx",)), ColumnSource(("stateEstimateZ.vx",), _MILLI)),
    "v_y_m_s": (ColumnSource(("stateEstimate.vy",)), ColumnSource(("stateEstimateZ.vy",), _MILLI)),
    "v_z_m_s": (ColumnSource(("stateEstimate.vz",)), ColumnSource(("stateEstimateZ.vz",), _MILLI)),
    "p_x_m": (ColumnSource(("stateEstimate.x",)), ColumnSource(("stateEstimateZ.x",), _MILLI)),
    "p_y_m": (ColumnSource(("stateEstimate.y",)), ColumnSource(("stateEstimateZ.y",), _MILLI)),
    "p_z_m": (ColumnSource(("stateEstimate.z",)), ColumnSource(("stateEstimateZ.z",), _MILLI)),
    "voltage_v": (ColumnSource(("pm.vbatMV",), 1e-3),),
    **{f"motor_{k}": (ColumnSource((f"motor.m{k}",), _THRUST),) for k in range(1, 5)},
    # the command, else what the motors were commanded
    "throttle": (
        ColumnSource(("controller.cmd_thrust",), _THRUST), ColumnSource(("stabilizer.thrust",), _THRUST),
        ColumnSource(("motor.m1", "motor.m2", "motor.m3", "motor.m4"), _THRUST),
        ColumnSource(("ctrlLee.thrustSI",), _NEWTONS), ColumnSource(("ctrlLee.thrustSi",), _NEWTONS),
    ),
}  # fmt: skip
# Second-order low-passes before anything reads the sensors (ACCEL_LPF_CUTOFF_FREQ, GYRO_LPF_CUTOFF_FREQ of sensors_bmi088_bmp388.c).
_FILTERS_HZ = {"specific_force": 30.0, "rates": 80.0}
# Commands and what each adds to the motors 1 to 4 (power_distribution_quadrotor.c, powerDistributionLegacy).
_MIXER = {
    "controller.cmd_thrust": (1.0, 1.0, 1.0, 1.0), "controller.cmd_roll": (-0.5, -0.5, 0.5, 0.5),
    "controller.cmd_pitch": (0.5, -0.5, -0.5, 0.5), "controller.cmd_yaw": (1.0, -1.0, 1.0, -1.0),
}  # fmt: skip
_OFTEN = 0.01  # of the samples with thrust: a motor that is at its limit less often leaves thrust as it was asked for


def crazyflie_map(names: tuple[str, ...]) -> ColumnMap:
    """The map of those variables that were logged."""
    present = set(names)
    logged = {
        name: next((one for one in sources if present.issuperset(one.columns)), None)
        for name, sources in _KNOWN.items()
    }
    return ColumnMap({name: one for name, one in logged.items() if one is not None}, filters_hz=_FILTERS_HZ)


def mixed_commands(sheet: Sheet) -> dict[str, FloatArray]:
    """Channel to command, 0 to 1, of the four motors where thrust and torques were logged in their place: their sum as the firmware mixes
    them, within what a motor has. None where one of them is missing."""
    return (
        {}
        if (asked := _asked(sheet)) is None
        else {f"motor_{k}": np.clip(m, 0.0, 1.0) for k, m in enumerate(asked.T, 1)}
    )


def _asked(sheet: Sheet) -> FloatArray | None:
    """What thrust and torques together ask of each motor, (n, 4) of its range, 0 where no thrust is asked for."""
    if not set(_MIXER) <= set(sheet.names):
        return None
    asked = np.sum([np.outer(sheet.column(name), parts) for name, parts in _MIXER.items()], axis=0) * _THRUST
    return np.where(sheet.column("controller.cmd_thrust")[:, None] > 0.0, asked, 0.0)


def beyond_limits(sheet: Sheet) -> list[str]:
    """A sentence for each motor that thrust and torques together ask for more than it has. What the motors give then is less than the
    thrust command, by how much depends on the firmware: older ones limit each motor, newer ones take as much from all four."""
    asked = _asked(sheet)
    if asked is None:
        return []
    flying = sheet.column("controller.cmd_thrust") > 0.0
    found = []
    for k, motor in enumerate(asked[flying].T, 1):
        share = float(np.mean(motor > 1.0)) if motor.size else 0.0
        if share > _OFTEN:
            found.append(
                f"motor {k} was asked for up to {motor.max():.2f} of its range, for more than it has in {100 * share:.0f} % of the flight: "
                "the thrust is less there than controller.cmd_thrust"
            )
    return found
