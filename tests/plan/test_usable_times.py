"""The usable times that design/model.md computed with Table 2, found again by flying Eq. 4."""

import math

import numpy as np
import pytest

from flighttest.plan import rehearse as module_of_rehearsals
from flighttest.plan.rehearse import Row, rehearse
from flighttest.script.profiles import Piece

STOP = (0.3 * 0.18, 1.8 * 0.18)


def pair(t0, t1, hold, record, voltage, lost=math.inf):
    lead = (Piece("entry", 0.3), Piece("hold_0", hold, throttle=t0), Piece("step", record, throttle=t1, record=True))
    return Row(lead, ("vertical",), None, 0.3, voltage, STOP, lost_s=lost)


def usable(predictor, t0, t1, hold):
    """Longest record after the delay that stays within 6 m of height (2.5 to 8.5) and under 8 m/s, s."""
    records = np.arange(0.2, 3.4, 0.04)
    flown = rehearse([pair(t0, t1, hold, r, 24.5) for r in records], predictor, 0.02)
    z = flown.motion.p_m[:, :, 2]
    fits = (np.ptp(z, axis=1) <= 6.0) & (np.abs(flown.motion.v_m_s[:, :, 2]).max(axis=1) < 8.0)
    return float(records[fits].max()) - predictor.delay_s


@pytest.mark.parametrize(
    ("t1", "shortest", "longest"),
    [(0.20, 2.0, 2.9), (0.25, 1.1, 1.6), (0.30, 0.8, 1.1), (0.35, 0.6, 0.8), (0.40, 0.46, 0.64)],
)
def test_ascents_from_a_full_battery(predictor, t1, shortest, longest):
    # From T_0 = 0.15, which hovers at 24.5 V, to 0.05 held for 0.6 s.
    assert usable(predictor, 0.15, t1, 0.2) == pytest.approx(shortest, abs=0.08)
    assert usable(predictor, 0.05, t1, 0.6) == pytest.approx(longest, abs=0.08)


@pytest.mark.parametrize("t0", [0.20, 0.25, 0.30])
def test_descents_last_longer_than_is_asked_for(predictor, t0):
    assert usable(predictor, t0, 0.10, 0.3) >= 1.5


@pytest.mark.parametrize(("timeout", "top"), [(0.2, 10.0), (0.5, 17.5), (3.0, 90.0)])
def test_how_far_a_lost_link_carries_a_full_throttle_step(predictor, monkeypatch, timeout, top):
    # design/ardupilot.md: 0.10 to 0.40 at 24.5 V, the last target held for GUID_TIMEOUT, then climb rate zero.
    monkeypatch.setattr(module_of_rehearsals, "GUID_TIMEOUT_S", timeout)
    record = usable(predictor, 0.10, 0.40, 0.6) + predictor.delay_s
    row = pair(0.10, 0.40, 0.6, record, 24.5).losing_link_at(0.9 + record)
    flown = rehearse([row], predictor, 0.02, after_s=timeout + 12.0)
    assert float(flown.motion.p_m[0, :, 2].max()) == pytest.approx(top, rel=0.07)


@pytest.mark.parametrize(("angle", "hold", "metres"), [(0.3, 2.0, 6.9), (0.5, 1.0, 3.9), (0.5, 2.0, 12.2)])
def test_what_a_tilt_step_with_its_counter_step_takes(predictor, angle, hold, metres):
    lead = (Piece("entry", 0.3), Piece("step", hold, roll_rad=angle, record=True))
    row = Row(lead, ("counter",), Piece("counter", 0.0, roll_rad=-angle), 1.0, 22.2, STOP)
    flown = rehearse([row], predictor, 0.02)
    assert np.abs(flown.motion.p_m[0, :, 1]).max() == pytest.approx(metres, rel=0.06)
    # And it stands at the end.
    assert abs(flown.motion.v_m_s[0, -1, 1]) < 0.2
    assert 0.5 * hold < flown.counter_s[0] < hold
