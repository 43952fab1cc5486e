"""Hops of a small quadrotor, eight of whose sets ended in a mismatch of the vertical velocity that nothing explained."""

from functools import cache

import numpy as np
import pytest

from flighttest.diagnose import Verdict, diagnose
from flighttest.frames import G_M_S2
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.segments import cut

CUT = "controller_data/cut_propeller_M3_0.5mm_46.5mm/*"
WEIGHT = "controller_data/add_weight_W3_near_M3/*"
TWO_VEHICLES = "motor_data/cut_propeller_M3_2mm_2mm_43mm/*"


@cache
def read(folder, files):
    recordings = open_recordings(sorted((folder / "propeller_damage").glob(files)))
    return recordings, tuple(s for r in recordings for s in cut(r))


def diagnosed(folder, files):
    recordings, segments = read(folder, files)
    return diagnose(segments, base_model(recordings, None))


@pytest.mark.slow
def test_the_gain_of_hops_is_the_one_that_holds_the_vehicle_in_the_air(shared_data):
    """19.2 m/s^2 at full throttle; the vehicle hovers at 0.60."""
    found = diagnosed(shared_data, CUT)
    _, segments = read(shared_data, CUT)
    hover = np.median(np.concatenate([s.u["throttle"][1] for s in segments if s.time_since_takeoff_s > 2.0]))
    assert found.verdict is Verdict.NOTHING_MISSING
    assert found.values["K"] == pytest.approx(G_M_S2 / hover, rel=0.02)


@pytest.mark.slow
def test_a_motor_at_its_limit_is_named_where_the_weight_is_beside_it(shared_data):
    """By the recorded torque commands, motor 3 was asked for up to 1.64 of its range in that log (power_distribution_quadrotor.c)."""
    found = diagnosed(shared_data, WEIGHT)
    assert found.accepted == ("motor_saturation",)
    assert found.values["T_max"] == pytest.approx(0.72, abs=0.04)


@pytest.mark.slow
def test_two_vehicles_at_two_voltages_are_no_effect_of_the_voltage(shared_data):
    """Beside a sentence that the battery voltage explained 57 % of the residual's variance, nothing said that the flights differ."""
    found = diagnosed(shared_data, TWO_VEHICLES)
    assert found.verdict is Verdict.NOTHING_MISSING
    assert "within flights, and these differ" in found.sentence
    assert "(E9_log" in found.sentence
    assert "(E8_log" in found.sentence
