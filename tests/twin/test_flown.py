"""Steps flown by both, against what repeats differ by."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.segments.commands import alike_until_s
from flighttest.segments.model import Segment
from flighttest.twin.flown import MOVE_S, flown_errors, mean_steps

T = np.arange(-0.2, 1.0, 0.02)


def steps(rng, count, bias=0.0, noise=0.01, offset=0.0, amplitude=0.2, late=0.0, jitter=0.0):
    def shape():
        return amplitude * np.clip((T - late - jitter * rng.standard_normal()) / 0.3, 0.0, 1.0)

    return [
        Segment(
            f"s{i}", "r", "roll_step", {"amplitude_rad": amplitude}, i, 5.0, T + 5.0,
            {"roll_rad": shape() + offset + bias * (T > 0.1) + noise * rng.standard_normal(T.size)}, {},
        )
        for i in range(count)
    ]  # fmt: skip


def test_equal_vehicles_are_at_one_noise_floor():
    rng = np.random.default_rng(1)
    found = flown_errors(steps(rng, 100), steps(rng, 100))["roll_rad"]
    assert found["ratio"] == pytest.approx(1.0, abs=0.03)
    assert 0.006 < found["floor"] < 0.01  # white noise, averaged over a sample
    assert found["steps"] == 1


def test_one_flight_of_the_twin_counts_with_its_own_noise():
    rng = np.random.default_rng(2)
    ratios = [flown_errors(steps(rng, 3), steps(rng, 1))["roll_rad"]["ratio"] for _ in range(60)]
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.08)


def test_a_bias_shows_and_an_offset_before_the_step_does_not():
    rng = np.random.default_rng(3)
    real = steps(rng, 30)
    assert flown_errors(real, steps(rng, 30, offset=0.5))["roll_rad"]["ratio"] < 1.1
    assert flown_errors(real, steps(rng, 30, bias=0.03))["roll_rad"]["ratio"] > 2.0


def test_a_step_that_only_one_of_them_flew_or_that_was_not_repeated_does_not_count():
    rng = np.random.default_rng(4)
    assert flown_errors(steps(rng, 1), steps(rng, 3)) == {}
    assert flown_errors(steps(rng, 3), steps(rng, 3, amplitude=0.3)) == {}


def test_a_delay_is_distinguished_and_jitter_of_the_link_does_not_widen_the_floor():
    rng = np.random.default_rng(5)
    found = flown_errors(steps(rng, 60, late=0.05, jitter=0.008), steps(rng, 60, late=0.02, jitter=0.008))["roll_rad"]
    assert found["later_s"] == pytest.approx(0.03, abs=3.0 * found["later_std_s"])
    assert found["later_std_s"] == pytest.approx(0.008 / np.sqrt(60), rel=0.4)
    assert found["floor"] < 0.012
    assert found["ratio"] < 1.1


def stopped_after(rng, count, stop_s):
    """Steps of 0.2 rad that a counter-step ends."""
    command = (np.array([4.0, 5.0, 5.0 + stop_s]), np.array([0.0, 0.2, -0.2]))
    return [
        replace(s, u={"roll_ref_rad": command}, y={"roll_rad": np.where(stop_s + 0.01 > T, s.y["roll_rad"], -0.2)})
        for s in steps(rng, count)
    ]


def test_a_stop_that_was_planned_otherwise_is_not_compared():
    rng = np.random.default_rng(6)
    found = flown_errors(stopped_after(rng, 20, 0.7), stopped_after(rng, 20, 0.5))["roll_rad"]
    assert found["ratio"] < 1.2
    # What follows a stop is compared where it comes at the same time, not where it comes a target earlier.
    assert alike_until_s([*stopped_after(rng, 1, 0.7), *stopped_after(rng, 1, 0.695)]) == pytest.approx(0.98)
    assert alike_until_s([*stopped_after(rng, 1, 0.7), *stopped_after(rng, 1, 0.68)]) == pytest.approx(0.68, abs=0.01)
    assert alike_until_s([*stopped_after(rng, 1, 0.7), *stopped_after(rng, 1, 0.5)]) == pytest.approx(0.5, abs=0.02)


def test_a_hover_throttle_that_rises_with_the_flight_is_no_other_command():
    rng = np.random.default_rng(8)
    throttles = [{"throttle": (np.array([4.0]), np.array([level]))} for level in (0.16, 0.185)]
    flown = [replace(s, u=u) for s, u in zip(steps(rng, 2), throttles, strict=True)]
    assert alike_until_s(flown) == pytest.approx(0.98)
    cut = {"throttle": (np.array([4.0, 5.5]), np.array([0.16, 0.05]))}
    assert alike_until_s([flown[1], replace(flown[0], u=cut)]) == pytest.approx(0.5, abs=0.01)


def test_the_mean_response_is_of_both_signs_and_late_by_the_mean_delay():
    rng = np.random.default_rng(7)
    flown = [
        replace(s, u={"roll_ref_rad": (np.array([4.0, 5.0, 5.9]), np.array([0.0, a, -a]))}, cell={"amplitude_rad": a})
        for a in (0.2, -0.2)
        for s in steps(rng, 8, noise=1e-4, amplitude=a, late=0.04, jitter=0.01, offset=0.1)
    ]
    (found,) = mean_steps(flown)["roll"]
    assert (found["size"], found["responses"]) == (0.2, 16)
    t = found["period_s"] * np.arange(len(found["answer"]))
    assert t[-1] == pytest.approx(0.9 - MOVE_S, abs=0.021)  # the counter-step is not in it
    assert found["answer"] == pytest.approx(0.2 * np.clip((t - 0.04) / 0.3, 0.0, 1.0), abs=4e-3)
    assert mean_steps([s for s in flown if s.kind == "pitch_step"]) == {}


def throttled(rng, volts, held_s=0.6, gain=1.0, alpha=1.6, lag_s=0.07, noise=0.03):
    """Steps of the specific force from 3 to 10 m/s^2 at 22.2 V, once per voltage; before them it came from 8 within a lag of thrust."""
    t = np.arange(-held_s, 1.0, 0.02)
    before = 3.0 + 5.0 * np.exp(-(t + held_s) / lag_s)
    thrust = np.where(t < 0.0, before, 10.0 + (before - 10.0) * np.exp(-np.maximum(t, 0.0) / lag_s))
    return [
        Segment(
            f"s{i}", "r", "throttle_step", {"throttle_0": 0.05, "throttle_1": 0.2}, i, 5.0, t + 5.0,
            {"f_z_m_s2": gain * thrust * (v / 22.2) ** alpha + noise * rng.standard_normal(t.size), "voltage_v": np.full(t.size, v)}, {},
        )
        for i, v in enumerate(volts)
    ]  # fmt: skip


def test_the_battery_is_not_in_the_floor_of_the_thrust():
    """With repeats at 24.8 to 22 V as they are, the floor is the battery's, and thrust that is 3 % off passes."""
    rng, volts = np.random.default_rng(9), (24.8, 23.6, 22.7, 22.0)
    lower = tuple(v - 0.15 for v in volts)  # the twin's pack
    real = throttled(rng, volts)
    for gain, passes in ((1.0, True), (1.03, False)):
        twin = throttled(rng, lower, gain=gain)
        assert (flown_errors(real, twin, 1.6, 22.2)["f_z_m_s2"]["ratio"] < 1.2) == passes
        assert flown_errors(real, twin)["f_z_m_s2"]["ratio"] < 1.2
    assert flown_errors(real, throttled(rng, lower), 1.6, 22.2)["f_z_m_s2"]["floor"] < 0.04


def test_a_hold_of_another_length_before_the_step_is_no_other_thrust():
    rng, volts = np.random.default_rng(10), (23.0,) * 20
    found = flown_errors(throttled(rng, volts, noise=0.09), throttled(rng, volts, held_s=0.45, noise=0.09))["f_z_m_s2"]
    assert found["ratio"] < 1.2
