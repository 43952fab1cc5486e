"""MAVLink messages to channels and targets, and back: one place with degE7, centimetres and signs. Independent of maneuvers."""

from flighttest.mavlink.accepted import in_force
from flighttest.mavlink.clock import ClockEstimate, estimate_clock
from flighttest.mavlink.decode import WANTED, Decoded, StreamDecoder, decode_stream
from flighttest.mavlink.marks import mark_message, mark_text, parse_mark
from flighttest.mavlink.modes import CopterMode, mode_name
from flighttest.mavlink.targets import target_message
from flighttest.mavlink.telemetry import RULES, columns_of, offset_m

__all__ = [
    "RULES",
    "WANTED",
    "ClockEstimate",
    "CopterMode",
    "Decoded",
    "StreamDecoder",
    "columns_of",
    "decode_stream",
    "estimate_clock",
    "in_force",
    "mark_message",
    "mark_text",
    "mode_name",
    "offset_m",
    "parse_mark",
    "target_message",
]
