"""Cut a few legs out of a flight's recordings, byte for byte: how the golden recordings in this folder were made.

    python tests/data/trim.py LOG.BIN OUT.BIN.xz LEG...        an onboard log
    python tests/data/trim.py RAW.tlog OUT.tlog.xz LEG...      what the ground station recorded

Around each LEG (its name in the marks, as roll_pitch/roll+0.30/r1) everything a fit needs is kept; outside, parameters, texts, modes and
clocks, and once a second where the vehicle was. Nothing is changed: frames and messages are the recorded bytes.
"""

from __future__ import annotations

import lzma
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

BEFORE_S, AFTER_S = 0.8, 0.4
SPARSE_S = 1.0
_FMT = 128
# Kept wherever they stand, kept around legs, kept around legs and once a second elsewhere.
LOG_ALWAYS = {"FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "MODE", "EV", "ERR", "VER", "ARM", "ORGN"}
LOG_LEG = {"GUIA", "ANG", "RATE", "IMU"}
LOG_SPARSE = {"XKF1", "XKF4", "BAT", "GPS"}
FIRST_LANE = {"IMU": "I", "XKF1": "C", "XKF4": "C", "BAT": "Inst", "GPS": "I"}
FRAMES_ALWAYS = {
    "HEARTBEAT", "PARAM_VALUE", "PARAM_SET", "STATUSTEXT", "TIMESYNC", "SYSTEM_TIME", "COMMAND_LONG", "COMMAND_ACK",
    "AUTOPILOT_VERSION", "HOME_POSITION",
}  # fmt: skip
_HEADER = b"\xa3\x95"
_SIZES = {
    "a": 64, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8, "g": 2, "n": 4, "N": 16, "Z": 64, "c": 2, "C": 2,
    "e": 4, "E": 4, "L": 4, "M": 1, "q": 8, "Q": 8,
}  # fmt: skip


def log_messages(data: bytes) -> Iterator[tuple[str, int, int, dict[str, int]]]:
    """Name, start and end of each message of a dataflash log, and where its fields lie."""
    names: dict[int, tuple[str, int, dict[str, int]]] = {_FMT: ("FMT", 89, {})}
    at = 0
    while at + 3 <= len(data):
        known = names.get(data[at + 2]) if data[at : at + 2] == _HEADER else None
        if known is None:
            at = data.find(_HEADER, at + 1)
            if at < 0:
                return
            continue
        name, length, fields = known
        if at + length > len(data):
            return
        if name == "FMT":
            number, size = data[at + 3], data[at + 4]
            label, codes, columns = (
                data[at + a : at + b].split(b"\0")[0].decode() for a, b in ((5, 9), (9, 25), (25, 89))
            )
            places, offset = {}, 3
            for code, column in zip(codes, columns.split(","), strict=False):
                places[column] = offset
                offset += _SIZES[code]
            names[number] = (label, size, places)
        yield name, at, at + length, fields
        at += length


def trim_log(data: bytes, legs: Iterable[str]) -> bytes:
    """A dataflash log with these legs."""
    wanted = tuple(legs)
    marks = []
    for name, start, end, fields in log_messages(data):
        if name == "MSG":
            text = data[start + fields["Message"] : end].split(b"\0")[0].decode(errors="replace")
            if any(f"{leg} " in text + " " for leg in wanted):
                marks.append(struct.unpack_from("<Q", data, start + 3)[0] * 1e-6)
    inside = _windows(marks)
    out, reported = bytearray(), {}
    for name, start, end, fields in log_messages(data):
        if name == "MSG" and _foreign(data[start + fields["Message"] : end].decode(errors="replace"), wanted):
            continue
        if name not in LOG_ALWAYS:
            if name not in LOG_LEG and name not in LOG_SPARSE:
                continue
            lane = FIRST_LANE.get(name)
            if lane in fields and data[start + fields[lane]] != 0:
                continue
            t_s = struct.unpack_from("<Q", data, start + 3)[0] * 1e-6
            if not inside(t_s):
                if name in LOG_LEG or t_s - reported.get(name, -9.0) < SPARSE_S:
                    continue
                reported[name] = t_s
        out += data[start:end]
    return bytes(out)


def frames(data: bytes) -> Iterator[tuple[float, bytes, object]]:
    """Time, s, stamp and frame together, and the decoded message, of each record of a tlog."""
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    at = 0
    while at + 20 <= len(data):
        size = data[at + 9] + (12 if data[at + 8] == 0xFD else 8)
        if data[at + 8] == 0xFD and data[at + 10] & 1:
            size += 13
        record = data[at : at + 8 + size]
        found = parser.parse_buffer(bytearray(record[8:])) or [None]
        yield struct.unpack_from(">Q", record)[0] * 1e-6, record, found[0]
        at += 8 + size


def trim_tlog(data: bytes, legs: Iterable[str]) -> bytes:
    """A tlog with these legs."""
    wanted = tuple(legs)
    records = list(frames(data))
    marks = [
        t for t, _, m in records
        if m is not None and m.get_type() == "STATUSTEXT" and any(f"{leg} " in m.text + " " for leg in wanted)  # type: ignore[attr-defined]
    ]  # fmt: skip
    inside = _windows(marks)
    out, reported = bytearray(), {}
    for t_s, record, message in records:
        kind = message.get_type() if message is not None else ""  # type: ignore[attr-defined]
        if kind == "STATUSTEXT" and _foreign(message.text, wanted):  # type: ignore[union-attr]
            continue
        if not inside(t_s) and kind not in FRAMES_ALWAYS:
            if kind == "SET_ATTITUDE_TARGET" or t_s - reported.get(kind, -9.0) < SPARSE_S:
                continue
            reported[kind] = t_s
        elif kind == "HEARTBEAT" and not inside(t_s):
            if t_s - reported.get(kind, -9.0) < 0.3:
                continue
            reported[kind] = t_s
        out += record
    return bytes(out)


def _foreign(text: str, wanted: tuple[str, ...]) -> bool:
    """Whether a text is the mark of a leg that is not kept."""
    return "FT " in text and not any(f"{leg} " in text + " " for leg in wanted)


def _windows(marks: list[float]) -> Callable[[float], bool]:
    """Whether a time lies around marks that follow one another closely."""
    spans: list[list[float]] = []
    for t in sorted(marks):
        if spans and t - spans[-1][1] < 3.0:
            spans[-1][1] = t
        else:
            spans.append([t, t])
    return lambda t_s: any(a - BEFORE_S <= t_s <= b + AFTER_S for a, b in spans)


if __name__ == "__main__":
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    trim = trim_tlog if source.suffix == ".tlog" else trim_log
    target.write_bytes(lzma.compress(trim(source.read_bytes(), sys.argv[3:]), preset=9))
