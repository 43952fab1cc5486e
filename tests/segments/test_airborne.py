"""What is flight and what is none, of recordings whose take-offs and landings the autopilot reports wrongly or not at all."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.frames import G_M_S2
from flighttest.recording import Recording
from flighttest.recording.model import Marker, Provenance, Series
from flighttest.segments import Use, budget, cut
from flighttest.segments.airborne import control_lost, flights, takeoffs


def recorded(throttle, force, roll=0.0, markers=()):
    """60 s at 20 Hz: functions of time, s, or constants."""
    t = np.arange(0.0, 60.0, 0.05)
    made = [
        np.broadcast_to(np.asarray(v(t) if callable(v) else v, dtype=float), t.shape) for v in (throttle, force, roll)
    ]
    series = {
        "reference": Series(t, {"throttle": made[0]}), "specific_force": Series(t, {"f_z_m_s2": made[1]}),
        "attitude": Series(t, {"roll_rad": made[2], "pitch_rad": np.zeros(t.size)}),
    }  # fmt: skip
    return Recording("made", series, tuple(markers), Provenance("made", "table"))


def spans(recording):
    return [tuple(round(x) for x in span) for span in flights(recording)]


@pytest.mark.parametrize(
    ("throttle", "force", "found"),
    [
        (0.12, G_M_S2, [(0, 19), (36, 60)]),  # stands: the ground carries it
        (0.12, 8.2, [(0, 19), (36, 60)]),  # the same, all of its accelerometer's readings 1.6 m/s^2 too low
        (0.35, G_M_S2, [(0, 60)]),  # a descent: more air from below, and the throttle that carries it is less
        (0.12, 2.5, [(0, 60)]),  # falls
    ],
)
def test_what_stands_with_motors_turning_does_not_fly(throttle, force, found):
    usual = 8.2 if force == 8.2 else G_M_S2

    def between(inside, outside):
        return lambda t: np.where((t >= 20.0) & (t < 35.0), inside, outside)

    assert spans(recorded(between(throttle, 0.5), between(force, usual))) == found


@pytest.mark.parametrize(
    ("force", "lasts_s", "found"),
    [
        (G_M_S2, 0.8, [(0, 19), (22, 60)]),  # touches down: the throttle of 0.12 carries a quarter of it
        (2.5, 0.8, [(0, 60)]),  # drops
        (G_M_S2, 0.3, [(0, 60)]),  # the rotors have not followed yet
    ],
)
def test_a_short_touch_down_is_no_flight(force, lasts_s, found):
    """A pilot's log stood for 0.9 s between two flights: 2.7 m/s^2 of its throttle step had no explanation."""

    def between(inside, outside):
        return lambda t: np.where((t >= 20.0) & (t < 20.0 + lasts_s), inside, outside)

    assert spans(recorded(between(0.12, 0.5), between(force, G_M_S2))) == found


def test_a_vehicle_that_stands_all_the_time_has_no_flight():
    """Of an armed vehicle whose motors never turned 20 s were used as free flight, with unknown physics in them: its horizontal velocity
    was known for the last quarter alone."""
    still = recorded(0.0, G_M_S2, markers=[Marker(5.0, "note", "armed")])
    velocity = np.where(np.arange(1200) < 900, np.nan, 0.01)
    t = still.series["reference"].t_s
    columns = {"v_x_m_s": velocity, "v_y_m_s": velocity, "v_z_m_s": np.full(t.size, 0.01)}
    for grounded in (still, replace(still, series={**still.series, "velocity": Series(t, columns)})):
        assert flights(grounded) == ()
        assert cut(grounded) == ()
        assert {s.use for s in budget(grounded, ())} == {Use.GROUND}
    thrown = replace(
        still, series={**still.series, "velocity": Series(t, {**columns, "v_z_m_s": np.full(t.size, -3.0)})}
    )
    assert spans(thrown) == [(0, 60)]


def test_a_hop_before_the_legs_have_left_the_ground_is_no_flight():
    """One log had two flights, the first of them from 4 s to 4 s."""
    throttle = lambda t: np.where((t < 20.4) | (t > 40.0), 0.5 * (t > 20.0), 0.0)  # noqa: E731
    hop = recorded(throttle, G_M_S2, markers=[Marker(19.0, "note", "take-off")])
    t = hop.series["reference"].t_s
    height = Series(t, {"height_m": np.interp(t, [41.0, 43.0], [0.0, 2.0])})
    assert spans(replace(hop, series={**hop.series, "height": height})) == [(41, 60)]


@pytest.mark.parametrize(
    ("rises", "slow_m_s", "found"),
    [
        ([24.0, 26.0], 0.02, [(24, 60)]),  # thirteen seconds with too little throttle to fly, then a climb
        ([24.0, 26.0], 1.0, [(11, 60)]),  # moves meanwhile: what its height says is wrong
        ([11.0, 12.0], 0.02, [(11, 60)]),  # a take-off of its usual duration
        ([70.0, 71.0], 0.02, []),  # never left the ground
    ],
)
def test_a_vehicle_that_stands_after_a_reported_take_off_does_not_fly(rises, slow_m_s, found):
    """ArduCopter reports one at half of the throttle of hovering: a simulated copter stood for 14 s so, five windows of that were used as
    free flight, and K was known to 1 %: 9.81 over the throttle that did not lift it."""
    driven = recorded(lambda t: np.where(t < 10.0, 0.0, np.where(t < 24.0, 0.29, 0.5)), G_M_S2)
    t = driven.series["reference"].t_s
    series = {
        **driven.series,
        "height": Series(t, {"height_m": 0.34 + np.interp(t, rises, [0.0, 2.0])}),
        "velocity": Series(t, {f"v_{axis}_m_s": np.full(t.size, slow_m_s) for axis in "xyz"}),
    }
    assert spans(replace(driven, series=series, markers=(Marker(10.02, "note", "take-off"),))) == found


@pytest.mark.parametrize(
    ("lasts_s", "up", "found"),
    [(5.0, (), [(0, 19), (25, 60)]), (5.0, (40.0,), [(1, 19), (41, 60)]), (0.6, (), [(0, 60)])],
)
def test_what_lies_upside_down_has_crashed_until_it_takes_off_again(lasts_s, up, found):
    """A pilot's log of 2014 went on through two crashes, and the windows on its back were used as free flight; a flip is flight."""
    roll = lambda t: np.where((t >= 20.0) & (t < 20.0 + lasts_s), 3.0, 0.1)  # noqa: E731
    marks = [Marker(at, "note", "take-off") for at in ((0.0, *up) if up else ())]
    assert spans(recorded(0.5, G_M_S2, roll, marks)) == found


def test_a_flight_without_a_landing_of_its_own_is_a_flight():
    """Of three flights, two of which ended in crashes, the first alone was used: the last landing was taken for the end."""
    marks = [Marker(0.0, "note", "take-off"), Marker(20.0, "note", "landed"), Marker(30.0, "note", "take-off")]
    grounded = recorded(lambda t: np.where((t >= 20.0) & (t < 30.0), 0.0, 0.5), G_M_S2, markers=marks)
    assert spans(grounded) == [(1, 19), (31, 60)]
    assert spans(recorded(0.5, G_M_S2, markers=marks[:2])) == [(1, 20)]


def test_a_flight_ends_where_the_vehicle_touches_down_and_not_where_the_autopilot_says_so():
    """ArduCopter reports a landing once it has stood with falling throttle. Those 2 s, in which the ground carried what the throttle did
    not, made the noise of a flight of 140 s five times as large."""
    marks = [Marker(0.0, "note", "take-off"), Marker(53.0, "note", "landed")]
    landing = recorded(lambda t: np.interp(t, [50.0, 51.5], [0.5, 0.0]), G_M_S2, markers=marks)
    t = landing.series["reference"].t_s
    still = np.zeros(t.size)
    series = {
        "height": Series(t, {"height_m": np.interp(t, [40.0, 50.0], [5.0, 0.0])}),
        "velocity": Series(t, {f"v_{axis}_m_s": still for axis in "xyz"}),
    }
    ((_, end),) = flights(replace(landing, series={**landing.series, **series}))
    assert 49.0 < end < 50.0


@pytest.mark.parametrize(
    ("drift", "slides_m_s"),
    [
        (lambda t: np.where(t > 30.0, -0.2, 0.0), 0.0),  # in flight
        (lambda t: -0.6 * np.exp(-t / 2.0), 0.0),  # until the estimate has settled
        (lambda t: np.interp(t, [23.0, 27.0, 33.0], [0.0, -0.5, 0.0]), 0.25),  # between two flights, and the velocity
    ],
)
def test_what_stands_does_not_fly_though_its_estimates_drift(drift, slides_m_s):
    """Windows from before a Crazyflie's take-off, with the floor below its feet, were taken for ground effect: 0.076 +- 0.013 m^2 by one
    flight, where the other two of the set had -0.08."""
    t = np.arange(0.0, 60.0, 0.05)
    height = np.interp(t, [10.0, 12.0, 18.0, 20.0, 36.0, 38.0, 50.0, 52.0], [0.0, 2.0, 2.0, 0.0, 0.0, 2.0, 2.0, 0.0])
    driven = ((t > 8.0) & (t < 21.0)) | ((t > 35.0) & (t < 53.0))
    series = {
        "reference": Series(t, {"throttle": np.where(driven, 0.5, 0.0)}),
        "height": Series(t, {"height_m": height + drift(t)}),
        "velocity": Series(t, {f"v_{axis}_m_s": np.where(driven, 0.0, slides_m_s) for axis in "xyz"}),
    }
    flown = flights(Recording("made", series, (), Provenance("made", "table")))
    assert flown == pytest.approx(np.array([(10.15, 19.85), (36.15, 51.85)]), abs=0.06)


def test_a_throttle_that_is_recorded_from_the_first_command_on_says_nothing_of_the_floor():
    """Of a flight whose commands begin at 5 m, the height before them was taken for the floor, and half a second of flight was lost."""
    t = np.arange(0.0, 60.0, 0.05)
    later = t[t >= 20.0]
    series = {
        "reference": Series(later, {"throttle": np.where(later < 53.0, 0.5, 0.0)}),
        "height": Series(
            t, {"height_m": np.interp(t, [10.0, 12.0, 22.0, 24.0, 50.0, 52.0], [0.0, 5.0, 5.0, 9.0, 9.0, 0.0])}
        ),
        "velocity": Series(t, {f"v_{axis}_m_s": np.zeros(t.size) for axis in "xyz"}),
    }
    (flown,) = flights(Recording("made", series, (), Provenance("made", "table")))
    assert flown[0] == pytest.approx(20.0, abs=0.06)


@pytest.mark.parametrize(
    ("low", "from_s", "found"),
    [
        (0.47, 20.0, [(0, 60)]),  # the throttle of the flight above, less what the ground saves: a hover
        (0.30, 20.0, [(0, 21)]),  # with that it stands
        (0.47, 56.5, [(0, 58)]),  # less than 3 s of it may be a touch-down
    ],
)
def test_a_record_that_ends_in_a_low_hover_is_flight_to_its_end(low, from_s, found):
    """Of 18 step responses from 2.1 to 1.1 m above the ground, or from 1.2 to 0.2 m, 27 s of 34 s were called the ground. The last rows of
    four had no throttle: no idle one."""
    t = np.arange(0.0, 60.0, 0.05)
    series = {
        "reference": Series(t, {"throttle": np.where(t < from_s + 1.0, 0.5, np.where(t > 59.92, np.nan, low))}),
        "height": Series(t, {"height_m": np.interp(t, [from_s, from_s + 2.0], [2.1, 1.1])}),
        "velocity": Series(t, {f"v_{axis}_m_s": np.full(t.size, 0.01) for axis in "xyz"}),
    }
    made = Recording("made", series, (), Provenance("made", "table"))
    assert [tuple(round(x - 0.3) for x in span) for span in flights(made)] == found


@pytest.mark.parametrize("thrown_m_s", [0.0, 6.0])
def test_what_falls_with_idle_motors_flies(thrown_m_s):
    """From rest its speed is 5.9 m/s in the median; thrown upwards so that it comes back as fast, 3.0."""
    t = np.arange(0.0, 60.0, 0.05)
    falls = (t >= 20.0) & (t < 21.2)
    series = {
        "reference": Series(t, {"throttle": np.where(falls, 0.0, 0.5)}),
        "velocity": Series(
            t,
            {"v_x_m_s": 0.0 * t, "v_y_m_s": 0.0 * t, "v_z_m_s": np.where(falls, thrown_m_s - G_M_S2 * (t - 20.0), 0.0)},
        ),
    }
    assert spans(Recording("made", series, (), Provenance("made", "table"))) == [(0, 60)]


def steered(pitch, asked, *, take_offs=(), period_s=0.1):
    """60 s of attitude at 10 Hz and its targets: functions of time, rad."""
    t, at = np.arange(0.0, 60.0, 0.1), np.arange(0.0, 60.0, period_s)
    series = {
        "attitude": Series(t, {"roll_rad": np.zeros(t.size), "pitch_rad": pitch(t)}),
        "reference": Series(at, {"roll_ref_rad": np.zeros(at.size), "pitch_ref_rad": asked(at)}),
    }
    marks = tuple(Marker(s, "note", "take-off") for s in take_offs)
    return Recording("made", series, marks, Provenance("made", "table"))


def follows(t):
    return 0.1 * np.sin(t)


def tumbles(t, behind=0.0):
    """From 30 s on; after 45 s it does what is given, by itself it lies still."""
    return np.where(t < 30.0, follows(t), np.where(t > 45.0, behind, 0.1 + 0.7 * np.sin(4.0 * (t - 30.0))))


@pytest.mark.parametrize(("take_offs", "until"), [((), 59.9), ((1.0, 50.0), 50.0)])
def test_after_control_is_lost_nothing_of_that_flight_is_used(take_offs, until):
    """Something of a vehicle broke; the last six seconds of its log, tumbling, gave its thrust a lag of a second for 0.1 and its attitude
    loops half of their damping."""
    recording = steered(tumbles, follows, take_offs=take_offs)
    ((begin, end),) = control_lost(recording)
    assert begin == pytest.approx(30.0, abs=0.3)
    assert end == pytest.approx(until, abs=0.01)
    ends = [stop for _, stop in flights(recording)]
    assert min(abs(stop - begin) for stop in ends) == 0.0
    assert len(ends) == len(takeoffs(recording)) == (2 if take_offs else 1)
    segments = cut(recording)
    lost = [s for s in budget(recording, segments) if s.use is Use.LOST]
    assert [(s.start_s, s.end_s) for s in lost] == [(begin, end)]
    assert all(s.t_s[-1] <= begin or s.t_s[0] >= end for s in segments)


def driven(recording, throttle):
    """The same with a throttle, of 0.4 where `throttle` (n,) holds and idle elsewhere."""
    reference = recording.series["reference"]
    columns = dict(reference.columns) | {"throttle": np.where(throttle(reference.t_s), 0.4, 0.0)}
    return replace(recording, series={**recording.series, "reference": Series(reference.t_s, columns)})


@pytest.mark.parametrize("take_offs", [(), (1.0,)])
def test_a_flight_is_used_again_where_the_attitude_follows_again(take_offs):
    """All until the landing was left out, minutes after a pilot had caught the vehicle."""
    recording = steered(lambda t: tumbles(t, follows(t)), follows, take_offs=take_offs)
    ((begin, end),) = control_lost(recording)
    assert begin == pytest.approx(30.0, abs=0.3)
    assert 47.0 < end < 50.0  # 10 degrees further than it was at 45 s
    first = take_offs[0] + 1.0 if take_offs else 0.0
    assert flights(recording) == ((first, begin), (end, pytest.approx(59.9)))
    assert takeoffs(recording) == (first,)
    segments = cut(recording)
    lost = [s for s in budget(recording, segments) if s.use is Use.LOST]
    assert [(s.start_s, s.end_s) for s in lost] == [(begin, end)]
    assert max(s.t_step_s - s.time_since_takeoff_s for s in segments) < 2.0
    assert any(s.t_s[0] >= end for s in segments)


@pytest.mark.parametrize(
    ("behind", "asked"),
    [
        (lambda t: 0.0 * t, follows),  # targets move by 11.5 degrees about it
        (lambda t: 0.8 * follows(t), lambda t: 0.8 * follows(t)),  # by 9.2 degrees
        (lambda t: np.where(t % 3.0 < 1.5, 0.1 * np.sin(5.0 * t), 0.6), lambda t: 0.1 * np.sin(5.0 * t)),
    ],
    ids=["lies still", "hardly moves", "not for long"],
)
def test_what_hardly_moves_or_not_for_long_does_not_follow_again(behind, asked):
    ((_, end),) = control_lost(steered(lambda t: tumbles(t, behind(t)), asked))
    assert end == pytest.approx(59.9)


@pytest.mark.parametrize(("idles_s", "ends"), [(60.0, 48.0), (46.0, 59.9)])
def test_what_is_carried_with_idle_motors_does_not_follow_again(idles_s, ends):
    """Targets of an autopilot that is disarmed are its attitude."""
    recording = steered(lambda t: tumbles(t, follows(t)), follows)
    ((_, end),) = control_lost(driven(recording, lambda t: (t < idles_s) | (t > 58.5)))
    assert end == pytest.approx(ends, abs=0.7)


def test_control_may_be_lost_twice():
    twice = steered(lambda t: np.where(t > 55.0, 0.8, tumbles(t, follows(t))), follows)
    (_, end), (begin, last) = control_lost(twice)
    assert end < begin == pytest.approx(55.0, abs=0.3)
    assert last == pytest.approx(59.9)


def between(t, begin, end, inside, outside=0.0):
    return np.where((t >= begin) & (t < end), inside, outside)


@pytest.mark.parametrize(
    ("pitch", "asked", "begins"),
    [
        (lambda t: between(t, 30.0, 33.0, 0.6), lambda t: 0.0 * t, 29.9),  # 34 degrees beside
        (lambda t: np.clip(0.225 * (t - 30.0), 0.0, 0.9), lambda t: 0.0 * t, 30.4),  # slowly: from 5 degrees on
        (
            lambda t: between(t, 0.0, 31.0, 0.7),
            lambda t: between(t, 0.0, 28.5, 0.7),
            29.5,
        ),  # stays for two seconds and a half
    ],
    ids=["by little", "slowly", "stays behind"],
)
def test_control_is_lost_from_where_the_attitude_left_what_was_asked_for(pitch, asked, begins):
    ((begin, _),) = control_lost(steered(pitch, asked))
    assert begin == pytest.approx(begins, abs=0.15)


@pytest.mark.parametrize(
    ("pitch", "asked", "period_s"),
    [
        (
            lambda t: np.where(t < 30.0, 0.0, 1.0 - np.exp(-3.0 * (t - 30.0))),
            lambda t: np.where(t < 30.0, 0.0, 1.0),
            0.1,
        ),
        (lambda t: np.where(np.abs(t - 30.0) < 0.05, 2.0, follows(t)), follows, 0.1),  # one wrong sample
        (lambda t: 0.8 + 0.0 * t, follows, 0.1),  # never followed: references of something else
        (lambda t: between(t, 1.0, 60.0, 0.8), follows, 0.1),  # for a second, by chance
        (lambda t: tumbles(t - 1.5), follows, 25.0),  # what was asked for in the last second is not known
        (lambda t: follows(t) + np.where((t > 30.0) & (t < 33.0), 0.5, 0.0), follows, 0.1),  # 29 degrees beside
    ],
    ids=["a large step", "a wrong sample", "other references", "by chance", "stale references", "near"],
)
def test_control_is_not_lost_where_the_attitude_follows_or_nothing_shows(pitch, asked, period_s):
    recording = steered(pitch, asked, period_s=period_s)
    assert control_lost(recording) == ()
    assert flights(recording) == ((0.0, pytest.approx(59.9)),)
