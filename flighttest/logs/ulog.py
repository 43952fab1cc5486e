"""PX4 logs (.ulg) to a Recording, read by pyulog: setpoints as the reference, NED/FRD turned to NWU/FLU."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog
from pyulog.exceptions import ULogException

from flighttest import frames
from flighttest.errors import RecordingError
from flighttest.logs.heights import ranged_height
from flighttest.logs.opening import LogFile, name_of
from flighttest.logs.other_vehicles import refuse_by_px4, vtol_of_px4
from flighttest.logs.timing import held_union, ordered, outliers
from flighttest.mavlink.telemetry import LEAST_BATTERY_V, NO_BATTERY
from flighttest.recording import Marker, Provenance, Recording, Series

FloatArray = NDArray[np.float64]
Fields = dict[str, NDArray[Any]]

_TOPICS = [
    "vehicle_attitude", "vehicle_angular_velocity", "sensor_combined", "vehicle_acceleration", "vehicle_attitude_setpoint",
    "vehicle_rates_setpoint", "vehicle_local_position", "battery_status", "vehicle_thrust_setpoint", "vehicle_status", "distance_sensor",
    "actuator_motors",
]  # fmt: skip
# What pyulog raises on damaged bytes.
_DAMAGED = (
    ULogException, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error, MemoryError, OverflowError,
)  # fmt: skip
_ARMED = 2  # vehicle_status.arming_state
_NAV_STATES = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "MISSION", 4: "LOITER", 5: "RTL", 10: "ACRO", 14: "OFFBOARD", 15: "STABILIZED",
    17: "TAKEOFF", 18: "LAND",
}  # fmt: skip
_V = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_P = ("p_x_m", "p_y_m", "p_z_m")


def import_ulog(path: Path) -> Recording:
    """Read a PX4 log (plain, .gz or .xz). RecordingError where it holds no flight."""
    file = LogFile(path)
    data = b"".join(file.pieces())
    if data[:7] != b"ULog\x01\x12\x35":
        raise RecordingError(f"{path}: this is not a ULog file", "give a .ulg log of PX4")
    words = io.StringIO()
    try:
        # pyulog reports damage on standard output; it belongs into the losses.
        with contextlib.redirect_stdout(words):
            log = ULog(_Forward(data), _TOPICS, disable_str_exceptions=True)
    except _DAMAGED as error:
        raise RecordingError(
            f"{path}: this ULog file is damaged in its definitions: {error!r}", "copy it anew"
        ) from error
    try:
        return _Importer(path, file, log, words.getvalue()).recording()
    except _DAMAGED as error:
        # Damaged definitions can make any field anything; in a sound file the same error would be ours.
        if log.file_corruption:
            raise RecordingError(f"{path}: this ULog file is damaged: {error!r}", "copy it anew") from error
        raise


class _Forward(io.BytesIO):
    """A file that pyulog cannot walk in circles: where a message claims to be longer than the file, pyulog steps back by the claimed
    length, to before that message, and would read the same bytes for ever."""

    _message = 0

    def read(self, size: int | None = -1, /) -> bytes:
        """As any file; the place of the last three-byte message header is kept."""
        if size == 3:
            self._message = self.tell()
        return super().read(size)

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """As any file, but a relative step never ends before the message it steps back over."""
        if whence == 1 and self.tell() + offset < self._message:
            return super().seek(self._message + 1)
        return super().seek(offset, whence)


class _Importer:
    def __init__(self, path: Path, file: LogFile, log: Any, words: str) -> None:
        self.path = path
        self.file = file
        self.log = log
        self.losses = list(file.losses)
        self.derived: dict[str, str] = {}
        self.filters: dict[str, float] = {}
        self.parameters = {str(k): float(v) for k, v in log.initial_parameters.items() if isinstance(v, (int, float))}
        if log.file_corruption:
            first = next((line for line in words.splitlines() if line.strip()), "some messages could not be read")
            self.losses.append(f"the file is damaged: {first.strip()}")
        for dropout in log.dropouts[:5]:
            self.losses.append(f"the logger dropped {dropout.duration} ms at {dropout.timestamp * 1e-6:.3f} s")
        if len(log.dropouts) > 5:
            total = sum(d.duration for d in log.dropouts)
            self.losses.append(f"the logger dropped {total} ms in {len(log.dropouts)} places in all")

    def recording(self) -> Recording:
        """All series that the log allows."""
        kinds = vtol = np.zeros(0)
        if (status := self._topic("vehicle_status")) is not None:
            kinds, vtol = (np.asarray(status[1].get(name, ())) for name in ("vehicle_type", "is_vtol"))
            refuse_by_px4(self.path, {int(k) for k in kinds}, bool(vtol.any()))
        groups = {
            "attitude": self._attitude(),
            "rates": self._rates(),
            "specific_force": self._specific_force(),
            "reference": self._reference(),
            "output": self._output(),
            "velocity": self._local(("vx", "vy", "vz"), _V),
            "position": self._local(("x", "y", "z"), _P),
            "battery": self._battery(),
            "motors": self._motors(),
            "state": self._state(),
        }
        series = {group: one for group, one in groups.items() if one is not None and len(one)}
        height = self._height(series)
        if height is not None:
            series["height"] = height
        if not {"attitude", "specific_force", "velocity"} & set(series):
            raise RecordingError(
                f"{self.path}: neither attitude nor acceleration nor velocity is in the log",
                "log the default topics (SDLOG_PROFILE bit 0)",
            )
        recording = Recording(
            name=name_of(self.path),
            series=series,
            markers=tuple(self._markers(series)),
            provenance=Provenance(
                source=str(self.path),
                importer="ulg",
                sha256=self.file.sha256,
                firmware=self._firmware(),
                parameters=self.parameters,
                clock={"method": "vehicle", "offset_s": 0.0, "error_s": 0.0},
                losses=tuple(self.losses),
                filters=self.filters,
                derived=self.derived,
                autopilot=str(self.log.msg_info_dict.get("sys_uuid") or ""),
            ),
        )
        return vtol_of_px4(recording, status[0], kinds) if status is not None and vtol.any() else recording

    def _topic(self, name: str) -> tuple[FloatArray, Fields] | None:
        """Times (n,), s, and fields of the first instance of a topic."""
        found = [d for d in self.log.data_list if d.name == name and len(d.data.get("timestamp", ()))]
        if not found:
            return None
        fields: Fields = min(found, key=lambda d: int(d.multi_id)).data
        stamp = fields["timestamp"]
        if "timestamp_sample" in fields and bool(np.all(fields["timestamp_sample"] > 0)):
            stamp = fields["timestamp_sample"]
        t_s = np.asarray(stamp, dtype=np.float64) * 1e-6
        wild = outliers(t_s)
        if wild.any():
            sentence = f"{name}: {int(np.count_nonzero(wild))} messages with a damaged time stamp were dropped"
            self.losses += [sentence] if sentence not in self.losses else []
            fields = {field: values[~wild] for field, values in fields.items()}
        return t_s[~wild], fields

    def _series(self, t_s: FloatArray, values: FloatArray, names: tuple[str, ...], what: str) -> Series:
        return ordered(t_s, {name: values[:, i] for i, name in enumerate(names)}, what, self.losses)

    def _attitude(self) -> Series | None:
        topic = self._topic("vehicle_attitude")
        if topic is None or "q[3]" not in topic[1]:
            return None
        rpy = _euler(_stack(topic[1], *(f"q[{i}]" for i in range(4))))
        return self._series(topic[0], rpy, ("roll_rad", "pitch_rad", "yaw_rad"), "vehicle_attitude")

    def _rates(self) -> Series | None:
        names = ("p_rad_s", "q_rad_s", "r_rad_s")
        for name, field in (("vehicle_angular_velocity", "xyz"), ("sensor_combined", "gyro_rad")):
            topic = self._topic(name)
            if topic is not None and f"{field}[2]" in topic[1]:
                if name == "vehicle_angular_velocity" and self.parameters.get("IMU_GYRO_CUTOFF", 0.0) > 0:
                    self.filters["rates"] = self.parameters["IMU_GYRO_CUTOFF"]
                return self._series(topic[0], _body(topic[1], field), names, name)
        return None

    def _specific_force(self) -> Series | None:
        names = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
        for name, field in (("sensor_combined", "accelerometer_m_s2"), ("vehicle_acceleration", "xyz")):
            topic = self._topic(name)
            if topic is not None and f"{field}[2]" in topic[1]:
                if name == "vehicle_acceleration" and self.parameters.get("IMU_ACCEL_CUTOFF", 0.0) > 0:
                    self.filters["specific_force"] = self.parameters["IMU_ACCEL_CUTOFF"]
                return self._series(topic[0], _body(topic[1], field), names, name)
        return None

    def _reference(self) -> Series | None:
        parts: list[tuple[FloatArray, dict[str, FloatArray]]] = []
        topic = self._topic("vehicle_attitude_setpoint")
        if topic is not None:
            # Setpoints are stamped when they are made, not when something was sampled.
            fields = topic[1]
            t_s = np.asarray(fields["timestamp"], dtype=np.float64) * 1e-6
            columns: dict[str, FloatArray] = {}
            if "q_d[3]" in fields:
                rpy = _euler(_stack(fields, *(f"q_d[{i}]" for i in range(4))))
                columns["roll_ref_rad"], columns["pitch_ref_rad"] = rpy[:, 0], rpy[:, 1]
            elif "roll_body" in fields and "pitch_body" in fields:
                columns["roll_ref_rad"] = _float(fields["roll_body"])
                columns["pitch_ref_rad"] = -_float(fields["pitch_body"])
            if "yaw_sp_move_rate" in fields and bool(np.isfinite(fields["yaw_sp_move_rate"]).any()):
                columns["yaw_rate_ref_rad_s"] = -np.nan_to_num(_float(fields["yaw_sp_move_rate"]))
            if "thrust_body[2]" in fields:
                columns["throttle"] = -_float(fields["thrust_body[2]"])
            elif "thrust" in fields:
                columns["throttle"] = _float(fields["thrust"])
            if columns:
                one = ordered(t_s, columns, "vehicle_attitude_setpoint", self.losses)
                parts.append((one.t_s, dict(one.columns)))
        have = {name for _, columns in parts for name in columns}
        rates = self._topic("vehicle_rates_setpoint")
        if rates is not None and "yaw" in rates[1] and "yaw_rate_ref_rad_s" not in have:
            one = ordered(rates[0], {"yaw_rate_ref_rad_s": -_float(rates[1]["yaw"])}, "vehicle_rates_setpoint", [])
            parts.append((one.t_s, dict(one.columns)))
            self.derived["yaw_rate_ref_rad_s"] = (
                "vehicle_rates_setpoint: the autopilot's own target is taken for the reference"
            )
        if not parts:
            return None
        return held_union(parts) if len(parts) > 1 else Series(*parts[0])

    def _output(self) -> Series | None:
        topic = self._topic("vehicle_thrust_setpoint")
        if topic is None or "xyz[2]" not in topic[1]:
            return None
        values = {"throttle_out": -_float(topic[1]["xyz[2]"])}
        return ordered(topic[0], values, "vehicle_thrust_setpoint", self.losses)

    def _local(self, fields: tuple[str, str, str], names: tuple[str, ...]) -> Series | None:
        topic = self._topic("vehicle_local_position")
        if topic is None or fields[2] not in topic[1]:
            return None
        values = frames.flip_vector(_stack(topic[1], *fields))
        flag_xy, flag_z = ("v_xy_valid", "v_z_valid") if fields[0] == "vx" else ("xy_valid", "z_valid")
        for flag, columns in ((flag_xy, (0, 1)), (flag_z, (2,))):
            if flag in topic[1]:
                for i in columns:
                    values[topic[1][flag] == 0, i] = np.nan
        return self._series(topic[0], values, names, "vehicle_local_position")

    def _height(self, series: dict[str, Series]) -> Series | None:
        position = series.get("position")
        topic = self._topic("vehicle_local_position")
        if topic is not None and "dist_bottom" in topic[1] and "dist_bottom_valid" in topic[1]:
            good = (topic[1]["dist_bottom_valid"] != 0) & np.isfinite(topic[1]["dist_bottom"])
            if np.count_nonzero(good) > 0.2 * good.size:
                height, how = ranged_height(topic[0], _float(topic[1]["dist_bottom"]), good, position)
                if how:
                    self.derived["height_m"] = how
                return ordered(topic[0], {"height_m": height}, "vehicle_local_position", [])
        if position is None or not np.isfinite(position.columns["p_z_m"]).any():
            return None
        up = position.columns["p_z_m"]
        self.derived["height_m"] = "height above where the log begins (p_z_m), taken as level ground"
        return Series(position.t_s, {"height_m": up - up[np.flatnonzero(np.isfinite(up))[0]]})

    def _battery(self) -> Series | None:
        topic = self._topic("battery_status")
        if topic is None:
            return None
        t_s, fields = topic
        name = next((n for n in ("voltage_v", "voltage_filtered_v") if n in fields), None)
        if name is None or not bool(np.any(fields[name] > LEAST_BATTERY_V)):
            self.losses.append(NO_BATTERY)
            return None
        voltage_v = _float(fields[name])
        columns = {"voltage_v": np.where(voltage_v > LEAST_BATTERY_V, voltage_v, np.nan)}
        if "current_a" in fields:
            current_a = _float(fields["current_a"])
            columns["current_a"] = np.where(current_a >= 0, current_a, np.nan)
        return ordered(t_s, columns, "battery_status", self.losses)

    def _motors(self) -> Series | None:
        """Commands of the motors of a quadrotor. Outputs, all that PX4 before 1.13 logs, do not say what is on them."""
        topic = self._topic("actuator_motors")
        if topic is None or "control[3]" not in topic[1]:
            return None
        fifth = topic[1].get("control[4]")
        if fifth is not None and bool(np.isfinite(fifth).any()):  # not a number where there is no motor
            return None
        values = np.clip(_stack(topic[1], *(f"control[{k}]" for k in range(4))), 0.0, 1.0)
        return self._series(topic[0], values, tuple(f"motor_{k}" for k in range(1, 5)), "actuator_motors")

    def _state(self) -> Series | None:
        topic = self._topic("vehicle_status")
        if topic is None or not {"nav_state", "arming_state"} <= set(topic[1]):
            return None
        columns = {
            "mode": _float(topic[1]["nav_state"]),
            "armed": (topic[1]["arming_state"] == _ARMED).astype(np.float64),
        }
        return ordered(
            np.asarray(topic[1]["timestamp"], dtype=np.float64) * 1e-6, columns, "vehicle_status", self.losses
        )

    def _markers(self, series: dict[str, Series]) -> list[Marker]:
        markers = [Marker(m.timestamp * 1e-6, "note", str(m.message)) for m in self.log.logged_messages]
        if "state" in series:
            state = series["state"]
            modes = state.columns["mode"]
            for i in np.flatnonzero(np.diff(modes, prepend=np.nan) != 0):
                number = int(modes[i])
                markers.append(
                    Marker(float(state.t_s[i]), "mode", _NAV_STATES.get(number, f"mode {number}"), {"mode": number})
                )
        flown = series["state"].t_s[series["state"].columns["armed"] > 0.0] if "state" in series else np.zeros(0)
        last_armed_s = float(flown[-1]) if flown.size else np.inf
        for stamp, name, value in self.log.changed_parameters:
            if not isinstance(value, (int, float)):
                continue
            before = self.parameters.get(str(name))
            if before is None or stamp * 1e-6 <= last_armed_s:  # what is set after landing does not describe the flight
                self.parameters[str(name)] = float(value)
            if before is not None and before != float(value):
                label = f"parameter {name} changed from {before:g} to {float(value):g}"
                markers.append(Marker(stamp * 1e-6, "note", label, {"parameter": str(name)}))
        return sorted(markers, key=lambda m: m.t_s)

    def _firmware(self) -> str:
        info = self.log.msg_info_dict
        release = self.log.get_version_info_str() or ""
        return " ".join(word for word in ("PX4", str(release), str(info.get("ver_sw", ""))[:12]) if word)


def _float(values: NDArray[Any]) -> FloatArray:
    """As float64. A damaged float32 may be a signalling NaN, of which the processor complains; it becomes a NaN like any other."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


def _stack(fields: Fields, *names: str) -> FloatArray:
    return np.stack([_float(fields[name]) for name in names], axis=-1)


def _body(fields: Fields, name: str) -> FloatArray:
    return frames.flip_vector(_stack(fields, *(f"{name}[{i}]" for i in range(3))))


def _euler(q_ned: FloatArray) -> FloatArray:
    length = np.linalg.norm(q_ned, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.where(length > 0.5, q_ned / length, np.nan)
    return frames.euler_from_quaternion(frames.flip_quaternion(q))
