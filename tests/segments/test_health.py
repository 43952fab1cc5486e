"""What is said of a recording before anything is fitted, against recordings whose faults are known."""

import numpy as np
import pytest

from flighttest.recording import Marker, Provenance, Recording, Series
from flighttest.segments import health

RATE_HZ = 200.0


def recording(**columns):
    t = np.arange(0.0, 40.0, 1 / RATE_HZ)
    force = {"f_z_m_s2": 9.81 + 2.0 * np.sqrt(2.0) * np.sin(2 * np.pi * 31.0 * t), **columns}
    marks = (Marker(0.0, "mode", "STABILIZE"), Marker(10.0, "mode", "LOITER"))
    return Recording("r", {"specific_force": Series(t, force)}, marks, Provenance("a", "table"))


def test_a_gap_and_its_share_are_found():
    r = recording()
    t = r.series["specific_force"].t_s
    keep = (t < 10.0) | (t >= 14.0)
    cut = Series(t[keep], {n: v[keep] for n, v in r.series["specific_force"].columns.items()})
    (found,) = health.sampling(Recording("r", {"specific_force": cut}, (), r.provenance))
    assert found.rate_hz == pytest.approx(RATE_HZ)
    assert (found.gaps, found.longest_at_s) == (1, pytest.approx(10.0 - 1 / RATE_HZ))
    assert found.longest_s == pytest.approx(4.0, abs=0.01)
    assert found.lost == pytest.approx(0.1, abs=0.001)
    assert health.sampling(r)[0].gaps == 0


def test_vibration_is_found_at_its_frequency_with_its_size():
    (found,) = health.spectra(recording())
    assert found.peak_hz == pytest.approx(31.0, abs=0.25)
    assert found.rms == pytest.approx(2.0, rel=0.03)
    assert found.frequency_hz[-1] == pytest.approx(RATE_HZ / 2)


def test_a_clipped_sensor_and_a_throttle_at_its_end_are_found():
    t = np.arange(0.0, 40.0, 1 / RATE_HZ)
    clipped = recording(f_z_m_s2=np.minimum(9.81 + 5.0 * np.sin(t), 12.0))
    (found,) = health.at_limits(clipped)
    assert (found.channel, found.limit) == ("f_z_m_s2", 12.0)
    assert found.share == pytest.approx(np.mean(9.81 + 5.0 * np.sin(t) >= 12.0), abs=1e-3)
    assert health.at_limits(recording()) == ()
    throttle = Series(t, {"throttle": np.where(t < 4.0, 1.0, 0.5)})
    full = Recording("r", {"reference": throttle}, (), Provenance("a", "table"))
    (found,) = health.at_limits(full)
    assert (found.limit, found.at_s) == (1.0, 0.0)
    assert found.share == pytest.approx(0.1, abs=0.01)


def test_modes_have_their_times_and_the_battery_its_numbers():
    r = recording()
    assert [(m[0], m[2]) for m in health.modes(r)] == [(0.0, "STABILIZE"), (10.0, "LOITER")]
    assert health.battery_course(r) is None
    t = np.arange(0.0, 40.0, 0.1)
    battery = Series(t, {"voltage_v": 25.0 - 0.05 * t, "current_a": np.full(t.size, 36.0)})
    found = health.battery_course(Recording("r", {**r.series, "battery": battery}, (), r.provenance))
    assert found.first_v == 25.0
    assert found.drawn_ah == pytest.approx(36.0 * 39.9 / 3600.0)


def flown(correlated: float, size_rad: float = 0.1, late_s: float = 0.1):
    """A pitch that answers its command so much later, with noise that makes their correlation so."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.02)
    asked = size_rad * np.sin(2 * np.pi * 0.4 * t) * np.sign(np.sin(0.9 * t))
    answer = np.interp(t - late_s, t, asked)
    noise = answer.std() * np.sqrt(1.0 / correlated**2 - 1.0) * rng.standard_normal(t.size)
    series = {
        "attitude": Series(t, {"pitch_rad": answer + noise}),
        "reference": Series(t, {"pitch_ref_rad": asked, "throttle": np.full(t.size, 0.3)}),
    }
    return Recording("r", series, (), Provenance("a", "table"))


@pytest.mark.parametrize("correlated", [0.7, 0.85, 0.97])
def test_how_a_channel_follows_its_command_is_measured_at_its_delay(correlated):
    (found,) = health.following(flown(correlated))
    assert (found.channel, found.reference) == ("pitch_rad", "pitch_ref_rad")
    assert found.correlation == pytest.approx(correlated, abs=0.015)
    assert found.delay_s == pytest.approx(0.1, abs=0.021)


def test_a_command_too_small_to_be_followed_is_not_judged():
    assert health.following(flown(0.5, size_rad=0.01)) == ()
