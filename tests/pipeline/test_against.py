"""`diagnose REAL... --against SIMULATED...`, from files to words."""

import json
from types import SimpleNamespace

import pytest

from flighttest.cli.main import call
from flighttest.diagnose import Verdict
from flighttest.errors import InputError
from flighttest.pipeline.diagnosis import against
from flighttest.pipeline.identification.fitting import base_model
from flighttest.recording import Provenance, Recording


@pytest.fixture
def _nothing_found(monkeypatch):
    """The search for terms is tested elsewhere: here it finds none."""

    def no_search(segments, recordings, stored, vehicle, progress, weather):
        model = base_model(recordings, vehicle)
        return SimpleNamespace(
            model=model,
            values=model.start(),
            accepted=(),
            untestable=(),
            noise_floor={},
            sentence="-",
            verdict=Verdict.NOTHING_MISSING,
        )

    monkeypatch.setattr(against, "run_diagnosis", no_search)


@pytest.mark.slow
@pytest.mark.usefixtures("_nothing_found")
def test_a_simulator_with_too_much_thrust_is_reported_and_corrected(
    flight_csv, worn_csv, throttle_steps, tmp_path, capsys
):
    real, simulated = throttle_steps(worn_csv), throttle_steps(flight_csv)
    code = call(["diagnose", str(real), "--against", str(simulated), "-o", str(tmp_path / "out")])
    assert code == 0
    assert "The simulator has K with another value." in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "against.json").read_text())
    (k,) = [p for p in found["parameters"] if p["differs"]]
    assert k["difference"] / k["simulated"] == pytest.approx(-0.06, abs=0.01)
    up = found["prediction"]["f_z_m_s2"]
    assert up["before"] > 1.5 * up["after"]
    assert up["after"] == pytest.approx(up["fitted"], rel=0.02)


def test_one_recording_cannot_be_on_both_sides(flight_csv):
    with pytest.raises(InputError, match="on both sides"):
        against.against([flight_csv], [flight_csv])


def test_two_vehicles_are_not_one_side():
    recordings = [Recording(n, {}, (), Provenance("x", "table", vehicle={"name": n})) for n in ("a", "b")]
    with pytest.raises(InputError, match="a is of vehicle a and b of b"):
        against.of_one_vehicle(recordings)


def board(name, number, vehicle=""):
    named = {"name": vehicle} if vehicle else {}
    return Recording(name, {}, (), Provenance("x", "table", vehicle=named, autopilot=number))


@pytest.mark.parametrize(
    ("other", "two"),
    [
        (board("b", "99"), True),
        (board("b", "", "rotor"), True),
        (board("b", "77", "heron"), False),  # its vehicle file was given for one of the flights only
        (board("b", "77"), False),
        (board("b", ""), False),
    ],
)
def test_an_unnamed_recording_is_of_its_autopilots_vehicle(other, two):
    """A flight of a named vehicle and one of another autopilot without a vehicle file were fitted in one model."""
    recordings = [board("a", "77"), other]
    if two:
        with pytest.raises(InputError, match="a is of vehicle autopilot 77 and b of"):
            against.of_one_vehicle(recordings)
    else:
        against.of_one_vehicle(recordings)
