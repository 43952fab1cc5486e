"""What is flown together, and only from where it differs, is what is flown alone from its start."""

import numpy as np
import pytest

from flighttest.pipeline.planning.checking import predictor_for
from flighttest.plan import compile_plan
from flighttest.plan.batched import Request, fly_rows
from flighttest.plan.model import BranchingPredictor
from flighttest.plan.rehearse import Row, rehearse
from flighttest.script.load import load_script
from flighttest.script.profiles import Piece
from flighttest.script.shipped import resolve
from flighttest.vehicle.model import DEFAULT_VEHICLE

PRIOR = predictor_for(None, DEFAULT_VEHICLE)
STOP = (0.05, 0.33)


class Plain:
    """The same prior, which cannot take a flight up again: each row is flown from its start."""

    def __init__(self, prior):
        self.delay_s, self.thrust_lag_s, self.attitude_lag_s = prior.delay_s, prior.thrust_lag_s, prior.attitude_lag_s
        self.hover_throttle, self.fly = prior.hover_throttle, prior.fly


def throttle(t0, t1, hold, record, volts):
    lead = (Piece("entry", 0.3), Piece("hold", hold, throttle=t0), Piece("step", record, throttle=t1, record=True))
    return Row(lead, ("vertical",), None, 0.3, volts, STOP)


def tilt(angle, volts):
    lead = (Piece("entry", 0.3), Piece("step", 0.9, pitch_rad=angle, record=True))
    return Row(lead, ("counter", "vertical"), Piece("counter", 0.0, pitch_rad=-angle), 0.5, volts, STOP)


def test_links_lost_on_the_way_give_the_flights_that_losing_them_from_the_start_gives():
    rows = []
    for row in (
        throttle(0.1, 0.3, 0.5, 0.85, 24.5),
        throttle(0.3, 0.08, 0.4, 0.91, 21.5),
        tilt(0.4, 22.0),
        tilt(-0.3, 24.0),
    ):
        rows += [row, *(row.losing_link_at(t) for t in (0.0, 0.37, 0.8, row.lead_s, row.lead_s + 0.31))]
    apart = rehearse(rows, Plain(PRIOR), 0.04)
    together = fly_rows(Request(rows, 0.04), PRIOR)
    np.testing.assert_allclose(together.motion.p_m, apart.motion.p_m, atol=1e-9)
    np.testing.assert_allclose(together.motion.v_m_s, apart.motion.v_m_s, atol=1e-9)
    planned = [i for i, row in enumerate(rows) if row.of is None]
    np.testing.assert_allclose(together.reach_low_m[planned], apart.reach_low_m[planned], atol=1e-9)
    np.testing.assert_allclose(together.reach_high_m[planned], apart.reach_high_m[planned], atol=1e-9)
    np.testing.assert_allclose(together.counter_s[planned], apart.counter_s[planned], atol=1e-9)
    np.testing.assert_allclose(together.vertical_s[planned], apart.vertical_s[planned], atol=1e-9)
    assert together.motion.p_m[1, -1, 2] != pytest.approx(together.motion.p_m[0, -1, 2], abs=0.1), "a lost link matters"


def test_what_else_is_flown_changes_nothing():
    some = [throttle(0.1, 0.3, 0.5, 0.9, 24.5), throttle(0.1, 0.3, 0.5, 0.9, 24.5).losing_link_at(0.9), tilt(0.3, 22.0)]
    among = fly_rows(Request([*some, throttle(0.3, 0.08, 0.4, 0.9, 21.5), tilt(-0.4, 24.0)], 0.04), PRIOR).motion.p_m
    alone = fly_rows(Request(some, 0.04), PRIOR).motion.p_m
    steps = min(alone.shape[1], among.shape[1])
    np.testing.assert_allclose(among[: len(some), :steps], alone[:, :steps], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("zone", [{}, {"z_m": (0.3, 7.0), "x_m": (-6.0, 7.0), "y_m": (-5.0, 6.0), "margin_m": 1.0}])
def test_plans_and_refusals_are_those_of_rehearsing_everything_from_its_start(zone):
    from dataclasses import replace

    vehicle = replace(DEFAULT_VEHICLE, zone=replace(DEFAULT_VEHICLE.zone, **zone))
    assert isinstance(PRIOR, BranchingPredictor)
    assert not isinstance(Plain(PRIOR), BranchingPredictor)
    scripts = [load_script(resolve(name)) for name in ("tilt_throttle", "ground_effect", "free_flight", "lateral_stop")]
    together = [compile_plan(script, vehicle, PRIOR) for script in scripts]
    for script, shared in zip(scripts, together, strict=True):
        apart = compile_plan(script, vehicle, Plain(PRIOR))
        assert shared.refusals == apart.refusals
        assert shared.notes == apart.notes
        assert [leg.id for leg in shared.legs] == [leg.id for leg in apart.legs]
        for mine, theirs in zip(shared.cells, apart.cells, strict=True):
            assert (mine.held_s, mine.stops, mine.shortened) == (theirs.held_s, theirs.stops, theirs.shortened)
            for corner in ("start_m", "low_m", "high_m", "lost_low_m", "lost_high_m"):
                assert getattr(mine, corner) == pytest.approx(getattr(theirs, corner), abs=1e-8), (mine.label, corner)
    if zone:
        assert any(plan.refusals for plan in together)
