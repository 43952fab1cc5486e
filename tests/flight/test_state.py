"""What the state reader makes of messages that came, and of those that no longer come."""

from types import SimpleNamespace

import pytest

from flighttest.flight.state import StateReader
from flighttest.mavlink.dialect import dialect


class Silent:
    """A session without a vehicle: hands its listeners what it is given."""

    silence_s = uplink_silence_s = 0.0

    def __init__(self):
        self.latest, self.t_s, self.listeners = {}, 0.0, []

    def now_s(self):
        return self.t_s

    def listen(self, listener):
        self.listeners.append(listener)

    def hear(self, message):
        self.latest[message.get_type()] = SimpleNamespace(message=message, t_s=self.t_s)
        for listener in self.listeners:
            listener(message, self.t_s)


def battery(volts):
    return dialect.MAVLink_sys_status_message(0, 0, 0, 0, int(1000 * volts), 1000, 80, 0, 0, 0, 0, 0, 0)


def test_voltage_is_a_mean_of_two_seconds_and_is_not_known_for_ever():
    session = Silent()
    reader = StateReader(session)
    assert reader.read().voltage_v is None
    for session.t_s, volts in ((0.0, 25.0), (1.0, 24.0), (2.5, 22.0)):
        session.hear(battery(volts))
    assert reader.read().voltage_v == pytest.approx(23.0)
    session.t_s = 12.0
    assert reader.read().voltage_v == pytest.approx(23.0)
    session.t_s = 13.0
    assert reader.read().voltage_v is None, "a battery without a message for ten seconds may be empty"
