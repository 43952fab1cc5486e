"""Score tests on free flight: a term that is there is found, and none where none is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flighttest.diagnose.free_flight.equation_screen import screen
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.diagnose.selection.candidates import acts_in
from flighttest.diagnose.selection.comparison import level_of
from flighttest.identify.free_flight import estimate, stretches
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from tests.identify.test_free_flight import GAIN, NAMES, flight

POOL = tuple(catalogue().values())


@cache
def screened(offset: float) -> dict:
    flown = stretches(flight(150.0, 5, offset=offset))
    base = estimate(flown, Model(attitude_loops=False), free=NAMES, start={"sigma_t": 18.0, "T_d_thrust": 0.06})
    return {s.term: s for s in screen(flown, base, POOL)}


@pytest.mark.slow
def test_a_tilted_thrust_axis_is_found_with_its_size():
    found = screened(0.03)
    first = next(iter(found.values()))
    assert first.term in ("attitude_offset", "accelerometer_bias", "steady_wind")  # one heading does not part them
    offset = found["attitude_offset"]
    assert offset.p_value < 0.01
    assert abs(offset.coefficients["offset_pitch"] - 0.03) < 0.005
    assert 0.1 < offset.size < 0.5  # 0.03 of 9.81 m/s^2


def curved(s):
    """A segment with the throttle that gives the same thrust, times (1 - c) + c times thrust over weight."""
    t, throttle = s.u["throttle"]
    c, linear = 0.8, GAIN * throttle / 9.81
    return replace(s, u={"throttle": (t, (np.sqrt((1 - c) ** 2 + 4 * c * linear) - (1 - c)) / (2 * c) * 9.81 / GAIN)})


@pytest.mark.slow
def test_what_few_blocks_show_surely_is_found():
    """Of 55 s of a figure of eight 16 had climbs: 413 nats of log likelihood, and a score test of p 0.011."""
    flown = [*flight(26.0, 31, run="climbs"), *flight(130.0, 32, run="level", climb=0.0)]
    some = stretches([curved(s) for s in flown])
    base = estimate(some, Model(attitude_loops=False), free=NAMES, start={"sigma_t": 18.0, "T_d_thrust": 0.06})
    found = {s.term: s for s in screen(some, base, POOL)}["throttle_curve"]
    assert found.p_value < level_of(len(POOL))
    assert 0.4 < found.coefficients["curvature"] < 1.2


@pytest.mark.slow
def test_an_error_holds_what_one_block_decides():
    """Estimates of six flights with 9 s of climbs scatter by 0.055; by the sandwich of one step the error was 0.022 here."""
    some = stretches([*flight(9.0, 41, run="climbs"), *flight(80.0, 91, run="level", climb=0.0)])
    base = estimate(some, Model(attitude_loops=False), free=NAMES, start={"sigma_t": 18.0, "T_d_thrust": 0.06})
    found = {s.term: s for s in screen(some, base, POOL)}["throttle_curve"]
    assert 0.055 / 2 < found.std["curvature"] < 0.055 * 2


@pytest.mark.slow
def test_where_nothing_is_missing_no_term_stands_out():
    found = screened(0.0)
    assert len(found) >= 10
    assert min(s.p_value for s in found.values()) > 0.05 / len(found) / 10
    assert np.median([s.p_value for s in found.values()]) > 0.1


@pytest.mark.slow
def test_every_term_of_the_translation_is_looked_at():
    seen = {t.id for t in POOL if acts_in(t, Model(), "translation")}
    assert {"quadratic_drag", "slung_payload", "velocity_latency", "motor_saturation", "thrust_extra_lag"} <= seen
    assert "rate_limit" not in seen
    assert {"slung_payload", "motor_saturation", "thrust_extra_lag"} <= set(screened(0.0))


def test_terms_of_the_loops_are_looked_at_where_they_act():
    roll, yaw = ({t.id for t in POOL if acts_in(t, Model(), part)} for part in ("roll_pitch", "yaw"))
    assert {"airflow_moment", "rate_limit", "rate_feedforward", "roll_pitch_coupling", "turn_axes"} <= roll
    assert {"heading_hold", "heading_rate_reference", "yaw_rate_shaping"} <= yaw
    assert "quadratic_drag" not in roll | yaw


def late(seconds, seed, samples):
    """A flight without accelerometer whose velocity is recorded so many samples late."""
    whole = stretches(flight(seconds, seed, gust=0.2, accelerometer=False))[0]
    y = {
        n: np.concatenate([v[:samples], v[: v.size - samples]]) if n.startswith("v_") else v for n, v in whole.y.items()
    }
    return [replace(whole, y=y)]


@pytest.mark.slow
def test_a_late_velocity_is_named_with_its_latency():
    delays = tuple(catalogue()[t] for t in ("velocity_latency", "thrust_extra_lag", "rotor_speed_lag", "axial_inflow"))
    found = find_terms(late(60.0, 31, 5), Model(attitude_loops=False), delays)
    assert "velocity_latency" in found.named
    assert abs(found.final.values["velocity_latency"] - 0.1) < 0.02
    assert not set(find_terms(late(60.0, 31, 0), Model(attitude_loops=False), POOL).named)
