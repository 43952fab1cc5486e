"""What the log variables of a Crazyflie are called and measure, for logs that come without a column map.

Source: the Crazyflie firmware's log groups (bitcraze.io, "list of logs"). Angles are in degrees in its legacy body frame, in which pitch
is positive nose up, as is controller.r_pitch (minus gyro.y), in rad/s; gyro in deg/s and acc in g are in the body frame, z up;
stateEstimate's accelerations are in g without gravity in the world frame; thrust runs from 0 to 65535.
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

# The first that was logged.
_KNOWN: dict[str, tuple[ColumnSource, ...]] = {
    "t_s": (ColumnSource(("timestamp",), 1e-3),),
    "roll_rad": (ColumnSource(("stateEstimate.roll",), _DEG),),
    "pitch_rad": (ColumnSource(("stateEstimate.pitch",), -_DEG),),
    "yaw_rad": (ColumnSource(("stateEstimate.yaw",), _DEG),),
    "p_rad_s": (ColumnSource(("controller.r_roll",)), ColumnSource(("gyro.x",), _DEG)),
    "q_rad_s": (ColumnSource(("controller.r_pitch",), -1.0), ColumnSource(("gyro.y",), _DEG)),
    "r_rad_s": (ColumnSource(("controller.r_yaw",)), ColumnSource(("gyro.z",), _DEG)),
    "roll_ref_rad": (ColumnSource(("controller.roll",), _DEG),),
    "pitch_ref_rad": (ColumnSource(("controller.pitch",), -_DEG),),
    "f_x_m_s2": (ColumnSource(("acc.x",), _G),),
    "f_y_m_s2": (ColumnSource(("acc.y",), _G),),
    "f_z_m_s2": (ColumnSource(("controller.accelz",), _G), ColumnSource(("acc.z",), _G)),
    "a_x_m_s2": (ColumnSource(("stateEstimate.ax",), _G),),
    "a_y_m_s2": (ColumnSource(("stateEstimate.ay",), _G),),
    "a_z_m_s2": (ColumnSource(("stateEstimate.az",), _G),),
    "v_x_m_s": (ColumnSource(("stateEstimate.vx",)),),
    "v_y_m_s": (ColumnSource(("stateEstimate.vy",)),),
    "v_z_m_s": (ColumnSource(("stateEstimate.vz",)),),
    "p_x_m": (ColumnSource(("stateEstimate.x",)),),
    "p_y_m": (ColumnSource(("stateEstimate.y",)),),
    "p_z_m": (ColumnSource(("stateEstimate.z",)),),
    "voltage_v": (ColumnSource(("pm.vbatMV",), 1e-3),),
    **{f"motor_{k}": (ColumnSource((f"motor.m{k}",), _THRUST),) for k in range(1, 5)},
    # the command, else what the motors were commanded
    "throttle": (
        ColumnSource(("controller.cmd_thrust",), _THRUST), ColumnSource(("stabilizer.thrust",), _THRUST),
        ColumnSource(("motor.m1", "motor.m2", "motor.m3", "motor.m4"), _THRUST),
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
