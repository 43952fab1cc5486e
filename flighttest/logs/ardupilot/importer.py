"""ArduPilot dataflash logs (.BIN) to a Recording: which message of which firmware gives which channel.

The reference is GUIA (each SET_ATTITUDE_TARGET at its arrival). Where a log has none, the autopilot's own targets are taken for it and
`derived` notes it. NED/FRD become NWU/FLU here and nowhere later.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from flighttest import frames
from flighttest.errors import RecordingError
from flighttest.logs.ardupilot.dataflash import TEXT_HEADER, Dataflash, MessageTable, read_dataflash, stack
from flighttest.logs.ardupilot.notes import board, firmware, logged_parameters, markers, parameter_changes, state
from flighttest.logs.ardupilot.targets import Targets
from flighttest.logs.ardupilot.text_log import messages
from flighttest.logs.ardupilot.times import Stamped, Times
from flighttest.logs.heights import ranged_height
from flighttest.logs.opening import LogFile, name_of
from flighttest.logs.other_vehicles import quadplane, refuse_by_firmware
from flighttest.logs.timing import ordered
from flighttest.mavlink import offset_m
from flighttest.mavlink.telemetry import LEAST_BATTERY_V, NO_BATTERY, motor_columns
from flighttest.recording import Provenance, Recording, Series
from flighttest.recording.manifest import ClockData

FloatArray = NDArray[np.float64]

_TIME = ("TimeUS", "TimeMS")
_ANGLES = (*_TIME, "DesRoll", "Roll", "DesPitch", "Pitch", "DesYaw", "Yaw")
_EKF = (*_TIME, "C", "VN", "VE", "VD", "PN", "PE", "PD")
_BATTERY = (*_TIME, "Inst", "Instance", "Volt", "Curr")
WANTED: dict[str, tuple[str, ...] | None] = {
    "ANG": _ANGLES,
    "ATT": _ANGLES,
    "RATE": (*_TIME, "R", "P", "Y", "YDes", "AOut"),
    "IMU": (*_TIME, "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GUIA": (*_TIME, "Type", "Roll", "Pitch", "Yaw", "RollRt", "PitchRt", "YawRt", "Thrust", "ClimbRt"),
    "CTUN": (*_TIME, "ThI", "ThO", "ABst", "ThrIn", "ThrOut", "AngBst"),
    "RCOU": (*_TIME, *(f"{prefix}{k}" for prefix in ("C", "Ch") for k in range(1, 15))),
    "BAT": _BATTERY,
    "CURR": _BATTERY,
    "XKF1": _EKF,
    "NKF1": _EKF,
    "EKF1": _EKF,
    "XKF4": (*_TIME, "C", "PI", "SS"),
    "NKF4": (*_TIME, "C", "PI", "SS"),
    "GPS": (*_TIME, "T", "I", "Status", "Lat", "Lng", "Alt", "Spd", "GCrs", "VZ"),
    "RFND": None,
    "PARM": None,
    "MSG": None,
    "MODE": None,
    "EV": None,
    "ERR": None,
    "ARM": None,
    "VER": None,
}  # fmt: skip
_NEEDED: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("ANG", "ATT"), ("Roll", "Pitch", "Yaw")),
    **dict.fromkeys(("XKF1", "NKF1", "EKF1"), ("VN", "VE", "VD", "PN", "PE", "PD")),
    "RATE": ("R", "P", "Y", "YDes"),
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GUIA": ("Roll", "Pitch", "YawRt", "Thrust"),
    "GPS": ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ"),
}
_TEXTS = frozenset({"Name", "Message", "FWS"})
DEFAULT_ACCEL_FILTER_HZ = 20.0
"""INS_ACCEL_FILTER as ArduPilot ships it (AP_InertialSensor.cpp)."""
_STATUS = {"XKF1": "XKF4", "NKF1": "NKF4"}
_CONSTANT_POSITION = 1 << 7  # of the EKF's solution status (AP_Nav_Common.h)
_FACING_DOWN = 25
_RANGE_GOOD = 4
_GPS_3D = 3
_MOTOR = 32  # SERVOn_FUNCTION of the first motor is one more (SRV_Channel.h)


def import_ardupilot_bin(path: Path) -> Recording:
    """Read a dataflash log (plain, .gz or .xz, or as text) of ArduCopter 3.2 to 4.7. RecordingError where it holds no flight."""
    file = LogFile(path)
    log = read_dataflash(messages(file.pieces()) if file.head().startswith(TEXT_HEADER) else file.pieces(), WANTED)
    if not log.formats:
        raise RecordingError(
            f"{path}: no dataflash message was found in {log.size} bytes", "is this a .BIN log of ArduPilot?"
        )
    return _Importer(path, file, log).recording()


class _Importer:
    def __init__(self, path: Path, file: LogFile, log: Dataflash) -> None:
        self.path = path
        self.file = file
        times = Times(log)
        if not times.known:
            raise RecordingError(
                f"{path}: no message with a time stamp was found in {log.size} bytes",
                "download the log from the vehicle again",
            )
        self.tables: dict[str, Stamped] = {}
        for name, table in log.tables.items():
            kept, t_s = times.of(name, table)
            if len(kept):
                self.tables[name] = (_sound(kept), t_s)
        self.losses = [*file.losses, *_gap_sentences(log), *log.notes, *times.losses]
        for name, fields in _NEEDED.items():
            if name in self.tables and not all(field in self.tables[name][0] for field in fields):
                self.losses.append(
                    f"{name} was not used: its format declares no {', '.join(fields)} (an unknown or damaged FMT)"
                )
                del self.tables[name]
        self.derived: dict[str, str] = {}
        self.choices: dict[str, str] = {}
        self.parameters = logged_parameters(self.tables)
        self.firmware = firmware(self.tables)
        self.winged = refuse_by_firmware(path, self.firmware, self.parameters)

    def recording(self) -> Recording:
        """All series that the log allows."""
        series: dict[str, Series] = {}
        angles = self._denser("ANG", "ATT")
        self._put(series, "attitude", self._attitude(angles))
        self._put(series, "rates", self._rates())
        self._put(series, "specific_force", self._specific_force())
        targets = Targets(self.tables, angles, self.derived, self.losses)
        self._put(series, "shaped", targets.shaped())
        marks = markers(self.tables)
        self._put(series, "state", state(self.tables))
        self._put(series, "reference", targets.reference(series.get("state")))
        self._put(series, "output", targets.output())
        self._motion(series)
        self._put(series, "height", self._height(series))
        self._put(series, "battery", self._battery())
        self._put(series, "motors", self._motors())
        if not {"attitude", "specific_force", "velocity"} & set(series):
            raise RecordingError(
                f"{self.path}: neither attitude nor acceleration nor velocity is in the log",
                "set LOG_BITMASK so that ATT, IMU and XKF1 are logged",
            )
        marks = sorted([*marks, *parameter_changes(self.tables.get("PARM"))], key=lambda m: m.t_s)
        recording = Recording(
            name=name_of(self.path),
            series=series,
            markers=tuple(marks),
            provenance=Provenance(
                source=str(self.path),
                importer="ardupilot_bin",
                sha256=self.file.sha256,
                firmware=self.firmware,
                parameters=self.parameters,
                clock=cast(ClockData, {"method": "vehicle", "offset_s": 0.0, "error_s": 0.0, **self.choices}),
                losses=tuple(self.losses),
                filters=known_filters(self.parameters),
                derived=self.derived,
                autopilot=board(self.tables),
            ),
        )
        return quadplane(self.path, recording) if self.winged else recording

    @staticmethod
    def _put(series: dict[str, Series], group: str, found: Series | None) -> None:
        if found is not None and len(found):
            series[group] = found

    def _denser(self, *names: str) -> tuple[str, MessageTable, FloatArray] | None:
        """The message with the most samples; the first named wins a tie."""
        found = [(name, *self.tables[name]) for name in names if name in self.tables]
        return max(found, key=lambda item: len(item[1]), default=None)

    def _instance(self, name: str, *fields: str) -> Stamped | None:
        """The messages of the primary instance, which `choices` names."""
        if name not in self.tables:
            return None
        table, t_s = self.tables[name]
        field = next((f for f in fields if f in table), None)
        if field is None:
            return table, t_s
        instances = Counter(int(i) for i in table.raw[field])
        real = [i for i, n in instances.items() if n >= 0.1 * max(instances.values())]
        wanted = self._primary(name)
        chosen = wanted if wanted in real else min(real)
        if len(real) > 1:
            self.choices[name] = f"instance {chosen} of {', '.join(map(str, sorted(real)))}"
        keep = table.raw[field] == chosen
        return table.where(keep), t_s[keep]

    def _primary(self, name: str) -> int | None:
        """The instance the autopilot flew on: the EKF's primary lane, and the IMU that lane uses."""
        for ekf, mask in (("XKF4", "EK3_IMU_MASK"), ("NKF4", "EK2_IMU_MASK")):
            if ekf in self.tables and "PI" in self.tables[ekf][0]:
                lane = Counter(int(i) for i in self.tables[ekf][0].raw["PI"]).most_common(1)[0][0]
                if name in ("XKF1", "NKF1", "XKF4", "NKF4"):
                    return lane
                if name == "IMU":
                    used = [i for i in range(8) if int(self.parameters.get(mask, 1)) >> i & 1]
                    return used[lane] if 0 <= lane < len(used) else None
        return None

    def _attitude(self, angles: tuple[str, MessageTable, FloatArray] | None) -> Series | None:
        if angles is None:
            return None
        name, table, t_s = angles
        rpy = frames.flip_euler(np.radians(stack(table, "Roll", "Pitch", "Yaw")))
        rpy[:, 2] = frames.wrap_angle(rpy[:, 2])
        return ordered(t_s, named_columns(rpy, "roll_rad", "pitch_rad", "yaw_rad"), name, self.losses)

    def _rates(self) -> Series | None:
        rate, imu = self.tables.get("RATE"), self._instance("IMU", "I")
        names = ("p_rad_s", "q_rad_s", "r_rad_s")
        if rate is not None and (imu is None or len(rate[0]) >= 0.9 * len(imu[0])):
            values = np.radians(stack(rate[0], "R", "P", "Y"))
            return ordered(rate[1], named_columns(frames.flip_vector(values), *names), "RATE", self.losses)
        if imu is None:
            return None
        return ordered(
            imu[1], named_columns(frames.flip_vector(stack(imu[0], "GyrX", "GyrY", "GyrZ")), *names), "IMU", self.losses
        )

    def _specific_force(self) -> Series | None:
        imu = self._instance("IMU", "I")
        if imu is None:
            return None
        values = frames.flip_vector(stack(imu[0], "AccX", "AccY", "AccZ"))
        return ordered(imu[1], named_columns(values, "f_x_m_s2", "f_y_m_s2", "f_z_m_s2"), "IMU", self.losses)

    def _motion(self, series: dict[str, Series]) -> None:
        for name in ("XKF1", "NKF1", "EKF1"):
            ekf = self._instance(name, "C")
            if ekf is None:
                continue
            table, t_s = ekf
            velocity, position = stack(table, "VN", "VE", "VD"), stack(table, "PN", "PE", "PD")
            if not np.any(velocity):
                continue
            made_up = self._made_up(name, t_s)
            for group, values, names in (("velocity", velocity, _V), ("position", position, _P)):
                values[made_up, :2] = np.nan
                columns = named_columns(frames.flip_vector(values), *names)
                columns = {n: v for n, v in columns.items() if np.isfinite(v).any()}
                self._put(series, group, ordered(t_s, columns, name, self.losses if group == "velocity" else []))
            return
        self._gps(series)

    def _made_up(self, name: str, t_s: FloatArray) -> NDArray[np.bool_]:
        """Where the EKF had nothing that measures horizontal motion (n,): it takes its position as constant then, its velocity drifts."""
        status = self._instance(_STATUS.get(name, ""), "C")
        if status is None or "SS" not in status[0]:
            return np.zeros(t_s.size, dtype=bool)
        held = status[0].raw["SS"].astype(np.int64) & _CONSTANT_POSITION != 0
        found = held[np.maximum(np.searchsorted(status[1], t_s, side="right") - 1, 0)]
        if found.any():
            self.losses.append(
                f"{name}: for {np.mean(found):.0%} of the time the EKF had neither GPS nor optical flow; its horizontal velocity and "
                "position were not used there"
            )
        return np.asarray(found)

    def _gps(self, series: dict[str, Series]) -> None:
        gps = self._instance("GPS", "I")
        if gps is None:
            return
        fix = gps[0].raw["Status"] >= _GPS_3D if "Status" in gps[0] else np.ones(len(gps[0]), dtype=bool)
        if not fix.any():
            return
        table, t_s = gps[0].where(fix), gps[1][fix]
        course = np.radians(table.get("GCrs"))
        ned = np.stack([table.get("Spd") * np.cos(course), table.get("Spd") * np.sin(course), table.get("VZ")], axis=-1)
        self._put(series, "velocity", ordered(t_s, named_columns(frames.flip_vector(ned), *_V), "GPS", self.losses))
        lat, lon, up = table.get("Lat"), table.get("Lng"), table.get("Alt")
        north, west = offset_m(float(lat[0]), float(lon[0]), lat, lon)
        columns = {"p_x_m": north, "p_y_m": west, "p_z_m": up - up[0]}
        self._put(series, "position", ordered(t_s, columns, "GPS", []))
        for name in (*_V, *_P):
            self.derived[name] = "GPS: the log has no EKF message"

    def _height(self, series: dict[str, Series]) -> Series | None:
        position = series.get("position")
        if "RFND" in self.tables:
            table, t_s = self.tables["RFND"]
            dist = next((f for f in ("Dist", "Dist1") if f in table), None)
            if dist is not None:
                down = table.raw["Orient"] == _FACING_DOWN if "Orient" in table else np.ones(len(table), dtype=bool)
                ranged = table.get(dist)[down]
                good = ranged > 0
                if "Stat" in table:
                    good &= table.raw["Stat"][down] == _RANGE_GOOD
                if np.count_nonzero(good) > 0.2 * len(table):
                    height, how = ranged_height(t_s[down], ranged, good, position)
                    if how:
                        self.derived["height_m"] = how
                    return ordered(t_s[down], {"height_m": height}, "RFND", self.losses)
        if position is None:
            return None
        up = position.columns["p_z_m"]
        start = position.t_s <= position.t_s[0] + 1.0
        ground = float(np.median(up[start]))
        self.derived["height_m"] = (
            "height above where the log begins (p_z_m), taken as level ground; the log has no rangefinder looking down"
        )
        return Series(position.t_s, {"height_m": up - ground})

    def _battery(self) -> Series | None:
        for name in ("BAT", "CURR"):
            self._drop_unmonitored(name)
        found = self._instance("BAT", "Inst", "Instance") or self._instance("CURR", "Instance", "Inst")
        if found is None or "Volt" not in found[0]:
            return None
        table, t_s = found
        scale = 1e-2 if table.format.codes[table.format.fields.index("Volt")] == "h" else 1.0  # before Copter 3.3
        voltage = table.get("Volt") * scale
        if not np.any(voltage > LEAST_BATTERY_V):
            self.losses.append(NO_BATTERY)
            return None
        columns = {"voltage_v": np.where(voltage > LEAST_BATTERY_V, voltage, np.nan)}
        if "Curr" in table:
            current = table.get("Curr") * scale
            columns["current_a"] = np.where(current >= 0, current, np.nan)
        return ordered(t_s, columns, table.format.name, self.losses)

    def _motors(self) -> Series | None:
        """Commands of the motors of a quadrotor, by the outputs that they are on (SERVOn_FUNCTION)."""
        if "RCOU" not in self.tables:
            return None
        on = {int(self.parameters.get(f"SERVO{n}_FUNCTION", 0)): n for n in range(1, 15)}
        table, t_s = self.tables["RCOU"]
        prefix = "C" if "C1" in table else "Ch"
        fields = [f"{prefix}{on.get(_MOTOR + k, k)}" for k in range(1, 5)]
        if _MOTOR + 5 in on or not all(field in table for field in fields):
            return None
        return ordered(t_s, motor_columns(stack(table, *fields)), "RCOU", self.losses)

    def _drop_unmonitored(self, name: str) -> None:
        """Leave out batteries that were set up for their current alone, where another one measures its voltage."""
        table, t_s = self.tables.get(name, (None, None))
        field = next((f for f in ("Inst", "Instance") if table is not None and f in table), None)
        if table is None or t_s is None or field is None or "Volt" not in table:
            return
        keep = np.isin(table.raw[field], table.raw[field][table.get("Volt") > LEAST_BATTERY_V])
        if keep.any():
            self.tables[name] = table.where(keep), t_s[keep]


_V = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_P = ("p_x_m", "p_y_m", "p_z_m")


def known_filters(parameters: dict[str, float]) -> dict[str, float]:
    """Measurement filters ArduPilot applies before logging and sending, Hz, by channel group."""
    pairs = (("specific_force", "INS_ACCEL_FILTER"), ("rates", "INS_GYRO_FILTER"))
    return {group: parameters[name] for group, name in pairs if parameters.get(name, 0.0) > 0}


def _sound(table: MessageTable) -> MessageTable:
    """The fields that are as their name states, text or one number: a damaged FMT can make them anything."""
    raw = {n: v for n, v in table.raw.items() if v.ndim == 1 and (v.dtype.kind == "S") == (n in _TEXTS)}
    return MessageTable(table.format, table.at, raw)


def named_columns(values: FloatArray, *names: str) -> dict[str, FloatArray]:
    """Columns (n,) of values (n, names) by name."""
    return {name: values[:, i] for i, name in enumerate(names)}


def _gap_sentences(log: Dataflash) -> list[str]:
    total = sum(gap.size for gap in log.gaps)
    if not total:
        return []
    shown = ", ".join(f"{gap.size} at {gap.offset}" for gap in log.gaps[:5])
    more = f" and {len(log.gaps) - 5} more places" if len(log.gaps) > 5 else ""
    return [f"{total} of {log.size} bytes could not be read as messages: {shown}{more}"]
