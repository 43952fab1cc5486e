"""`flighttest check` on all shipped scripts: its answer for each is that for it alone, and it does not take long."""

import json
import subprocess
import sys
import time

import pytest

from flighttest.identify import expected_information as expected
from flighttest.identify.expected_information import expected_of_information, planned_information
from flighttest.pipeline.planning.checking import plans, predictor_for
from flighttest.vehicle.model import DEFAULT_VEHICLE


def expected_of_plans(plans, model, values):
    """What each plan by itself would make known, and all of them together."""
    planned = planned_information(plans, model, values)
    return [expected_of_information([one], model, values) for one in planned], expected_of_information(
        planned, model, values
    )


@pytest.mark.slow
def test_what_scripts_tell_together_is_what_each_shows_alone():
    prior = predictor_for(None, DEFAULT_VEHICLE)
    compiled = plans(["yaw_rate", "roll_pitch", "hover_rest", "tilt_throttle"], DEFAULT_VEHICLE, prior)
    each, altogether = expected_of_plans(compiled, prior.model, prior.values)
    for plan, found in zip(compiled, each, strict=True):
        (alone,), _ = expected_of_plans([plan], prior.model, prior.values)
        assert [e.name for e in found] == [e.name for e in alone]
        for mine, theirs in zip(found, alone, strict=True):
            assert mine.std == (None if theirs.std is None else pytest.approx(theirs.std, rel=1e-9)), (
                plan.script.name,
                mine,
            )
            assert [cell for cell, _ in mine.best] == [cell for cell, _ in theirs.best]
    std = {e.name: e.std for e in altogether}
    assert std["d_x"] < 0.99 * {e.name: e.std for e in each[1]}["d_x"], "more flights hold more information"
    assert std["sigma_r"] == pytest.approx({e.name: e.std for e in each[0]}["sigma_r"], rel=1e-9), "of what they move"


@pytest.mark.slow
def test_flying_a_plan_in_coarser_steps_moves_no_expected_error(monkeypatch):
    prior = predictor_for(None, DEFAULT_VEHICLE)
    compiled = plans(["roll_pitch", "spot_check", "reversals"], DEFAULT_VEHICLE, prior)
    coarse, _ = expected_of_plans(compiled, prior.model, prior.values)
    monkeypatch.setattr(expected, "PLANNED_STEP_S", 0.004)
    fine, _ = expected_of_plans(compiled, prior.model, prior.values)
    planned = [
        (a, b)
        for one, other in zip(coarse, fine, strict=True)
        for a, b in zip(one, other, strict=True)
        if a.std is not None
    ]
    assert len(planned) > 20
    for a, b in planned:
        assert a.std == pytest.approx(b.std, rel=2e-3), a.name


@pytest.mark.slow
def test_nothing_heavy_is_loaded_that_check_does_not_use():
    code = "import flighttest.cli.main, flighttest.pipeline.planning.checking, sys, json; print(json.dumps(sorted(sys.modules)))"
    loaded = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout)
    assert not {"pandas", "plotly", "mavsdk"} & set(loaded)


def test_a_script_is_checked_while_one_waits():
    prior = predictor_for(None, DEFAULT_VEHICLE)
    began = time.process_time()
    compiled = plans(["roll_pitch", "yaw_rate", "lateral_stop"], DEFAULT_VEHICLE, prior)
    expected_of_plans(compiled, prior.model, prior.values)
    # A quarter of a second here where nothing else runs; four times that where everything does.
    assert time.process_time() - began < 2.5


@pytest.mark.parametrize("terms", [(), ("ground_effect",)])
def test_repeats_that_are_the_same_flight_are_flown_once(monkeypatch, terms):
    prior = predictor_for(None, DEFAULT_VEHICLE)
    model = prior.model.with_terms(*terms)
    compiled = plans(["roll_pitch"], DEFAULT_VEHICLE, prior)
    flown = []
    simulate_many = expected.simulate_many

    def counted(model, values, runs, step_s):
        flown.append(len(runs))
        return simulate_many(model, values, runs, step_s)

    monkeypatch.setattr(expected, "simulate_many", counted)
    planned = expected.planned_information(compiled, model, model.start(prior.values))
    poses = {(*sorted(leg.cell.items()), leg.kind, leg.heading_rad, leg.start_m[2]) for leg in compiled[0].legs}
    assert flown == [len(poses) if terms else 12], "only headings and heights separate them"
    assert len(poses) > 24
    assert len(planned[0].steps) == 36


def test_a_turn_on_the_spot_shows_hover_and_nothing_of_drag_along_z():
    prior = predictor_for(None, DEFAULT_VEHICLE)
    (found,), _ = expected_of_plans(plans(["yaw_rate"], DEFAULT_VEHICLE, prior), prior.model, prior.values)
    std = {e.name: e.std for e in found}
    assert 0.1 < std["K"] < 1.0
    assert std["d_z"] is None
