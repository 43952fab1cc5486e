"""ROS 2 bags in MCAP (and MCAP of JSON messages): every topic's numbers as columns, each on its own times.

Needs the packages of the extra `mcap`. Frames are those of REP 103 (ENU, FLU) where no column map states others.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.datafiles import MOST_VALUES
from flighttest.errors import RecordingError
from flighttest.logs.opening import UNPACKED_BYTES, UNPACKED_TIMES, LogFile
from flighttest.logs.tables.columns import ColumnMap, ColumnSource
from flighttest.logs.tables.sheet import Sheet, joined

FloatArray = NDArray[np.float64]
MAGIC = b"\x89MCAP0\r\n"
SQLITE = b"SQLite format 3\0"
MOST_CELLS = 16  # of an array that becomes columns: a quaternion or twelve motors, no image and no covariance
STAMP_NEAR_S = 1.0  # header stamps count where they are the recorder's clock
# Message type to (channel, field, scale); REP 103 and the message definitions.
_KNOWN: dict[str, tuple[tuple[str, str, float], ...]] = {
    "sensor_msgs/msg/Imu": (
        ("p_rad_s", "angular_velocity.x", 1.0), ("q_rad_s", "angular_velocity.y", 1.0), ("r_rad_s", "angular_velocity.z", 1.0),
        ("f_x_m_s2", "linear_acceleration.x", 1.0), ("f_y_m_s2", "linear_acceleration.y", 1.0), ("f_z_m_s2", "linear_acceleration.z", 1.0),
    ),
    "nav_msgs/msg/Odometry": tuple((f"p_{a}_m", f"pose.pose.position.{a}", 1.0) for a in "xyz"),
    "geometry_msgs/msg/PoseStamped": tuple((f"p_{a}_m", f"pose.position.{a}", 1.0) for a in "xyz"),
    "mavros_msgs/msg/AttitudeTarget": (("throttle", "thrust", 1.0), ("yaw_rate_ref_rad_s", "body_rate.z", 1.0)),
    "sensor_msgs/msg/BatteryState": (("voltage_v", "voltage", 1.0), ("current_a", "current", -1.0)),
}  # fmt: skip
# Message type to (attitude or reference, field that holds the quaternion), the best source of each first.
_TURNS = (
    ("attitude", "sensor_msgs/msg/Imu", "orientation"),
    ("attitude", "nav_msgs/msg/Odometry", "pose.pose.orientation"),
    ("attitude", "geometry_msgs/msg/PoseStamped", "pose.orientation"),
    ("reference", "mavros_msgs/msg/AttitudeTarget", "orientation"),
)


def read_bag(file: LogFile) -> tuple[Sheet, ColumnMap]:
    """The bag as a sheet whose columns are TOPIC.FIELD, and the map of the message types that are known."""
    topics: dict[str, tuple[str, list[float], list[float], list[dict[str, float]]]] = {}
    losses: list[str] = []
    count = 0
    unread: set[str] = set()
    try:
        for topic, kind, log_s, message in _messages(file):
            if message is None:
                unread.add(f"{topic} ({kind})")
                continue
            fields: dict[str, float] = {}
            _flatten("", message, fields)
            count += len(fields)
            if count > MOST_VALUES:
                raise RecordingError(
                    f"{file.path}: it holds more than {MOST_VALUES} numbers", "keep the topics and times of a flight"
                )
            _, logged, stamped, rows = topics.setdefault(topic, (kind, [], [], []))
            logged.append(log_s)
            stamped.append(_stamp(fields))
            rows.append(fields)
    except Damaged as error:
        if not topics:
            raise RecordingError(
                f"{file.path}: this MCAP file is damaged: {error}", "copy it anew, or run `mcap recover`"
            ) from error
        losses.append(
            f"the bag is damaged after {sum(len(rows) for *_, rows in topics.values())} messages ({error}); the rest was not read"
        )
    if unread:
        losses.append(f"messages that are neither ROS 2 (CDR) nor JSON were not read: {', '.join(sorted(unread)[:6])}")
    tables = [_columns(topic, *found) for topic, found in topics.items() if found[3]]
    if not tables:
        raise RecordingError(
            f"{file.path}: the bag holds no messages with numbers", "name a bag with the topics of a flight"
        )
    sheet = Sheet(str(file.path), joined(tables), [*file.losses, *losses])
    return sheet, _map({topic: found[0] for topic, found in topics.items()}, sheet)


def _messages(file: LogFile) -> Iterator[tuple[str, str, float, Any]]:
    """(topic, type, time s, message) in order; the message is None where its encoding is not known."""
    try:
        from mcap.reader import NonSeekingReader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise RecordingError(
            "ROS bags need the packages mcap and mcap-ros2-support", "pip install 'flighttest[mcap]'"
        ) from error
    factory = DecoderFactory()
    decoders: dict[int, Any] = {}
    _check_chunks(file)
    with file.open() as stream:
        reader = NonSeekingReader(stream, record_size_limit=_most_bytes(file))
        try:
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if channel.id not in decoders:
                    with contextlib.redirect_stderr(io.StringIO()):  # where a message definition's parser prints
                        decoders[channel.id] = (
                            json.loads
                            if channel.message_encoding == "json"
                            else factory.decoder_for(channel.message_encoding, schema)
                        )
                decode = decoders[channel.id]
                kind = schema.name if schema is not None else channel.message_encoding
                yield channel.topic, kind, message.log_time * 1e-9, None if decode is None else decode(message.data)
        except Exception as error:  # damaged bytes end in any error of four packages
            raise Damaged(f"{type(error).__name__}: {error}") from error


class Damaged(Exception):
    """The bag cannot be read further."""


def _most_bytes(file: LogFile) -> int:
    """That a bag may unpack to, as for other compressed logs."""
    return max(UNPACKED_BYTES, UNPACKED_TIMES * file.path.stat().st_size)


def _check_chunks(file: LogFile) -> None:
    """RecordingError where the chunks declare that they unpack to more than a recording does; they are not unpacked for it."""
    import zstandard
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    total, most = 0, _most_bytes(file)
    with file.open() as stream, contextlib.suppress(Exception):  # what is damaged is found where it is read
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=most).records:
            if isinstance(record, Chunk):
                frame = zstandard.frame_content_size(record.data) if record.compression == "zstd" else 0
                total += max(record.uncompressed_size, frame)
                if total > most:
                    break
    if total > most:
        raise RecordingError(
            f"{file.path}: it unpacks to more than {most} bytes", "keep the topics and times of a flight"
        )


def _flatten(name: str, value: Any, found: dict[str, float]) -> None:
    """Numbers of a message by their dotted path."""
    if isinstance(value, bool | int | float):
        found[name] = float(value)
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            _flatten(f"{name}.{key}" if name else str(key), inner, found)
    elif isinstance(value, list | tuple | np.ndarray):
        if len(value) <= MOST_CELLS:
            for i, inner in enumerate(value):
                _flatten(f"{name}[{i}]", inner, found)
    elif hasattr(value, "__slots__"):
        for key in value.__slots__:
            _flatten(f"{name}.{key}" if name else str(key), getattr(value, key), found)


def _stamp(fields: Mapping[str, float]) -> float:
    sec, nano = fields.get("header.stamp.sec"), fields.get("header.stamp.nanosec")
    return sec + 1e-9 * nano if sec is not None and nano is not None else float("nan")


def _columns(
    topic: str, _kind: str, logged: list[float], stamped: list[float], rows: list[dict[str, float]]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """A topic's times and columns: by header stamps where they lie near the recorder's times, else by those."""
    t, stamps = np.array(logged), np.array(stamped)
    near = np.isfinite(stamps).all() and abs(float(np.median(stamps - t))) < STAMP_NEAR_S
    names = [n for n in dict.fromkeys(n for row in rows for n in row) if not n.startswith("header.")]
    columns = {f"{topic}.{n}": np.array([row.get(n, np.nan) for row in rows]) for n in names}
    return (stamps if near else t), columns


def _map(kinds: Mapping[str, str], sheet: Sheet) -> ColumnMap:
    """Channels of known message types, each from the first topic that has it."""
    columns: dict[str, ColumnSource] = {}
    quaternions: dict[str, tuple[str, ...]] = {}
    for topic, kind in kinds.items():
        for channel, name, scale in _KNOWN.get(kind, ()):
            if f"{topic}.{name}" in sheet.raw:
                columns.setdefault(channel, ColumnSource((f"{topic}.{name}",), scale))
        if (
            topic.endswith("velocity_local") and kind == "geometry_msgs/msg/TwistStamped"
        ):  # mavros: in the world's frame
            columns |= {f"v_{a}_m_s": ColumnSource((f"{topic}.twist.linear.{a}",)) for a in "xyz"}
    for what, kind, name in _TURNS:
        topic = next((t for t, k in kinds.items() if k == kind), "")
        if topic and f"{topic}.{name}.w" in sheet.raw:
            quaternions.setdefault(what, tuple(f"{topic}.{name}.{part}" for part in "wxyz"))
    return ColumnMap(columns, quaternions, "ENU", "FLU", file="message types of the bag")
