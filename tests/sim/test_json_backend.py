"""The JSON physics interface, byte by byte, with a firmware that is played by the test."""

import json
import socket
import struct
import threading

import pytest

from flighttest.errors import InputError, LinkError
from flighttest.frames import G_M_S2
from flighttest.sim.plants.plant import Motion
from flighttest.sim.plants.plant_motors import MotorPlant
from flighttest.sim.plants.rotor_vehicle import RotorVehicle, random_rotor
from flighttest.sim.sitl.json_backend import JsonBackend, bind_physics, motor_commands, state_text


def outputs(frame: int, pulses: list[int], rate_hz: int = 800) -> bytes:
    return struct.pack("<HHI16H", 18458, rate_hz, frame, *(pulses + [1000] * (16 - len(pulses))))


def lift(plant: MotorPlant, seconds: float, bias: tuple[float, ...] = (), dt: float = 0.00125) -> None:
    """Hover commands, motor by motor a little changed."""
    n = plant.motors
    for _ in range(round(seconds / dt)):
        plant.step([plant.hover_throttle * 1.05 + (bias[i] if bias else 0.0) for i in range(n)], dt)


class TestPacket:
    def test_reads_motors_in_order(self):
        frame, rate, commands = motor_commands(outputs(7, [1000, 1250, 1500, 2100]), 4)
        assert (frame, rate) == (7, 800)
        assert commands == pytest.approx([0.0, 0.25, 0.5, 1.0])

    def test_reads_32_channels(self):
        packet = struct.pack("<HHI32H", 29569, 400, 3, *([1500] * 32))
        assert motor_commands(packet, 4) == (3, 400, [0.5] * 4)

    @pytest.mark.parametrize(
        "packet", [b"", b"hello", struct.pack("<HHI16H", 1, 2, 3, *([0] * 16)), outputs(1, [])[:-1]]
    )
    def test_ignores_what_is_no_packet(self, packet):
        assert motor_commands(packet, 4) is None


class TestState:
    def test_signs_are_ned_and_frd(self):
        m = Motion(
            px=1, py=2, pz=3, vx=4, vy=5, vz=6, roll=0.1, pitch=0.2, yaw=0.3, p=0.4, q=0.5, r=0.6, fx=7, fy=8, fz=9
        )
        text = state_text(1.5, m)
        assert text.startswith(b"\n")
        assert text.endswith(b"\n")
        found = json.loads(text)
        assert found["position"] == [1, -2, -3]
        assert found["velocity"] == [4, -5, -6]
        assert found["attitude"] == [0.1, -0.2, -0.3]
        assert found["imu"] == {"gyro": [0.4, -0.5, -0.6], "accel_body": [7, -8, -9]}

    def test_at_rest_the_accelerometer_points_up(self):
        found = json.loads(state_text(0.0, MotorPlant().motion))
        assert found["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -G_M_S2])

    def test_battery_travels_as_distances(self):
        found = json.loads(state_text(0.0, Motion(voltage=24.7, current=21.5)))
        assert (found["rng_1"], found["rng_2"]) == (24.7, 21.5)


# What more from each motor does, in ArduCopter's numbers. QUAD X: 1 front right, 2 rear left, 3 front left, 4 rear right. HEXA X: 1 right,
# 2 left, 3 front left, 4 rear right, 5 front right, 6 rear left. More on the left rolls right; more at the back puts the nose down (FLU
# pitch positive); a motor that turns clockwise pushes the nose to the left (FLU yaw positive).
TURNS = {
    "p": {4: (-1, 1, 1, -1), 6: (-1, 1, 1, -1, -1, 1)},
    "q": {4: (-1, 1, -1, 1), 6: (0, 0, -1, 1, -1, 1)},
    "r": {4: (-1, -1, 1, 1), 6: (1, -1, 1, -1, -1, 1)},
}


class TestMotors:
    @pytest.mark.parametrize("rotors", [4, 6])
    @pytest.mark.parametrize("rate", ["p", "q", "r"])
    def test_turns_where_it_should(self, rotors, rate):
        plant = MotorPlant(RotorVehicle(rotors=rotors))
        lift(plant, 1.0)
        lift(plant, 0.05, tuple(0.005 * s for s in TURNS[rate][rotors]))
        rates = {name: getattr(plant.motion, name) for name in "pqr"}
        assert rates[rate] > 0.02
        assert all(abs(v) < 0.2 * rates[rate] for name, v in rates.items() if name != rate)

    def test_hovers_where_it_says(self):
        plant = MotorPlant()
        lift(plant, 0.5)
        for _ in range(2000):
            plant.step([plant.hover_throttle] * 4, 0.00125)
        assert plant.motion.fz == pytest.approx(G_M_S2, rel=0.03)

    @pytest.mark.parametrize("name", ["rate_limit", "reference_shaping", "angle_boost", "velocity_latency"])
    def test_refuses_what_the_firmware_owns(self, name):
        with pytest.raises(InputError, match=name):
            MotorPlant(hide={name: {}})

    def test_random_vehicles_have_motors(self):
        assert {MotorPlant(random_rotor(seed)).motors for seed in range(12)} == {4, 6}


class TestServer:
    @pytest.fixture
    def served(self):
        backend = JsonBackend(MotorPlant())
        thread = threading.Thread(target=backend.run, daemon=True)
        thread.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as firmware:
            firmware.settimeout(5.0)
            firmware.connect(("127.0.0.1", backend.port))
            yield backend, firmware
        backend.stop()
        thread.join(5.0)
        assert not thread.is_alive()

    def test_one_step_per_frame(self, served):
        backend, firmware = served
        for frame in range(5):
            firmware.send(outputs(frame, [1000] * 4))
            answer = json.loads(firmware.recv(2000))
            assert answer["timestamp"] == pytest.approx((frame + 1) / 800, rel=2e-5)
        assert backend.steps == 5

    def test_a_repeated_frame_gets_the_same_answer_and_no_time(self, served):
        backend, firmware = served
        firmware.send(outputs(0, [1200] * 4))
        first = firmware.recv(2000)
        firmware.send(outputs(0, [1200] * 4))
        assert firmware.recv(2000) == first
        assert backend.steps == 1

    def test_lost_frames_are_counted(self, served):
        backend, firmware = served
        for frame in (0, 3):
            firmware.send(outputs(frame, [1000] * 4))
            firmware.recv(2000)
        assert backend.frames_lost == 2

    def test_other_packets_are_not_answered(self, served):
        backend, firmware = served
        firmware.send(b"noise")
        firmware.send(outputs(0, [1000] * 4))
        assert json.loads(firmware.recv(2000))["timestamp"] == pytest.approx(1 / 800, rel=2e-5)
        assert backend.steps == 1

    def test_finishes_only_when_the_firmware_is_silent(self):
        backend = JsonBackend(MotorPlant())
        thread = threading.Thread(target=backend.run, daemon=True)
        thread.start()
        backend.finish()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as firmware:
            firmware.settimeout(5.0)
            firmware.connect(("127.0.0.1", backend.port))
            firmware.send(outputs(0, [1000] * 4))
            assert firmware.recv(2000)
        thread.join(5.0)
        assert not thread.is_alive()

    def test_a_taken_port_is_said(self, served):
        backend, _ = served
        with pytest.raises(LinkError, match=str(backend.port)):
            bind_physics("127.0.0.1", backend.port)


def test_after_a_landing_there_is_a_full_battery():
    plant = MotorPlant(RotorVehicle())
    sock = bind_physics("127.0.0.1", 0)
    backend = JsonBackend(plant, sock=sock)
    frame = 0

    def run(pulse, seconds):
        nonlocal frame
        for _ in range(round(seconds * 800)):
            frame += 1
            backend.take(outputs(frame, [pulse] * 4))

    run(1300, 0.4)
    run(1100, 2.5)
    used = plant.battery.used_ah
    assert used > 0.0
    assert plant.motion.on_ground
    run(1000, 1.5)
    assert plant.battery.used_ah > used
    run(1000, 1.0)
    assert plant.battery.used_ah < 0.1 * used
    sock.close()
