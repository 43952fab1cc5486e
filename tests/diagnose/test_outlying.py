"""Responses that were pushed once are set aside and reported; what repeats share is the vehicle's own and stays."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flight import campaign, fly

from flighttest.diagnose.residuals.outlying import LEAST, outlying, outlying_in_words, set_aside
from flighttest.identify.fit import fit


def response(cell, t_s, kind="throttle_step"):
    return SimpleNamespace(kind=kind, cell_key=(kind, cell), t_s=np.array([t_s, t_s + 1.0]), run="flight")


def flown(pushes, kind="throttle_step", repeats=2):
    """Two (or so) repeats of each cell, one after the other round of cells."""
    cells = len(pushes) // repeats
    return [response(i % cells, 10.0 * i, kind) for i in range(len(pushes))]


def state(north, up=None):
    north = np.asarray(north, dtype=float)
    local = {
        "a_d_x_m_s2": north,
        "a_d_y_m_s2": np.zeros_like(north),
        "a_d_z_m_s2": np.asarray(up if up is not None else 0 * north),
    }
    return local


USUAL = np.tile([0.05, -0.04, 0.02, -0.03], 5)


def test_a_gust_that_came_once_is_found_and_reported():
    pushed = USUAL.copy()
    pushed[[3, 4]] = 1.5, 1.8
    segments = flown(pushed)
    found = outlying(state(pushed), segments)
    assert list(found) == [3, 4]
    assert found[4] == pytest.approx(1.8, abs=0.1)
    assert "2 of 20 responses, between 30 and 40 s of flight, were pushed by up to 1.8 m/s^2" in outlying_in_words(
        found, segments
    )


def test_a_push_from_below_counts_too():
    up = np.zeros(20)
    up[7] = -1.0
    segments = flown(up)
    found = outlying(state(USUAL, up), segments)
    assert list(found) == [7]
    assert "1 of 20 responses, at 70 s of flight, was pushed by up to 1.0 m/s^2" in outlying_in_words(found, segments)


def test_what_its_repeat_shares_is_the_vehicles_own():
    pushed = USUAL.copy()
    pushed[[3, 13]] = 1.5, 1.4
    assert outlying(state(pushed), flown(pushed)) == {}


def test_usual_weather_is_no_exception():
    rng = np.random.default_rng(0)
    pushed = rng.normal(0.0, 0.3, 40)
    assert outlying(state(pushed), flown(pushed)) == {}


def test_what_comes_in_every_second_response_is_no_exception():
    pushed = np.zeros(20)
    pushed[:9] = 2.0
    assert outlying(state(pushed), flown(pushed)) == {}


def test_free_flight_has_no_repeats_and_what_was_not_measured_no_push():
    pushed = USUAL.copy()
    pushed[3] = 2.0
    assert outlying(state(pushed), flown(pushed, kind="free")) == {}
    assert outlying({}, flown(pushed)) == {}


@pytest.mark.parametrize("count", [LEAST - 1, LEAST])
def test_few_responses_do_not_determine_what_is_usual(count):
    steps = [replace(step, repeat=k % 2) for step in campaign(1, throttles=False, yaws=False) for k in (0, 1)]
    segments = tuple(fly(steps[:count], gust=((3,), -2.0)))
    kept, aside = set_aside(segments, fit(segments, select="all", robust=False).start.nuisance)
    assert len(kept) == (count if count < LEAST else count - 1)
    assert bool(aside) is (count == LEAST)
