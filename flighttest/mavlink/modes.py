"""ArduCopter's mode numbers (HEARTBEAT.custom_mode), from ArduPilot's mode.h."""

from __future__ import annotations

from enum import IntEnum


class CopterMode(IntEnum):
    """The modes this package asks for or must recognise. Source: ArduCopter/mode.h, Copter 4.3 to 4.7."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    CIRCLE = 7
    LAND = 9
    DRIFT = 11
    SPORT = 13
    FLIP = 14
    AUTOTUNE = 15
    POSHOLD = 16
    BRAKE = 17
    THROW = 18
    AVOID_ADSB = 19
    GUIDED_NOGPS = 20
    SMART_RTL = 21
    FLOWHOLD = 22
    FOLLOW = 23
    ZIGZAG = 24
    SYSTEMID = 25
    AUTOROTATE = 26
    AUTO_RTL = 27
    TURTLE = 28


TAKES_ATTITUDE_TARGETS: tuple[int, ...] = (CopterMode.GUIDED, CopterMode.GUIDED_NOGPS)
"""In any other mode ArduCopter drops SET_ATTITUDE_TARGET without a word."""


def mode_name(number: int) -> str:
    """The name of a mode number, or `mode <number>` for one that is not in the table."""
    try:
        return CopterMode(number).name
    except ValueError:
        return f"mode {number}"
