"""What errors of a prediction are counted in."""

from types import SimpleNamespace

import pytest
from flight import TRUE, campaign, fly

from flighttest.diagnose import Verdict
from flighttest.diagnose.records import FROM_REPEATS, FROM_RESIDUAL
from flighttest.diagnose.residuals.prediction import floors_of, prediction_quality
from flighttest.identify.fit import fit
from flighttest.physics.model import Model

CHANNEL = "f_x_m_s2"
FIT = SimpleNamespace(quality={CHANNEL: SimpleNamespace(rmse=0.10, floor=0.07)})


def diagnosed(verdict, **row):
    return SimpleNamespace(verdict=verdict, noise_floor={"f_x": row} if row else {})


@pytest.mark.parametrize("verdict", [Verdict.NOTHING_MISSING, Verdict.EXPLAINED])
def test_where_nothing_was_repeated_what_a_whole_model_leaves_is_noise(verdict):
    """12 unrepeated steps of a twin's own model: the fast part said 0.082 m/s2, the fit left 0.100 and so did every other flight."""
    assert floors_of(FIT, diagnosed(verdict, value=0.08, **{"from": FROM_RESIDUAL})) == {CHANNEL: 0.10}


@pytest.mark.parametrize("verdict", [Verdict.PARTLY, Verdict.UNKNOWN_PHYSICS])
def test_what_a_model_that_lacks_something_leaves_is_no_noise(verdict):
    assert floors_of(FIT, diagnosed(verdict, value=0.08, **{"from": FROM_RESIDUAL})) == {CHANNEL: 0.08}


@pytest.mark.parametrize("verdict", list(Verdict))
def test_repeats_are_taken_whatever_the_fit_leaves(verdict):
    assert floors_of(FIT, diagnosed(verdict, value=0.08, **{"from": FROM_REPEATS})) == {CHANNEL: 0.08}


def test_a_channel_that_was_not_diagnosed_has_the_fast_part_of_its_residual():
    assert floors_of(FIT, diagnosed(Verdict.NOTHING_MISSING)) == {CHANNEL: 0.07}


def test_a_delay_that_is_the_runs_own_is_estimated_and_nothing_else():
    """A link that came 3 ms later for all of a run is no error of the vehicle; a yaw rate that is followed more slowly is one."""
    segments = fly(campaign(2, throttles=False, tilts=False))
    model = Model(("linear_drag",))
    found = fit(segments, model, select="all")
    assert found.values["T_d_yaw_rate"] == pytest.approx(TRUE["T_d"], abs=0.002)
    later = found.values | {"T_d_yaw_rate": found.values["T_d_yaw_rate"] - 0.003}
    slower = found.values | {"sigma_r": 0.8 * found.values["sigma_r"]}

    def error(values, free=()):
        made = prediction_quality(segments, model, values, found.noise, free)
        return made["r_rad_s"].rmse / found.quality["r_rad_s"].rmse

    assert error(later) > 1.2
    assert error(later, ("T_d_yaw_rate",)) == pytest.approx(1.0, abs=0.02)
    assert error(slower, ("T_d_yaw_rate",)) > 1.2
