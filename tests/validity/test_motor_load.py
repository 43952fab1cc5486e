"""How the motors share the load: false alarms as stated, what a damaged propeller must do to show, and recorded flights."""

import re
from itertools import combinations

import numpy as np
import pytest

from flighttest.identify.motor_shares import MOTORS, REPEATS
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.validity.status import stored_motors
from flighttest.report.render.plain import plain
from flighttest.segments.model import Segment
from flighttest.validity.assess import RecordingEvidence, assess
from flighttest.validity.compare import Estimates
from flighttest.validity.model import ValidityVerdict
from flighttest.validity.motor_load import motor_load, motor_load_test

SOUND = np.array([1.09, 0.87, 1.13, 0.91])
LEVEL = 0.01


def flights(rng, count, damage=0.0, spread=0.02):
    """Flights of three windows. damage: what motor 3 is commanded more, as a share; the mean of all four stays 1."""
    found = []
    for k in range(count):
        scatter = rng.standard_normal(4)
        shares = SOUND + spread * (scatter - scatter.mean()) * np.sqrt(4 / 3)
        shares = shares + damage * np.array([-0.25, -0.25, 0.75, -0.25])
        t = np.arange(0.0, 2.0, 0.1)
        y = {m: 0.6 * s + 0.0 * t for m, s in zip(MOTORS, shares, strict=True)}
        found += [Segment(f"free #{i}", f"run {k}", "free", {}, i, 2.0 * i, t, y, {}) for i in range(3)]
    return found


@pytest.mark.slow
def test_false_alarms_of_undamaged_flights_are_as_stated():
    rng = np.random.default_rng(3)
    tests = [motor_load_test(motor_load(flights(rng, 5)), motor_load(flights(rng, 1)), LEVEL) for _ in range(1500)]
    assert sum(t.alarm for t in tests) <= 30, "stated: 1 %, 15 of 1500; the shrinkage makes it less"
    usual = [motor_load_test(motor_load(flights(rng, 5)), motor_load(flights(rng, 1)), 0.2).alarm for _ in range(500)]
    assert sum(usual) >= 20, "nor is it blind"


def test_a_damaged_propeller_is_seen_in_its_motor_at_the_size_that_is_stated():
    rng = np.random.default_rng(4)
    seen = 0
    for _ in range(100):
        test = motor_load_test(motor_load(flights(rng, 7)), motor_load(flights(rng, 3, damage=0.2)), LEVEL)
        assert 0.04 < test.detectable["motor_3"] < 0.12
        seen += test.alarm and "motor 3 beside the others rose" in test.sentence
    assert seen >= 97
    small = [
        motor_load_test(motor_load(flights(rng, 7)), motor_load(flights(rng, 3, damage=0.03)), LEVEL)
        for _ in range(100)
    ]
    assert sum(t.alarm for t in small) <= 10


def test_a_vehicle_that_repeats_itself_shows_a_smaller_change_and_one_flight_has_what_others_did():
    rng = np.random.default_rng(5)

    def least(count, spread):
        return motor_load_test(
            motor_load(flights(rng, count, spread=spread)), motor_load(flights(rng, 1)), LEVEL
        ).detectable["motor_3"]

    assert motor_load(flights(rng, 1)).spread == pytest.approx(REPEATS)
    assert least(1, 0.02) > 1.5 * least(12, 0.02)
    assert least(12, 0.005) < 0.7 * least(12, 0.025)


def test_status_names_the_motor_and_is_current_where_the_load_is_shared_as_before():
    rng = np.random.default_rng(6)
    nothing = Estimates("model", (), np.zeros(0), np.zeros((0, 0)))

    def answer(new):
        loads = motor_load(flights(rng, 7)), new
        return assess(
            model_fingerprint={}, vehicle_fingerprint=None, stored=nothing, new=RecordingEvidence(motors=loads)
        )

    found = answer(motor_load(flights(rng, 3, damage=0.3)))
    assert found.verdict is ValidityVerdict.STALE
    rose, half = map(float, re.search(r"motor 3 beside the others rose ([\d.]+) ± ([\d.]+) %", found.sentence).groups())
    assert abs(rose - 100.0 * 0.3 * 0.75 / SOUND[2]) < half < 5.0
    assert found.sentence.endswith(": the propeller of motor 3, the motor itself, or a load near it.")
    assert found.impact == ("motor 3 reaches its limit earlier than in the model's flights",)
    assert answer(motor_load(flights(rng, 3))).verdict is ValidityVerdict.CURRENT
    assert answer(None).tests == ()


@pytest.mark.parametrize(
    "damage", [{"shares": [1.0]}, {"flights": 0}, {"spread": -1.0}, {"dof": "x"}, {"shares": None}]
)
def test_what_a_model_keeps_of_its_motors_is_read_again_and_a_damaged_block_is_none(damage):
    from types import SimpleNamespace

    load = motor_load(flights(np.random.default_rng(7), 3))
    kept = plain(load)
    again = stored_motors(SimpleNamespace(fit_quality={"motors": kept}))
    assert again.shares == pytest.approx(load.shares)
    assert (again.spread, again.dof, again.flights) == (load.spread, load.dof, load.flights)
    assert stored_motors(SimpleNamespace(fit_quality={"motors": {**kept, **damage}})) is None
    assert stored_motors(SimpleNamespace(fit_quality={})) is None


@pytest.mark.slow
def test_two_millimetres_of_a_recorded_propeller_are_seen_and_no_undamaged_flight(shared_data):
    """A Crazyflie (CrazyPAD): both ends of one propeller cut; the commands of its motors are recorded."""
    folder = shared_data / "propeller_damage" / "motor_data"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")

    def flown(name, vehicle="E8"):
        recordings = open_recordings(sorted((folder / name).glob(f"{vehicle}_*")))
        segments = cut_all(recordings)
        return [[s for s in segments if s.run == r.name] for r in recordings]

    def joined(parts):
        return motor_load([s for part in parts for s in part])

    normal = flown("normal_flight")
    model = joined(normal)
    for name, seen in {"2mm_2mm_43mm": True, "3mm_3mm_41mm": True, "1mm_1mm_45mm": False}.items():
        test = motor_load_test(model, joined(flown(f"cut_propeller_M3_{name}")), 0.005)
        assert test.alarm is seen, name
        assert not seen or "motor 3 beside the others rose" in test.sentence
    for flights_of in (normal, flown("normal_flight", "E9")):
        for size in range(1, len(flights_of)):
            for own in combinations(range(len(flights_of)), size):
                rest = [k for k in range(len(flights_of)) if k not in own]
                sides = (joined([flights_of[k] for k in part]) for part in (own, rest))
                assert not motor_load_test(*sides, 0.005).alarm, own


def test_the_torque_commands_of_a_log_without_motor_commands_show_a_cut_propeller(shared_data):
    """The controller log of the same vehicles: thrust and torques, which the firmware mixes to motor commands."""
    folder = shared_data / "propeller_damage" / "controller_data"

    def load(name, *which):
        files = [f for f in sorted((folder / name).glob("E8_*")) if not which or int(f.name[-2:]) in which]
        return motor_load(cut_all(open_recordings(files)))

    model = load("normal_flight")
    test = motor_load_test(model, load("cut_propeller_M3_3mm_3mm_41mm"), 0.0033)
    assert test.alarm
    assert "motor 3 beside the others rose" in test.sentence
    one, other = load("normal_flight", 0, 1, 2), load("normal_flight", 3, 4)
    assert not motor_load_test(one, other, 0.0033).alarm
    assert not motor_load_test(other, one, 0.0033).alarm
