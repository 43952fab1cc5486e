"""The dangerous cells on a real ArduCopter: the same faults, between this program and its SITL, in real time."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from flighttest.link import parameters
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import Transport, open_transport
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect
from flighttest.sim.sitl.launcher import Sitl
from tests.faults.cells import FAULTS, Cell, judge
from tests.faults.proxy import EPOCH_S, Fault, Proxy, When
from tests.flight.faulty import fly, make_leg, make_plan

DANGEROUS: tuple[tuple[str, When], ...] = (
    ("nothing", When.LANDING),
    *(("down 3.2 s", when) for when in (When.ENTERING, When.RETURNING, When.ARMING, When.CLIMBING)),
    *(("down 5.5 s", when) for when in (When.RETURNING, When.FLYING, When.ABORTING)),
    *(("down for good", when) for when in (When.FLYING, When.LANDING)),
    *(("up 3.2 s", when) for when in (When.ENTERING, When.FLYING, When.ARMING)),
    *(("up for good", when) for when in (When.FLYING, When.RETURNING)),
    *(("both 3.2 s", when) for when in (When.ENTERING, When.FLYING, When.CLIMBING, When.ABORTING)),
    *(("both for good", when) for when in (When.FLYING, When.LANDING)),
    *(("20 % lost", when) for when in (When.PREFLIGHT, When.ARMING, When.FLYING)),
    *(("one bit in 10 % of the frames", when) for when in (When.ARMING, When.FLYING)),
    ("stall 4 s, then all", When.FLYING),
    ("client frozen 4 s", When.FLYING),
    ("client frozen 4 s", When.RETURNING),
    ("client frozen 65 s", When.FLYING),
    ("clock leaps a day", When.FLYING),
    ("one false mode", When.FLYING),
    ("one false disarmed", When.FLYING),
    ("second vehicle", When.FLYING),
    ("streams switched off", When.FLYING),
    ("Ctrl-C", When.CLIMBING),
    ("Ctrl-C twice", When.FLYING),
    ("disk full", When.FLYING),
    *(("pilot", when) for when in (When.CLIMBING, When.RETURNING, When.ENTERING, When.FLYING, When.ABORTING)),
    *(("pilot brakes", when) for when in (When.RETURNING, When.ENTERING, When.FLYING, When.LANDING)),
    ("pilot while down 3.2 s", When.ENTERING),
    ("pilot while down 3.2 s", When.FLYING),
    ("pilot while up 15 s", When.FLYING),
    *(("pilot while 300 ms latency", when) for when in (When.ENTERING, When.RETURNING, When.FLYING)),
)
"""What left a vehicle armed in the air, or was called an unseen landing, and what a pilot does meanwhile."""

_DOWN_S = 90.0
_PACK, _OTHER_V = "SIM_BATT_VOLTAGE", 0.01  # SITL's pack is full again where this changes


class LiveProxy(Proxy):
    """Between a flight and a vehicle that is elsewhere. speed: vehicle seconds per second; others reach the vehicle by a link of theirs."""

    inner: Transport
    witness: ArduPilot
    speed: float = 1.0

    def __post_init__(self) -> None:
        """No vehicle of its own."""
        self._began_host_s = time.monotonic()
        self._prepare()

    def _now(self) -> None:
        self.now_s = EPOCH_S + self.speed * (time.monotonic() - self._began_host_s)

    def _to_vehicle(self, data: bytes) -> None:
        self.inner.send(data)  # rates are of a link: another station changes this one's behind the same router

    def _switch(self) -> None:
        self.witness.ask_mode(self.fault.pilot_mode)

    def _reboot(self) -> None:
        raise NotImplementedError("a SITL that starts anew loses its links")

    def _pass(self, span_s: float) -> None:
        """Let time pass as it does, and move what is due."""
        end_s = self.now_s + span_s
        while True:
            self._now()
            self._act()
            due = self._arrived(self._up)
            if due:
                self.inner.send(due)
            said = self.inner.receive(min(0.002, max(end_s - self.now_s, 0.0) / self.speed))
            for message in (self._theirs.parse_buffer(said) or []) if said else []:
                self._queue(self._down, self._altered(message), lost=self.fault.down)
            self._send_as_twin()
            self.witness.session.advance(self.witness.session.now_s())
            self._now()
            if self.now_s >= end_s or self._down:
                return

    def _freeze(self) -> None:
        time.sleep(self.fault.freeze_s / self.speed)

    def close(self) -> None:
        """Give the link back."""
        self.inner.close()


def witness_of(sitl: Sitl) -> ArduPilot:
    """Another link to the vehicle: the pilot's, and the truth."""
    session = Session(MavlinkPort(open_transport(f"tcp:127.0.0.1:{sitl.base_port + 2}"), system=255, component=190))
    session.connect()
    session.clock.keep_real_time()
    vehicle = ArduPilot(session)
    vehicle.set_rates({"EXTENDED_SYS_STATE": 5.0, "HEARTBEAT": 5.0})
    return vehicle


class Truth:
    """What the vehicle is, by the witness."""

    def __init__(self, witness: ArduPilot) -> None:
        self._witness = witness
        witness.session.advance(witness.session.now_s() + 1.0)

    @property
    def armed(self) -> bool:
        """Whether it is armed."""
        return self._witness.armed

    @property
    def mode(self) -> int:
        """Its mode."""
        return self._witness.mode

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        heard = self._witness.session.latest.get("EXTENDED_SYS_STATE")
        return heard is not None and heard.message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND


def fly_live(sitl: Sitl, name: str, when: When, speed: float = 1.0) -> tuple[Cell, bool]:
    """One cell, and whether the vehicle stands disarmed afterwards."""
    fault: Fault = next(f for f in FAULTS if f.name == name)
    witness = witness_of(sitl)
    _full_pack(witness)
    proxy = LiveProxy.__new__(LiveProxy)
    proxy.inner, proxy.witness, proxy.speed = open_transport(sitl.url), witness, speed
    Proxy.__init__(proxy, None, fault, when, after_s=0.05 if when is When.FLYING else 0.0)  # type: ignore[arg-type]
    try:
        with tempfile.TemporaryDirectory() as folder:
            plan = make_plan(make_leg("a"), make_leg("b"))
            run = Path(folder) / "run"
            cell = judge(
                proxy,
                lambda stops: fly(plan, sitl.url, run, transport=proxy, stop_requested=stops),
                lambda: Truth(witness),
            )
        proxy.close()
        return cell, _bring_down(witness)
    finally:
        proxy.close()
        witness.session.port.close()


def _bring_down(witness: ArduPilot) -> bool:
    session = witness.session
    session.advance(session.now_s() + 1.0)
    deadline = session.now_s() + _DOWN_S
    while witness.armed and session.now_s() < deadline:
        witness.ask_mode(CopterMode.LAND)
        session.advance(session.now_s() + 1.0)
    return not witness.armed


def _full_pack(witness: ArduPilot) -> None:
    """What the flights before have taken would end this one."""
    volt = parameters.read_parameter(witness.session, _PACK)
    assert volt is not None
    tenths = round(volt, 1)
    parameters.write_parameter(
        witness.session, _PACK, tenths if abs(volt - tenths) > 0.5 * _OTHER_V else tenths - _OTHER_V, {_PACK: volt}
    )
    witness.session.advance(witness.session.now_s() + 3.0)
