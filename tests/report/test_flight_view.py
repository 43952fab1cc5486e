"""What is said of a flight while it happens."""

import math
from types import SimpleNamespace

from flighttest.report.flight_view import line


def facts(**changed):
    known = {
        "leg": 3, "legs": 8, "doing": "taking off", "next": "land", "phase": "", "time_left_s": 125.0, "zone_margin_m": 4.26,
        "height_m": -0.01, "voltage_v": math.nan, "link_loss": 0.01,
    }  # fmt: skip
    return SimpleNamespace(**{**known, **changed})


def test_a_line_says_what_is_known_and_nothing_else():
    assert line(facts()) == "step 3/8 taking off, 0.0 m up, zone 4.3 m, link 99 %, 2:05 left, next land"
    assert line(facts(doing="flying: a/r1", phase="step", voltage_v=24.04, height_m=math.nan, next="")) == (
        "step 3/8 flying: a/r1 (step), zone 4.3 m, 24.0 V, link 99 %, 2:05 left"
    )
