from dataclasses import replace

import numpy as np
import pytest

from flighttest.recording import Marker, Series
from flighttest.segments import Flaw, cut


def first(recording, kind="roll_step"):
    return next(s for s in cut(recording) if s.kind == kind)


def without(recording, group, start, end):
    series = recording.series[group]
    keep = (series.t_s < start) | (series.t_s > end)
    groups = {**recording.series, group: Series(series.t_s[keep], {n: v[keep] for n, v in series.columns.items()})}
    return type(recording)(recording.name, groups, recording.markers, recording.provenance)


def changed(recording, group, name, change):
    series = recording.series[group]
    columns = {**series.columns, name: change(series.t_s, series.columns[name].copy())}
    groups = {**recording.series, group: Series(series.t_s, columns)}
    return type(recording)(recording.name, groups, recording.markers, recording.provenance)


def test_a_sound_response_has_no_flaws(campaign):
    assert first(campaign.recording()).flaws == ()


def test_missing_samples(campaign):
    edge = campaign.edges_s()[0]
    segment = first(without(campaign.recording(), "attitude", edge + 0.2, edge + 0.5))
    assert segment.flaws == (Flaw.GAP,)
    assert segment.notes == ("missing: roll_rad",)


def test_silence_of_the_targets(campaign):
    edge = campaign.edges_s()[0]
    segment = first(without(campaign.recording(), "reference", edge + 0.2, edge + 0.7))
    assert segment.flaws == (Flaw.LINK_LOST,)


def test_a_late_target(campaign):
    edge = campaign.edges_s()[0]
    assert first(without(campaign.recording(), "reference", edge + 0.2, edge + 0.37)).flaws == (Flaw.LATE,)
    assert first(without(campaign.recording(), "reference", edge + 0.2, edge + 0.25)).flaws == ()


def test_unrest_before_the_step(campaign):
    edge = campaign.edges_s()[0]
    moving = changed(campaign.recording(), "rates", "q_rad_s", lambda t, q: np.where(np.abs(t - edge) < 0.2, 0.6, q))
    assert Flaw.NOT_SETTLED in first(moving).flaws
    tilted = changed(campaign.recording(), "attitude", "pitch_rad", lambda t, x: np.where(t < edge + 0.1, 0.2, x))
    assert Flaw.NOT_SETTLED in first(tilted).flaws


def test_the_pilot_takes_over(campaign):
    edge = campaign.edges_s()[0]
    campaign.markers = [Marker(edge + 0.4, "mode", "LOITER", {"mode": 5})]
    assert Flaw.TAKE_OVER in first(campaign.recording()).flaws


def test_the_mode_of_the_maneuver_is_no_take_over(campaign):
    campaign.markers = [Marker(campaign.edges_s()[0] + 0.1, "mode", "GUIDED_NOGPS", {"mode": 20})]
    assert first(campaign.recording()).usable


def test_a_sensor_at_its_limit(campaign):
    edge = campaign.edges_s()[0]
    clipped = changed(
        campaign.recording(),
        "specific_force",
        "f_z_m_s2",
        lambda t, f: np.where(np.abs(t - edge - 0.3) < 0.02, 157.0, f),
    )
    assert first(clipped).flaws == (Flaw.CLIPPED,)


def test_a_channel_of_nothing(campaign):
    blank = changed(campaign.recording(), "attitude", "roll_rad", lambda t, x: np.where(t > 100.5, np.nan, x))
    assert Flaw.NOT_A_NUMBER in first(blank).flaws


@pytest.mark.parametrize(("hz", "few"), [(1.5, True), (2.5, False), (9.0, False)])
def test_an_attitude_logged_more_slowly_than_the_rest_is_no_hole(fly, hz, few):
    """At 10 Hz beside 50 Hz one sample more or less decided whether a response was used."""
    hover, step = (1.0, 0.0, 0.0, 0.0, 0.25), (1.0, 0.2, 0.0, 0.0, 0.25)
    flight = fly([hover, step, hover, step, hover, step, hover])
    flight.rates = {**flight.rates, "attitude": hz}
    steps = [s for s in cut(flight.recording()) if s.kind == "roll_step"]
    assert steps
    for s in steps:
        assert (Flaw.NOT_A_NUMBER in s.flaws) is few
        assert Flaw.GAP not in s.flaws
        assert s.notes == (("missing: roll_rad",) if few else ())


@pytest.mark.parametrize(("seconds", "short"), [(0.25, True), (0.5, False)])
def test_a_record_that_is_too_short(fly, seconds, short):
    hover = (1.0, 0.0, 0.0, 0.0, 0.25)
    step = (seconds, 0.0, 0.0, 0.0, 0.4)
    flight = fly([hover, step, hover, hover, step, hover, hover, step, (1.0, 0.1, 0.1, 0.0, 0.3)])
    last = [s for s in cut(flight.recording()) if s.cell.get("throttle_1") == 0.4][-1]
    assert (Flaw.TOO_SHORT in last.flaws) == short


@pytest.mark.parametrize(("late_s", "lost", "short"), [(0.012, 0, False), (0.012, 1, True)])
def test_a_step_recorded_for_the_least_that_is_planned_is_used_where_its_first_target_was_a_little_late(
    fly, late_s, lost, short
):
    """Near the ground steps are planned with 0.3 s: 9 of 24 steps of a flight were rejected as shorter, by 1 to 11 ms."""
    hover, step = (1.0, 0.0, 0.0, 0.0, 0.25), (0.3, 0.0, 0.0, 0.0, 0.4)
    recording = fly([hover, step, hover, hover, step, hover, hover, step, (1.0, 0.1, 0.1, 0.0, 0.3)]).recording()
    targets = recording.series["reference"]
    t_s, keep = targets.t_s.copy(), np.ones(targets.t_s.size, dtype=bool)
    for rise in np.flatnonzero(np.diff(targets.columns["throttle"]) > 0.1) + 1:
        keep[rise : rise + lost] = False
        t_s[rise + lost] += late_s
    series = Series(t_s[keep], {name: values[keep] for name, values in targets.columns.items()})
    changed_times = replace(recording, series={**recording.series, "reference": series})
    last = [s for s in cut(changed_times) if s.cell.get("throttle_1") == 0.4][-1]
    assert (Flaw.TOO_SHORT in last.flaws) is short


@pytest.mark.parametrize(("hz", "few"), [(2.5, True), (4.0, False), (25.0, False)])
def test_a_telemetry_log_of_a_few_samples_a_second(fly, hz, few):
    """Real telemetry of 1 to 2 Hz was said to have "less than 0.3 s recorded after the step"."""
    hover, step = (1.0, 0.0, 0.0, 0.0, 0.25), (1.0, 0.2, 0.0, 0.0, 0.25)
    flight = fly([hover, step, hover, step, hover, step, hover])
    flight.rates = dict.fromkeys(flight.rates, hz)
    steps = [s for s in cut(flight.recording()) if s.kind == "roll_step"]
    assert steps
    for s in steps:
        assert (Flaw.TOO_FEW in s.flaws) is few
        assert Flaw.TOO_SHORT not in s.flaws
