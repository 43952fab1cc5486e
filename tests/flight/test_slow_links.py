"""Links that carry little: message rates are fitted to them, by what a serial port declares or by what arrives."""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from unittest import mock

import pytest

from flighttest.flight import FlightOutcome, LegOutcome, fly
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.preparation.preflight import BLIND_RATES_HZ, RATES_HZ
from flighttest.flight.preparation.rates import bytes_s, declared_bytes_s, fitted
from flighttest.mavlink.dialect import parser
from flighttest.recording.store import open_run, read_events, read_manifest
from flighttest.sim import SimOptions
from tests.faults.proxy import Fault, Proxy, When
from tests.flight.faulty import GATE, GOOD, FaultyLink, make_leg, make_plan, options

WAITING_BYTES = 1024  # of a vehicle's serial port; what does not fit in is dropped


@dataclass
class SlowLink(FaultyLink):
    """A vehicle behind a serial line. bytes_s: what it carries; loss: share of frames that a radio loses, 0..1."""

    bytes_s: float = 5760.0
    loss: float = 0.0
    dropped: int = 0
    _waiting: float = 0.0
    _then_s: float = 0.0
    _chance: random.Random = field(default_factory=lambda: random.Random(1))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._line = parser(1, 1)

    def receive(self, timeout_s: float) -> bytes:
        data = super().receive(timeout_s)
        passed = []
        for message in self._line.parse_buffer(data) or []:
            frame = bytes(message.get_msgbuf())
            if message.get_type() == "SYSTEM_TIME":
                # What is sent between two ends of a step is sent evenly in it.
                now = self.sim.time_s
                self._waiting = max(self._waiting - self.bytes_s * (now - self._then_s), 0.0)
                self._then_s = now
            elif self._waiting + len(frame) > WAITING_BYTES:
                self.dropped += 1
                continue
            else:
                self._waiting += len(frame)
                if self._chance.random() < self.loss:
                    continue
            passed.append(frame)
        return b"".join(passed)


@pytest.mark.parametrize(
    ("url", "bytes_per_s", "loss"),
    [
        ("serial:/dev/ttyUSB0:57600", 5760.0, 0.05),
        ("serial:/dev/ttyUSB0:115200", 11520.0, 0.0),
        ("udpin:0.0.0.0:14550", 5760.0, 0.0),
    ],
    ids=["radio", "115200", "unknown"],
)
def test_a_slow_link_flies_with_fewer_messages(run_dir: Path, url: str, bytes_per_s: float, loss: float) -> None:
    link = SlowLink(options(), bytes_s=bytes_per_s, loss=loss)
    plan = make_plan(make_leg("roll+0.30"), make_leg("roll+0.31"))
    result = fly(plan, url, run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN] * 2
    assert any("messages are asked for less often" in note for note in result.notes)
    rates = read_manifest(run_dir)["rates_hz"]
    assert rates["ATTITUDE"] >= 40.0
    assert rates["BATTERY_STATUS"] >= 1.5
    assert link.sim.time_s < 120.0, "no wait for what a full link drops"
    t_s = open_run(run_dir).series["attitude"].t_s
    assert len(t_s) > 0.75 * 40.0 * (t_s[-1] - t_s[0])


def test_rates_fit_into_what_a_link_carries() -> None:
    for wanted in (RATES_HZ, RATES_HZ | BLIND_RATES_HZ):
        assert fitted(wanted, None) == wanted
        assert fitted(wanted, 1e6) == wanted
        for capacity in (6500.0, 9000.0, 11520.0, 15000.0):
            rates = fitted(wanted, capacity)
            assert bytes_s(rates) <= 0.86 * capacity
            assert all(0.0 < rates[name] <= wanted[name] for name in wanted)
        assert fitted(wanted, 100.0) == fitted(wanted, 0.0), (
            "no less than a flight needs: preflight will say what is missing"
        )
    assert bytes_s(fitted(RATES_HZ, 5760.0)) <= 0.86 * 5760.0
    assert declared_bytes_s("serial:/dev/ttyACM0:57600") == 5760.0
    assert declared_bytes_s("tcp:127.0.0.1:5760") is None


@pytest.mark.slow
def test_a_link_that_slows_down_in_flight_is_asked_for_less_and_later_for_all_again(tmp_path: Path) -> None:
    """At 5760 bytes/s HEARTBEAT is lost among what does not fit: without fewer messages the flight ends as if the link were gone."""
    fault = Fault("5760 bytes/s", 12.0, bytes_per_s=5760.0)
    proxy = Proxy(SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0), fault, When.FLYING)
    plan = make_plan(*(make_leg(f"s{k}") for k in range(7)))
    result = fly(plan, "proxy", tmp_path / "run", transport=proxy, clock=proxy.clock())  # type: ignore[arg-type]
    labels = [e.label for e in read_events(result.run_dir)[0] if e.kind == "note"]
    assert (result.outcome.name, result.left.name) == ("COMPLETED", "LANDED")
    less = next(k for k, text in enumerate(labels) if text.startswith("the link carries less"))
    assert any(text.startswith("the link carries what is asked for") for text in labels[less:])
    assert sum(text.startswith("asked again") for text in labels) <= 12


@pytest.mark.parametrize(("unanswered_s", "fed_back"), [(0.0, True), (0.28, True), (0.32, False)])
def test_a_climb_is_not_fed_back_over_a_link_that_takes_too_long(unanswered_s: float, fed_back: bool) -> None:
    """With a second of delay that swung the vehicle between 1 and 6 m, and on the ground."""
    control = FlightControl.__new__(FlightControl)
    control.session = mock.Mock(**{"clock.pace": 1.0})
    control.gate, control.hover_throttle = GATE, GATE.hover_throttle
    control.state = replace(GOOD, climb_m_s=0.4, silence_s=0.0, uplink_silence_s=unanswered_s)
    assert (control.release_target().throttle < GATE.hover_throttle) is fed_back


@pytest.mark.slow
def test_a_link_of_lasting_latency_does_not_leave_the_vehicle_level_for_long(tmp_path: Path) -> None:
    """Seen: answers that are late for as long as they come kept a flown step from its end, and level targets do not hold the height: from
    5 m the vehicle sank to the ground."""
    late = Fault("300 ms latency", 300.0, latency_s=0.3)
    proxy = Proxy(SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0), late, When.FLYING)
    result = fly(
        make_plan(make_leg("a"), make_leg("b")), "proxy", tmp_path / "run", transport=proxy, clock=proxy.clock()
    )
    assert result.outcome is FlightOutcome.COMPLETED
    assert [leg.outcome for leg in result.legs][-2:] == [
        LegOutcome.FLOWN
    ] * 2  # the one in which it begins is flown again
    phases = [m for m in read_events(tmp_path / "run")[0] if m.kind == "phase"]
    for coast, end in ((m, n) for m, n in pairwise(phases) if m.label == "coast"):
        assert end.label == "end"
        assert end.t_s - coast.t_s < make_leg().phases[-1].end_s - make_leg().phases[-1].start_s + 2.0
