"""Declared changes: every component and shaping parameter is flagged, harmless differences are not, the unknown is called unknown."""

import copy

import numpy as np
import pytest

from flighttest.validity.assess import assess
from flighttest.validity.compare import Estimates
from flighttest.validity.declared import declared_changes, touched
from flighttest.validity.model import ALL_SCRIPTS, ValidityVerdict

FINGERPRINT = {
    "components": {
        "battery": {"id": "B07", "model": "6S 10 Ah", "installed": "2026-10-02"},
        "propellers": {"id": "P03", "model": "15x5 CF"},
        "motors": {"id": "M01"},
        "payload": {"id": "none"},
        "gimbal": {"id": "G1"},
    },
    "firmware": "ArduCopter V4.6.3 (abc123)",
    "nominal_voltage_v": 22.2,
    "frame": "hexa x",
    "shaping_parameters": {
        "ATC_RAT_RLL_P": 0.135,
        "ATC_RAT_YAW_P": 0.18,
        "MOT_SPIN_MIN": 0.15,
        "INS_ACCEL_FILTER": 20.0,
        "ATC_ANGLE_BOOST": 1.0,
    },
}


def changed(path, value):
    after = copy.deepcopy(FINGERPRINT)
    place = after
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return after


def test_the_same_vehicle_is_the_same():
    assert declared_changes(FINGERPRINT, copy.deepcopy(FINGERPRINT)) == ((), ())


@pytest.mark.parametrize("component", list(FINGERPRINT["components"]))
def test_every_component_is_flagged_and_the_paper_s_rule_flies_all(component):
    changes, _ = declared_changes(FINGERPRINT, changed(("components", component, "id"), "new"))
    assert [c.name for c in changes] == [component]
    assert changes[0].scripts == ALL_SCRIPTS
    assert set(changes[0].narrower) <= set(ALL_SCRIPTS)


@pytest.mark.parametrize("parameter", list(FINGERPRINT["shaping_parameters"]))
def test_every_shaping_parameter_is_flagged(parameter):
    value = FINGERPRINT["shaping_parameters"][parameter]
    changes, _ = declared_changes(FINGERPRINT, changed(("shaping_parameters", parameter), value * 1.2))
    assert [c.name for c in changes] == [parameter]


def test_firmware_voltage_and_frame_touch_everything():
    for path, value in ((("firmware",), "ArduCopter V4.7.0"), (("nominal_voltage_v",), 14.8), (("frame",), "quad x")):
        (change,), _ = declared_changes(FINGERPRINT, changed(path, value))
        assert change.narrower == ALL_SCRIPTS


def test_a_battery_offers_the_thrust_script_alone_with_its_reason():
    (change,), _ = declared_changes(FINGERPRINT, changed(("components", "battery", "id"), "B08"))
    assert change.narrower == ("thrust",)
    assert change.because


def test_when_it_was_put_in_is_said_but_is_no_change_by_itself():
    assert declared_changes(FINGERPRINT, changed(("components", "battery", "installed"), "2026-11-01"))[0] == ()
    after = changed(("components", "battery", "id"), "B08")
    after["components"]["battery"]["installed"] = "2026-11-01"
    assert declared_changes(FINGERPRINT, after)[0][0].since == "2026-11-01"


def test_single_precision_is_no_change():
    assert declared_changes(FINGERPRINT, changed(("shaping_parameters", "ATC_RAT_RLL_P"), 0.13500000536441803))[0] == ()


def test_what_is_not_declared_is_unknown_not_changed():
    after = copy.deepcopy(FINGERPRINT)
    del after["components"]["motors"]
    changes, unknown = declared_changes(FINGERPRINT, after)
    assert changes == ()
    assert any("motors" in sentence for sentence in unknown)
    changes, unknown = declared_changes({}, FINGERPRINT)
    assert changes == ()
    assert unknown


def test_a_list_of_a_few_parameters_is_no_change_of_the_others():
    """A telemetry log holds the parameters that somebody asked for while it ran."""
    whole = {"shaping_parameters": {f"MOT_{i}": float(i) for i in range(30)}}
    few = {"shaping_parameters": {"MOT_1": 1.0, "MOT_2": 7.0}}
    for before, after, whose in ((whole, few, "today's vehicle"), (few, whole, "the model's flight")):
        changes, unknown = declared_changes(before, after)
        assert [c.name for c in changes] == ["MOT_2"]
        assert any(f"28 of 30 parameters that shape the response are not known of {whose}" in u for u in unknown)
    less = {"shaping_parameters": {k: v for k, v in whole["shaping_parameters"].items() if k != "MOT_3"}}
    assert [(c.name, c.after) for c in declared_changes(whole, less)[0]] == [("MOT_3", "absent")]


def test_a_vehicle_file_that_names_only_the_autopilot_is_no_change_of_firmware():
    assert declared_changes(FINGERPRINT, changed(("firmware",), "ardupilot"))[0] == ()


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("4.7.0-dev (90700977)", "ArduCopter V4.7.0-dev (90700977)", True),
        ("ArduCopter V4.6.3", "ArduCopter V4.6.3 (abc12345)", True),
        ("ArduCopter V4.6.3 (abc12345)", "ArduCopter V4.6.3 (def67890)", False),
        ("ArduCopter V4.6.2", "ArduCopter V4.6.3", False),
        ("4.7.0-dev", "4.7.0", False),
    ],
)
def test_firmware_is_compared_by_version_and_hash(old, new, same):
    changes, _ = declared_changes({"firmware": old}, {"firmware": new})
    assert (changes == ()) is same


def test_renamed_parameters_are_not_reported_twice():
    before = {**FINGERPRINT, "shaping_parameters": {"ATC_ACCEL_R_MAX": 110000.0}}
    after = {**FINGERPRINT, "shaping_parameters": {"ATC_ACC_R_MAX": 1100.0}}
    assert declared_changes(before, after)[0] == ()


@pytest.mark.parametrize(
    ("name", "subset"),
    [
        ("ATC_RAT_YAW_P", "yaw"),
        ("ATC_RAT_RLL_D", "attitude"),
        ("MOT_SPIN_MIN", "thrust"),
        ("INS_ACCEL_FILTER", "thrust"),
        ("FRAME_CLASS", "drag"),
    ],
)
def test_what_a_parameter_touches(name, subset):
    assert subset in touched(name)


def test_another_mass_is_flagged_with_what_it_does():
    before, after = {**FINGERPRINT, "mass_kg": 2.9}, {**FINGERPRINT, "mass_kg": 3.132}
    (change,), _ = declared_changes(before, after)
    assert (change.kind, change.before, change.after) == ("mass", "2.9 kg", "3.132 kg")
    assert "0.926" in change.because
    assert declared_changes({**FINGERPRINT}, after)[0] == (), "never declared before: unknown, not changed"


def test_the_same_parts_are_current_though_the_parameters_are_unknown():
    base = Estimates("model", (), np.zeros(0), np.zeros((0, 0)))
    today = {key: FINGERPRINT[key] for key in ("components", "firmware")}
    found = assess(model_fingerprint=FINGERPRINT, vehicle_fingerprint=today, stored=base)
    assert found.verdict is ValidityVerdict.CURRENT
    assert "could not be compared" in found.sentence
    assert any("parameters" in line for line in found.cannot_tell)
    fewer = {**today, "components": {"battery": FINGERPRINT["components"]["battery"]}}
    found = assess(model_fingerprint=FINGERPRINT, vehicle_fingerprint=fewer, stored=base)
    assert found.verdict is ValidityVerdict.UNKNOWN, "four parts are declared on one side only"
