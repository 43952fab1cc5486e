"""ArduPilot's JSON physics interface: the real firmware flies on a plant of ours, in lock-step over UDP.

The firmware sends motor outputs and waits; we step the plant once and answer with what its inertial sensors, its position and its
velocity would be; no time passes in between. Vibration is added here; the firmware simulates the other sensors' errors and runs its own
filters and estimator, so what it records are measurements. The interface has no battery: voltage and current travel as two range-finder
distances, which `sitl/scripts/battery.lua` hands to the firmware's scripting battery monitor.

On the wire NED and FRD (`frames` pins the signs); the plant is NWU and FLU.
"""

from __future__ import annotations

import selectors
import socket
import struct
from collections.abc import Sequence
from contextlib import suppress
from math import sqrt
from typing import Protocol

from flighttest.errors import InputError, LinkError
from flighttest.sim.noise import NoiseStream
from flighttest.sim.plants.plant import Motion
from flighttest.sim.sensors import SensorNoise
from flighttest.sim.sitl.relay import Relay

# magic, frame rate Hz, frame count, 16 or 32 pulse widths us (libraries/SITL/examples/JSON/readme.md in ArduPilot)
_SHORT, _LONG = struct.Struct("<HHI16H"), struct.Struct("<HHI32H")
_MAGIC = {18458: _SHORT, 29569: _LONG}
_PULSE_MIN_US, _PULSE_SPAN_US = 1000, 1000.0
_IDLE_S = 0.2
_STOPPED_S = 2.0  # on the ground without a turning motor, of the plant's time, until a flight counts as over
# The firmware refuses to arm with a gyro below 1.8 times its 400 Hz loop; motor outputs change at 400 Hz.
RATE_HZ = 800
# The firmware adds up whole microseconds, rounded down, of differences between stamps: a little more than a step is a whole step.
_STRETCH = 1.0 + 1e-5
_BUSY_S = 0.005


class MotorDriven(Protocol):
    """What the server needs of a plant."""

    motion: Motion

    @property
    def motors(self) -> int:
        """How many motor commands it takes."""

    def step(self, motor_commands: Sequence[float], dt_s: float) -> None:
        """Move on by dt_s, s, under constant motor commands 0..1."""

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V."""


def motor_commands(packet: bytes, motors: int) -> tuple[int, int, list[float]] | None:
    """Frame count, frame rate Hz and commands 0..1 of the first `motors` outputs; None for what is no such packet."""
    if len(packet) < _SHORT.size:
        return None
    layout = _MAGIC.get(packet[0] | packet[1] << 8)
    if layout is None or len(packet) != layout.size:
        return None
    values = layout.unpack(packet)
    commands = [min(max((us - _PULSE_MIN_US) / _PULSE_SPAN_US, 0.0), 1.0) for us in values[3 : 3 + motors]]
    return values[2], values[1], commands


def state_text(
    t_s: float, m: Motion, shake: Sequence[float] = (0.0, 0.0, 0.0), tremble: Sequence[float] = (0.0, 0.0, 0.0)
) -> bytes:
    """One line for the firmware: time s, gyro rad/s and specific force m/s^2 (FRD), position m, attitude rad, velocity m/s (NED).

    shake, tremble: what vibration adds to specific force, m/s^2, and to rates, rad/s.
    """
    return (
        f'\n{{"timestamp":{t_s:.9f},"imu":{{"gyro":[{m.p + tremble[0]:.8g},{tremble[1] - m.q:.8g},{tremble[2] - m.r:.8g}],'
        f'"accel_body":[{m.fx + shake[0]:.8g},{shake[1] - m.fy:.8g},{shake[2] - m.fz:.8g}]}},'
        f'"position":[{m.px:.9g},{-m.py:.9g},{-m.pz:.9g}],"attitude":[{m.roll:.8g},{-m.pitch:.8g},{-m.yaw:.8g}],'
        f'"velocity":[{m.vx:.8g},{-m.vy:.8g},{-m.vz:.8g}],"rng_1":{m.voltage:.5f},"rng_2":{m.current:.4f}}}\n'
    ).encode()


class JsonBackend:
    """Serves one plant to one firmware. time_s: plant time, s; vehicle_us: the firmware's time, us; steps: how many; frames_lost: packets
    that never came.

    After each landing the plant gets a battery as it began with: full, or one that rests at rested_v, V.
    """

    def __init__(
        self,
        plant: MotorDriven,
        port: int = 0,
        host: str = "127.0.0.1",
        sock: socket.socket | None = None,
        noise: SensorNoise | None = None,
        seed: int = 0,
        rested_v: float | None = None,
    ) -> None:
        self.plant = plant
        self._rested_v = rested_v
        self._flown, self._stopped_s = False, 0.0
        self._noise = noise
        self._draw = NoiseStream(seed, "imu").draw
        self._socket = sock or bind_physics(host, port)
        self._socket.settimeout(_IDLE_S)
        self.port = int(self._socket.getsockname()[1])
        self.time_s = 0.0
        self.vehicle_us = 0
        self.steps = self.frames_lost = 0
        self._frame = -1
        self._answer = b""
        self._stopped = self._finishing = False

    def stop(self) -> None:
        """End `run` within a moment; from any thread."""
        self._stopped = True

    def finish(self) -> None:
        """End `run` when the firmware falls silent: one that waits for an answer would not notice that its parent is gone."""
        self._finishing = True

    def run(self, relay: Relay | None = None) -> None:
        """Answer until `stop`, or after `finish` until the firmware is silent. relay: a ground program's way to the firmware, which may
        grant time (`relay.Relay`)."""
        if relay is not None:
            self._run_between(relay)
            return
        sock, receive = self._socket, self._socket.recvfrom
        try:
            while not self._stopped:
                try:
                    packet, peer = receive(256)
                except TimeoutError:
                    if self._finishing:
                        return
                    continue
                except ConnectionRefusedError:  # the firmware went away between its packet and our answer
                    continue
                if self.take(packet):
                    sock.sendto(self._answer, peer)
        finally:
            sock.close()

    def _run_between(self, relay: Relay) -> None:
        """The same with a ground program's bytes passing beside, and no further than it grants."""
        sock, selector = self._socket, relay.selector
        sock.setblocking(False)
        selector.register(sock, selectors.EVENT_READ)
        waiting: tuple[bytes, tuple[str, int]] | None = None  # the firmware's packet that is not answered yet
        try:
            while not self._stopped:
                if waiting is not None:
                    if relay.may_run(self.vehicle_us + self._step_us(waiting[0])):
                        packet, peer = waiting
                        waiting = None
                        if self.take(packet):
                            sock.sendto(self._answer, peer)
                    elif not relay.resting or relay.granted:
                        relay.waits(self.vehicle_us)
                        continue
                found = selector.select(_BUSY_S if relay.busy else _IDLE_S)
                if not found and self._finishing:
                    return
                heard = False
                for key, _ in found:
                    if key.fileobj is sock:
                        heard = True
                    else:
                        relay.look(key.fileobj)
                if heard:
                    with suppress(ConnectionRefusedError, BlockingIOError):
                        waiting = sock.recvfrom(256)
                relay.flush()
        finally:
            relay.close()
            sock.close()

    def _step_us(self, packet: bytes) -> int:
        """How far an answer to this packet takes the firmware's time, us."""
        found = motor_commands(packet, self.plant.motors)
        if found is None or found[0] == self._frame:
            return 0
        return int(1e6 * _STRETCH / (found[1] if found[1] >= 1 else RATE_HZ))

    def take(self, packet: bytes) -> bool:
        """Step the plant for one packet; whether there is an answer to send."""
        found = motor_commands(packet, self.plant.motors)
        if found is None:
            return False
        frame, rate_hz, commands = found
        if frame == self._frame and self._answer:
            return True  # our answer was lost: the firmware asks again, and no time has passed
        if self._frame >= 0 and frame > self._frame + 1:
            self.frames_lost += frame - self._frame - 1
        dt = 1.0 / (rate_hz if rate_hz >= 1 else RATE_HZ)
        self.plant.step(commands, dt)
        self.time_s += dt
        begun = self._frame < 0 or frame < self._frame  # a firmware takes its first stamp for its time
        self.vehicle_us = int(1e6 * _STRETCH * self.time_s) if begun else self.vehicle_us + int(1e6 * _STRETCH * dt)
        self._frame = frame
        self.steps += 1
        self._look_after(any(commands), dt)
        self._answer = self._state(dt)
        return True

    def _look_after(self, turning: bool, dt_s: float) -> None:
        """Another battery once a flight is over."""
        on_ground = self.plant.motion.on_ground
        self._flown = self._flown or not on_ground
        self._stopped_s = self._stopped_s + dt_s if on_ground and not turning else 0.0
        if self._flown and self._stopped_s >= _STOPPED_S:
            self._flown = False
            self.plant.replace_battery(self._rested_v)

    def _state(self, dt_s: float) -> bytes:
        noise, motion = self._noise, self.plant.motion
        if noise is None or motion.on_ground:  # motors that carry nothing hardly shake the frame
            return state_text(_STRETCH * self.time_s, motion)
        # White noise of one density whatever the step: a 400 Hz sample has the stated deviation.
        density = sqrt(1.0 / (400.0 * dt_s))
        a, g, draw = noise.accel_m_s2 * density, noise.gyro_rad_s * density, self._draw
        return state_text(
            _STRETCH * self.time_s, motion, (a * draw(), a * draw(), a * draw()), (g * draw(), g * draw(), g * draw())
        )


def bind_physics(host: str, port: int) -> socket.socket:
    """A UDP socket for the firmware to talk to; LinkError when the port is taken."""
    if not 0 <= port <= 65535:
        raise InputError(f"{port} is not a port", "0 takes a free one")
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise LinkError(
            f"UDP port {port} on {host}: {error.strerror}", "another physics uses it; take port 0"
        ) from error
    return sock
