"""Small writers of the log formats that the importers read."""

import struct
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.logs import import_log
from flighttest.recording import Recording

STRUCT = {
    "a": "32h", "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "g": "e", "n": "4s", "N": "16s",
    "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "b", "q": "q", "Q": "Q",
}  # fmt: skip


class DataflashWriter:
    """Writes dataflash bytes; values are the raw (unscaled) numbers."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.kinds: dict[str, tuple[int, str]] = {}
        self.format("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 128)

    def format(self, name: str, codes: str, labels: str, kind: int | None = None) -> None:
        kind = kind if kind is not None else 10 + len(self.kinds)
        size = 3 + struct.calcsize("<" + "".join(STRUCT[c] for c in codes))
        self.kinds[name] = kind, codes
        self.data += b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", kind, size, name.encode(), codes.encode(), labels.encode()
        )

    def write(self, name: str, *values: object) -> None:
        kind, codes = self.kinds[name]
        plain = [v.encode() if isinstance(v, str) else v for v in values]
        self.data += b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(STRUCT[c] for c in codes), *plain)

    def save(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


def guided_flight(
    seconds: float = 4.0, rate_hz: float = 100.0, wrap: bool = False, start_us: int = 50_000_000
) -> DataflashWriter:
    """Copter 4.6-like: hover, then a roll step of +0.2 rad (NED) for 1 s at t = 1 s, targets at 50 Hz."""
    w = DataflashWriter()
    w.format("PARM", "QNff", "TimeUS,Name,Value,Default")
    w.format("MSG", "QZ", "TimeUS,Message")
    w.format("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    w.format("EV", "QB", "TimeUS,Id")
    w.format("ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF")
    w.format("RATE", "Qfffffffff", "TimeUS,RDes,R,PDes,P,YDes,Y,ADes,A,AOut")
    w.format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    w.format("GUIA", "QBffffffff", "TimeUS,Type,Roll,Pitch,Yaw,RollRt,PitchRt,YawRt,Thrust,ClimbRt")
    w.format("XKF1", "QBccCfffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD")
    w.format("BAT", "QBff", "TimeUS,Inst,Volt,Curr")

    def us(t_s: float) -> int:
        t = start_us + round(t_s * 1e6)
        return t % 2**32 if wrap else t

    w.write("PARM", us(0), "INS_ACCEL_FILTER", 20.0, 20.0)
    w.write("PARM", us(0), "ATC_RAT_RLL_P", 0.135, 0.135)
    w.write("MSG", us(0), "ArduCopter V4.6.0 (0123abcd)")
    w.write("MODE", us(0), 20, 20, 2)
    w.write("EV", us(0), 10)
    w.write("EV", us(0.001), 28)
    for k in range(round(seconds * rate_hz)):
        t = k / rate_hz
        roll = 0.2 if 1.0 <= t < 2.0 else 0.0
        if k % 2 == 0:
            w.write("GUIA", us(t), 6, np.degrees(roll), 0.0, 90.0, 0.0, 0.0, 0.0, 0.25, 0.0)
        measured = np.degrees(0.2 * np.clip((t - 1.05) / 0.1, 0, 1) - 0.2 * np.clip((t - 2.05) / 0.1, 0, 1))
        w.write("ATT", us(t + 1e-4), np.degrees(roll), measured, 0.0, 1.0, 90.0, 90.0, 3)
        w.write("RATE", us(t + 2e-4), 0, 10.0, 0, 20.0, 0, 30.0, 0, 0, 0.26)
        for i in (0, 1):
            w.write("IMU", us(t + 3e-4), i, 0.01, 0.02, 0.03, 0.1, 0.2, -9.8 + i)
        if k % 4 == 0:
            w.write("XKF1", us(t), 0, 0, 0, 0, 1.0, 2.0, -3.0, 0, 10.0, 20.0, -5.0)
        if k % 10 == 0:
            w.write("BAT", us(t), 0, 23.5, 20.0)
        if k == round(0.95 * rate_hz):
            w.write("MSG", us(t), "SRC=250/190:FT roll_pitch/roll+0.20/r1 step")
    return w


@pytest.fixture
def dataflash() -> type[DataflashWriter]:
    return DataflashWriter


@pytest.fixture
def attempt():
    """Import a log that may be damaged: a Recording, or the RecordingError that refuses it. Anything else is a crash."""

    def run(path: Path) -> Recording | RecordingError:
        try:
            return import_log(path)
        except RecordingError as error:
            return error

    return run


@pytest.fixture
def flight():
    return guided_flight


@pytest.fixture
def ulog_bytes():
    return small_ulog


def small_ulog(fifth: float = np.nan, kinds: tuple[int, ...] = (0, 1), vtol: bool = False) -> bytes:
    """A PX4 log of 3 s: attitude at 100 Hz rolled 0.1 rad (NED), setpoints, accelerometer, battery, four motors and perhaps a fifth; kinds:
    what PX4 takes the vehicle for, one after the other."""

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    def build() -> bytes:
        out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        out += message("B", bytes(40))
        formats = {
            "vehicle_attitude": ("uint64_t timestamp;float[4] q;", "Q4f"),
            "vehicle_attitude_setpoint": (
                "uint64_t timestamp;float[4] q_d;float[3] thrust_body;float yaw_sp_move_rate;",
                "Q4f3ff",
            ),
            "sensor_combined": ("uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;", "Q3f3f"),
            "battery_status": ("uint64_t timestamp;float voltage_v;float current_a;", "Qff"),
            "vehicle_status": (
                "uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;uint8_t vehicle_type;bool is_vtol;",
                "QBBB?",
            ),
            "actuator_motors": ("uint64_t timestamp;float[12] control;", "Q12f"),
        }
        for name, (layout, _) in formats.items():
            out += message("F", f"{name}:{layout}".encode())
        key = b"float THR_MDL_FAC"
        out += message("P", bytes([len(key)]) + key + struct.pack("<f", 0.3))
        for number, name in enumerate(formats):
            out += message("A", struct.pack("<BH", 0, number) + name.encode())

        def data(number: int, *values: float) -> bytes:
            code = list(formats.values())[number][1]
            return message("D", struct.pack("<H", number) + struct.pack("<" + code, *values))

        q = (np.cos(0.05), np.sin(0.05), 0.0, 0.0)
        for k, kind in enumerate(kinds):
            out += data(4, 500_000 + k * 1000, 14, 2, kind, vtol)
        for k in range(300):
            t = 1_000_000 + k * 10_000
            out += data(0, t, *q)
            out += data(2, t, 0.1, 0.2, 0.3, 0.5, 0.25, -9.75)
            if k % 2 == 0:
                out += data(1, t, np.cos(0.1), 0.0, np.sin(0.1), 0.0, 0.0, 0.0, -0.4, 0.5)
            if k % 10 == 0:
                out += data(3, t, 15.5, 12.0)
                out += data(5, t, 0.4, 0.5, 0.6, 0.7, fifth, *(7 * [np.nan]))
        return out

    return build()
