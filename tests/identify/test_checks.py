"""Cross-checks of a fit: the paper's block coordinate descent, residual tests, expected errors of a script."""

import numpy as np
import pytest

from flighttest.estimation.problem import Noise
from flighttest.identify.diagnostics.residuals import residual_tests
from flighttest.identify.expected_information import ASSUMED, expected_of
from flighttest.identify.fit import fit
from flighttest.identify.validation.block_coordinate_descent import block_coordinate_descent
from flighttest.identify.validation.prediction import coverage
from flighttest.physics.model import Model
from tests.identify.campaign import QUIET, TRUTH, campaign


def test_the_papers_descent_finds_the_same_thrust_and_drag(found):
    result = block_coordinate_descent(found)
    assert result.settled
    for name, value in result.values.items():
        assert value == pytest.approx(TRUTH[name], rel=0.06), name


def test_the_descent_needs_both_halves(flown):
    assert block_coordinate_descent(fit([s for s in flown if s.kind == "throttle_step"])) is None


def test_residuals_of_the_right_model_do_not_follow_the_commands(found):
    tests = {t.channel: t for t in residual_tests(found.problem, found.solution)}
    assert not any(t.follows for t in tests.values())
    assert "does not follow the roll command" in tests["roll_rad"].sentence


def test_residuals_of_a_loop_that_is_too_slow_follow_its_command(flown):
    wrong = fit(flown, frozen={"omega_phi": 14.0, "zeta_phi": 0.8})
    tests = {t.channel: t for t in residual_tests(wrong.problem, wrong.solution)}
    assert tests["roll_rad"].follows
    assert not tests["pitch_rad"].follows


def test_expected_errors_are_those_the_fit_finds():
    """With white noise and a constant disturbance per response, as assumed, the forecast is the spread of estimates."""
    noise = {**QUIET, "attitude": 0.003, "rate": 0.02, "force": 0.3, "velocity": 0.05, "disturbance": 0.1}
    assumed = Noise(
        {**ASSUMED.channel, "roll_rad": 0.003, "pitch_rad": 0.003, "v_x_m_s": 0.05, "v_y_m_s": 0.05, "v_z_m_s": 0.05},
        {**dict.fromkeys(ASSUMED.disturbance, 1e-3), "a_d_x_m_s2": 0.1, "a_d_y_m_s2": 0.1, "a_d_z_m_s2": 0.1},
    )
    flown = campaign(21, noise=noise, thrust_repeats=2, tilt_repeats=1)
    result = fit(flown, robust=False)
    forecast = {e.name: e for e in expected_of(flown, Model(), Model().start({**TRUTH}), assumed)}
    model = np.sqrt(np.diag(result.covariance.model))
    for name in ("omega_phi", "sigma_r", "sigma_t", "K", "alpha", "d_x", "d_z"):
        assert forecast[name].std == pytest.approx(model[result.covariance.names.index(name)], rel=0.3), name
    assert forecast["K"].std_twice == pytest.approx(forecast["K"].std / np.sqrt(2))


def test_a_script_of_yaw_steps_shows_nothing_about_drag(flown):
    yaw = [s for s in flown if s.kind == "yaw_rate_step"]
    forecast = {e.name: e for e in expected_of(yaw, Model(), Model().start())}
    assert forecast["omega_phi"].std is None
    assert "no information" in forecast["omega_phi"].sentence
    assert forecast["sigma_r"].best[0][0].startswith("yaw rate ")


def test_intervals_for_unseen_responses_hold_what_they_promise(found):
    for c in coverage(found, campaign(31, thrust_repeats=1, tilt_repeats=1, yaw_repeats=1)):
        assert 0.9 < c.share < 0.99, c
        assert c.rmse == pytest.approx(c.std, rel=0.25)


def few_of(segments, pick):
    """A spot check: one each of the larger tilt steps and of some throttle steps."""
    tilts = [s for s in segments if s.kind in ("roll_step", "pitch_step") and abs(s.cell["amplitude_rad"]) == 0.3]
    pairs = {(0.05, 0.25), (0.05, 0.3), (0.1, 0.25), (0.1, 0.3), (0.2, 0.1), (0.25, 0.1)}
    steps = [s for s in segments if s.kind == "throttle_step" and (s.cell["throttle_0"], s.cell["throttle_1"]) in pairs]
    each: dict[object, list[object]] = {}
    for s in (*tilts, *steps):
        each.setdefault((s.kind, *sorted(s.cell.items())), []).append(s)
    return [some[pick % len(some)] for some in each.values()]


@pytest.mark.parametrize("seed", [5, 9])
def test_few_responses_of_the_right_model_do_not_make_the_descent_differ(seed):
    spot = few_of(campaign(seed), seed)
    assert len(spot) == 10
    assert block_coordinate_descent(fit(spot)).differs == ()


@pytest.mark.slow
def test_throttle_and_tilt_steps_of_different_vehicles_are_distinguished():
    throttle = [s for s in campaign(1) if s.kind == "throttle_step"]
    tilt = [
        s
        for s in campaign(2, truth={**TRUTH, "sigma_t": 12.0, "d_x": 0.1, "d_y": 0.1, "K": 80.0})
        if s.kind != "throttle_step"
    ]
    result = block_coordinate_descent(fit([*throttle, *tilt]))
    assert "K" in result.differs or "d_z" in result.differs, result.z
    assert "do not agree on one model" in result.sentence
