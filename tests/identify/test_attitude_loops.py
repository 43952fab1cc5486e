"""The attitude loops of free flight: second-order loops in gusts, flown by a pilot who answers what the gusts do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flighttest.diagnose import diagnose
from flighttest.diagnose.conclusion import UNTRIED
from flighttest.diagnose.free_flight import answer
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.identify.fit import fit
from flighttest.identify.free_flight import estimate, fit_by_prediction_errors, parts_by_prediction_errors, stretches
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import for_later_flights
from flighttest.segments.model import Segment, SegmentContext

TRUTH = {"omega_phi": 9.0, "zeta_phi": 0.7, "omega_theta": 8.0, "zeta_theta": 0.8, "T_d_attitude": 0.05}
DT, EVERY = 0.005, 4
ALL = ("translation", "roll_pitch", "yaw")


@cache
def piloted(seconds, seed, torque=4.0, moment=0.0, rate_hz=50.0, lag_s=0.0):
    """Windows of 2.5 s of a vehicle that a pilot flies to and fro, who levels it and brings it back 0.25 s after what he sees. torque:
    of gusts of 0.5 s, rad/s^2; moment: M_u = L_v, rad/(s m); rate_hz: of the attitude's samples; lag_s: of motors inside the loops."""
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    omega, zeta = (
        np.array([TRUTH["omega_phi"], TRUTH["omega_theta"]]),
        np.array([TRUTH["zeta_phi"], TRUTH["zeta_theta"]]),
    )
    push = torque * np.sqrt(2.0 * DT / 0.5) * rng.standard_normal((n, 2))
    angle, rate, gust, v, x = (np.zeros(2) for _ in range(5))
    late, seen = [np.zeros(2)] * round(TRUTH["T_d_attitude"] / DT), [np.zeros(6)] * round(0.25 / DT)
    asked, goal, made = np.zeros(2), np.zeros(2), np.zeros(2)
    out = np.empty((n, 7))
    for k in range(n):
        if k % round(1.5 / DT) == 0:
            goal = rng.uniform(-2.0, 2.0, 2)
        seen.append(np.concatenate([angle, v, x]))
        if k % EVERY == 0:
            tilt, speed, place = np.split(seen[-round(0.25 / DT)], 3)
            lateral = np.clip(0.25 * (goal - place) - 0.25 * speed, -0.35, 0.35)  # to the left, forward
            asked = np.array([-1.0, 1.0]) * lateral[::-1] - 0.3 * (tilt - np.array([-1.0, 1.0]) * lateral[::-1])
        late.append(asked)
        out[k] = [k * DT, *angle, *asked, *v]
        gust = gust - gust * DT / 0.5 + push[k]
        # Forward speed lifts the nose (theta falls), speed to the left lifts the left side.
        air = moment * np.array([v[1], -v[0]])
        wanted = omega**2 * (late.pop(0) - angle) - 2.0 * zeta * omega * rate
        made = made + DT / lag_s * (wanted - made) if lag_s else wanted
        acceleration = made + gust + air
        angle, rate = angle + DT * (rate + 0.5 * DT * acceleration), rate + DT * acceleration
        v = v + DT * (9.81 * np.array([np.sin(angle[1]), -np.sin(angle[0])]) - 0.3 * v)
        x = x + DT * v
    some = out[::EVERY]
    t, sparse = some[:, 0], max(round(1.0 / (DT * EVERY) / rate_hz), 1)
    found = []
    for k in range(1, t.size // 125):
        at, reach = slice(125 * k, 125 * (k + 1)), slice(125 * k - 50, 125 * (k + 1))
        held = np.arange(125 * k, 125 * (k + 1)) % sparse == 0
        noise = 5e-4 * rng.standard_normal((125, 2))
        y = {
            f"{axis}_rad": np.where(held, some[at, 1 + i] + noise[:, i], np.nan)
            for i, axis in enumerate(("roll", "pitch"))
        }
        y |= {"yaw_rad": np.zeros(125), "v_x_m_s": some[at, 5], "v_y_m_s": some[at, 6], "v_z_m_s": np.zeros(125)}
        u = {f"{axis}_ref_rad": (t[reach], some[reach, 3 + i]) for i, axis in enumerate(("roll", "pitch"))}
        u |= {"throttle": (t[reach], np.full(t[reach].size, 0.2)), "yaw_rate_ref_rad_s": (t[reach][:1], np.zeros(1))}
        found.append(Segment(f"free #{k}", "run", "free", {}, k, float(t[at][0]), t[at], y, u))
    return tuple(found)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [50.0, 10.0])
def test_a_pilot_who_answers_gusts_does_not_bias_the_loops(rate_hz):
    """Gusts of torque tilt the vehicle by 3 degrees, a fifth of what it flies."""
    errors = []
    for seed in range(4):
        found = estimate(stretches(piloted(60.0, seed, rate_hz=rate_hz), "roll_pitch"), Model(), part="roll_pitch")
        assert found.converged
        errors += [(found.values[n] - truth) / found.std[n] for n, truth in TRUTH.items()]
        assert found.std["T_d_attitude"] < 0.015
    assert np.abs(errors).max() < 4.0
    assert np.mean(np.abs(errors) < 2.0) >= 0.85


@pytest.mark.slow
def test_output_error_takes_the_answer_to_a_gust_for_its_cause():
    """Why the loops of free flight have an estimator of their own."""
    segments = piloted(60.0, 0)
    ours, other = (
        estimate(stretches(segments), Model(), part="roll_pitch").values,
        fit(segments, Model(), robust=False).values,
    )
    wrong, right = (sum(abs(np.log(v[n] / t)) for n, t in TRUTH.items() if n[0] in "oz") for v in (other, ours))
    assert wrong > 2.0 * right


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_faster_than_the_loops_does_not_decide_what_they_are(seed):
    """Motors of 40 ms inside the loops: by single samples of 50 Hz, where the noise is least, the angles were missed by a fifth more than
    without them; by means over 0.2 s the natural frequency was known half as well."""
    found, quick = (estimate(stretches(piloted(60.0, seed, lag_s=s)), Model(), part="roll_pitch") for s in (0.04, 0.0))
    assert found.rms["roll_rad"] < 1.12 * quick.rms["roll_rad"]
    assert found.std["omega_phi"] < 0.25


def test_a_fit_and_a_diagnosis_print_the_same_values_and_intervals():
    segments = piloted(60.0, 0)
    fitted, found = fit_by_prediction_errors(segments, Model(), ALL), diagnose(segments, Model(), only=())
    assert not {"roll", "pitch"} & {place.channel for place in found.located}  # gusts have no place
    assert set(TRUTH) <= set(found.after)
    for name in TRUTH:
        one = fitted.estimates[name]
        assert one.identifiable
        assert found.after[name]["value"] == pytest.approx(one.value)
        assert found.after[name]["interval_95"] == pytest.approx(one.interval_95)
        assert found.before[name]["interval_95"] == pytest.approx(one.interval_95)


@pytest.mark.slow
def test_a_parameter_that_is_held_stays_and_the_others_are_estimated_beside_it():
    """A fit with --freeze went to output error, and answered otherwise than one without."""
    held = fit_by_prediction_errors(piloted(60.0, 0), Model(), ALL, {"omega_phi": TRUTH["omega_phi"]})
    assert held.estimates["omega_phi"].source == "frozen"
    assert held.values["omega_phi"] == TRUTH["omega_phi"]
    for name in TRUTH.keys() - {"omega_phi"}:
        one = held.estimates[name]
        assert one.source == "fit"
        assert abs(one.value - TRUTH[name]) < 4.0 * one.std


@pytest.mark.slow
def test_an_interrupt_while_the_loops_are_searched_keeps_the_translation(monkeypatch):
    """It lost the whole diagnosis."""

    def interrupted(*args, part="translation", **more):
        if part == "roll_pitch":
            raise KeyboardInterrupt
        return find_terms(*args, part=part, **more)

    monkeypatch.setattr(answer, "find_terms", interrupted)
    found = diagnose(piloted(60.0, 0), Model(), only=("rate_limit",))
    assert not found.complete
    assert "K" in found.after
    assert [u.why for u in found.untestable] == [UNTRIED]


def test_all_of_a_flight_is_estimated_by_prediction_errors_where_somebody_steered():
    windows = piloted(60.0, 0)
    step = replace(windows[3], kind="roll_step", cell={"amplitude_rad": 0.1})
    by_hand = replace(step, context=SegmentContext(by_hand=True))
    assert parts_by_prediction_errors(windows) == ALL
    assert parts_by_prediction_errors([*windows[:3], by_hand, *windows[4:]]) == ALL
    assert parts_by_prediction_errors([*windows[:3], step, *windows[4:]]) == ()  # of a script
    assert parts_by_prediction_errors(windows[:2]) == ALL
    assert parts_by_prediction_errors(windows[:1]) == ()  # 2.5 s, of which a second is what the others begin from


@pytest.mark.slow
def test_an_attitude_that_is_stuck_shows_nothing_of_its_loop():
    """Its loop is assumed, the other one is not moved by it, and a model file is written."""
    whole = piloted(60.0, 0)
    stuck = [replace(s, y=s.y | {"pitch_rad": np.zeros(s.t_s.size)}) for s in whole]
    fitted, found = (fit_by_prediction_errors(s, Model(), ALL) for s in (whole, stuck))
    assert found.estimates["omega_theta"].source == "assumed"
    assert abs(found.values["omega_phi"] - fitted.values["omega_phi"]) < 2.0 * fitted.estimates["omega_phi"].std
    assert set(found.covariance.names) <= set(found.solution.normal.names)
    assert for_later_flights(found)["discrepancy"]
