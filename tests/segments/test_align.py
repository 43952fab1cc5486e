from dataclasses import replace

import numpy as np
import pytest

from flighttest.recording import Provenance, Recording, Series
from flighttest.segments import align, cut
from flighttest.segments.align import prepare_motion, sample
from flighttest.segments.compatibility import Compatibility


def recording(**groups):
    return Recording("r", groups, (), Provenance("x", "table"))


def at(hz, seconds=10.0, shift=0.0):
    return shift + np.arange(round(seconds * hz)) / hz


def force(t, wave):
    return Series(t, {"f_x_m_s2": 0 * t, "f_y_m_s2": 0 * t, "f_z_m_s2": wave})


def attitude(t, roll):
    return Series(t, {"roll_rad": roll, "pitch_rad": 0 * t, "yaw_rad": 0 * t})


@pytest.mark.parametrize(("hz", "rate"), [(400, 50), (250, 50), (100, 50), (60, 60), (50, 50), (25, 25)])
def test_the_rate_is_brought_to_about_50_hz(hz, rate):
    t = at(hz)
    aligned = prepare_motion(recording(specific_force=force(t, 0 * t), attitude=attitude(t, 0 * t)))
    times, _ = sample(aligned, 2.0, 8.0)
    assert 1.0 / np.median(np.diff(times)) == pytest.approx(rate, rel=0.16)


@pytest.mark.parametrize("hz", [400, 200, 100, 50])
def test_averaging_moves_nothing_in_time(hz):
    t = at(hz)
    aligned = prepare_motion(recording(specific_force=force(t, 9.81 + t**2), attitude=attitude(t, 0.3 * t)))
    times, y = sample(aligned, 2.0, 8.0)
    np.testing.assert_allclose(y["roll_rad"], 0.3 * times, atol=1e-9)
    np.testing.assert_allclose(y["f_z_m_s2"], 9.81 + times**2, atol=1e-4)


def test_yaw_is_read_off_through_its_jump():
    t = at(100.0)
    yaw = (2.9 + 0.5 * t + np.pi) % (2 * np.pi) - np.pi
    aligned = prepare_motion(recording(attitude=Series(t, {"roll_rad": 0 * t, "pitch_rad": 0 * t, "yaw_rad": yaw})))
    times, y = sample(aligned, 0.0, 2.0)
    np.testing.assert_allclose(np.diff(y["yaw_rad"]), 0.5 * np.diff(times), atol=1e-9)


def test_gaps_are_not_bridged():
    t = at(50.0)
    v = Series(t[(t < 4) | (t > 5)], {"v_x_m_s": t[(t < 4) | (t > 5)]})
    aligned = prepare_motion(recording(specific_force=force(t, 0 * t), velocity=v))
    times, y = sample(aligned, 3.0, 6.0)
    missing = np.isnan(y["v_x_m_s"])
    assert np.array_equal(missing, (times > 3.985) & (times < 5.015))


def test_slow_attitude_keeps_its_own_times():
    ti, ta = at(25.0), at(10.0, shift=0.013)
    aligned = prepare_motion(recording(specific_force=force(ti, 0 * ti), attitude=attitude(ta, np.sin(5 * ta))))
    times, y = sample(aligned, 2.0, 4.0)
    known = np.isfinite(y["roll_rad"])
    assert known.sum() == 20
    np.testing.assert_allclose(y["roll_rad"][known], np.sin(5 * times[known]), atol=1e-12)
    assert np.all(np.diff(times) > 0)


@pytest.mark.parametrize("shift", [0.0, 0.01])
def test_the_time_base_falls_on_velocity_samples_where_it_can(shift):
    t, tv = at(100.0), at(50.0, shift=shift)
    v = Series(tv, {"v_z_m_s": np.where(tv < 5.0, 0.0, tv - 5.0)})
    aligned = prepare_motion(recording(specific_force=force(t, 0 * t), velocity=v))
    times, y = sample(aligned, 4.0, 6.0)
    # Between two samples the chord would cut the corner by 5 mm/s.
    np.testing.assert_allclose(y["v_z_m_s"], np.maximum(times - 5.0, 0.0), atol=1e-9)


def test_rates_are_read_at_their_own_samples_where_the_force_was_moved(monkeypatch):
    """A force 2.5 ms late moves no rate: a chord across the corner of a step would be off by 2.5 % of the step."""
    monkeypatch.setattr(align, "compatibility", lambda *_: Compatibility(0.0, 0.001, 0.0025, 0.001, 0.0, 0.005, 6))
    t = at(100.0)
    jump = np.where(t < 5.005, 0.0, 1.0 - np.exp(-21.5 * (t - 5.005)))
    still = Series(t, dict.fromkeys(("v_x_m_s", "v_y_m_s", "v_z_m_s"), 0 * t))
    rates = Series(t, {"p_rad_s": 0 * t, "q_rad_s": 0 * t, "r_rad_s": jump})
    swing = force(t, 9.81 + np.sin(12.0 * t))  # 2 Hz
    times, y = sample(prepare_motion(recording(specific_force=swing, rates=rates, velocity=still)), 4.0, 6.0)
    true = np.where(times < 5.005, 0.0, 1.0 - np.exp(-21.5 * (times - 5.005)))
    np.testing.assert_allclose(y["r_rad_s"], true, atol=1e-9)
    np.testing.assert_allclose(y["f_z_m_s2"], 9.81 + np.sin(12.0 * (times + 0.0025)), atol=1e-3)


def test_world_acceleration_follows_from_force_and_attitude():
    t = at(50.0)
    aligned = prepare_motion(recording(specific_force=force(t, 10.0 + 0 * t), attitude=attitude(t, 0.2 + 0 * t)))
    _, y = sample(aligned, 1.0, 2.0)
    np.testing.assert_allclose(y["a_y_m_s2"], -10.0 * np.sin(0.2), atol=1e-12)
    np.testing.assert_allclose(y["a_z_m_s2"], 10.0 * np.cos(0.2) - 9.81, atol=1e-12)


def test_nothing_recorded_gives_nothing():
    t = at(10.0)
    assert prepare_motion(recording(battery=Series(t, {"voltage_v": 0 * t}))) is None


def test_a_stream_that_was_quicker_on_the_ground_is_read_in_the_air():
    """Battery at 200 Hz for a while before the flight, at 10 Hz in it: a tenth of a second is no gap there."""
    quick, slow = np.arange(0.0, 10.0, 0.005), np.arange(10.0, 20.0, 0.1)
    t_s = np.concatenate([quick, slow])
    moving = np.arange(0.0, 20.0, 0.02)
    still = Series(moving, dict.fromkeys(("v_x_m_s", "v_y_m_s", "v_z_m_s"), 0 * moving))
    found = recording(velocity=still, battery=Series(t_s, {"voltage_v": 24.0 - 0.05 * t_s}))
    t, y = sample(prepare_motion(found), 12.0, 15.0)
    assert y["voltage_v"] == pytest.approx(24.0 - 0.05 * t)
    missing = replace(found, series={**found.series, "battery": without(found.series["battery"], 13.0, 14.0)})
    t, y = sample(prepare_motion(missing), 12.0, 15.0)
    assert np.isnan(y["voltage_v"][(t > 13.01) & (t < 13.89)]).all()


def without(series: Series, start_s: float, end_s: float) -> Series:
    keep = (series.t_s < start_s) | (series.t_s >= end_s)
    return Series(series.t_s[keep], {n: v[keep] for n, v in series.columns.items()})


def test_a_specific_force_without_one_axis_gives_no_world_acceleration(fly):
    recording = fly([(6.0, 0.0, 0.0, 0.0, 0.25)]).recording()
    force = recording.series["specific_force"]
    two = {n: v for n, v in force.columns.items() if n != "f_y_m_s2"}
    series = {**recording.series, "specific_force": Series(force.t_s, two)}
    found = cut(type(recording)(recording.name, series, (), recording.provenance))
    assert found
    assert all("f_z_m_s2" in s.y and "a_z_m_s2" not in s.y for s in found)
