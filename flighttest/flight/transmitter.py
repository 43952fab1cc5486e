"""The pilot's transmitter by what the autopilot reports of its receiver: whether it is received, and its mode switch."""

from __future__ import annotations

from bisect import bisect_right

from flighttest.mavlink.dialect import Message, dialect

LOST = "the pilot's transmitter is not received any more: the mode switch has no effect (while this program flies it, Ctrl-C lands it)"
BACK = "the pilot's transmitter is received again"
POSITIONS_US = (1231, 1361, 1491, 1621, 1750)
"""Pulse lengths, us, at which the second to the sixth position of a mode switch begin (ArduPilot, RC_Channel::read_6pos_switch)."""
PULSES_US = (800, 2200)  # others are no position (RC_MIN_LIMIT_PWM, RC_MAX_LIMIT_PWM)
STAYS_S = 0.2  # in a position before it counts (SWITCH_DEBOUNCE_TIME_MS)
_BIT = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER


def received(message: Message) -> bool | None:
    """Whether the transmitter is lost by SYS_STATUS (health of the receiver, where one is present) or RC_CHANNELS (no channel at all);
    None where the message does not show it.

    RC_CHANNELS goes on with the last channels when a transmitter is off, so that channels alone do not show that it is received.
    """
    kind = message.get_type()
    if kind == "SYS_STATUS" and message.onboard_control_sensors_present & _BIT:
        return bool(message.onboard_control_sensors_health & _BIT)
    if kind == "RC_CHANNELS" and message.chancount == 0:
        return False
    return None


class Transmitter:
    """Follows the messages of a flight. lost: by the newest message that shows it."""

    def __init__(self) -> None:
        self.lost = False
        self._heard = False
        self._channels = True
        self._healthy = True

    def look(self, message: Message) -> str:
        """A sentence where this message shows a loss or a return, else ''. A vehicle that never had a receiver loses none."""
        live = received(message)
        if message.get_type() == "RC_CHANNELS":
            self._channels = live is None
            self._heard |= self._channels
        elif live is not None:
            self._healthy = live
            self._heard |= live
        before, self.lost = self.lost, self._heard and not (self._channels and self._healthy)
        if self.lost == before:
            return ""
        return LOST if self.lost else BACK


class ModeSwitch:
    """Follows the position of the pilot's mode switch. channel: FLTMODE_CH, 5 in ArduCopter; 0: no switch changes the mode."""

    def __init__(self, channel: int = 5) -> None:
        self.channel = channel
        self.forget()

    def forget(self) -> None:
        """Take the next position that is seen for the one to start from."""
        self._position: int | None = None
        self._other: tuple[int, float] | None = None  # and since when it is seen

    @property
    def position(self) -> int | None:
        """Of six, from 1, as FLTMODE1 to FLTMODE6 count them; None before one is seen."""
        return None if self._position is None else self._position + 1

    def moved(self, message: Message, t_s: float) -> bool:
        """Whether this message shows the switch in another position than before, as it did for `STAYS_S`."""
        position = self._shown(message)
        if position is None:
            return False
        if self._position is None or position == self._position:
            self._position, self._other = position, None
        elif self._other is None or self._other[0] != position:
            self._other = position, t_s
        elif t_s - self._other[1] >= STAYS_S:
            self._position, self._other = position, None
            return True
        return False

    def _shown(self, message: Message) -> int | None:
        if message.get_type() != "RC_CHANNELS" or not 0 < self.channel <= message.chancount:
            return None
        pulse_us = getattr(message, f"chan{self.channel}_raw", 0)
        return bisect_right(POSITIONS_US, pulse_us) if PULSES_US[0] < pulse_us < PULSES_US[1] else None
