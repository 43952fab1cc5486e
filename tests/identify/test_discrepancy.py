"""What the equations may err is in the intervals, and not in the scatter by which two fits of like flights differ."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.estimation.discrepancy import discrepancy_covariance
from flighttest.identify.fit import fit
from tests.identify.campaign import TRUTH, campaign


@pytest.fixture(scope="module")
def yaw():
    return [s for s in campaign(7, thrust_repeats=0, tilt_repeats=0, yaw_repeats=6) if s.kind == "yaw_rate_step"]


def slower(segments, size):
    """The same flights of a vehicle whose rate comes up in another shape, in all cells alike."""
    made = []
    for s in segments:
        since = np.maximum(s.t_s - s.t_step_s - TRUTH["T_d"], 0.0)
        shape = since * np.exp(-since * TRUTH["sigma_r"])
        made.append(replace(s, y={**s.y, "r_rad_s": s.y["r_rad_s"] - s.cell["rate_rad_s"] * size * shape}))
    return made


def test_an_error_that_all_cells_share_is_in_the_interval_and_in_no_scatter(yaw):
    found = fit(slower(yaw, 2.0)).estimates["sigma_r"]
    off = abs(found.value - TRUTH["sigma_r"])
    assert off > 4 * found.scatter, "no spread between cells shows it"
    assert found.interval_95[0] < TRUTH["sigma_r"] < found.interval_95[1]


def test_more_repeats_leave_less_room_for_a_discrepancy(yaw):
    few = fit([s for s in yaw if s.repeat <= 2])
    many = fit(yaw)
    widths = [
        float(np.sqrt(discrepancy_covariance(one.problem, one.solution, ("sigma_r",))[0, 0])) for one in (few, many)
    ]
    assert 0.0 < widths[1] < widths[0]


def test_without_repeats_all_of_the_residual_may_be_discrepancy(yaw):
    once = fit([s for s in yaw if s.repeat == 1])
    again = fit(yaw)
    assert once.estimates["sigma_r"].std > 2 * once.estimates["sigma_r"].scatter
    assert once.estimates["sigma_r"].std > 1.5 * again.estimates["sigma_r"].std
