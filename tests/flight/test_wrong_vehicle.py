"""A vehicle that is no multirotor, or no ArduPilot, is refused by its first HEARTBEAT: nothing is asked of it, nothing set."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from unittest import mock

import pytest

from flighttest.errors import FlighttestError, LinkError, PreflightError
from flighttest.mavlink.dialect import dialect, parser
from flighttest.mavlink.signing import make_key
from flighttest.pipeline.flights.fetching import fetch_log, refuse_unreadable
from flighttest.pipeline.vehicles.live import hello, read_vehicle
from flighttest.pipeline.vehicles.signing import sign
from flighttest.sim import SimOptions, start_simulator
from tests.flight.faulty import FaultyLink, fly, make_plan, options

OTHERS = [
    (dialect.MAV_TYPE_FIXED_WING, "a fixed-wing aircraft"),
    (dialect.MAV_TYPE_GROUND_ROVER, "a rover"),
    (dialect.MAV_TYPE_SURFACE_BOAT, "a boat"),
    (dialect.MAV_TYPE_SUBMARINE, "a submarine"),
    (dialect.MAV_TYPE_AIRSHIP, "an airship"),
    (dialect.MAV_TYPE_VTOL_QUADROTOR, "a VTOL aircraft"),
]


class OtherLink(FaultyLink):
    """The built-in vehicle with another type, and another autopilot, in its HEARTBEATs."""

    mav_type = dialect.MAV_TYPE_QUADROTOR
    autopilot = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA

    def receive(self, timeout_s: float) -> bytes:
        reader, data = parser(1, 1), b""
        for message in reader.parse_buffer(super().receive(timeout_s)) or []:
            if message.get_type() == "HEARTBEAT":
                message.type, message.autopilot = self.mav_type, self.autopilot
                writer = parser(1, 1)
                writer.seq = message.get_seq()
                data += bytes(message.pack(writer))
            else:
                data += bytes(message.get_msgbuf())
        return data


def other(mav_type: int, autopilot: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA) -> OtherLink:
    link = OtherLink(options(parameters={"GUID_OPTIONS": 0.0}))
    link.mav_type, link.autopilot = mav_type, autopilot
    return link


def refused(link: OtherLink, run_dir: Path, *waived: str) -> FlighttestError:
    """The error of a flight on it; nothing but what every link carries was sent."""
    with pytest.raises(FlighttestError) as caught:
        fly(make_plan(), "sim", run_dir, transport=link, set_params=True, waive=waived)
    assert {kind for _, kind in link.sent} <= {"HEARTBEAT", "TIMESYNC"}
    return caught.value


@pytest.mark.parametrize(("mav_type", "kind"), OTHERS)
def test_another_kind_of_vehicle_is_not_flown_even_where_its_frame_is_waived(
    mav_type: int, kind: str, run_dir: Path
) -> None:
    """A rover's parameters were read, its message rates set, and then "not a multirotor" could be waived: it was to be armed in HOLD."""
    error = refused(other(mav_type), run_dir, "frame")
    assert isinstance(error, LinkError)
    assert f"the vehicle is {kind} (type {mav_type} in its HEARTBEAT)" in error.message
    assert error.exit_code == 1


@pytest.mark.parametrize(
    ("mav_type", "kind"),
    [(dialect.MAV_TYPE_HELICOPTER, "a helicopter"), (dialect.MAV_TYPE_GENERIC, "of a kind that is")],
)
def test_another_frame_of_the_firmware_can_be_waived(mav_type: int, kind: str, run_dir: Path) -> None:
    error = refused(other(mav_type), run_dir)
    assert isinstance(error, PreflightError)
    (refusal,) = error.refusals
    assert refusal[0].startswith(f"frame: the vehicle is {kind}")
    assert refusal[0].endswith("not a multirotor")


def test_another_autopilot_is_refused_likewise(run_dir: Path) -> None:
    error = refused(other(dialect.MAV_TYPE_HEXAROTOR, dialect.MAV_AUTOPILOT_PX4), run_dir)
    assert "not ArduPilot" in error.message


def asks_for_nothing(
    opened_by: str, ask: Callable[[str], object], mav_type: int, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command that opens its link in a module refuses such a vehicle by its name, and has sent it nothing but what every link carries."""
    link = other(mav_type)
    monkeypatch.setattr(f"{opened_by}.open_transport", lambda _url: link)
    with pytest.raises(LinkError, match=kind):
        ask("tcp:127.0.0.1:1")
    assert {message for _, message in link.sent} <= {"HEARTBEAT", "TIMESYNC"}


@pytest.mark.parametrize("ask", [read_vehicle, hello])
@pytest.mark.parametrize(("mav_type", "kind"), [*OTHERS, (dialect.MAV_TYPE_HELICOPTER, "a helicopter")])
def test_status_and_doctor_do_not_call_it_arducopter(
    ask: object, mav_type: int, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`doctor` said of a rover: "ok ArduCopter 4.7.0-dev"."""
    asks_for_nothing("flighttest.pipeline.vehicles.live", ask, mav_type, kind, monkeypatch)  # type: ignore[arg-type]


@pytest.mark.parametrize(("mav_type", "kind"), OTHERS[1:5])
def test_no_log_is_downloaded_that_no_import_takes(
    mav_type: int, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rover's log was downloaded for minutes, and refused then."""
    run = tmp_path / "run"
    asks_for_nothing("flighttest.link.onboard.logs", lambda url: fetch_log(url, run), mav_type, kind, monkeypatch)
    assert not run.exists()


@pytest.mark.parametrize("quadplane", [False, True])
def test_a_quadplanes_log_is_downloaded(quadplane: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flighttest.pipeline.flights.fetching.read_parameter", lambda _s, _name: float(quadplane))
    beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_FIXED_WING, 3, 0, 0, 0, 3)
    with nullcontext() if quadplane else pytest.raises(LinkError, match="a fixed-wing aircraft"):
        refuse_unreadable(mock.Mock(), beat)


@pytest.mark.parametrize(("mav_type", "kind"), [*OTHERS, (dialect.MAV_TYPE_HELICOPTER, "a helicopter")])
def test_another_kind_of_vehicle_gets_no_key(
    mav_type: int, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An aeroplane took the key, and answered its own ground station no more."""
    key = tmp_path / "key"
    asks_for_nothing("flighttest.pipeline.vehicles.signing", lambda url: sign(url, key), mav_type, kind, monkeypatch)
    assert not key.exists()


def test_a_key_is_taken_away_from_any_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has the key was given it, and is to be had back."""
    monkeypatch.setattr("flighttest.flight.preparation.preflight.vehicle_kind", lambda _type: "a rover")
    key = make_key(tmp_path / "key")
    with start_simulator(SimOptions(speed=10.0, signing_key=key.hex()), in_thread=True) as vehicle:
        assert sign(vehicle.url, tmp_path / "key", remove=True).data["signs"] is False
        with pytest.raises(LinkError, match="a rover"):
            sign(vehicle.url, tmp_path / "another")
