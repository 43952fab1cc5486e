"""The vehicle's parameters: names and defaults of ArduCopter 4.7, and a store that sends them as MAVLink does."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9

# (name, type, default). Read on ArduCopter 4.7.0-dev SITL; SIM_* that ArduPilot has not are marked where they act.
_TABLE: tuple[tuple[str, int, float], ...] = (
    ("FORMAT_VERSION", INT16, 120), ("SYSID_ENFORCE", INT8, 0), ("MAV_SYSID", INT16, 1), ("MAV_GCS_SYSID", INT16, 255),
    ("MAV_OPTIONS", INT16, 0), ("FRAME_CLASS", INT8, 1), ("FRAME_TYPE", INT8, 1), ("SCHED_LOOP_RATE", INT16, 400),
    ("ARMING_CHECK", INT32, 1), ("ARMING_REQUIRE", INT8, 1), ("DISARM_DELAY", INT8, 10), ("INITIAL_MODE", INT8, 0),
    ("FLTMODE_CH", INT8, 5), ("FLTMODE1", INT8, 0), ("FLTMODE2", INT8, 5), ("FLTMODE3", INT8, 17), ("FLTMODE4", INT8, 9),
    ("FLTMODE5", INT8, 4), ("FLTMODE6", INT8, 2), ("FLTMODE_GCSBLOCK", INT32, 0),
    ("GUID_OPTIONS", INT32, 0), ("GUID_TIMEOUT", REAL32, 3.0),
    ("FS_GCS_ENABLE", INT8, 0), ("FS_GCS_TIMEOUT", REAL32, 5.0), ("FS_THR_ENABLE", INT8, 1), ("FS_THR_VALUE", INT16, 975),
    ("FS_EKF_ACTION", INT8, 1), ("FS_EKF_THRESH", REAL32, 0.8), ("FS_CRASH_CHECK", INT8, 1), ("FS_OPTIONS", INT32, 16),
    ("FENCE_ENABLE", INT8, 0), ("FENCE_TYPE", INT8, 7), ("FENCE_ACTION", INT8, 1), ("FENCE_ALT_MAX", REAL32, 100.0),
    ("FENCE_ALT_MIN", REAL32, -10.0), ("FENCE_RADIUS", REAL32, 300.0), ("FENCE_MARGIN", REAL32, 2.0),
    ("ATC_ANGLE_BOOST", INT8, 0), ("ATC_ANGLE_MAX", REAL32, 30.0), ("ATC_RATE_FF_ENAB", INT8, 0),
    ("ATC_INPUT_TC", REAL32, 0.15), ("ATC_ACC_R_MAX", REAL32, 1100.0), ("ATC_ACC_P_MAX", REAL32, 1100.0),
    ("ATC_ACC_Y_MAX", REAL32, 270.0), ("ATC_RATE_R_MAX", REAL32, 0.0), ("ATC_RATE_P_MAX", REAL32, 0.0),
    ("ATC_RATE_Y_MAX", REAL32, 0.0), ("ATC_ANG_RLL_P", REAL32, 4.5), ("ATC_ANG_PIT_P", REAL32, 4.5),
    ("ATC_ANG_YAW_P", REAL32, 4.5), ("ATC_RAT_RLL_P", REAL32, 0.135), ("ATC_RAT_RLL_I", REAL32, 0.135),
    ("ATC_RAT_RLL_D", REAL32, 0.0036), ("ATC_RAT_PIT_P", REAL32, 0.135), ("ATC_RAT_PIT_I", REAL32, 0.135),
    ("ATC_RAT_PIT_D", REAL32, 0.0036), ("ATC_RAT_YAW_P", REAL32, 0.18), ("ATC_RAT_YAW_I", REAL32, 0.018),
    ("ATC_RAT_YAW_D", REAL32, 0.0), ("ATC_THR_MIX_MAN", REAL32, 0.1), ("ATC_THR_MIX_MAX", REAL32, 0.5),
    ("ATC_THR_MIX_MIN", REAL32, 0.1),
    ("MOT_THST_EXPO", REAL32, 0.65), ("MOT_THST_HOVER", REAL32, 0.2), ("MOT_HOVER_LEARN", INT8, 2),
    ("MOT_SPIN_ARM", REAL32, 0.10), ("MOT_SPIN_MIN", REAL32, 0.15), ("MOT_SPIN_MAX", REAL32, 0.95),
    ("MOT_BAT_VOLT_MAX", REAL32, 0.0), ("MOT_BAT_VOLT_MIN", REAL32, 0.0), ("MOT_BAT_CURR_MAX", REAL32, 0.0),
    ("MOT_SLEW_UP_TIME", REAL32, 0.0), ("MOT_SLEW_DN_TIME", REAL32, 0.0), ("MOT_SPOOL_TIME", REAL32, 0.5),
    ("PILOT_THR_FILT", REAL32, 0.0), ("PILOT_TKOFF_ALT", REAL32, 0.0), ("PILOT_SPD_UP", REAL32, 2.5), ("THR_DZ", INT16, 100),
    ("INS_ACCEL_FILTER", INT16, 20), ("INS_GYRO_FILTER", INT16, 0), ("INS_HNTCH_ENABLE", INT8, 0), ("INS_HNTC2_ENABLE", INT8, 0),
    ("INS_LOG_BAT_MASK", INT8, 0), ("INS_POS1_X", REAL32, 0.0), ("INS_POS1_Y", REAL32, 0.0), ("INS_POS1_Z", REAL32, 0.0),
    ("LOG_BITMASK", INT32, 176126), ("LOG_DISARMED", INT8, 0), ("LOG_BACKEND_TYPE", INT8, 0), ("LOG_FILE_RATEMAX", REAL32, 0.0),
    ("BATT_MONITOR", INT8, 4), ("BATT_CAPACITY", INT32, 5000), ("BATT_LOW_VOLT", REAL32, 0.0), ("BATT_CRT_VOLT", REAL32, 0.0),
    ("BATT_FS_LOW_ACT", INT8, 0), ("BATT_FS_CRT_ACT", INT8, 0), ("BATT_VOLT_MULT", REAL32, 10.1), ("BATT_AMP_PERVLT", REAL32, 17.0),
    ("WP_SPD", REAL32, 5.0), ("WP_SPD_UP", REAL32, 2.5), ("WP_SPD_DN", REAL32, 1.5), ("WP_ACC", REAL32, 2.5),
    ("WP_RADIUS_M", REAL32, 2.0), ("LAND_SPD_MS", REAL32, 0.5), ("LAND_SPD_HIGH_MS", REAL32, 0.0), ("RTL_ALT_M", REAL32, 15.0),
    ("RTL_LOIT_TIME", INT32, 5000), ("LOIT_SPEED_MS", REAL32, 12.5), ("PSC_NE_POS_P", REAL32, 1.0), ("PSC_NE_VEL_P", REAL32, 2.0),
    ("PSC_NE_VEL_I", REAL32, 1.0), ("PSC_D_POS_P", REAL32, 1.0), ("PSC_D_VEL_P", REAL32, 5.0), ("PSC_D_ACC_P", REAL32, 0.05),
    ("EK3_ENABLE", INT8, 1), ("EK3_SRC1_POSXY", INT8, 3), ("EK3_SRC1_VELXY", INT8, 3), ("EK3_SRC1_POSZ", INT8, 1),
    ("EK3_SRC1_VELZ", INT8, 3), ("EK3_SRC1_YAW", INT8, 1), ("AHRS_EKF_TYPE", INT8, 3), ("AHRS_TRIM_X", REAL32, 0.0),
    ("AHRS_TRIM_Y", REAL32, 0.0), ("GPS1_TYPE", INT8, 1), ("COMPASS_USE", INT8, 1), ("COMPASS_DEC", REAL32, 0.0),
    ("RC1_TRIM", INT16, 1500), ("RC2_TRIM", INT16, 1500), ("RC3_MIN", INT16, 1000), ("RC3_MAX", INT16, 2000),
    ("RC3_TRIM", INT16, 1500), ("RC4_TRIM", INT16, 1500), ("RCMAP_ROLL", INT8, 1), ("RCMAP_PITCH", INT8, 2),
    ("RCMAP_THROTTLE", INT8, 3), ("RCMAP_YAW", INT8, 4), ("RNGFND1_TYPE", INT8, 0), ("BRD_TYPE", INT8, 0),
    ("BARO1_GND_PRESS", REAL32, 94502.83), ("STAT_RUNTIME", INT32, 0), ("STAT_FLTTIME", INT32, 0), ("STAT_BOOTCNT", INT16, 1),
    ("MIS_TOTAL", INT16, 0),
    ("SIM_SPEEDUP", REAL32, 1.0), ("SIM_BATT_VOLTAGE", REAL32, 25.2), ("SIM_BATT_CAP_AH", REAL32, 5.0), ("SIM_RC_FAIL", INT8, 0),
    ("SIM_GPS1_ENABLE", INT8, 1),
    # Not in ArduPilot: 1 lets the vehicle's time go only as far as the client grants (see `lockstep`); the pilot's mode switch and
    # throttle stick (-1: untouched); the charge below which a landed, disarmed vehicle is given a full battery (0: never).
    ("SIM_BATT_SWAP", REAL32, 0.4), ("SIM_LOCKSTEP", INT8, 0), ("SIM_PILOT_MODE", INT8, -1), ("SIM_PILOT_THR", INT16, 1500),
)  # fmt: skip


class ParameterStore:
    """Values by name, each kept as its type would keep it (integers whole, floats in single precision)."""

    def __init__(self, overrides: Mapping[str, float] | None = None) -> None:
        self._types = {name: kind for name, kind, _ in _TABLE}
        self._values = {name: float(value) for name, _, value in _TABLE}
        self._names = tuple(self._values)
        self._index = {name: i for i, name in enumerate(self._names)}
        for name, value in (overrides or {}).items():
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def name_at(self, index: int) -> str | None:
        """The name at an index of the list, or None outside it."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index(self, name: str) -> int:
        """Place of a name in the list."""
        return self._index[name]

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a name."""
        return self._types[name]

    def set(self, name: str, value: float) -> float:
        """Store a value as its type keeps it, and return that."""
        single = struct.unpack("<f", struct.pack("<f", value))[0]
        kept = float(single) if self._types[name] == REAL32 else float(round(value))
        self._values[name] = kept
        return kept
