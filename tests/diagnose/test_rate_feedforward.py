"""Pilots' references move all the time: an attitude loop that is given their rate beforehand, and one that is not."""

import numpy as np
import pytest
from scipy.signal import lsim

from flighttest.diagnose import Verdict, diagnose
from flighttest.segments import Segment
from flighttest.segments.model import SegmentContext

OMEGA, ZETA, LATE = 12.0, 0.7, 2  # 1/s; samples by which the loop gets the reference late
GIVEN_S = 0.2
HELD_S = 0.001  # `lsim` joins the samples of a reference by lines, where a recording holds them
RIVALS = ("rate_feedforward", "reference_shaping", "attitude_extra_pole", "rate_limit", "roll_pitch_coupling")


def flown(feedforward_s, seconds=75.0):
    """Windows of one flight, 50 Hz: (omega^2 t_f s + omega^2) / (s^2 + 2 zeta omega s + omega^2) of a reference that wanders."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 0.02)
    y, u = {}, {}
    for axis in ("roll", "pitch"):
        hertz, phase = rng.uniform(0.1, 1.5, 12), rng.uniform(0.0, 2 * np.pi, 12)
        asked = 0.04 * np.sum(np.sin(2 * np.pi * hertz[:, None] * t + phase[:, None]), axis=0)
        late = np.concatenate([np.full(LATE, asked[0]), asked[:-LATE]])
        loop = (OMEGA**2 * feedforward_s, OMEGA**2), (1.0, 2 * ZETA * OMEGA, OMEGA**2)
        _, angle, _ = lsim(([c for c in loop[0] if c], loop[1]), late, t)
        y[f"{axis}_rad"] = angle + 0.001 * rng.standard_normal(t.size)
        u[f"{axis}_ref_rad"] = asked
    found = []
    for k, first in enumerate(range(50, t.size - 125, 125)):
        at = slice(first, first + 125)
        inputs = {name: (t[at], asked[at]) for name, asked in u.items()}
        outputs = {name: angle[at] for name, angle in y.items()}
        context = SegmentContext(by_hand=True)
        found.append(
            Segment(f"free{k}", "pilot", "free", {}, 0, float(t[first]), t[at], outputs, inputs, context=context)
        )
    return tuple(found)


@pytest.mark.slow
def test_a_rate_given_beforehand_is_named_with_its_time_and_the_loop_is_as_it_is():
    """Without the name the loop of a pilot's log had omega 21 1/s and zeta 0.15; with it 15 and 0.9."""
    found = diagnose(flown(GIVEN_S), only=RIVALS)
    assert [f.term for f in found.findings] == ["rate_feedforward"]
    assert found.verdict is Verdict.EXPLAINED
    own = found.findings[0].parameters["feedforward_s"]
    low, high = own["interval_95"]
    assert low - HELD_S <= GIVEN_S <= high + HELD_S
    assert own["value"] == pytest.approx(GIVEN_S, rel=0.1)
    assert found.values["omega_phi"] == pytest.approx(OMEGA, rel=0.1)
    assert found.values["zeta_theta"] == pytest.approx(ZETA, rel=0.1)


@pytest.mark.slow
def test_a_loop_that_is_given_the_reference_alone_has_no_feedforward():
    assert not diagnose(flown(0.0), only=RIVALS).findings
