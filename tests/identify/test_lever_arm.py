"""An accelerometer away from the centre of mass of a vehicle that is turned by references and by gusts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from flighttest.identify.free_flight import estimate, stretches
from flighttest.physics.model import Model
from tests.identify.test_free_flight import NAMES, flight

WITH_ARM = Model(attitude_loops=False).with_terms("imu_lever_arm")
FINE = 20  # steps of integration in a sample of 50 Hz
FILTER_HZ = 20.0  # ArduPilot's default of gyroscope and accelerometer


def turned(above_m, seed, gust=0.0, every=1, filtered=False):
    """60 s at 50 Hz, or each second or fifth sample of it: jumps of the reference pitch, a loop of 10 rad/s, motors of 0.03 s.

    gust: rad/s^2 RMS, of 0.1 s, which pushes by -0.27 m/s^2 for each rad/s^2; filtered: gyroscope and accelerometer are.
    """
    (whole,) = stretches(flight(60, seed, gust=0.05))
    rng, n, period = np.random.default_rng(seed), whole.t_s.size, float(np.median(np.diff(whole.t_s)))
    h = period / FINE
    jumps = np.arange(0, n * FINE, 40 * FINE) + rng.integers(0, FINE, n // 40 + 1)
    values = 0.1 * rng.standard_normal(jumps.size)
    wanted = np.append(0.0, values)[np.searchsorted(jumps, np.arange(n * FINE), side="right")]
    pushed = lfilter([np.sqrt(2.0 * h / 0.1)], [1.0, h / 0.1 - 1.0], gust * rng.standard_normal(n * FINE))
    angle = rate = by_motors = 0.0
    rows = np.zeros((n * FINE, 2))
    for k in range(n * FINE):
        by_motors += h / 0.03 * (100.0 * (wanted[k] - angle) - 14.0 * rate - by_motors)
        turning = by_motors + pushed[k]
        rate += h * turning
        angle += h * rate
        rows[k] = rate, turning
    w = 2.0 * np.pi * FILTER_HZ
    low_pass = bilinear([w * w], [1.0, np.sqrt(2.0) * w, w * w], 1.0 / h)
    rates = rows[:, 0]
    ahead, up = above_m * rows[:, 1] - 0.27 * pushed, -above_m * rates**2
    seen = [lfilter(*low_pass, x) if filtered else x for x in (rates, ahead, up)]
    rates, ahead, up = (x[::FINE] for x in seen)
    still = np.zeros(n)
    force, lift = whole.y["f_x_m_s2"] + ahead, whole.y["f_z_m_s2"] + up
    y = {**whole.y, "f_x_m_s2": force, "f_z_m_s2": lift, "p_rad_s": still, "q_rad_s": rates, "r_rad_s": still}
    known = {"rates": FILTER_HZ, "specific_force": FILTER_HZ} if filtered else {}
    return replace(
        whole, t_s=whole.t_s[::every], y={name: x[::every] for name, x in y.items()}, context=replace(whole.context, filters=known),
        u={**whole.u, "pitch_ref_rad": (whole.t_s[0] + jumps * h, values)},
    )  # fmt: skip


def arm_of(known):
    return estimate([known], WITH_ARM, free=(*NAMES, "arm_z")).values["arm_z"]


@pytest.mark.parametrize("above_m", [0.0, 0.1])
def test_what_gusts_turn_is_no_lever_arm_of_the_accelerometer(above_m):
    """Gusts that push and turn at once: an accelerometer in the centre of mass seemed to be 0.27 m below it in flights of the real
    firmware, and one 0.057 m above it 0.010 m."""
    assert arm_of(turned(above_m, 5, gust=1.0)) == pytest.approx(above_m, abs=0.006)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_a_quick_turn_is_resolved(every):
    """References that jump between samples of 50, 25 and 10 Hz."""
    assert arm_of(turned(0.1, 5, every=every)) == pytest.approx(0.1, abs=0.006)


@pytest.mark.parametrize("every", [1, 2])
def test_filters_of_the_instruments_do_not_lengthen_an_arm(every):
    """Known filters of 20 Hz: behind a line from sample to sample they made 0.1026 m of it at 50 Hz and 0.1057 m at 25; with the rates
    11 ms early it is 0.095 and 0.097."""
    assert arm_of(turned(0.1, 5, every=every, filtered=True)) == pytest.approx(0.1, abs=0.002)
