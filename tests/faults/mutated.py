"""Frames and logs with something wrong in them: nothing but a clear error may come of it, in bounded time and memory.

python -m tests.faults.mutated [--packets 1000000] [--logs 1000]
"""

from __future__ import annotations

import argparse
import gzip
import io
import lzma
import random
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io
from pymavlink.generator.mavcrc import x25crc

from flighttest.errors import FlighttestError
from flighttest.flight.execution.control import FlightControl, Stops
from flighttest.flight.execution.machine import Event
from flighttest.flight.outcome import FlightEnded
from flighttest.flight.preparation.changes import ExternalChanges
from flighttest.flight.recorder import Recorder
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.clock import FollowedClock
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.streams import StreamRates
from flighttest.logs import import_log
from flighttest.mavlink.dialect import dialect
from flighttest.sim import InProcess, SimOptions
from tests.flight.faulty import GATE, make_plan

DATA = Path(__file__).resolve().parents[1] / "data"
_A_LINK = 2_000  # frames after which the conversation begins anew
_BATCH = 20


def frames_of_a_flight(seconds: float = 3.0) -> list[bytes]:
    """Frames as the built-in vehicle sends them, all message types that it has."""
    sim = InProcess(SimOptions(ready_s=0.1, gps_s=0.1))
    station = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    for number in (30, 32, 33, 74, 83, 105, 147, 148, 1, 65, 36, 193, 27, 29, 245):
        rate = (dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, float(number), 2e4, 0, 0, 0, 0, 0)
        sim.send(bytes(dialect.MAVLink_command_long_message(1, 1, *rate).pack(station)))
    sim.send(bytes(dialect.MAVLink_param_request_list_message(1, 1).pack(station)))
    sim.advance(seconds)
    data, found = sim.receive(), []
    while data:
        size = data[1] + 12
        found.append(data[:size])
        data = data[size:]
    return found


def mutated(frame: bytes, draw: random.Random) -> bytes:
    """A frame with something wrong: mostly wrong values under a right checksum, which get farthest."""
    kind = draw.random()
    if kind < 0.1:
        return frame
    changed = bytearray(frame)
    for _ in range(draw.choice((1, 1, 2, 8))):
        changed[draw.randrange(3, len(changed) - 2)] = draw.choice((0, 255, 127, 128, draw.randrange(256)))
    if kind < 0.75:
        known = dialect.mavlink_map.get(int.from_bytes(changed[7:10], "little"))
        checksum = x25crc(bytes(changed[1:-2]) + bytes([known.crc_extra if known is not None else 0]))
        changed[-2:] = checksum.crc.to_bytes(2, "little")
        return bytes(changed)
    if kind < 0.85:
        return bytes(changed)
    if kind < 0.95:
        return bytes(frame[: draw.randrange(len(frame))])
    return draw.randbytes(draw.randrange(1, 300))


class Mutations:
    """A transport that gives mutated frames; time passes with them."""

    def __init__(self, frames: list[bytes], draw: random.Random) -> None:
        self._frames, self._draw = frames, draw
        self.given, self.now_s = 0, 1000.0

    def send(self, data: bytes) -> None:
        """Not sounded."""

    def receive(self, timeout_s: float) -> bytes:
        """A handful of frames, once for each wait."""
        self.now_s += max(timeout_s, 1e-4)
        if timeout_s <= 0.0:
            return b""
        self.given += _BATCH
        return b"".join(mutated(self._draw.choice(self._frames), self._draw) for _ in range(_BATCH))

    def close(self) -> None:
        """Nothing to give back."""


def listen_to_packets(count: int, folder: Path, seed: int = 1) -> int:
    """Let a flight's session, state and record take in so many mutated frames; how often they ended a flight."""
    draw, frames, given, ended = random.Random(seed), frames_of_a_flight(), 0, 0
    while given < count:
        link = Mutations(frames, draw)
        session = Session(MavlinkPort(link), FollowedClock(lambda now=link: now.now_s, lambda now=link: now.now_s))  # type: ignore[misc]
        recorder = Recorder(folder, session.clock.ground_s, {}, make_plan())
        session.port.tap(recorder.tap)
        vehicle = ArduPilot(session)
        control = FlightControl(
            vehicle,
            GATE,
            recorder,
            rate_hz=50.0,
            stops=Stops(lambda: 0),
            external_changes=ExternalChanges({"GUID_OPTIONS": 8.0}),
        )
        control.streams = StreamRates(vehicle, {"ATTITUDE": 50.0}, {}, lambda wanted, _seen: wanted)
        try:
            control.on(Event.ARM)
            control.on(Event.ARMED)
            while link.given < min(_A_LINK, count - given):
                control.cycle()
                control.release()
        except FlightEnded:
            ended += 1
        given += max(link.given, 1)
        recorder.flush(force=True)
    return ended


@dataclass(frozen=True)
class Log:
    """A log of one kind. suffix: of its file."""

    suffix: str
    data: bytes


def logs() -> Iterator[Log]:
    """A short sound log of each kind."""
    from tests.logs.conftest import guided_flight, small_ulog

    yield Log(".BIN", bytes(guided_flight().data))
    yield Log(".tlog", lzma.decompress((DATA / "sitl_yaw_rate.tlog.xz").read_bytes())[:60_000])
    yield Log(".ulg", small_ulog())
    rows = "\n".join(f"{k / 100},{0.1 * (k > 50)},{0.1 * (k > 53)},0,0.2,{-9.8}" for k in range(300))
    text = f"t_s,roll_ref_rad,roll_rad,pitch_rad,throttle,f_z_m_s2\n{rows}\n".encode()
    yield Log(".csv", text)
    yield Log(".tsv", text.replace(b",", b"\t"))
    yield Log(".csv.gz", gzip.compress(text))
    yield Log(".csv.xz", lzma.compress(text))
    columns = {"t_s": np.arange(300) / 100.0, "roll_rad": np.linspace(0.0, 0.1, 300), "throttle": np.full(300, 0.2)}
    buffer = io.BytesIO()
    pd.DataFrame(columns).to_parquet(buffer)
    yield Log(".parquet", buffer.getvalue())
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"log": {"att": columns, "bat": {"time": columns["t_s"], "voltage_v": columns["t_s"]}}})
    yield Log(".mat", buffer.getvalue())
    yield Log(".mcap", _bag())


def _bag() -> bytes:
    """A ROS 2 bag of an IMU."""
    from mcap_ros2.writer import Writer

    from tests.logs.test_other_programs import IMU, header, quaternion

    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=4000)
    imu = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
    turn = {"x": 0.2, "y": 0.0, "z": 0.1}
    for k in range(60):
        t_s = 1_700_000_000.0 + k / 50.0
        message = {"header": header(t_s), "orientation": quaternion(0.1), "orientation_covariance": [0.0] * 9}
        writer.write_message(
            "/imu", imu, message | {"angular_velocity": turn, "linear_acceleration": turn}, int(t_s * 1e9)
        )
    writer.finish()
    return buffer.getvalue()


def damaged(data: bytes, draw: random.Random) -> bytes:
    """A log with bytes changed, cut out, doubled or cut off."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 3, 30, 300))):
        place = draw.randrange(len(changed))
        changed[place] = draw.choice((0, 255, draw.randrange(256)))
    kind, place = draw.random(), draw.randrange(len(changed))
    if kind < 0.2:
        del changed[place : place + draw.randrange(1, 400)]
    elif kind < 0.4:
        changed[place:place] = changed[place : place + draw.randrange(1, 400)]
    elif kind < 0.5:
        del changed[place:]
    return bytes(changed)


def read_logs(
    log: Log, count: int, folder: Path, seed: int = 1, tell: Callable[[str], None] = lambda _text: None
) -> int:
    """Import so many damaged copies of a log; how many were refused. Anything but a FlighttestError is raised, a warning too."""
    draw, refused = random.Random(seed), 0
    path = folder / f"damaged{log.suffix}"
    for k in range(count):
        path.write_bytes(damaged(log.data, draw))
        began = time.monotonic()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                import_log(path)
        except FlighttestError:
            refused += 1
        except BaseException:
            kept = folder.parent / f"found-{k}{log.suffix}"
            kept.write_bytes(path.read_bytes())
            tell(f"{kept} was not read as it should be")
            raise
        took_s = time.monotonic() - began
        assert took_s < 60.0, f"{log.suffix} number {k} took {took_s:.0f} s"
    return refused


def main() -> None:
    """Run both and say how it went."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--packets", type=int, default=1_000_000)
    options.add_argument("--logs", type=int, default=1_000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--kind", action="append", help="of a log, such as .mat; may be repeated; otherwise all")
    asked = options.parse_args()

    def say(text: str) -> None:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        listen_to_packets(min(asked.packets, 20_000), folder, asked.seed)
        before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
        ended = listen_to_packets(asked.packets, folder, asked.seed + 1)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        say(
            f"{asked.packets} frames in {time.monotonic() - began:.0f} s: {ended} flights ended, {grown:.1f} MB more at most"
        )
        for log in logs():
            if asked.kind and log.suffix not in asked.kind:
                continue
            read_logs(log, min(asked.logs, 100), Path(name), asked.seed, say)
            before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
            refused = read_logs(log, asked.logs, Path(name), asked.seed + 1, say)
            grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
            say(
                f"{asked.logs} logs {log.suffix} in {time.monotonic() - began:.0f} s: {refused} refused, the others read, "
                f"{grown:.1f} MB more at most"
            )


if __name__ == "__main__":
    main()
