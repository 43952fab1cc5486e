"""MAVLink 2 signing: what is not signed with the key is refused, on either side; a false frame ends no link."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from flighttest.errors import InputError, LinkError
from flighttest.flight import FlightOutcome
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import Message, dialect, parser
from flighttest.mavlink.signing import SignedLink, make_key, read_key, setup_message, ticks
from flighttest.pipeline.vehicles import live
from flighttest.sim import InProcess, SimOptions, start_simulator
from tests.flight.faulty import FaultyLink, fly, make_plan, options

KEY = bytes(range(32))
OTHER = bytes(range(1, 33))


def attitude() -> Message:
    return dialect.MAVLink_attitude_message(5, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


def heard(link: SignedLink, frame: bytes) -> bool:
    return [m.get_type() for m in link.parse_buffer(frame) or []] == ["ATTITUDE"]


def test_only_what_is_signed_with_the_key_is_taken() -> None:
    ours, theirs, other = SignedLink(245, 191, KEY), SignedLink(1, 1, KEY), SignedLink(1, 1, OTHER)
    frame = bytes(attitude().pack(theirs))
    assert not heard(ours, bytes(attitude().pack(parser(1, 1)))), "unsigned"
    assert not heard(ours, bytes(attitude().pack(other))), "another key"
    assert heard(ours, frame)
    assert not heard(ours, frame), "played again"
    assert not heard(ours, frame[:-1] + bytes([frame[-1] ^ 1])), "changed"
    assert ours.refused == 4


def test_a_false_frame_from_the_future_ends_no_link() -> None:
    ours, theirs, forger = SignedLink(245, 191, KEY), SignedLink(1, 1, KEY), SignedLink(1, 1, OTHER)
    forger.signing.timestamp = ticks(4e9)
    assert not heard(ours, bytes(attitude().pack(forger)))
    assert heard(ours, bytes(attitude().pack(theirs)))


def test_a_key_is_made_for_its_owner_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "hexa.key"
    key = make_key(path)
    assert read_key(path) == key
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(InputError, match="cannot be written"):
        make_key(path)
    for text in ("", "abc", "00" * 32, "zz" * 32):
        path.write_text(text)
        with pytest.raises(InputError, match="not a signing key"):
            read_key(path)


@pytest.mark.slow
def test_a_signed_flight_is_flown_and_frames_without_the_key_change_nothing(run_dir: Path) -> None:
    link = FaultyLink(options(signing_key=KEY.hex()))
    unsigned = parser(245, 191)

    def send_unsigned(message: object, _now: float) -> None:
        if message.get_type() != "HEARTBEAT":  # type: ignore[attr-defined]
            return
        mode = (dialect.MAV_CMD_DO_SET_MODE, 0, 1.0, float(CopterMode.LOITER), 0, 0, 0, 0, 0)
        link.sim.send(bytes(dialect.MAVLink_command_long_message(1, 1, *mode).pack(unsigned)))
        link._aside = bytes(dialect.MAVLink_heartbeat_message(2, 3, 81, 5, 4, 3).pack(parser(1, 1)))

    link.hook = send_unsigned
    result = fly(make_plan(), "sim", run_dir, transport=link, signing_key=KEY)
    assert result.outcome is FlightOutcome.COMPLETED, result
    assert any("not signed with the key" in note for note in result.notes)
    assert not link.sim.vehicle.armed
    assert (run_dir / "channels").is_dir(), "a signed record is decoded"


@pytest.mark.parametrize(
    ("vehicle", "ours", "words"),
    [
        ("", KEY, "none was signed with this key"),
        (KEY.hex(), None, "signs what it sends"),
        (KEY.hex(), OTHER, "none was"),
    ],
)
def test_a_key_on_one_side_only_is_said(vehicle: str, ours: bytes | None, words: str) -> None:
    session = Session(MavlinkPort(FreeRunning(vehicle), key=ours))
    with pytest.raises(LinkError, match=words):
        session.connect(0.3)


class FreeRunning(FaultyLink):
    """The built-in vehicle, a hundredth of a second further at each look."""

    def __init__(self, key: str) -> None:
        super().__init__(options(signing_key=key))
        self.sim = InProcess(type(self.sim.options)(signing_key=key))

    def receive(self, timeout_s: float) -> bytes:
        self.sim.advance(0.01)
        return super().receive(timeout_s)


def test_the_vehicle_takes_a_key_and_gives_it_back() -> None:
    link = FreeRunning("")
    signing = link.sim.vehicle.encoder.signing
    link.send(bytes(setup_message(1, 1, KEY).pack(parser(245, 191))))
    assert signing.key == KEY
    link.send(bytes(setup_message(1, 1, bytes(32)).pack(parser(245, 191))))
    assert signing.key == KEY, "an unsigned request takes no key away"
    ours = SignedLink(245, 191, KEY)
    link.send(bytes(setup_message(1, 1, bytes(32)).pack(ours)))
    assert signing.key == b""


@pytest.mark.slow
def test_status_reads_a_vehicle_that_signs_with_its_key_only(tmp_path: Path) -> None:
    path = tmp_path / "hexa.key"
    key = make_key(path)
    (tmp_path / "vehicle.yaml").write_text("format: vehicle/1\nname: hexa\nsigning_key: hexa.key\n")
    with start_simulator(SimOptions(signing_key=key.hex(), speed=10.0), in_thread=True) as simulation:
        for named, vehicle in ((path, None), (None, tmp_path / "vehicle.yaml")):
            assert "GUID_OPTIONS" in live.read_vehicle(simulation.url, key=live.key_for(named, vehicle)).parameters
        with pytest.raises(LinkError, match="signs what it sends"):
            live.read_vehicle(simulation.url)
