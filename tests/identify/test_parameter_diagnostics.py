"""What the model cannot describe is not printed as known, however small its standard error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from flighttest.errors import FitError
from flighttest.identify.fit import fit
from flighttest.physics.model import Model
from flighttest.segments.model import SegmentContext
from tests.identify.campaign import QUIET, TRUTH, campaign


@pytest.fixture(scope="module")
def yaws():
    return [s for s in campaign(21, thrust_repeats=0, tilt_repeats=0, yaw_repeats=3) if s.kind == "yaw_rate_step"]


def ramped(segment, rng, accel_rad_s2=4.7):
    """The same step with the reference ramped by the autopilot, as ATC_ACCEL_Y_MAX does."""
    rate = segment.cell["rate_rad_s"]
    t = np.arange(-0.5, 2.1, 1e-3)
    edges = [(0.0, rate), (1.5, 0.0)]
    late, value = t - TRUTH["T_d"], np.zeros_like(t)
    for at, (began, aim) in zip((0.0, rate), edges, strict=True):
        gone = np.clip((late - began) * accel_rad_s2, 0.0, abs(aim - at)) * np.sign(aim - at)
        value += gone
    _, r, _ = lsim(([TRUTH["sigma_r"]], [1, TRUTH["sigma_r"]]), value, t + 0.5)
    made = np.interp(segment.t_s - segment.t_step_s, t, r) + 0.02 * rng.standard_normal(segment.t_s.size)
    return replace(segment, y={**segment.y, "r_rad_s": made})


def test_a_ramped_yaw_rate_has_no_one_decay_constant(yaws):
    rng = np.random.default_rng(1)
    usual = fit(yaws).estimates["sigma_r"]
    assert usual.identifiable, usual.why
    shaped = fit([ramped(s, rng) for s in yaws])
    for name in ("sigma_r", "T_d_yaw_rate"):
        assert not shaped.estimates[name].identifiable
    assert "in steps of 1 rad/s" in shaped.estimates["sigma_r"].why
    assert "in steps of 2 rad/s" in shaped.estimates["sigma_r"].why
    assert not shaped.estimates["T_d"].identifiable
    assert "T_d_yaw_rate" in shaped.estimates["T_d"].why


def test_what_leans_on_a_delay_at_its_bound_is_not_known(yaws):
    # Stamped 130 ms late: the vehicle seems to answer before it was asked.
    late = [replace(s, u={c: (t + 0.13, v) for c, (t, v) in s.u.items()}) for s in yaws]
    found = fit(late)
    assert "T_d_yaw_rate" in found.solution.at_bound
    assert not found.estimates["sigma_r"].identifiable
    assert "T_d_yaw_rate is at its bound" in found.estimates["sigma_r"].why


def test_a_gain_that_changes_with_throttle_is_no_constant():
    flown = []
    for t_1 in (0.1, 0.2, 0.4):
        curve = {**TRUTH, "K": TRUTH["K"] * np.sqrt(t_1 / 0.2)}
        every = campaign(22, truth=curve, thrust_repeats=2, tilt_repeats=0, yaw_repeats=0)
        flown += [s for s in every if s.cell["throttle_1"] == t_1]
    gain = fit(flown).estimates["K"]
    assert not gain.identifiable
    assert "in steps to throttle 0.40" in gain.why


def test_what_is_known_and_yet_differs_with_the_step_is_said():
    flown = []
    for size in (0.2, 0.3):
        shaped = {**TRUTH, "omega_phi": TRUTH["omega_phi"] * (1.15 if size == 0.2 else 1.0)}
        every = campaign(24, truth=shaped, thrust_repeats=0, tilt_repeats=2, yaw_repeats=0)
        flown += [s for s in every if abs(s.cell.get("amplitude_rad", 0.0)) == size]
    found = fit(flown)
    assert found.estimates["omega_phi"].identifiable
    assert any(note.startswith("omega_phi: no single value fits") for note in found.notes)
    assert found.checks["step_sizes"]["omega_phi"]["high_in"] == "steps of 0.2 rad"
    assert "omega_theta" not in found.checks["step_sizes"]


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_few_repeats_of_a_good_model_raise_no_doubt(seed):
    small = campaign(seed, thrust_repeats=1, tilt_repeats=1, yaw_repeats=1)
    assert not [e.why for e in fit(small).estimates.values() if "one number" in e.why]


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_responses_make_nothing_known(flown, count):
    steps = [s for s in flown if s.kind == "throttle_step"][:count]
    estimates = fit(steps).estimates.values()
    assert not any(e.identifiable for e in estimates)
    assert any("without repeats" in e.why for e in estimates)


def test_constant_columns_are_no_measurement(flown):
    still = [replace(s, y={c: np.full(v.shape, 0.2) for c, v in s.y.items()}) for s in flown]
    with pytest.raises(FitError, match="never change"):
        fit([replace(s, kind="free", cell={}) for s in still])


def test_flights_without_any_command_are_refused_for_that(flown):
    """249 windows of a telemetry log without targets and throttle were called segments that were each rejected."""
    with pytest.raises(FitError, match="neither references nor a throttle were recorded"):
        fit([replace(s, kind="free", cell={}, u={}) for s in flown])


def test_one_filled_in_column_is_left_out_and_said(flown):
    filled = [replace(s, y={**s.y, "v_x_m_s": np.zeros(s.t_s.size)}) for s in flown]
    found = fit(filled)
    assert any("v_x_m_s never changes" in note for note in found.notes)
    assert "v_x_m_s" not in found.quality
    assert abs(found.values["K"] / TRUTH["K"] - 1) < 0.02


def test_without_attitude_only_level_steps_tell_of_thrust(flown):
    blind = [replace(s, y={c: v for c, v in s.y.items() if c not in ("roll_rad", "pitch_rad")}) for s in flown]
    found = fit(blind)
    assert any("attitude was not recorded" in note for note in found.notes)
    assert any("roll command: the channel that responds to it was not recorded" in note for note in found.notes)
    assert not found.estimates["d_x"].identifiable
    assert abs(found.values["K"] / TRUTH["K"] - 1) < 0.02
    (part,) = (p for p in found.problem.parts if p.block.name == "translation")
    assert {found.problem.segments[r.index].kind for r in part.responses} <= {"throttle_step", "yaw_rate_step"}


@pytest.mark.slow
def test_a_model_no_better_than_the_mean_makes_nothing_known(flown):
    rng = np.random.default_rng(3)
    free = [replace(s, kind="free", cell={}) for s in flown if s.kind == "throttle_step"]
    # Force and velocity that have nothing to do with the throttle, nor with one another.
    noise = [
        replace(
            s,
            y={
                **s.y,
                **{c: rng.standard_normal(s.t_s.size) for c in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")},
                **{c: rng.standard_normal(s.t_s.size) for c in ("v_x_m_s", "v_y_m_s", "v_z_m_s")},
            },
        )
        for s in free
    ]
    estimates = fit(noise).estimates
    assert not estimates["d_x"].identifiable
    assert not estimates["sigma_t"].identifiable


def test_a_gain_at_another_voltage_than_was_flown_rests_on_an_assumed_exponent(flown):
    steps = [s for s in flown if s.kind == "throttle_step"]
    at_nominal = [replace(s, y={**s.y, "voltage_v": np.full(s.t_s.size, 22.2)}) for s in steps]
    far = [replace(s, y={**s.y, "voltage_v": np.full(s.t_s.size, 11.1)}) for s in steps]
    near, other = fit(at_nominal).estimates["K"], fit(far, Model(nominal_voltage_v=22.2)).estimates["K"]
    assert near.identifiable, near.why
    assert not other.identifiable
    assert other.interval_95[0] < near.value < other.interval_95[1]


@pytest.mark.parametrize("omega", [25.43, 15.0])
def test_windows_of_free_flight_are_compared_by_how_lively_they_are(omega):
    """A roll loop that is slower in lively windows than in calm ones has no one natural frequency."""
    calm = campaign(23, thrust_repeats=0, tilt_repeats=3, yaw_repeats=0)
    lively = campaign(23, truth={**TRUTH, "omega_phi": omega}, thrust_repeats=0, tilt_repeats=3, yaw_repeats=0)
    windows = [
        replace(b if abs(b.cell["amplitude_rad"]) > 0.25 else a, kind="free", cell={})
        for a, b in zip(calm, lively, strict=True)
        if a.kind == "roll_step" and abs(a.cell["amplitude_rad"]) != 0.3
    ]
    estimates = fit(windows).estimates
    assert any("livelier windows" in e.why for e in estimates.values()) == (omega == 15.0)
    assert estimates["omega_phi"].identifiable == (omega != 15.0)


@pytest.mark.slow
def test_runs_with_different_filters_are_each_read_through_their_own():
    rng = np.random.default_rng(4)
    flown = campaign(
        5, noise={**QUIET, "force": 0.02, "velocity": 0.01}, thrust_repeats=2, tilt_repeats=0, yaw_repeats=0
    )

    def filtered(segment, hz, name):
        w = 2 * np.pi * hz
        t = segment.t_s - segment.t_s[0]
        y = dict(segment.y)
        fine = np.arange(0.0, t[-1] + 1e-9, 1e-3)
        clean = clean_force(fine, segment)
        _, made, _ = lsim(([w * w], [1, np.sqrt(2) * w, w * w]), clean - clean[0], fine)
        y["f_z_m_s2"] = np.interp(t, fine, made + clean[0]) + 0.02 * rng.standard_normal(t.size)
        return replace(segment, y=y, run=name, context=SegmentContext(filters={"specific_force": hz}))

    mixed = [filtered(s, 8.0 if i % 2 else 40.0, "a" if i % 2 else "b") for i, s in enumerate(flown)]
    own = fit(mixed)
    one = fit([replace(s, context=SegmentContext(filters={"specific_force": 40.0})) for s in mixed])
    assert abs(own.values["sigma_t"] / TRUTH["sigma_t"] - 1) < 0.01
    assert abs(own.values["T_d_thrust"] - TRUTH["T_d"]) < 5e-4
    assert own.quality["f_z_m_s2"].rmse < 0.5 * one.quality["f_z_m_s2"].rmse


def clean_force(fine, segment):
    """a_t less the drag of the measured climb, on a fine grid: what an accelerometer without a filter would see."""
    throttle = segment.u["throttle"]
    first, second = throttle[1]
    gain = TRUTH["K"] * (float(np.mean(segment.y["voltage_v"])) / 22.2) ** TRUTH["alpha"]
    since = np.clip(fine + segment.t_s[0] - throttle[0][1] - TRUTH["T_d"], 0.0, None)
    a_t = gain * (first + (second - first) * (1.0 - np.exp(-TRUTH["sigma_t"] * since)))
    climb = np.interp(fine, segment.t_s - segment.t_s[0], segment.y["v_z_m_s"])
    return a_t - TRUTH["d_z"] * climb


@pytest.mark.parametrize("white", [True, False])
def test_a_loop_whose_course_is_missed_is_not_known_for_another_reason_than_noise(flown, white):
    rng = np.random.default_rng(8)

    def disturbed(segment):
        t, r = segment.t_s, segment.y["r_rad_s"]
        other = (
            rng.normal(0.0, 0.6 * np.std(r), t.size)
            if white
            else 2.4 * np.std(r) * np.sin(2 * np.pi * (0.3 * t + rng.uniform()))
        )
        return replace(segment, y={**segment.y, "r_rad_s": r + other})

    yaws = [s for s in flown if s.kind == "yaw_rate_step"]
    found = fit([disturbed(s) for s in yaws] * 3)
    assert found.quality["r_rad_s"].r2 < 0.9
    sigma_r = found.estimates["sigma_r"]
    assert white or not sigma_r.identifiable
    assert ("neither explained nor noise" in sigma_r.why) is not white


def test_k_far_from_the_voltage_flown_asks_for_the_nominal_one():
    """A battery of three cells at a steady 12.6 V: nothing carries K from there to the paper's 22.2 V."""
    steps = [s for s in campaign(3, thrust_repeats=1) if s.kind == "throttle_step"]
    steps = [replace(s, y={**s.y, "voltage_v": np.full(s.t_s.size, 12.6)}) for s in steps]
    far, near = fit(steps, Model()), fit(steps, Model(nominal_voltage_v=11.1))
    assert not far.estimates["K"].identifiable
    assert any("--vehicle" in note for note in far.notes)
    assert any("alpha cannot be determined" in note for note in far.notes)
    assert near.estimates["K"].identifiable
