"""Attitude between the samples of a slow log, by the gyroscope."""

import numpy as np
import pytest

from flighttest.estimation.responses import attitude_angles
from flighttest.frames import euler_rates_from_body
from flighttest.segments.model import Segment

HZ, LOGGED = 50.0, 5  # every fifth attitude was logged
BIAS_RAD_S = 0.05


def recorded(angles: np.ndarray, rates: np.ndarray | None) -> Segment:
    """A stretch with angles (n, 3) of which few were logged, and rates (n, 3) at every sample."""
    t = np.arange(len(angles)) / HZ
    y = {}
    for k, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad")):
        y[name] = np.where(np.arange(t.size) % LOGGED == 0, angles[:, k], np.nan)
    if rates is not None:
        y |= {f"{axis}_rad_s": rates[:, k] for k, axis in enumerate("pqr")}
    return Segment("a", "run", "free", {}, 1, 0.0, t, y, {})


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Angles and body rates: 3 Hz in pitch, slower in roll and yaw, with a gyroscope that has a bias."""
    t = np.arange(0.0, 10.0, 1.0 / HZ)
    wave = np.stack([0.2 * np.sin(3.0 * t), 0.05 * np.sin(2.0 * np.pi * 3.0 * t), 0.5 * t], axis=1)
    slope = np.stack([0.6 * np.cos(3.0 * t), 0.3 * np.pi * np.cos(6.0 * np.pi * t), 0.5 + 0.0 * t], axis=1)
    (phi, theta), (dphi, dtheta, dpsi) = wave.T[:2], slope.T
    p = dphi - dpsi * np.sin(theta)
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(phi) * np.cos(theta) * dpsi
    return wave, np.stack([p, q, r], axis=1)


def test_euler_rates_are_the_slopes_of_the_angles():
    angles, rates = motion()
    assert np.allclose(
        np.gradient(angles, 1.0 / HZ, axis=0)[1:-1], euler_rates_from_body(angles, rates)[1:-1], atol=0.03
    )


@pytest.mark.parametrize(("by_rates", "most"), [(True, 0.05), (False, 0.5)])
def test_a_motion_between_the_samples_is_that_of_the_gyroscope(by_rates, most):
    """A chord between samples of 10 Hz leaves a third of a motion of 3 Hz out; a bias of the gyroscope does not matter."""
    angles, rates = motion()
    found = attitude_angles(recorded(angles, rates + BIAS_RAD_S if by_rates else None))
    inside = slice(LOGGED, -LOGGED)
    error = np.std((found - angles)[inside, 1]) / np.std(angles[inside, 1])
    assert error < most
    assert by_rates or error > 0.25
    assert np.allclose(found[::LOGGED], angles[::LOGGED], atol=1e-9)


def test_what_was_logged_at_every_sample_stays_as_it_is():
    angles, rates = motion()
    whole = recorded(angles, rates)
    for k, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad")):
        whole.y[name][:] = angles[:, k]  # type: ignore[index]
    assert np.array_equal(attitude_angles(whole), angles)
