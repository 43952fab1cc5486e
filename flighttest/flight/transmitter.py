"""Whether the autopilot receives the pilot's transmitter, by what it reports of its receiver."""

from __future__ import annotations

from flighttest.mavlink.dialect import Message, dialect

LOST = "the pilot's transmitter is not received any more: the mode switch has no effect (stop with Ctrl-C: it lands)"
BACK = "the pilot's transmitter is received again"
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
