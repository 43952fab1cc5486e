"""The fit finds the parameters that made the data, with their errors, and lists those that the data do not determine."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from flighttest.errors import FitError, InputError
from flighttest.identify.fit import default_model, fit, heldout
from flighttest.identify.selection import problem_of
from flighttest.physics.model import Model
from flighttest.segments.model import Flaw, Segment
from tests.identify.campaign import QUIET, TRUTH, campaign

identify_fit = import_module("flighttest.identify.fit")  # the package has a function of this name

CHANNEL = {"T_d_attitude": "T_d", "T_d_yaw_rate": "T_d", "T_d_thrust": "T_d"}


def truth(name):
    return TRUTH[CHANNEL.get(name, name)]


def without(segment: Segment, *channels: str) -> Segment:
    return replace(segment, y={c: v for c, v in segment.y.items() if c not in channels})


def test_every_parameter_of_table_2_is_found_within_its_error(found):
    assert found.status.good
    for name in TRUTH:
        e = found.estimates[name]
        assert e.identifiable, (name, e.why)
        assert abs(e.value - truth(name)) < 4 * e.std, name
        assert e.interval_95[0] < e.value < e.interval_95[1]
    assert abs(found.estimates["T_d"].value - TRUTH["T_d"]) < 1e-3
    assert set(found.delays_s) == {"attitude", "yaw_rate", "thrust"}


def test_the_papers_onset_is_later_than_the_joint_estimate(found):
    assert TRUTH["T_d"] < found.onset.mean_s < TRUTH["T_d"] + 0.02


def test_without_noise_the_truth_comes_back_to_a_thousandth():
    quiet = campaign(3, noise=QUIET, thrust_repeats=1, tilt_repeats=1, yaw_repeats=1)
    values = fit(quiet, robust=False).values
    for name, value in values.items():
        assert value == pytest.approx(truth(name), rel=2e-3), name


def test_quality_distinguishes_noise_from_misfit(found, flown):
    assert found.quality["roll_rad"].rmse == pytest.approx(0.003, rel=0.1)
    assert "noise" in found.quality["roll_rad"].sentence
    wrong = fit(flown, Model(("body",)))
    assert wrong.quality["f_x_m_s2"].autocorrelation > 0.3
    assert "lacks" in wrong.quality["v_x_m_s"].sentence


def test_missing_samples_and_uneven_times_do_no_harm(flown):
    rng = np.random.default_rng(5)
    thinned = []
    for s in flown:
        keep = rng.uniform(size=s.t_s.size) > 0.25
        y = {c: v[keep].copy() for c, v in s.y.items()}
        y["f_z_m_s2"][rng.uniform(size=keep.sum()) < 0.2] = np.nan
        y["roll_rad"][rng.uniform(size=keep.sum()) < 0.1] = np.nan
        thinned.append(replace(s, t_s=s.t_s[keep], y=y))
    estimates = fit(thinned).estimates
    for name in TRUTH:
        assert abs(estimates[name].value - truth(name)) < 4 * estimates[name].std, name


@pytest.mark.slow
def test_an_outlying_repeat_is_reported_and_hardly_moves_the_fit(flown, found):
    at = next(i for i, s in enumerate(flown) if s.kind == "throttle_step")
    hit = flown[at]
    gust = {
        **hit.y,
        "f_z_m_s2": hit.y["f_z_m_s2"] + 6 * np.sin(9 * hit.t_s),
        "v_z_m_s": hit.y["v_z_m_s"] + np.sin(6 * hit.t_s),
    }
    disturbed = [*flown[:at], replace(hit, y=gust), *flown[at + 1 :]]
    robust, plain = fit(disturbed), fit(disturbed, robust=False)
    assert [o.segment for o in robust.outliers] == [hit.name]
    moved = [abs(f.values["K"] - found.values["K"]) for f in (robust, plain)]
    assert moved[0] < moved[1]
    assert found.outliers == ()


def test_alpha_is_not_known_at_one_voltage(flown):
    level = [replace(s, y={**s.y, "voltage_v": np.full(s.t_s.size, 23.0)}) for s in flown]
    e = fit(level).estimates["alpha"]
    assert not e.identifiable
    assert e.fly == "thrust"


def test_an_estimate_is_no_better_for_what_is_held_beside_it(flown, monkeypatch):
    """A drag that grows with the thrust was 0.165 +- 0.003 s/m beside a linear one that was held where the solver had wandered."""
    model = default_model(flown).with_terms("thrust_scaled_drag")
    drag = ("d_x", "d_y")
    free = fit(flown, model)
    held = fit(flown, model, frozen={n: free.estimates[n].value for n in drag})
    rounds = iter([drag, ()])
    monkeypatch.setattr(identify_fit, "hopeless", lambda *_: next(rounds))
    found = fit(flown, model, start={n: free.estimates[n].value for n in drag})
    assert all(found.estimates[n].std is None for n in drag)
    assert held.estimates["c_h"].std < 0.8 * free.estimates["c_h"].std
    assert found.estimates["c_h"].std == pytest.approx(free.estimates["c_h"].std, rel=0.1)
    assert found.estimates["sigma_t"].std == pytest.approx(free.estimates["sigma_t"].std, rel=0.1)


def test_without_voltage_alpha_has_no_effect_and_keeps_its_start(flown):
    result = fit([without(s, "voltage_v") for s in flown])
    alpha = result.estimates["alpha"]
    assert alpha.source == "assumed"
    assert alpha.std is None
    assert not alpha.identifiable
    assert any("voltage" in note for note in result.notes)


def test_without_attitude_references_the_loops_are_left_out(flown):
    bare = [replace(s, u={"throttle": s.u["throttle"]}) for s in flown if s.kind != "yaw_rate_step"]
    result = fit(bare)
    assert not result.model.attitude_loops
    assert "omega_phi" not in result.estimates
    assert abs(result.values["K"] - TRUTH["K"]) < 0.02 * TRUTH["K"]
    assert any("attitude references" in note for note in result.notes)


def test_without_an_accelerometer_velocity_alone_gives_thrust(flown):
    result = fit([without(s, "f_x_m_s2", "f_y_m_s2", "f_z_m_s2") for s in flown])
    assert abs(result.values["K"] - TRUTH["K"]) < 0.03 * TRUTH["K"]
    assert any("specific force" in note for note in result.notes)


def test_thrust_steps_alone_leave_the_attitude_loops_unknown(flown):
    result = fit([s for s in flown if s.kind == "throttle_step"])
    omega = result.estimates["omega_phi"]
    assert (omega.source, omega.identifiable, omega.fly) == ("assumed", False, "roll_pitch")
    assert result.estimates["K"].identifiable
    assert result.estimates["T_d"].value == pytest.approx(result.estimates["T_d_thrust"].value)


def test_free_flight_windows_identify_what_they_excite(flown):
    free = [replace(s, kind="free", cell={}) for s in flown if s.kind != "yaw_rate_step"]
    result = fit(free)
    for name in ("omega_phi", "K", "d_x"):
        assert abs(result.values[name] - truth(name)) < 0.08 * truth(name), name


def test_frozen_stays_and_tied_moves_together(flown):
    result = fit(flown, frozen={"alpha": 1.5}, ties={"d_y": "d_x", "omega_theta": "omega_phi"})
    assert result.values["alpha"] == 1.5
    assert result.estimates["alpha"].source == "frozen"
    assert result.values["d_y"] == result.values["d_x"]
    assert result.estimates["d_y"].source == "tied"
    assert result.estimates["d_y"].std == result.estimates["d_x"].std
    tests = {t.name: t for t in result.ties}
    assert tests["d_y"].p_value > 0.001
    assert tests["omega_theta"].p_value < 1e-6
    assert "contradicts" in tests["omega_theta"].sentence


def test_a_wrong_name_is_an_error_with_the_names_there_are(flown):
    with pytest.raises(InputError, match="omega_phi"):
        fit(flown, frozen={"omega_roll": 3.0})


def test_nothing_usable_is_an_error(flown):
    with pytest.raises(FitError, match="no segment"):
        fit([replace(s, flaws=(Flaw.GAP,)) for s in flown])


def test_heldout_prediction_is_as_good_as_the_fit(flown, found):
    others = campaign(8, thrust_repeats=1, tilt_repeats=1, yaw_repeats=1)
    problem, solution = heldout(found, others)
    i = next(k for k, p in enumerate(problem.parts) if p.block.name == "translation")
    at = problem.parts[i].outputs.index("f_z_m_s2")
    residual = solution.evaluations[i].residual[..., at][problem.parts[i].mask[..., at]]
    assert np.std(residual) == pytest.approx(found.quality["f_z_m_s2"].rmse, rel=0.1)


def test_the_papers_subsets_feed_the_papers_parameters(flown):
    problem = problem_of(flown, default_model(flown))
    for part in problem.parts:
        used = [problem.segments[r.index] for r in part.responses]
        if part.block.name == "roll":
            assert {abs(s.cell["amplitude_rad"]) for s in used} == {0.2, 0.3}
        if part.block.name == "translation":
            tilts = {abs(s.cell["amplitude_rad"]) for s in used if "amplitude_rad" in s.cell}
            assert tilts == {0.3, 0.5}
            assert not any(s.kind == "yaw_rate_step" for s in used)


def test_the_integrators_steps_put_no_bias_into_the_attitude_loops():
    # 3e-5 is a tenth of the best damping ratio's standard error in a full campaign; steps of 12.5 ms would err by 7e-5.
    tilts = campaign(3, noise=QUIET, thrust_repeats=0, tilt_repeats=1, yaw_repeats=1)
    exact = fit([s for s in tilts if s.kind != "throttle_step"], robust=False)
    for name in ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r"):
        assert exact.estimates[name].value == pytest.approx(TRUTH[name], rel=3e-5), name
    assert exact.estimates["T_d_attitude"].value == pytest.approx(TRUTH["T_d"], rel=3e-5)
