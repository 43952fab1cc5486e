import contextlib
import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flighttest.errors import FlighttestError, VehicleError
from flighttest.vehicle.load import load_components, load_vehicle, parse_vehicle
from flighttest.vehicle.model import DEFAULT_VEHICLE

# The example of design/formats.md.
FORMATS = """\
format: vehicle/1
name: hexa-1
connect: udpin:0.0.0.0:14550
firmware: ardupilot
nominal_voltage_v: 22.2
hover_throttle: 0.18
zone: {origin: home, heading_deg: 40, x_m: [-15, 15], y_m: [-7.5, 7.5], z_m: [1, 10], margin_m: 1.5}   # x along the heading
mass_kg: 2.9
rotor_height_m: 0.2                   # of the rotor plane above the landing gear's feet
components:                     # change one of these and the model is stale
  battery:    {id: B07, model: 6S 10 Ah, installed: 2026-10-02}
  propellers: {id: P03, model: 15x5 CF}
  motors:     {id: M01, model: U5 400 KV}
  payload:    {id: none}
"""


def test_the_example_of_the_formats_page():
    vehicle = parse_vehicle(FORMATS)
    assert vehicle.name == "hexa-1"
    assert vehicle.zone.heading_rad == pytest.approx(-math.radians(40))
    assert vehicle.zone.x_m == (-15.0, 15.0)
    assert vehicle.zone.origin is None
    assert vehicle.components["battery"] == {"id": "B07", "model": "6S 10 Ah", "installed": "2026-10-02"}
    assert vehicle.components["payload"]["id"] == "none"
    assert vehicle.mass_kg == 2.9


def test_the_zone_may_start_at_a_place():
    vehicle = parse_vehicle(FORMATS.replace("origin: home", "origin: [50.86, 4.68]"))
    assert vehicle.zone.origin == (50.86, 4.68)


def test_the_built_in_vehicle_is_the_papers():
    assert DEFAULT_VEHICLE.hover_throttle == pytest.approx(9.81 / 54.55, abs=2e-4)
    assert DEFAULT_VEHICLE.nominal_voltage_v == 22.2
    zone = DEFAULT_VEHICLE.zone
    assert zone.x_m[1] - zone.x_m[0] == 30.0
    assert zone.y_m[1] - zone.y_m[0] == 15.0
    assert zone.z_m[1] == 10.0


@pytest.mark.parametrize(
    ("old", "new", "line", "path", "what", "hint"),
    [
        ("hover_throttle: 0.18", "hover_throttle: 18", 6, "hover_throttle", "outside", "0 to 1"),
        ("hover_throttle: 0.18", "hover_throtle: 0.18", 6, "hover_throtle", "unknown key", "`hover_throttle`"),
        ("nominal_voltage_v: 22.2", "nominal_voltage_v: .nan", 5, "nominal_voltage_v", "not a finite", ""),
        ("firmware: ardupilot", "firmware: ardupilotx", 4, "firmware", "not one of", "`ardupilot`"),
        ("x_m: [-15, 15]", "x_m: [15, -15]", 7, "zone.x_m", "not below", "lower number first"),
        ("margin_m: 1.5", "margin_m: 8", 7, "zone.y_m", "leaves nothing", "margin_m"),
        ("origin: home", "origin: [123, 4]", 7, "zone.origin", "latitude", ""),
        ("mass_kg: 2.9", "mass_kg: heavy", 8, "mass_kg", "expected a number", ""),
        ("payload:    {id: none}", "payload: [1, 2]", 14, "components.payload", "expected a block", ""),
        ("name: hexa-1\n", "", 1, "name", "missing", "add `name:`"),
    ],
)
def test_each_mistake_is_named_with_its_place_and_remedy(old, new, line, path, what, hint):
    assert old in FORMATS
    with pytest.raises(VehicleError) as caught:
        parse_vehicle(FORMATS.replace(old, new, 1), "v.yaml")
    found = caught.value.problems
    assert any(p.line == line and p.path == path and what in p.what and hint in p.hint for p in found), str(
        caught.value
    )


def test_several_problems_at_once():
    bad = FORMATS.replace("0.18", "18").replace("ardupilot", "other").replace("2.9", "-1")
    with pytest.raises(VehicleError) as caught:
        parse_vehicle(bad)
    assert len(caught.value.problems) == 3


AMC = {
    "Format version": 1,
    "Components": {
        "Battery": {
            "Product": {"Manufacturer": "Tattu", "Model": "Plus", "URL": "https://example.org", "Version": "1"},
            "Specifications": {"Chemistry": "Lipo", "Capacity mAh": 10000, "Number of cells": 6},
            "Notes": "the blue one",
        },
        "Propellers": {"Product": {"Model": "15x5"}, "Specifications": {"Diameter_inches": 15}},
        "RC Receiver": {"Product": {"Model": "TBS"}},
    },
}


def test_methodic_configurators_components(tmp_path):
    (tmp_path / "vehicle_components.json").write_text(json.dumps(AMC))
    text = FORMATS[: FORMATS.index("components:")] + "components: vehicle_components.json\n"
    (tmp_path / "vehicle.yaml").write_text(text)
    components = load_vehicle(tmp_path / "vehicle.yaml").components
    assert set(components) == {"battery", "propellers"}  # what cannot change the dynamics is left out
    assert components["battery"]["specifications.capacity_mah"] == 10000
    assert "product.url" not in components["battery"]
    assert "notes" not in components["battery"]
    assert components["propellers"]["specifications.diameter_inches"] == 15


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"Components": 3}'])
def test_a_bad_components_file_is_a_problem_of_the_vehicle_file(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(VehicleError):
        load_components(tmp_path / "c.json")
    (tmp_path / "v.yaml").write_text(FORMATS[: FORMATS.index("components:")] + "components: c.json\n")
    with pytest.raises(VehicleError) as caught:
        load_vehicle(tmp_path / "v.yaml")
    assert caught.value.problems[0].path == "components"


@given(st.integers(0, len(FORMATS) - 1), st.text(max_size=3), st.integers(0, 6))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_no_slip_of_the_pen_gives_a_traceback(at, typed, removed):
    with contextlib.suppress(FlighttestError):  # anything else is a traceback
        parse_vehicle(FORMATS[:at] + typed + FORMATS[at + removed :])
