"""Ports, clocks and parameters against links that lose, delay and fall silent as real ones do."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import pytest

from flighttest.errors import LinkError
from flighttest.link import parameters
from flighttest.link.ardupilot import ArduPilot, SentHeading
from flighttest.link.clock import FollowedClock, TimeSync
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from tests.link.host import Host


class ScriptedVehicle:
    """A vehicle that answers by a table; each poll of the link takes 20 ms of the host's time. lose: drops the n-th frame sent to it."""

    def __init__(self, host: Host, lose: Callable[[int], bool] = lambda _n: False) -> None:
        self.host = host
        self.lose = lose
        self.values = {"GUID_OPTIONS": 0.0, "ANGLE_MAX": 3000.0, "STUBBORN": 1.0}
        self.mode = 0
        self.refuse_arming = 2
        self.armed = False
        self.asked: list[str] = []
        self._count = 0
        self._in, self._out = parser(0, 0), parser(1, 1)
        self._pending: list[bytes] = []
        self._next_beat = 0.0

    def say(self, message: object) -> None:
        self._pending.append(bytes(message.pack(self._out)))  # type: ignore[attr-defined]
        self._out.seq = (self._out.seq + 1) % 256

    def send(self, data: bytes) -> None:
        for m in self._in.parse_buffer(data) or []:
            self._count += 1
            if self.lose(self._count):
                continue
            self.asked.append(m.get_type())
            handler = getattr(self, "on_" + m.get_type().lower(), None)
            if handler is not None:
                handler(m)

    def on_timesync(self, m: object) -> None:
        self.say(dialect.MAVLink_timesync_message(int((self.host.now - 900.0) * 1e9), m.ts1))  # type: ignore[attr-defined]

    def on_param_request_list(self, _m: object) -> None:
        for index, (name, value) in enumerate(self.values.items()):
            if index != 1:  # lost on the way the first time
                self.value(name, value, index)

    def on_param_request_read(self, m: object) -> None:
        index = m.param_index  # type: ignore[attr-defined]
        name = list(self.values)[index] if index >= 0 else m.param_id  # type: ignore[attr-defined]
        if name in self.values:
            self.value(name, self.values[name], index if index >= 0 else 0xFFFF)

    def on_param_set(self, m: object) -> None:
        if m.param_id in self.values and m.param_id != "STUBBORN":  # type: ignore[attr-defined]
            self.values[m.param_id] = m.param_value  # type: ignore[attr-defined]

    def value(self, name: str, value: float, index: int) -> None:
        self.say(dialect.MAVLink_param_value_message(name.encode(), value, 9, len(self.values), index))

    def on_command_long(self, m: object) -> None:
        result = 0
        if m.command == 176:  # type: ignore[attr-defined]
            self.mode = int(m.param2) if m.param2 != 9 else self.mode  # type: ignore[attr-defined]
        if m.command == 400 and self.refuse_arming > 0:  # type: ignore[attr-defined]
            self.refuse_arming -= 1
            result = 4
            self.say(dialect.MAVLink_statustext_message(2, b"Arm: Gyros inconsistent"))
        elif m.command == 400:  # type: ignore[attr-defined]
            self.armed = True
        if m.command != 511:  # type: ignore[attr-defined]
            self.say(dialect.MAVLink_command_ack_message(m.command, result))  # type: ignore[attr-defined]

    def receive(self, timeout_s: float) -> bytes:
        if self.host.now >= self._next_beat:
            self._next_beat = self.host.now + 1.0
            self.say(dialect.MAVLink_heartbeat_message(2, 3, 129 if self.armed else 1, self.mode, 4, 3))
        self.host.now += min(max(timeout_s, 1e-3), 0.02)
        data, self._pending = b"".join(self._pending), []
        return data

    def close(self) -> None: ...


def session_of(vehicle: ScriptedVehicle) -> Session:
    host = vehicle.host
    session = Session(MavlinkPort(vehicle), FollowedClock(host, host))
    session.connect()
    return session


def test_parameters_by_either_name_verified_and_lost_ones_asked_again() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    known = parameters.read_all(session)
    assert known == {"GUID_OPTIONS": 0.0, "ANGLE_MAX": 3000.0, "STUBBORN": 1.0}
    assert parameters.by_either_name(known, "ATC_ANGLE_MAX") == 30.0
    assert parameters.read_parameter(session, "ATC_ANGLE_MAX") == 30.0
    assert parameters.read_parameter(session, "NO_SUCH") is None
    parameters.write_parameter(session, "ATC_ANGLE_MAX", 45.0, known)
    assert vehicle.values["ANGLE_MAX"] == 4500.0
    with pytest.raises(LinkError, match="STUBBORN does not take 2"):
        parameters.write_parameter(session, "STUBBORN", 2.0, known)
    with pytest.raises(LinkError, match="no parameter NO_SUCH"):
        parameters.write_parameter(session, "NO_SUCH", 2.0, known)


def test_a_vehicle_whose_time_stands_at_zero_has_answered() -> None:
    class JustBooted(ScriptedVehicle):
        def on_timesync(self, m: object) -> None:
            self.say(dialect.MAVLink_timesync_message(0, m.ts1))  # type: ignore[attr-defined]

    host = Host()
    session = session_of(JustBooted(host))
    assert session.offset is not None
    assert host.now - 1000.0 < 0.2, "a second of asking again, in each of a proof's hundreds of flights"


def test_a_vehicles_own_question_is_no_answer() -> None:
    class Asking(ScriptedVehicle):
        def on_timesync(self, m: object) -> None:
            self.say(dialect.MAVLink_timesync_message(0, int(self.host.now * 1e9) + 1))

    assert session_of(Asking(Host())).offset is None


def test_a_lossy_link_is_asked_again() -> None:
    chance = random.Random(1)
    vehicle = ScriptedVehicle(Host(), lose=lambda _n: chance.random() < 0.33)
    session = session_of(vehicle)
    known = {"GUID_OPTIONS": 0.0}
    parameters.write_parameter(session, "GUID_OPTIONS", 8.0, known)
    assert vehicle.values["GUID_OPTIONS"] == 8.0


def test_a_silent_vehicle_is_an_error_not_a_hang() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    vehicle.lose = lambda _n: True
    with pytest.raises(LinkError, match="did not answer PARAM_REQUEST_LIST"):
        parameters.read_all(session)
    copter = ArduPilot(session)
    ack = copter.command(400, 1.0)
    assert ack.result is None
    assert not ack.accepted
    assert ack.sentence == "no answer"


def test_arming_is_tried_again_and_says_why_it_was_refused() -> None:
    vehicle = ScriptedVehicle(Host())
    copter = ArduPilot(session_of(vehicle))
    copter.arm()
    assert vehicle.armed
    vehicle.armed, vehicle.refuse_arming = False, 1000
    copter.session.advance(copter.session.now_s() + 1.5)
    with pytest.raises(LinkError, match="Gyros inconsistent"):
        copter.arm(timeout_s=3.0)


def test_a_mode_is_confirmed_by_heartbeat() -> None:
    vehicle = ScriptedVehicle(Host())
    copter = ArduPilot(session_of(vehicle))
    copter.set_mode(CopterMode.GUIDED)
    assert copter.mode == 4
    with pytest.raises(LinkError, match="did not enter LAND"):  # accepted, but it never shows
        copter.set_mode(CopterMode.LAND, timeout_s=3.0)


def test_a_muted_port_sends_nothing() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    session.port.mute()
    asked = len(vehicle.asked)
    session.advance(session.now_s() + 3.0)
    assert not session.send(dialect.MAVLink_param_request_list_message(1, 1))
    assert len(vehicle.asked) == asked


def test_noise_is_counted_and_lost_frames_are_too() -> None:
    host = Host()
    vehicle = ScriptedVehicle(host)
    port = MavlinkPort(vehicle)
    for _ in range(5):
        vehicle.say(dialect.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0))
    del vehicle._pending[1:3]
    vehicle._pending.insert(1, b"noise")
    assert len(port.receive(0.01)) >= 3
    assert port.frames_lost == 2
    assert port.bad_bytes == 5


def test_the_heading_sent_is_that_of_the_firmware_s_target() -> None:
    sent = SentHeading(0.1, 4.7)
    headings = np.array([sent.next(1.0, 0.02) for _ in range(51)]) - 0.1
    t = 0.02 * np.arange(51)
    np.testing.assert_allclose(headings, np.where(t < 1 / 4.7, 0.5 * 4.7 * t**2, t - 0.5 / 4.7), atol=1e-12)
    unlimited = SentHeading(0.0, 0.0)
    assert [unlimited.next(1.0, dt) for dt in (0.0, 0.02, 0.02)] == pytest.approx([0.0, 0.02, 0.04])
    assert unlimited.next(0.0, 0.02) == unlimited.next(0.0, 0.02) == pytest.approx(0.06)


def test_where_no_target_is_shaped_the_heading_trails_the_integral_of_the_rate() -> None:
    lagged = SentHeading(0.0, 0.0, lag_s=0.2)
    headings = [lagged.next(1.0, 0.02) for _ in range(101)]
    assert headings[5] < 0.05
    assert headings[-1] == pytest.approx(2.0 - 0.2, abs=0.02)


def beat_of(vehicle: ScriptedVehicle, mode: int, sequence: int) -> None:
    vehicle._out.seq = sequence
    vehicle.say(dialect.MAVLink_heartbeat_message(2, 3, 129, mode, 4, 3))


def test_a_heartbeat_that_was_overtaken_shows_a_mode_that_is_over() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    vehicle._next_beat = float("inf")
    copter = ArduPilot(session)
    for mode, sequence, seen in ((4, 250, 4), (20, 2, 20), (4, 255, 20), (5, 40, 5)):
        beat_of(vehicle, mode, sequence)
        session.advance(session.now_s() + 0.05)
        assert copter.mode == seen
    vehicle.host.now += 1.0
    beat_of(vehicle, 9, 20)  # after a pause of the link the numbers show nothing
    session.advance(session.now_s() + 0.05)
    assert copter.mode == 9


def test_a_reboot_makes_all_that_was_heard_old() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    vehicle.say(dialect.MAVLink_attitude_message(100_100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    session.advance(session.now_s() + 0.05)
    assert "ATTITUDE" in session.latest
    vehicle.say(dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 0, 0.0, 0.0))
    vehicle.say(dialect.MAVLink_system_time_message(0, 1500))
    session.advance(session.now_s() + 0.05)
    assert "ATTITUDE" not in session.latest


def test_an_answer_to_another_ground_station_is_not_ours() -> None:
    class Busy(ScriptedVehicle):
        def on_command_long(self, m: object) -> None:
            self.say(dialect.MAVLink_command_ack_message(m.command, 2, 0, 0, 255, 190))  # type: ignore[attr-defined]
            super().on_command_long(m)

    assert ArduPilot(session_of(Busy(Host()))).command(176, 1.0, 20.0).accepted


def test_the_grounds_clock_may_be_set_in_mid_flight() -> None:
    host, wall = Host(), Host()
    clock = FollowedClock(host, wall)
    began = clock.ground_s()
    host.now += 2.0
    wall.now += 3.0e7
    assert clock.ground_s() - began == 2.0


def test_a_second_autopilot_on_the_link_is_noticed_and_not_listened_to() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    other = parser(2, 1)
    vehicle._pending.append(bytes(dialect.MAVLink_heartbeat_message(2, 3, 129, 5, 4, 3).pack(other)))
    session.advance(session.now_s() + 0.05)
    assert session.others == {2}
    assert ArduPilot(session).mode == 0


@pytest.mark.parametrize("real", [True, False])
def test_a_leap_of_the_vehicles_clock_in_flight_is_no_silence(real: bool) -> None:
    host = Host()
    clock = FollowedClock(host, host)
    if real:
        clock.keep_real_time()
    clock.heard(50.0)
    clock.hold()
    for step in range(1, 400):
        host.now += 0.02
        leapt = 86400.0 if step > 200 else 0.0
        clock.heard(50.0 + 0.02 * step + leapt)
        clock.answered(50.0 + 0.02 * step + leapt, 0.001)
        assert clock.now_s() == pytest.approx(50.0 + 0.02 * step, abs=0.01)
    assert clock.leap_s == pytest.approx(86400.0, abs=0.1)


def test_one_false_stamp_in_flight_moves_no_clock() -> None:
    host = Host()
    clock = FollowedClock(host, host)
    clock.heard(50.0)
    clock.hold()
    for step in range(1, 100):
        host.now += 0.02
        clock.heard({50: 86400.0, 60: 1.0}.get(step, 50.0 + 0.02 * step))
        assert clock.now_s() == pytest.approx(50.0 + 0.02 * step, abs=0.01)
    assert clock.leap_s == 0.0
    for step in range(10):
        host.now += 0.02
        clock.heard(1.0 + 0.02 * step)
    assert clock.now_s() == pytest.approx(1.18, abs=0.01), "booted anew"


def test_one_lost_request_for_the_parameters_is_sent_again() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    first = []

    def lose(count: int) -> bool:
        first.append(count)
        return len(first) == 1

    vehicle.lose = lose
    assert set(parameters.read_all(session)) == set(vehicle.values)


def test_a_link_that_is_lost_is_said_instead_of_what_was_asked_for() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    known = parameters.read_all(session)
    session.advance(session.now_s() + 1.0)
    vehicle.lose = lambda _n: True
    with pytest.raises(LinkError, match="lost in one direction"):
        parameters.write_parameter(session, "ANGLE_MAX", 4000.0, known)
    vehicle.say = lambda _message: None  # type: ignore[method-assign]
    began = session.now_s()
    session.advance(began + 6.5)
    with pytest.raises(LinkError, match="nothing has been heard"):
        parameters.write_parameter(session, "ANGLE_MAX", 4000.0, known)
    assert session.now_s() - began < 8.0


class Twins(ScriptedVehicle):
    """Two vehicles of one system id behind one link: the second counts its own frames and is in another mode. from_s: of host time."""

    def __init__(self, host: Host, from_s: float = 0.0, hz: float = 1.0) -> None:
        super().__init__(host)
        self._from_s, self._hz = from_s, hz
        self._second = parser(1, 1)
        self._second.seq = 117
        self._next_second = from_s

    def receive(self, timeout_s: float) -> bytes:
        # The first one streams, in its own order.
        self.say(dialect.MAVLink_attitude_message(int(1e3 * (self.host.now - 900.0)), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        data = super().receive(timeout_s)
        if self.host.now >= max(self._next_second, self._from_s):
            self._next_second = self.host.now + 1.0 / self._hz
            data += bytes(dialect.MAVLink_heartbeat_message(2, 3, 209, 6, 4, 3).pack(self._second))
            self._second.seq = (self._second.seq + 1) % 256
        return data


@pytest.mark.parametrize("hz", [1.0, 10.0, 50.0])
def test_two_vehicles_of_one_system_id_are_distinguished(hz: float) -> None:
    host = Host()
    session = session_of(Twins(host, host.now + 1.0, hz))
    session.advance(session.now_s() + 0.5)
    assert session.others == set()
    modes = []
    session.listen(lambda m, _t: modes.append(m.custom_mode) if m.get_type() == "HEARTBEAT" else None)
    session.advance(session.now_s() + 10.0)
    assert session.others == {1}
    if hz == 1.0:
        assert modes.count(6) < 8, "most of what the second one sends is not taken for the first one's"


def test_a_program_that_did_not_look_for_long_finds_the_link_as_it_is() -> None:
    vehicle = ScriptedVehicle(Host())
    session = session_of(vehicle)
    known = parameters.read_all(session)
    for _ in range(60):  # the vehicle goes on, and its frames wait
        vehicle.host.now += 1.0
        vehicle.say(dialect.MAVLink_heartbeat_message(2, 3, 1, 0, 4, 3))
    parameters.write_parameter(session, "ANGLE_MAX", 4000.0, known)
    assert vehicle.values["ANGLE_MAX"] == 4000.0


def test_what_is_kept_of_the_clock_does_not_grow() -> None:
    sync = TimeSync()
    for k in range(5000):
        sync.answer(0, sync.ask(float(k)), k + 0.01 + 0.001 * (k % 7))
    for k in range(5000, 10_000):
        sync.ask(float(k))
    offset = sync.offset()
    assert offset is not None
    assert offset.error_s == pytest.approx(0.005)
    assert offset.samples == 5000
    assert len(sync._asked) <= 1000


def test_a_question_that_did_not_leave_is_not_unanswered() -> None:
    session = session_of(ScriptedVehicle(Host()))
    session.advance(session.now_s() + 1.0)
    session.held = True
    session.advance(session.now_s() + 12.0)
    assert session.uplink_silence_s < 0.5
    session.require_link()
