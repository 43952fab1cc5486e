import numpy as np
import pytest

from flighttest.segments import Segment, cut, metrics_of


def test_numbers_of_a_response_that_is_known(campaign):
    roll, yaw, *_ = cut(campaign.recording())
    m = metrics_of(roll)
    # Two equal lags of 0.06 s after 0.05 s: 5 % at 0.3554 lags, 10 to 90 % in 3.358 lags, 5 % band from 4.744 lags on.
    assert m.delay_s == pytest.approx(0.05 + 0.3554 * 0.06, abs=0.004)
    assert m.rise_s == pytest.approx(3.358 * 0.06, abs=0.006)
    assert m.settling_s == pytest.approx(0.05 + 4.744 * 0.06, abs=0.02)
    assert m.overshoot == pytest.approx(0.0, abs=1e-3)
    assert m.steady_error == pytest.approx(0.0, abs=2e-3)
    assert metrics_of(yaw).channel == "r_rad_s"
    assert metrics_of(yaw).change == pytest.approx(-1.0, abs=1e-3)


def test_a_throttle_step_has_no_steady_error(campaign):
    step = next(s for s in cut(campaign.recording()) if s.kind == "throttle_step")
    m = metrics_of(step)
    assert m.channel == "f_z_m_s2"
    assert m.change == pytest.approx(0.3 * 9.81 / 0.25, rel=0.01)
    assert m.steady_error is None


def made(y, kind="roll_step", cell=None):
    t = np.arange(-0.3, 1.0, 0.02)
    reference = (np.array([-1.0, 0.0]), np.array([0.0, 0.3]))
    return Segment(
        "s", "r", kind, cell or {"amplitude_rad": 0.3}, 1, 0.0, t, {"roll_rad": y(t)}, {"roll_ref_rad": reference}
    )


def test_overshoot_of_an_oscillation():
    m = metrics_of(made(lambda t: np.where(t > 0, 0.3 * (1 - np.exp(-8 * np.maximum(t, 0)) * np.cos(12 * t)), 0.0)))
    t = np.linspace(0, 1, 10001)
    assert m.overshoot == pytest.approx(np.max(1 - np.exp(-8 * t) * np.cos(12 * t)) - 1, abs=0.01)


def test_what_has_no_meaning_is_none():
    silent = metrics_of(made(lambda t: 0.0 * t))
    assert (silent.delay_s, silent.rise_s) == (None, None)
    unsettled = metrics_of(made(lambda t: np.maximum(t, 0.0)))
    assert (unsettled.overshoot, unsettled.settling_s, unsettled.steady_error) == (None, None, None)
    assert metrics_of(made(lambda t: t, kind="free")) is None
    assert metrics_of(made(lambda t: t, kind="pitch_step")) is None
    assert metrics_of(made(lambda t: t * np.nan)).delay_s is None
