"""Free flight whose velocity was not recorded, as without a satellite receiver: the accelerometer shows the thrust."""

from dataclasses import replace

import pytest

from flighttest.diagnose import diagnose
from flighttest.diagnose.model import Verdict
from flighttest.identify.fit import fit
from flighttest.identify.free_flight import parts_by_prediction_errors, stretches
from flighttest.identify.free_flight.winds import winds
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import fit_segments
from tests.identify.test_free_flight import DELAY_S, GAIN, SIGMA, flight

HORIZONTAL = ("v_x_m_s", "v_y_m_s")
EVERY = (*HORIZONTAL, "v_z_m_s")
THRUST = {"K": GAIN, "sigma_t": SIGMA, "T_d_thrust": DELAY_S}


def without(names, segments):
    """Segments in which these channels were not recorded."""
    return [replace(s, y={n: v for n, v in s.y.items() if n not in names}) for s in segments]


@pytest.mark.parametrize("missing", [HORIZONTAL, EVERY])
def test_the_thrust_is_estimated_by_prediction_errors(missing):
    """In gusts that a position loop answers."""
    segments = without(missing, flight(60.0, 30))
    assert "translation" in parts_by_prediction_errors(segments)
    made = fit_segments(segments, [])
    for name, truth in THRUST.items():
        low, high = made.estimates[name].interval_95
        assert low < truth < high, name
        assert made.estimates[name].identifiable


def test_output_error_takes_an_answer_to_gusts_for_their_cause():
    """Its lag of twelve such flights without horizontal velocity is off by 7.5 1/s (root mean square), that of prediction errors by 1.0."""
    segments = without(HORIZONTAL, flight(60.0, 30))
    by_output, by_prediction = (
        made.values["sigma_t"] - SIGMA
        for made in (fit(segments, Model(attitude_loops=False)), fit_segments(segments, []))
    )
    assert abs(by_prediction) < 0.5 * abs(by_output)


@pytest.mark.parametrize("missing", [HORIZONTAL, EVERY])
def test_drag_along_an_axis_without_velocity_is_assumed(missing):
    """A pilot's answer to gusts says nothing of how the air drags."""
    made = fit_segments(without(missing, flight(20.0, 31)), [])
    for name, channel in (("d_x", "v_x_m_s"), ("d_y", "v_y_m_s"), ("d_z", "v_z_m_s")):
        drag = made.estimates[name]
        assert (drag.source == "assumed") == (channel in missing), name
        if channel in missing:
            assert drag.value == Model().param[name].nominal
            assert "while velocity was recorded" in drag.why


@pytest.mark.parametrize("seed", [33, 34])
def test_intervals_hold_where_the_drag_is_not_the_one_assumed(seed):
    """Of d_z 1.5 1/s, where 0.51 is assumed: without the velocity that the accelerometer adds up to, an interval of the lag misses it."""
    made = fit_segments(without(EVERY, flight(60.0, seed, drag=(0.6, 0.6, 1.5))), [])
    for name, truth in THRUST.items():
        low, high = made.estimates[name].interval_95
        assert low < truth < high, name


def test_a_bias_of_the_accelerometer_is_no_velocity():
    """Added up over two seconds a bias of -1.6 m/s^2, as a log of 2014 has, was a fall of 3 m/s, whose drag took a sixth of the gain."""
    segments = without(EVERY, flight(40.0, 35))
    off = [replace(s, y={**s.y, "f_z_m_s2": s.y["f_z_m_s2"] - 1.6}) for s in segments]
    shown = GAIN * (9.81 - 1.6) / 9.81
    assert fit_segments(off, []).values["K"] == pytest.approx(shown, rel=0.05)  # steps have the gain itself


def test_a_wind_is_named_neither_as_such_nor_as_an_offset():
    """Without a velocity its force along the body is that of an attitude offset: 0.04 rad had the name in a wind of 3 m/s."""
    segments = without(HORIZONTAL, flight(60.0, 71, wind=(3.0, 0.0)))
    found = diagnose(segments, only=("steady_wind", "attitude_offset", "accelerometer_bias"))
    assert found.verdict == Verdict.NOTHING_MISSING
    assert {u.term for u in found.untestable} == {"steady_wind", "attitude_offset", "accelerometer_bias"}
    assert winds(segments, Model(attitude_loops=False)) is None


def test_a_flight_with_velocity_in_some_stretches_is_estimated_from_these():
    """Without an accelerometer, stretches without velocity have no equation."""
    windows = flight(60.0, 36, accelerometer=False)
    some = [*windows[:12], *without(EVERY, windows[14:])]
    assert [s.t_s[0] for s in stretches(some)] == [windows[0].t_s[0]]
