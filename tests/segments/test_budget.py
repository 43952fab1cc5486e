"""Every second of a recording is accounted for."""

from itertools import pairwise

import pytest

from flighttest.recording import Marker
from flighttest.segments import Use, budget, cut


def seconds(recording):
    """By use, s; the stretches follow each other from the first sample to the last."""
    found = budget(recording, cut(recording))
    assert (found[0].start_s, found[-1].end_s) == recording.t_span_s
    assert all(a.end_s == b.start_s for a, b in pairwise(found))
    assert all(s.end_s > s.start_s for s in found)
    return {use: sum(s.end_s - s.start_s for s in found if s.use is use) for use in Use}


def test_steps_and_what_lies_between_them(campaign):
    found = seconds(campaign.recording())
    assert found[Use.STEP] == pytest.approx(13.4, abs=0.3)
    assert found[Use.STEP] + found[Use.BETWEEN] == pytest.approx(campaign.duration_s, abs=0.1)


def test_free_flight_pauses_the_ground_and_a_take_over(fly):
    pieces = [(5.0, 0.0, 0.0, 0.0, 0.0), (20.0, 0.0, 0.0, 0.0, 0.25), (5.0, 0.0, 0.0, 0.0, 0.0)]
    flight = fly(pieces)
    flight.markers = [Marker(112.0, "take_over", "the pilot has it")]
    recording = flight.recording()
    kept = {}
    for group, series in recording.series.items():
        keep = (series.t_s < 116) | (series.t_s > 119)
        kept[group] = type(series)(series.t_s[keep], {n: v[keep] for n, v in series.columns.items()})
    recording = type(recording)(recording.name, kept, recording.markers, recording.provenance)
    found = seconds(recording)
    assert found[Use.GROUND] == pytest.approx(10.0, abs=0.2)
    assert found[Use.PAUSE] == pytest.approx(3.0, abs=0.1)
    assert 2.0 < found[Use.REJECTED] < 4.0
    assert found[Use.FREE] == pytest.approx(20.0 - 3.0 - found[Use.REJECTED] - found[Use.SHORT], abs=0.2)
    assert {s.why for s in budget(recording, cut(recording)) if s.use is Use.REJECTED} == {
        "the flight mode changed during the response (a take-over, a failsafe, a mission)"
    }
