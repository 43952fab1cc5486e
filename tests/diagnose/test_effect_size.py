"""How large an effect in free flight is, by the residuals of models without and with it."""

import numpy as np
import pytest

from flighttest.diagnose.free_flight.effect_size import EffectSize
from flighttest.estimation.drift import DRIFT
from flighttest.estimation.equation_error import Stream

T_S = np.arange(0.0, 60.0, 0.01)
SWING = np.sqrt(2.0) * np.sin(3.5 * T_S)  # 1 RMS


def effect_of(flights, noise_m_s2, channel="f_x_m_s2"):
    """Of what a term changes in each flight (n,), beside white noise."""
    rng = np.random.default_rng(7)
    left = [rng.normal(0.0, noise_m_s2, T_S.size) for _ in flights]
    none = np.zeros((T_S.size, 0))
    without = [Stream(channel, k, r + e, none) for k, (e, r) in enumerate(zip(flights, left, strict=True))]
    return EffectSize.of(without, [Stream(channel, k, r, none) for k, r in enumerate(left)])


def test_sizes_and_floors_are_root_mean_squares():
    found = effect_of([0.03 * SWING, 0.01 + 0.03 * SWING], 0.06)
    assert found.sizes["f_x_m_s2"] == pytest.approx(np.sqrt(0.03**2 + 0.5 * 0.01**2), rel=0.01)
    assert found.floors["f_x_m_s2"] == pytest.approx(0.5, rel=0.02)


def test_what_changes_in_a_flight_has_a_name_from_seven_tenths_of_its_noise_on():
    """A load of 0.035 of the mass swings ArduPilot's simulator by 0.05 m/s^2, beside noise of 0.013 m/s^2."""
    assert effect_of([0.03 * SWING], 0.03 / 0.65).too_small()
    assert not effect_of([0.03 * SWING], 0.03 / 0.75).too_small()


def test_what_stays_for_all_of_a_flight_has_a_name_from_what_instruments_drift_by_on():
    drift = DRIFT["f_x_m_s2"]
    still = np.ones(T_S.size)
    assert effect_of([0.95 * drift * still, -0.95 * drift * still], 1e-3).too_small()
    assert not effect_of([1.05 * drift * still], 1.0).too_small()


def test_one_channel_in_which_it_is_large_is_enough():
    large, small = effect_of([0.1 * SWING], 0.5, "f_z_m_s2"), effect_of([0.01 * SWING], 0.5)
    assert not EffectSize({**small.sizes, **large.sizes}, {**small.floors, **large.floors}).too_small()
    assert "0.01 m/s^2 RMS, is below what estimates drift by, and changes by 0.02 of the noise" in small.too_small()
