"""When attitude targets leave for the vehicle, by the kernel's time stamps at the vehicle's socket: real time, 50 Hz, all streams on.

python benchmarks/target_timing.py [--seconds 30] [--busy N] [--plain] [--same]    N processes that only compute run beside it

The sender is the flight's own: session, recorder, reading of the state, one target per period on a grid. The gate and the rest of a leg
(0.1 ms) are left out.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing as mp
import os
import socket
import struct
import tempfile
import time
from pathlib import Path

import numpy as np

from flighttest.flight.execution.control import AHEAD_SHARE
from flighttest.flight.preparation import priority
from flighttest.flight.preparation.preflight import RATES_HZ
from flighttest.flight.recorder import Recorder
from flighttest.flight.state import StateReader
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import open_transport
from flighttest.mavlink.dialect import dialect, parser
from flighttest.plan import Plan
from flighttest.script.load import load_script
from flighttest.script.shipped import resolve
from flighttest.vehicle.model import DEFAULT_VEHICLE

PERIOD_S = 0.02
_SO_TIMESTAMPNS = getattr(socket, "SO_TIMESTAMPNS", 35)


def double(port: int, seconds: float, result: object) -> None:
    """Sends as a vehicle does, and notes when each target reached its socket."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    line.setblocking(False)
    there, mav, began, came = ("127.0.0.1", port), parser(1, 1), time.monotonic(), []
    made = {
        "HEARTBEAT": lambda ms: dialect.MAVLink_heartbeat_message(2, 3, 217, 20, 4, 3),
        "ATTITUDE": lambda ms: dialect.MAVLink_attitude_message(ms, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
        "HIGHRES_IMU": lambda ms: dialect.MAVLink_highres_imu_message(ms * 1000, *([0.1] * 13), 65535),
        "LOCAL_POSITION_NED": lambda ms: dialect.MAVLink_local_position_ned_message(ms, *([0.1] * 6)),
        "ATTITUDE_TARGET": lambda ms: dialect.MAVLink_attitude_target_message(
            ms, 0, [1.0, 0.1, 0.1, 0.1], 0.1, 0.1, 0.1, 0.2
        ),
    }
    due = dict.fromkeys(made, began)
    while time.monotonic() < began + seconds:
        now = time.monotonic()
        for name, make in made.items():
            if now >= due[name]:
                due[name] += 1.0 / RATES_HZ[name]
                line.sendto(bytes(make(int(1e3 * (now - began)) + 1).pack(mav)), there)
                mav.seq = (mav.seq + 1) % 256
        while True:
            try:
                data, extra, _, _ = line.recvmsg(2048, 256)
            except BlockingIOError:
                break
            if len(data) > 10 and int.from_bytes(data[7:10], "little") == dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
                s, ns = struct.unpack("@qq", extra[0][2][:16])
                came.append(s + 1e-9 * ns)
        time.sleep(0.001)
    result.put(came)  # type: ignore[attr-defined]


def compute() -> None:
    while True:
        sum(k * k for k in range(10_000))


def any_plan() -> Plan:
    script = load_script(resolve("roll_pitch"))
    return Plan(script, DEFAULT_VEHICLE, (), script.limits, script.reset, script.rate_hz)


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--seconds", type=float, default=30.0)
    options.add_argument("--busy", type=int, default=0)
    options.add_argument("--plain", action="store_true", help="without the priority that a real flight takes")
    options.add_argument("--same", action="store_true", help="from the thread that does all the rest, as before")
    asked = options.parse_args()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    session = Session(MavlinkPort(open_transport(f"udpin:127.0.0.1:{port}")))
    came: mp.Queue = mp.Queue()
    beside = [mp.Process(target=double, args=(port, asked.seconds + 3.0, came), daemon=True)]
    beside += [mp.Process(target=compute, daemon=True) for _ in range(asked.busy)]
    for one in beside:
        one.start()
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "run", session.clock.ground_s, {}, any_plan())
        session.port.tap(recorder.tap)
        session.connect()
        session.clock.keep_real_time()
        first = contextlib.nullcontext() if asked.plain else priority.first()
        vehicle, reader = ArduPilot(session), StateReader(session)
        start, tick = session.now_s(), 0
        with first:
            end, ahead_s = (lambda: None, 0.0) if asked.same else (session.port.send_on_time(), AHEAD_SHARE * PERIOD_S)
            while session.now_s() < start + asked.seconds:
                t_s = max(session.now_s() - start, tick * PERIOD_S)
                vehicle.steer((0.1, 0.0, 0.0), None, 0.2, start + t_s if ahead_s else None)
                tick = max(tick + 1, int((session.now_s() - start) / PERIOD_S + 1e-6) + 1)
                session.advance(start + tick * PERIOD_S - ahead_s)
                reader.read()
                recorder.flush()
            end()
    t_s = np.sort(np.array(came.get(timeout=20.0)))[25:]
    for one in beside:
        one.terminate()
    gaps = 1e3 * np.diff(t_s)
    off = np.abs(gaps - 1e3 * PERIOD_S)
    print(f"{t_s.size} targets, load {os.getloadavg()[0]:.1f}, {asked.busy} busy processes beside it")
    shares = ", ".join(f"p{p:g} {np.percentile(off, p):.2f}" for p in (50, 90, 99, 100))
    within, over = 100 * np.mean(off < 3.0), np.sum(gaps > 200.0)
    print(f"between two targets, off 20 ms by (ms): {shares}; within 3 ms {within:.1f} %; over 200 ms: {over}")


if __name__ == "__main__":
    main()
