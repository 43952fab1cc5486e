"""The shared clock, in process and over a real socket."""

import socket
import time

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.errors import InputError, LinkError
from flighttest.sim import InProcess, SimOptions, parse_hide, start_simulator


class _Flight:
    """Lock-step over a TCP socket, byte for byte."""

    def __init__(self, url: str) -> None:
        _, host, port = url.split(":")
        self.sock = socket.create_connection((host, int(port)), 5.0)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # two small writes in a row would wait 40 ms
        self.mav = dialect.MAVLink(None, srcSystem=245)
        self.parser = dialect.MAVLink(None)
        self.bytes = b""

    def send(self, message) -> None:
        self.sock.sendall(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) & 0xFF

    def until(self, wanted):
        while True:
            data = self.sock.recv(65536)
            assert data, "the vehicle closed the connection"
            self.bytes += data
            for m in self.parser.parse_buffer(data) or []:
                if wanted(m):
                    return m

    def grant(self, ms: int) -> int:
        self.send(dialect.MAVLink_system_time_message(0, ms))
        return self.until(lambda m: m.get_type() == "SYSTEM_TIME" and m.time_unix_usec == 0).time_boot_ms


def _fly(seed: int, airframe: str) -> bytes:
    options = SimOptions(airframe=airframe, seed=seed, lockstep=True, ready_s=0.5, gps_s=0.6, gust_rms_m_s=0.5)
    with start_simulator(options, in_thread=True) as simulation:
        f = _Flight(simulation.url)
        f.until(lambda m: m.get_type() == "HEARTBEAT")
        f.send(dialect.MAVLink_param_set_message(1, 1, b"SIM_LOCKSTEP", 1, 2))
        f.until(lambda m: m.get_type() == "PARAM_VALUE")
        assert f.grant(0) == 0
        f.send(dialect.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 8, 6))
        for number, params in ((511, (30, 10000)), (511, (105, 10000)), (511, (32, 20000))):
            f.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *params, 0, 0, 0, 0, 0))
        assert f.grant(1000) == 1000
        f.send(dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 20, 0, 0, 0, 0, 0))
        f.send(dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        for k in range(250):
            q = [0.9987502603949663, 0.04997916927067833, 0.0, 0.0] if k > 180 else [1.0, 0.0, 0.0, 0.0]
            f.send(dialect.MAVLink_set_attitude_target_message(0, 1, 1, 7, q, 0, 0, 0, 0.24))
            assert f.grant(1020 + 20 * k) == 1020 + 20 * k
        f.sock.close()
    return f.bytes


@pytest.mark.parametrize("airframe", ["paper", "rotor"])
def test_equal_bytes_give_equal_flights(airframe):
    first = _fly(3, airframe)
    assert first == _fly(3, airframe)
    assert first != _fly(4, airframe)
    assert b"Arming motors" in first


def test_time_stands_still_without_grants_and_runs_on_when_the_client_dies():
    options = SimOptions(lockstep=True, speed=50.0)
    with start_simulator(options, in_thread=True) as simulation:
        f = _Flight(simulation.url)
        f.send(dialect.MAVLink_param_set_message(1, 1, b"SIM_LOCKSTEP", 1, 2))
        f.until(lambda m: m.get_type() == "PARAM_VALUE")
        assert f.grant(500) == 500
        time.sleep(0.2)
        assert f.grant(0) == 500
        watcher = _Flight(simulation.url)
        watcher.until(lambda m: m.get_type() == "HEARTBEAT")
        f.sock.close()
        start = time.monotonic()
        for _ in range(4):  # heartbeats of later vehicle seconds, at 50 times real time
            watcher.until(lambda m: m.get_type() == "HEARTBEAT")
        assert time.monotonic() - start < 2.0


@pytest.mark.slow
def test_free_running_keeps_the_speed_and_waits_for_its_first_client():
    with start_simulator(SimOptions(speed=20.0), in_thread=True) as simulation:
        time.sleep(0.5)
        met = time.monotonic()
        c = mavutil.mavlink_connection(simulation.url, source_system=245, dialect="ardupilotmega")
        c.wait_heartbeat(timeout=5)

        def vehicle_s(stamp):
            asked = time.monotonic()
            c.mav.timesync_send(0, stamp)
            while (answer := c.recv_match(type="TIMESYNC", blocking=True, timeout=2)).ts1 != stamp:
                pass
            return answer.tc1 * 1e-9, asked, time.monotonic()

        # All bounds are against the wall time really spent: a busy machine may delay any of it.
        first, asked, answered = vehicle_s(1)
        assert first <= 20.0 * (answered - met) + 1.0
        time.sleep(0.5)
        second, asked_again, answered_again = vehicle_s(2)
        assert 0.6 * 20.0 * (asked_again - answered) <= second - first <= 1.4 * 20.0 * (answered_again - asked)
        c.close()


def test_a_process_of_its_own_ends_with_its_context():
    with start_simulator(SimOptions(airframe="rotor", hide={"steady_wind": {"w_north": 3.0}})) as simulation:
        f = _Flight(simulation.url)
        f.until(lambda m: m.get_type() == "HEARTBEAT")
        assert simulation.alive
        with pytest.raises(LinkError, match="cannot listen"):
            start_simulator(port=simulation.port)
    assert not simulation.alive


def test_garbage_on_the_wire_is_survived():
    io = InProcess(SimOptions(ready_s=0.5, gps_s=0.6))
    io.send(bytes(range(256)) * 5 + b"\xfd\x09\x00\x00")
    ask = dialect.MAVLink_param_request_read_message(1, 1, b"GUID_OPTIONS", -1).pack(dialect.MAVLink(None, srcSystem=9))
    io.send(ask * 20)  # the first ones may be taken for the payload of a damaged frame
    io.advance(0.1)
    assert b"GUID_OPTIONS" in io.receive()


def test_what_is_typed_wrong_is_said():
    assert parse_hide(["steady_wind:w_north=3,w_up=1", "ground_effect"]) == {
        "steady_wind": {"w_north": 3.0, "w_up": 1.0}, "ground_effect": {},
    }  # fmt: skip
    for word in ("steady_wind:w_north", "steady_wind:w_north=fast", ":x=1"):
        with pytest.raises(InputError):
            parse_hide([word])
    for airframe in ("paper", "rotor"):
        with pytest.raises(InputError, match="did you mean 'ground_effect'"):
            InProcess(SimOptions(airframe=airframe, hide={"ground_efect": {}}))
        with pytest.raises(InputError, match="has no"):
            InProcess(SimOptions(airframe=airframe, hide={"ground_effect": {"radius": 1.0}}))
        for word, match in {
            "ground_effect:R2_m2=-5": "cannot be -5 m\\^2; give a value from 0 to 8",
            "voltage_sag:sag_tau=-1": "cannot be -1 s",
            "thrust_fade:fade_depth=1.5": "cannot be 1.5",
            "quadratic_drag:k_x=nan": "not a finite number",
            "steady_wind:w_north=inf": "not a finite number",
        }.items():
            with pytest.raises(InputError, match=match):
                InProcess(SimOptions(airframe=airframe, hide=parse_hide([word])))
    for word in ("tether:rest_m=-1", "resonance:damping=-0.1", "updraft:radius_m=-2"):
        with pytest.raises(InputError, match="give a value from 0 on"):
            InProcess(SimOptions(airframe="rotor", hide=parse_hide([word])))
    with pytest.raises(InputError, match="no airframe"):
        SimOptions(airframe="blimp")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_waiting_ground_station_is_sent_to():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(5.0)
        with start_simulator(protocol="udp", peer=ground.getsockname()) as simulation:
            assert simulation.url == f"udpin:127.0.0.1:{ground.getsockname()[1]}"
            data, _ = ground.recvfrom(2048)
    kinds = [m.get_type() for m in dialect.MAVLink(None).parse_buffer(data)]
    assert kinds
    assert set(kinds) <= {"HEARTBEAT", "STATUSTEXT"}
