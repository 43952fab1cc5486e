"""The parser gives the messages that pymavlink itself gives, of every type and whatever the bytes are."""

import random
import struct
from typing import Any

import pytest

from flighttest.mavlink.dialect import dialect, parser


def theirs() -> Any:
    mav = dialect.MAVLink(None)
    mav.robust_parsing = True
    return mav


def frame_of(kind: int, payload: bytes, rng: random.Random, wrong: int = 0) -> bytes:
    known = dialect.mavlink_map.get(kind)
    head = bytes((len(payload), 0, 0, rng.randrange(256), rng.randrange(256), rng.randrange(256)))
    body = head + kind.to_bytes(3, "little") + payload
    crc = dialect.x25crc(body + bytes([known.crc_extra if known else 0])).crc ^ wrong
    return b"\xfd" + body + struct.pack("<H", crc)


def all_of(message: Any) -> dict[str, Any]:
    """Everything that a message holds; numbers as they are written, so that what is not a number equals itself."""
    held = {name: repr(value) for name, value in vars(message).items() if name != "_header"}
    return held | {"header": vars(message.get_header()), "class": type(message)}


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 1.3])
def test_a_frame_of_every_type_is_the_message_that_pymavlink_makes(share: float) -> None:
    """share: of the payload that is sent; MAVLink 2 cuts zeros off the end, and newer senders send more than is known."""
    rng = random.Random(share)
    for kind, made in dialect.mavlink_map.items():
        length = min(max(round(share * made.unpacker.size), 1), 255)
        text = bytes(rng.choice((0, 65, rng.randrange(256))) for _ in range(length))
        frame = frame_of(kind, text, rng)
        (mine,), (other,) = parser(0, 0).parse_buffer(frame), theirs().parse_buffer(frame)
        assert all_of(mine) == all_of(other), made.msgname
        assert all_of(parser(0, 0).decode(bytearray(frame))) == all_of(other)
        assert mine.pack(parser(1, 1)) == other.pack(parser(1, 1))


def a_stream(rng: random.Random) -> bytes:
    """Frames of both versions, some damaged, signed, of unknown types or cut short, with noise between them."""
    kinds = [
        dialect.MAVLink_attitude_message,
        dialect.MAVLink_heartbeat_message,
        dialect.MAVLink_battery_status_message,
    ]
    parts: list[bytes] = []
    for _ in range(60):
        kind = rng.choice(kinds)
        frame = frame_of(kind.id, rng.randbytes(kind.unpacker.size), rng, wrong=rng.random() < 0.1)
        what = rng.randrange(8)
        if what == 0:
            frame = frame_of(50_000, rng.randbytes(9), rng)
        elif what == 1:
            payload = rng.randbytes(dialect.MAVLink_attitude_message.unpacker.size)
            body = bytes((len(payload), 7, 1, 1, dialect.MAVLINK_MSG_ID_ATTITUDE)) + payload
            crc = dialect.x25crc(body + bytes([dialect.MAVLink_attitude_message.crc_extra])).crc
            frame = b"\xfe" + body + struct.pack("<H", crc)
        elif what == 2:
            frame = rng.randbytes(rng.randrange(1, 20))
        elif what == 3:
            frame = frame[: rng.randrange(1, len(frame))]
        elif what == 4:
            body = frame[1:2] + b"\x01" + frame[3:-2]
            crc = dialect.x25crc(body + bytes([kind.crc_extra])).crc
            frame = b"\xfd" + body + struct.pack("<H", crc) + rng.randbytes(13)
        elif what == 5:
            frame = frame[:2] + b"\x02" + frame[3:]
        parts.append(frame)
    return b"".join(parts)


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_stream_in_pieces_is_read_as_pymavlink_reads_it(seed: int) -> None:
    rng = random.Random(seed)
    stream = a_stream(rng)
    mine, other = parser(0, 0), theirs()
    at = 0
    while at < len(stream):
        size = rng.choice((1, 3, 11, 40, 300))
        piece = stream[at : at + size]
        at += size
        got, wanted = mine.parse_buffer(piece) or [], other.parse_buffer(piece) or []
        assert [all_of(m) for m in got] == [all_of(m) for m in wanted]
    assert bytes(mine.buf[mine.buf_index :]) == bytes(other.buf[other.buf_index :])
    assert (mine.total_packets_received, mine.total_receive_errors, mine.total_bytes_received) == (
        other.total_packets_received, other.total_receive_errors, other.total_bytes_received,
    )  # fmt: skip
