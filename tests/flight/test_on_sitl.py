"""The safety of a flight on the real ArduCopter SITL: what only the built-in vehicle has seen has not been seen."""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import PreflightError
from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.flight.preparation.fence import ZoneFence
from flighttest.flight.transmitter import LOST
from flighttest.link import parameters as params
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.onboard.fence import Fence, FenceItem, polygon, same_fence
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import Transport, open_transport
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, is_armed, parser
from flighttest.pipeline.planning.checking import predictor_for
from flighttest.pipeline.planning.predictor import ScriptReplanner
from flighttest.plan import AttitudeTarget
from flighttest.plan.compile import compile_plan
from flighttest.script.load import parse_script
from flighttest.sim.sitl.launcher import SitlOptions, launch, sitl_dir
from flighttest.vehicle.load import load_vehicle
from tests.flight.faulty import fly, make_leg, make_plan

pytestmark = pytest.mark.sitl
SPEEDUP = 3.0


def fast_tilt(t_s: float) -> AttitudeTarget:
    """0.5 rad for a second: the vehicle is at 5 m/s when the counter-step begins."""
    return AttitudeTarget(t_s, 0.5 if 0.3 <= t_s < 1.3 else -0.5 if 1.3 <= t_s < 2.0 else 0.0, 0.0, 0.0, 0.155)


def full_throttle(t_s: float) -> AttitudeTarget:
    """T_0 = 0.10, then T_1 = 0.40 for as long as the script's gate lets it."""
    return AttitudeTarget(t_s, 0.0, 0.0, 0.0, 0.10 if t_s < 0.5 else 0.40 if t_s < 0.9 else 0.05)


CLIMBS = """format: maneuver/1
name: climbs
doc: the climbs that need most space
identifies: [sigma_t]
mode: GUIDED_NOGPS
rate_hz: 50
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.6], height_m: [2, 10], speed_max_m_s: 8}
reset: {to: [0, 0, 5], by: guided, settle_s: 2}
steps:
  - throttle_pair: {throttle_0: [0.05, 0.15], throttle_1: [0.25, 0.40], hold_0_s: {up_to: 0.6}, record_1_s: {up_to: 1.5}}
"""
PROFILES = {"tilt": fast_tilt, "throttle": full_throttle}


class Watched:
    """A link to the vehicle that counts what leaves, and may go down."""

    def __init__(self, inner: Transport) -> None:
        self.inner = inner
        self.sent_at: list[float] = []
        self.down_until = 0.0
        self.on_step: object = None
        self._parser = parser(1, 1)

    def send(self, data: bytes) -> None:
        self.sent_at.append(time.monotonic())
        for message in self._parser.parse_buffer(data) or []:
            if message.get_type() == "STATUSTEXT" and message.text.endswith(" step") and callable(self.on_step):
                self.on_step()
        if time.monotonic() >= self.down_until:
            self.inner.send(data)

    def receive(self, timeout_s: float) -> bytes:
        data = self.inner.receive(timeout_s)
        return data if time.monotonic() >= self.down_until else b""

    def close(self) -> None:
        self.inner.close()


def second_link(sitl) -> ArduPilot:
    """Another ground station on the same vehicle."""
    session = Session(MavlinkPort(open_transport(f"tcp:127.0.0.1:{sitl.base_port + 2}"), system=255, component=190))
    session.connect()
    return ArduPilot(session)


@pytest.fixture(scope="module")
def sitl(arducopter):
    with launch(SitlOptions(airframe="paper", speedup=SPEEDUP)) as vehicle:
        yield vehicle


def test_take_over_link_loss_and_kill(sitl, tmp_path):
    """One vehicle, three flights: each ends with the vehicle safe, so that the next can begin."""
    link_lost(sitl, tmp_path / "lost")
    killed(sitl, tmp_path / "tilt", "tilt")
    killed(sitl, tmp_path / "throttle", "throttle")
    take_over(sitl, tmp_path / "over")


def link_lost(sitl, run_dir):
    watched = Watched(open_transport(sitl.url))

    def lose() -> None:
        watched.on_step = None
        watched.down_until = time.monotonic() + 2.0 / SPEEDUP

    watched.on_step = lose
    result = fly(make_plan(make_leg()), sitl.url, run_dir, transport=watched)
    assert result.outcome is FlightOutcome.COMPLETED, result
    assert [leg.outcome for leg in result.legs] == [LegOutcome.LINK_LOST, LegOutcome.FLOWN]


def take_over(sitl, run_dir):
    pilot = second_link(sitl)
    watched = Watched(open_transport(sitl.url))
    switched: list[float] = []

    def switch() -> None:
        watched.on_step = None
        switched.append(time.monotonic())
        pilot.ask_mode(CopterMode.LOITER)

    watched.on_step = switch
    result = fly(make_plan(make_leg()), sitl.url, run_dir, transport=watched)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert watched.sent_at[-1] - switched[0] < 0.4
    pilot.set_mode(CopterMode.LAND)
    assert (
        pilot.session.await_message(lambda m: m.get_type() == "HEARTBEAT" and not m.base_mode & 128, 60.0) is not None
    )
    pilot.session.port.close()  # the firmware serves one connection on this port: the next test's would wait for its end


def killed(sitl, run_dir: Path, profile: str):
    watcher = second_link(sitl)
    watcher.set_rates({"ATTITUDE": 50.0, "LOCAL_POSITION_NED": 50.0})
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.flight.test_on_sitl", sitl.url, str(run_dir), profile],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).resolve().parents[2],
    )
    try:
        assert process.stdout is not None
        # Read on meanwhile: telemetry that waits in a buffer would be taken for what happens after the kill.
        while not select.select([process.stdout], [], [], 0.0)[0]:
            watcher.session.advance(watcher.session.now_s() + 0.05)
        assert process.stdout.readline().strip() == "step", "the flight ended before its step"
        watcher.session.advance(watcher.session.now_s() + (0.9 if profile == "tilt" else 0.35))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    finally:
        process.kill()
    killed_s = watcher.session.now_s()
    tilts: list[tuple[float, float]] = []
    places: list[tuple[float, float, float]] = []
    while watcher.session.now_s() < killed_s + 6.0:
        watcher.session.advance(watcher.session.now_s() + 0.02)
        attitude = watcher.session.latest["ATTITUDE"].message
        place = watcher.session.latest["LOCAL_POSITION_NED"].message
        tilts.append((watcher.session.now_s(), math.acos(math.cos(attitude.roll) * math.cos(attitude.pitch))))
        places.append((place.x, -place.y, -place.z))
    # Level within GUID_TIMEOUT (0.2 s) + 1 s, and inside a fence of 30 m about the zone.
    assert max(tilt for t, tilt in tilts if t > killed_s + 1.2) < 0.12
    assert max(math.hypot(x, y) for x, y, _ in places) < 30.0
    assert min(z for *_, z in places) > 0.5
    assert max(z for *_, z in places) < 18.0
    assert (run_dir / "raw.tlog").stat().st_size > 100_000
    watcher.set_mode(CopterMode.LAND)
    assert (
        watcher.session.await_message(lambda m: m.get_type() == "HEARTBEAT" and not m.base_mode & 128, 60.0) is not None
    )
    watcher.session.port.close()


def test_hard_climbs_are_flown_once_the_plan_has_the_vehicles_model(sitl, tmp_path):
    """This vehicle's thrust follows in 10 ms, not in the paper's 150: what the prior leads to, the gate refuses."""
    vehicle = load_vehicle(sitl_dir() / "paper.yaml")
    prior = predictor_for(None, vehicle)
    plan = compile_plan(parse_script(CLIMBS), vehicle, prior)
    result = fly(plan, sitl.url, tmp_path / "climbs", replanner=ScriptReplanner(plan, prior))
    assert result.outcome is FlightOutcome.COMPLETED, result
    assert {leg.leg for leg in result.legs if leg.outcome is LegOutcome.FLOWN} == {leg.id for leg in plan.legs}, (
        result.legs
    )
    assert any("planned again" in note for note in result.notes)


def test_without_satellites_every_leg_is_flown(arducopter, tmp_path):
    blind = {"GPS1_TYPE": 0.0, "EK3_SRC1_POSXY": 0.0, "EK3_SRC1_VELXY": 0.0, "FENCE_ENABLE": 0.0}
    with launch(SitlOptions(airframe="paper", speedup=SPEEDUP, parameters=blind), wait_s=0.0) as vehicle:
        vehicle.wait_ready(60.0, until=lambda state: state.heard)
        plan = make_plan(*(make_leg(name) for name in "abcd"), by="attitude")
        heights: list[float] = []
        result = fly(plan, vehicle.url, tmp_path / "blind", on_progress=lambda p: heights.append(p.height_m))
    assert result.outcome is FlightOutcome.COMPLETED, result
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN] * 4
    assert any("no position" in note for note in result.notes)
    assert 4.0 < np.nanmax(heights) < 9.0


def _fly_to_be_killed(url: str, run_dir: str, profile: str) -> None:
    watched = Watched(open_transport(url))
    watched.on_step = lambda: sys.stdout.write("step\n") and sys.stdout.flush()
    leg = make_leg(profile, PROFILES[profile], 2.5)
    fly(make_plan(leg), url, Path(run_dir), transport=watched)


if __name__ == "__main__":
    _fly_to_be_killed(*sys.argv[1:])


def test_a_lost_transmitter_is_said_at_once(sitl, tmp_path):
    """SIM_RC_FAIL 1: no pulses. What the firmware then does by its own failsafe is its own."""
    witness, said = second_link(sitl), []
    link, failed = Watched(open_transport(sitl.url)), []

    def fail() -> None:
        if not failed:
            failed.append(time.monotonic())
            message = dialect.MAVLink_param_set_message(1, 1, b"SIM_RC_FAIL", 1.0, dialect.MAV_PARAM_TYPE_REAL32)
            witness.session.send(message)

    link.on_step = fail
    try:
        result = fly(
            make_plan(make_leg("a"), make_leg("b")), sitl.url, tmp_path / "run", transport=link,
            on_progress=lambda p: said.append((time.monotonic(), p.alarm)) if p.alarm else None,
        )  # fmt: skip
    finally:
        back = dialect.MAVLink_param_set_message(1, 1, b"SIM_RC_FAIL", 0.0, dialect.MAV_PARAM_TYPE_REAL32)
        witness.session.send(back)
        witness.session.port.close()
    # The firmware lands by its own failsafe after the flight was left to it; the next test begins on the ground. A link of its own: what
    # was sent during the flight waits on the other.
    after = second_link(sitl)
    landed = after.session.await_message(lambda m: m.get_type() == "HEARTBEAT" and not is_armed(m), 180.0)
    after.session.port.close()
    assert landed is not None
    alarmed = [t for t, text in said if text == LOST]
    assert alarmed, (result.outcome, said)
    assert SPEEDUP * (alarmed[0] - failed[0]) < 1.5, "vehicle seconds"


def test_the_zones_fence_polygon_on_the_real_firmware(sitl, tmp_path):
    """Uploaded beside the operator's own fence, read back, seen on another link in flight; then the operator's alone. And it brakes."""
    witness = second_link(sitl)
    fence = Fence(witness.session)
    home = witness.request("HOME_POSITION", dialect.MAVLINK_MSG_ID_HOME_POSITION)
    assert home is not None
    lat, lon = home.latitude, home.longitude
    own = (
        FenceItem(dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 0, (4.0, 0.0, 0.0, 0.0), lat + 4000, lon),
        *polygon([(lat + dx * 10000, lon + dy * 10000) for dx, dy in ((1, 1), (1, -1), (-1, -1), (-1, 1))]),
    )
    plan = make_plan()
    plan = replace(plan, vehicle=replace(plan.vehicle, zone=replace(plan.vehicle.zone, fence="polygon")))
    aboard: list[int] = []
    try:
        fence.write(own)
        with pytest.raises(PreflightError, match="a fence of its own"):
            fly(plan, sitl.url, tmp_path / "refused")
        link = Watched(open_transport(sitl.url))
        link.on_step = lambda: aboard.append(1)
        result = fly(plan, sitl.url, tmp_path / "added", transport=link, extend_fence=True)
        assert result.outcome is FlightOutcome.COMPLETED, result.notes
        assert any("beside 5 items" in note for note in result.notes)
        assert same_fence(fence.read(), own)
        here = witness.request("GLOBAL_POSITION_INT", dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
        assert here is not None
        lat, lon = here.lat, here.lon
        half = round(1.2 / 0.0111319)  # degE7 of latitude: a box that the step leaves
        box = polygon([(lat + dx * half, lon + dy * half) for dx, dy in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
        fence.write(box)
        known = params.read_all(witness.session)
        for name, value in {"FENCE_TYPE": 4.0, "FENCE_ACTION": 4.0, "FENCE_ENABLE": 1.0}.items():
            params.write_parameter(witness.session, name, value, known)
        ZoneFence(witness, "", lambda _data: None).switch_on()
        braked = fly(make_plan(make_leg("a", fast_tilt, 2.5), make_leg("b")), sitl.url, tmp_path / "braked")
        assert braked.outcome is FlightOutcome.TAKE_OVER, braked.notes
        assert braked.mode == "BRAKE"
    finally:
        known = params.read_all(witness.session)
        params.write_parameter(witness.session, "FENCE_ENABLE", 0.0, known)
        fence.write(())
        witness.set_mode(CopterMode.LAND)
        witness.session.port.close()
