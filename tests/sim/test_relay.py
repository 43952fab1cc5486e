"""Lock-step for a firmware that does not have it: the test plays ground program and firmware."""

import itertools
import json
import socket
import struct
import threading
import time
from contextlib import suppress

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.plants.plant_motors import MotorPlant
from flighttest.sim.ports import listen
from flighttest.sim.sitl.json_backend import JsonBackend
from flighttest.sim.sitl.relay import PARAMETER, FrameSplitter, Relay

STEP_US = 1250


class Firmware:
    """Asks for steps over UDP, and echoes over TCP what it received with its time, as ArduPilot's SITL between two steps."""

    def __init__(self, port: int, serial: socket.socket) -> None:
        self.physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.physics.connect(("127.0.0.1", port))
        self.physics.settimeout(0.3)
        self.serial = serial
        self.ground: socket.socket | None = None
        self.mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.received: list[tuple[int, bytes]] = []
        self.now_us, self.stamp_s, self.frame, self.ended = 0, 0.0, 0, False

    def run(self) -> None:
        self.serial.settimeout(0.0)
        while not self.ended:
            self.physics.send(struct.pack("<HHI16H", 18458, 800, self.frame, *([1000] * 16)))
            try:
                stamp_s = json.loads(self.physics.recv(2000))["timestamp"]
            except TimeoutError:
                continue
            self.now_us = int(self.now_us + (stamp_s - self.stamp_s) * 1.0e6)
            self.stamp_s, self.frame = stamp_s, self.frame + 1
            if self.ground is None:
                try:
                    self.ground, _ = self.serial.accept()
                    self.ground.settimeout(0.0)
                except BlockingIOError:
                    continue
            try:
                data = self.ground.recv(4096)
            except BlockingIOError:
                data = b""
            if data:
                self.received.append((self.now_us, data))
            if self.frame % 8 == 0:
                beat = dialect.MAVLink_attitude_message(self.now_us // 1000, 0, 0, 0, 0, 0, 0)
                with suppress(BrokenPipeError):
                    self.ground.send(beat.pack(self.mav))
                self.mav.seq = (self.mav.seq + 1) % 256


@pytest.fixture
def flown():
    """A ground program's connection, and the firmware behind it."""
    serial, front = listen("127.0.0.1", 0), listen("127.0.0.1", 0)
    backend = JsonBackend(MotorPlant())
    relay = Relay(front, serial.getsockname())
    firmware = Firmware(backend.port, serial)
    threads = [
        threading.Thread(target=backend.run, args=(relay,), daemon=True),
        threading.Thread(target=firmware.run, daemon=True),
    ]
    with socket.create_connection(front.getsockname(), timeout=5.0) as ground:
        for thread in threads:
            thread.start()
        yield Ground(ground), firmware
    firmware.ended = True
    backend.stop()
    for thread in threads:
        thread.join(5.0)
        assert not thread.is_alive()


class Ground:
    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.mav = dialect.MAVLink(None, srcSystem=245, srcComponent=191)
        self.heard: list = []
        self.numbers: list[int] = []

    def send(self, message) -> None:
        self.sock.send(message.pack(self.mav))

    def until(self, kind: str):
        while True:
            for message in self.mav.parse_buffer(self.sock.recv(4096)) or []:
                self.heard.append(message)
                self.numbers.append(message.get_seq())
            for i, message in enumerate(self.heard):
                if message.get_type() == kind:
                    return [self.heard.pop(0) for _ in range(i + 1)][-1]

    def enter(self) -> int:
        self.send(dialect.MAVLink_param_set_message(1, 1, PARAMETER.encode(), 1.0, dialect.MAV_PARAM_TYPE_INT8))
        assert self.until("PARAM_VALUE").param_value == 1.0
        return self.grant(0)

    def grant(self, until_ms: int) -> int:
        self.send(dialect.MAVLink_system_time_message(0, until_ms))
        return self.until("SYSTEM_TIME").time_boot_ms


def test_the_firmware_goes_as_far_as_is_granted_and_a_target_arrives_at_the_next_step(flown):
    ground, firmware = flown
    ground.until("ATTITUDE")
    ground.send(dialect.MAVLink_param_request_read_message(1, 1, PARAMETER.encode(), -1))
    assert ground.until("PARAM_VALUE").param_value == 0.0
    now_ms = ground.enter()
    assert firmware.now_us // 1000 == now_ms
    begin = firmware.now_us
    for k in range(1, 6):
        target = dialect.MAVLink_heartbeat_message(18, 8, 0, k, 4, 3)
        sent = target.pack(ground.mav)
        ground.sock.send(sent)
        assert ground.grant(now_ms + 20 * k) == now_ms + 20 * k
        assert firmware.received[-1] == (begin + STEP_US, sent)  # the first step after it was sent
        begin = firmware.now_us
        assert (now_ms + 20 * k) * 1000 - STEP_US < firmware.now_us <= (now_ms + 20 * k) * 1000


def test_time_stands_still_without_a_grant_and_runs_on_when_the_client_leaves(flown):
    ground, firmware = flown
    ground.until("ATTITUDE")
    ground.enter()
    stood = firmware.now_us
    ground.sock.settimeout(0.4)
    with pytest.raises(TimeoutError):
        ground.until("HEARTBEAT")
    assert firmware.now_us == stood
    ground.sock.close()
    time.sleep(0.3)
    assert firmware.now_us > stood + 10 * STEP_US


def test_what_is_put_in_leaves_no_gap_in_the_firmwares_count(flown):
    ground, _ = flown
    ground.until("ATTITUDE")
    now_ms = ground.enter()
    for k in range(1, 5):
        ground.grant(now_ms + 20 * k)
    steps = [(b - a) % 256 for a, b in itertools.pairwise(ground.numbers)]
    assert set(steps) == {0, 1}
    assert sum(steps) > 6


def test_frames_are_passed_whole():
    mav = dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    one = dialect.MAVLink_attitude_message(5, 0, 0, 0, 0, 0, 1.0).pack(mav)
    mav.seq = 9
    two = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3).pack(mav, force_mavlink1=True)
    frames = FrameSplitter()
    passed = [frames.feed(bytes([b])) for b in b"noise" + one + two]
    assert b"".join(passed) == b"noise" + one + two
    assert one in passed
    assert two in passed
    assert (frames.system, frames.component, frames.sequence) == (7, 1, 9)
