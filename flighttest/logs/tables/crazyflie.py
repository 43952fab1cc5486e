"""What the log variables of a Crazyflie are called and measure, for logs that come without a column map.

Source: the Crazyflie firmware's log groups (bitcraze.io, "list of logs"). Angles are in degrees in its legacy body frame, in which pitch
is positive nose up; accelerations in g, stateEstimate's without gravity in the world frame; thrust runs from 0 to 65535.
"""

from __future__ import annotations

from flighttest.logs.tables.columns import ColumnMap, Source

_DEG = 0.017453292519943295
_G = 9.80665
_THRUST = 1.0 / 65535.0

_KNOWN: dict[str, Source] = {
    "t_s": Source(("timestamp",), 1e-3),
    "roll_rad": Source(("stateEstimate.roll",), _DEG),
    "pitch_rad": Source(("stateEstimate.pitch",), -_DEG),
    "yaw_rad": Source(("stateEstimate.yaw",), _DEG),
    "p_rad_s": Source(("controller.r_roll",)),
    "q_rad_s": Source(("controller.r_pitch",)),
    "r_rad_s": Source(("controller.r_yaw",)),
    "roll_ref_rad": Source(("controller.roll",), _DEG),
    "pitch_ref_rad": Source(("controller.pitch",), -_DEG),
    "f_z_m_s2": Source(("controller.accelz",), _G),
    "a_x_m_s2": Source(("stateEstimate.ax",), _G),
    "a_y_m_s2": Source(("stateEstimate.ay",), _G),
    "a_z_m_s2": Source(("stateEstimate.az",), _G),
    "v_x_m_s": Source(("stateEstimate.vx",)),
    "v_y_m_s": Source(("stateEstimate.vy",)),
    "v_z_m_s": Source(("stateEstimate.vz",)),
    "p_x_m": Source(("stateEstimate.x",)),
    "p_y_m": Source(("stateEstimate.y",)),
    "p_z_m": Source(("stateEstimate.z",)),
    "voltage_v": Source(("pm.vbatMV",), 1e-3),
    **{f"motor_{k}": Source((f"motor.m{k}",), _THRUST) for k in range(1, 5)},
}  # fmt: skip
# The first that was logged: the command, else what the motors were commanded.
_THROTTLE = (
    Source(("controller.cmd_thrust",), _THRUST),
    Source(("stabilizer.thrust",), _THRUST),
    Source(("motor.m1", "motor.m2", "motor.m3", "motor.m4"), _THRUST),
)


def crazyflie_map(names: tuple[str, ...]) -> ColumnMap:
    """The map of those variables that were logged."""
    present = set(names)
    columns = {name: source for name, source in _KNOWN.items() if present.issuperset(source.columns)}
    throttle = next((source for source in _THROTTLE if present.issuperset(source.columns)), None)
    if throttle is not None:
        columns["throttle"] = throttle
    return ColumnMap(columns)
