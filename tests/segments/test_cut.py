from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from flighttest.channels import INPUTS
from flighttest.estimation.responses import zero_order_hold
from flighttest.recording import Marker, Series
from flighttest.segments import Flaw, cut
from flighttest.segments.edges import between_polls


def phase(t, leg, label, **data):
    return Marker(t, "phase", label, {"leg": leg, **data})


def of_marks(recording):
    """The responses that bear the name of a mark."""
    labels = {m.label for m in recording.markers}
    return [s for s in cut(recording) if s.name in labels]


def test_a_flight_without_marks_is_cut_by_its_references(campaign):
    segments = cut(campaign.recording())
    assert [s.kind for s in segments] == ["roll_step", "yaw_rate_step", "throttle_step", "throttle_step", "pitch_step"]
    edges = campaign.edges_s()
    assert [s.t_step_s for s in segments] == pytest.approx([edges[i] for i in (0, 3, 6, 8, 9)])
    assert [dict(s.cell) for s in segments] == [
        {"amplitude_rad": 0.3}, {"rate_rad_s": -1.0}, {"throttle_0": 0.1, "throttle_1": 0.4},
        {"throttle_0": 0.1, "throttle_1": 0.25}, {"amplitude_rad": -0.2},
    ]  # fmt: skip
    assert all(s.usable for s in segments), [s.flaws for s in segments]
    assert segments[0].context.later_edges_s == pytest.approx([edges[1], edges[2]])
    # The roll record goes on through counter-step and coast, the pair from the onset of T_0 to the end of T_1.
    assert segments[0].t_s[-1] > edges[2] + 1.9
    assert segments[2].t_s[0] == pytest.approx(edges[5], abs=0.03)
    assert segments[2].t_s[-1] == pytest.approx(edges[7], abs=0.03)


def test_the_step_is_the_references_edge_not_the_mark(campaign):
    edge = campaign.edges_s()[0]
    leg = "roll_pitch/roll+0.30/r2"
    for offset in (-0.15, 0.0, 0.12):
        campaign.markers = [
            Marker(edge - 0.9, "leg", leg, {"leg": leg}),
            phase(edge - 0.9, leg, "entry"),
            phase(edge + offset, leg, "step"),
            phase(edge + 3.9, leg, "end"),
        ]
        (segment,) = of_marks(campaign.recording())
        assert segment.t_step_s == pytest.approx(edge)
        assert (segment.name, segment.maneuver, segment.repeat, segment.kind) == (leg, "roll_pitch", 2, "roll_step")


def test_the_marked_throttle_step_is_t_1(campaign):
    edges = campaign.edges_s()
    leg = "thrust/0.10-0.40/r1"
    campaign.markers = [
        Marker(edges[5] - 0.3, "leg", leg, {"leg": leg, "kind": "throttle_step", "repeat": 3, "maneuver": "thrust"}),
        phase(edges[5], leg, "hold_0", record=False),
        phase(edges[6] + 0.04, leg, "step", record=True),
        phase(edges[7] + 0.04, leg, "stop", record=False),
        phase(edges[8], leg, "end", outcome="FLOWN"),
    ]
    (segment,) = of_marks(campaign.recording())
    assert (segment.kind, segment.repeat, segment.maneuver) == ("throttle_step", 3, "thrust")
    assert segment.cell == {"throttle_0": 0.1, "throttle_1": 0.4}
    assert segment.usable


@pytest.mark.parametrize(
    ("outcome", "flaw"), [("LINK_LOST", Flaw.LINK_LOST), ("TAKE_OVER", Flaw.TAKE_OVER), ("STOPPED", Flaw.ABORTED)]
)
def test_a_leg_that_ended_badly_is_rejected_with_its_reason(campaign, outcome, flaw):
    edge = campaign.edges_s()[0]
    campaign.markers = [
        Marker(edge - 0.9, "leg", "a/b/r1", {"leg": "a/b/r1"}), phase(edge, "a/b/r1", "step"),
        phase(edge + 0.8, "a/b/r1", "end", outcome=outcome),
    ]  # fmt: skip
    (segment,) = of_marks(campaign.recording())
    assert flaw in segment.flaws
    assert segment.t_s[-1] <= edge + 0.8


@pytest.mark.parametrize(("after_s", "usable"), [(0.35, False), (0.9, True)])
def test_what_was_recorded_before_the_gate_ended_a_step_is_used_where_it_shows_enough(campaign, after_s, usable):
    edge = campaign.edges_s()[0]
    campaign.markers = [
        Marker(edge - 0.9, "leg", "a/b/r1", {"leg": "a/b/r1"}), phase(edge, "a/b/r1", "step"),
        phase(edge + after_s, "a/b/r1", "end", outcome="REFUSED"),
    ]  # fmt: skip
    (segment,) = of_marks(campaign.recording())
    assert segment.usable is usable
    assert (Flaw.ABORTED in segment.flaws) is not usable
    assert ("the gate ended it 0.90 s after the step" in " ".join(segment.notes)) is usable
    assert segment.t_s[-1] <= edge + after_s


def test_texts_of_another_ground_station_name_the_steps(campaign):
    edges = campaign.edges_s()
    campaign.markers = [
        Marker(edges[0], "note", "STEP roll +0.30"), Marker(edges[3] + 0.01, "note", "STEP yawrate +1.0"),
        Marker(edges[5], "note", "STEP thrust 0.10 0.40"), Marker(edges[8], "note", "END"),
    ]  # fmt: skip
    segments = of_marks(campaign.recording())
    assert [(s.name, s.kind) for s in segments] == [
        ("STEP roll +0.30", "roll_step"), ("STEP yawrate +1.0", "yaw_rate_step"), ("STEP thrust 0.10 0.40", "throttle_step")
    ]  # fmt: skip
    assert segments[2].t_step_s == pytest.approx(edges[6])


def test_a_marked_step_that_was_not_flown_is_kept_and_rejected(fly):
    flight = fly([(6.0, 0.0, 0.0, 0.0, 0.25)])
    flight.markers = [Marker(102.0, "note", "STEP roll +0.30"), Marker(105.0, "note", "END")]
    (segment,) = cut(flight.recording())
    assert not segment.usable
    assert Flaw.REFERENCE_MOVED in segment.flaws


def test_numbered_steps_of_a_table(campaign):
    edges = campaign.edges_s()
    campaign.markers = [
        Marker(edges[0] - 0.2, "leg", "step 1", {"leg": "step 1", "step": 1.0}), phase(edges[2] + 0.5, "step 1", "end"),
        Marker(edges[5] - 0.2, "leg", "step 2", {"leg": "step 2", "step": 2.0}), phase(edges[7], "step 2", "end"),
    ]  # fmt: skip
    segments = of_marks(campaign.recording())
    assert [(s.name, s.kind) for s in segments] == [("step 1", "roll_step"), ("step 2", "throttle_step")]
    assert segments[0].t_step_s == pytest.approx(edges[0])
    assert segments[0].t_s[-1] <= edges[2] + 0.5


def test_a_piece_may_begin_just_before_its_step(fly):
    flight = fly(
        [(2.0, 0.0, 0.0, 0.0, 0.25), (0.04, 0.0, 0.0, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0, 0.4), (2.0, 0.3, 0.1, 0.0, 0.25)]
    )
    step = flight.edges_s()[1]
    flight.markers = [
        Marker(step - 0.04, "leg", "step 7", {"leg": "step 7", "step": 7.0}),
        phase(step + 1.0, "step 7", "end"),
    ]
    (segment,) = of_marks(flight.recording())
    assert (segment.kind, segment.t_step_s) == ("throttle_step", pytest.approx(step))
    assert segment.cell == {"throttle_0": 0.2, "throttle_1": 0.4}


def test_inputs_are_kept_as_edges_and_reach_back(campaign):
    segment = cut(campaign.recording())[1]
    assert set(segment.u) == set(INPUTS)
    t, value = segment.u["yaw_rate_ref_rad_s"]
    assert t[0] <= segment.t_s[0] - 0.5
    assert list(value) == [0.0, -1.0, 0.0]
    assert t[1] == segment.t_step_s
    assert list(segment.u["roll_ref_rad"][1]) == [0.0]


def test_a_target_that_ended_before_the_response_is_not_in_force(campaign):
    """Another mode held the position until just before the step: its stretch without any target must not reach the fit."""
    recording = campaign.recording()
    plain = cut(recording)[1]
    reference = recording.series["reference"]
    hole = (reference.t_s > plain.t_s[0] - 0.5) & (reference.t_s < plain.t_s[0] - 0.1)
    columns = {name: np.where(hole, np.nan, values) for name, values in reference.columns.items()}
    series = {**recording.series, "reference": Series(reference.t_s, columns)}
    found = next(s for s in cut(replace(recording, series=series)) if s.t_step_s == plain.t_step_s)
    for name, (times, values) in found.u.items():
        assert np.isfinite(values).all(), name
        assert times[0] >= reference.t_s[hole][-1]
        assert values[-1] == plain.u[name][1][-1]


def test_the_autopilots_own_target_is_held_between_its_samples(campaign):
    recording = campaign.recording()
    times = np.arange(campaign.t0_s, campaign.t0_s + campaign.duration_s, 0.05)
    target = np.where(np.arange(times.size) % 2, 0.3, -0.3)
    series = {**recording.series, "shaped": Series(times, {"roll_shaped_rad": target})}
    segment = cut(replace(recording, series=series))[1]
    assert set(np.unique(segment.y["roll_shaped_rad"])) == {-0.3, 0.3}
    at = np.searchsorted(times, segment.t_s, side="right") - 1
    assert np.array_equal(segment.y["roll_shaped_rad"], target[at])


def test_the_batterys_own_samples_are_kept(campaign):
    recording = campaign.recording()
    battery = recording.series["battery"]
    segment = cut(recording)[1]
    times, volts = segment.context.voltage_samples
    assert times[0] < segment.t_s[0]
    assert times[-1] > segment.t_s[-1]
    assert np.array_equal(volts, np.interp(times, battery.t_s, battery.columns["voltage_v"]))
    assert np.median(np.diff(times)) == pytest.approx(0.1)


def test_the_throttle_that_hovers_is_the_one_held_for_half_of_the_flight(fly):
    held = fly(
        [(1.0, 0.0, 0.0, 0.0, 0.1), (1.0, 0.2, 0.0, 0.0, 0.1), (6.0, 0.0, 0.0, 0.0, 0.3), (2.0, 0.0, 0.0, 0.0, 0.5)]
    )
    assert {s.context.hover_throttle for s in cut(held.recording())} == {0.3}


def test_repeats_share_a_cell_and_are_counted(fly, campaign):
    twice = fly([*campaign.pieces, *campaign.pieces])
    segments = cut(twice.recording())
    rolls = [s for s in segments if s.kind == "roll_step"]
    assert [s.repeat for s in rolls] == [1, 2]
    assert len({s.cell_key for s in rolls}) == 1
    assert len({s.name for s in segments}) == len(segments)


def test_without_steps_a_flight_becomes_windows(fly):
    flight = fly([(11.0, 0.0, 0.0, 0.0, 0.25)])
    segments = cut(flight.recording())
    assert [s.kind for s in segments] == ["free"] * 4
    assert all(1.2 <= s.t_s[-1] - s.t_s[0] <= 3.8 for s in segments)
    assert all(s.usable for s in segments)


def test_a_pause_in_the_log_is_no_window(fly):
    recording = fly([(20.0, 0.0, 0.0, 0.0, 0.25)]).recording()
    kept = {}
    for group, series in recording.series.items():
        keep = (series.t_s < 106) | (series.t_s > 113)
        kept[group] = type(series)(series.t_s[keep], {n: v[keep] for n, v in series.columns.items()})
    segments = cut(type(recording)(recording.name, kept, (), recording.provenance))
    assert segments
    assert not any(s.t_s[0] < 113 and s.t_s[-1] > 106.1 for s in segments)


def test_no_window_shows_what_others_asked_for_before(fly):
    """Until 104 s the autopilot flew by itself: what it wanted then still moves the vehicle for the length of the delay."""
    recording = fly([(20.0, 0.0, 0.0, 0.0, 0.25)]).recording()
    targets = recording.series["reference"]
    later = targets.t_s >= 104.0
    ours = Series(targets.t_s[later], {n: v[later] for n, v in targets.columns.items()})
    segments = cut(replace(recording, series={**recording.series, "reference": ours}))
    assert segments[0].t_s[0] == pytest.approx(104.5, abs=0.03)
    marker = Marker(103.9, "leg", "a/r1", {"leg": "a/r1", "kind": "free"})
    marks = (marker, phase(103.9, "a/r1", "free", record=True), phase(112.0, "a/r1", "end", outcome="FLOWN"))
    marked = cut(replace(recording, series={**recording.series, "reference": ours}, markers=marks))
    assert marked[0].t_s[0] == pytest.approx(104.5, abs=0.03)
    assert {s.kind for s in marked} == {"free"}


def test_steps_by_hand_take_time_and_are_found(fly):
    """A stick is moved over 0.2 s; the target the autopilot makes of it is what was recorded."""
    ramp = [(0.02, 0.3 * (k + 1) / 10, 0.0, 0.0, 0.25) for k in range(10)]
    back = [(0.02, 0.3 - 0.3 * (k + 1) / 10, 0.0, 0.0, 0.25) for k in range(10)]
    one = [(2.0, 0.0, 0.0, 0.0, 0.25), *ramp, (1.5, 0.3, 0.0, 0.0, 0.25), *back]
    flight = fly([*one, *one, *one, (2.0, 0.0, 0.0, 0.0, 0.25)], derived={"roll_ref_rad": "stands in"})
    steps = [s for s in cut(flight.recording()) if s.kind == "roll_step"]
    assert len(steps) == 3
    assert steps[0].t_step_s == pytest.approx(102.0, abs=0.03)
    assert steps[0].cell["amplitude_rad"] == pytest.approx(0.3, abs=0.02)
    # No script made them alike: what they differ by is no noise.
    assert len({s.cell_key for s in steps}) == 3
    assert [s.repeat for s in steps] == [1, 1, 1]


def test_a_throttle_that_drifts_does_not_hide_the_steps_beside_it(fly):
    """Somebody else holds the height meanwhile; one pair of targets that happen to hold still makes no script of it."""
    rng = np.random.default_rng(1)
    pieces = [(1.0, 0.0, 0.0, 0.0, 0.25), (1.0, 0.2, 0.0, 0.0, 0.25)]
    for roll in (0.0, 0.3, 0.0, -0.3, 0.0):
        pieces += [(0.1, roll, 0.0, 0.0, 0.25 + 0.004 * rng.standard_normal()) for _ in range(20)]
    steps = [s for s in cut(fly(pieces).recording()) if s.kind == "roll_step"]
    assert [s.cell["amplitude_rad"] for s in steps] == pytest.approx([0.2, 0.3, -0.3], abs=0.02)


@pytest.mark.parametrize("recorded", [True, False])
def test_a_throttle_that_rests_now_and_then_is_a_step_only_where_tilt_was_asked_to_stay(fly, recorded):
    """A position loop's throttle of 0.71 to 0.74 made five steps of figures of eight of which roll and pitch asked for were not in the
    log, and 20 s of 55 between them were not used."""
    levels = [0.25, 0.29, 0.25, 0.3, 0.25, 0.31]
    pieces = []
    for before, after in pairwise(levels):
        pieces += [(0.02, 0.0, 0.0, 0.0, before + (after - before) * (k + 1) / 10) for k in range(10)]
        pieces += [(0.1, 0.0, 0.0, 0.0, after + 0.002 * (-1) ** k) for k in range(20)]
    recording = fly([(2.0, 0.0, 0.0, 0.0, 0.25), *pieces]).recording()
    reference = recording.series["reference"]
    if not recorded:
        reference = Series(reference.t_s, {"throttle": reference.columns["throttle"]})
    segments = cut(replace(recording, series={**recording.series, "reference": reference}))
    assert ("throttle_step" in {s.kind for s in segments}) is recorded
    if not recorded:
        assert sum(s.t_s[-1] - s.t_s[0] for s in segments if s.usable) > 11.0


def test_a_recording_without_references_becomes_windows(campaign):
    recording = campaign.recording()
    series = {g: s for g, s in recording.series.items() if g != "reference"}
    segments = cut(type(recording)(recording.name, series, (), recording.provenance))
    assert {s.kind for s in segments} == {"free"}
    assert all(s.u == {} for s in segments)


def test_heading_and_time_in_the_air_are_kept(campaign):
    campaign.markers = [Marker(100.2, "note", "take-off")]
    segment = cut(campaign.recording())[-1]
    assert segment.time_since_takeoff_s == pytest.approx(segment.t_step_s - 100.2)
    assert segment.heading_rad == pytest.approx(3.0 - 1.5, abs=0.02)


@pytest.mark.slow
def test_the_real_campaign_is_cut_alike_from_both_of_its_logs(shared_data):
    from flighttest.logs import import_log

    folder = shared_data / "real_firmware_clean"
    found = [cut(import_log(folder / name)) for name in ("recording.BIN.xz", "recording.tlog.gz")]
    for segments in found:
        kinds = [s.kind for s in segments]
        assert {k: kinds.count(k) for k in set(kinds) - {"free"}} == {
            "roll_step": 18, "pitch_step": 18, "yaw_rate_step": 8, "throttle_step": 54
        }  # fmt: skip
        assert len([s for s in segments if s.name == "FREE" or s.name.startswith("FREE #")]) == 17
        # The vehicle is brought back between the steps: 350 s of flight that follows recorded references.
        assert sum(s.t_s[-1] - s.t_s[0] for s in segments if s.kind == "free") > 400.0
        assert all(s.usable for s in segments)
        assert all(s.name.split()[1] in ("thrust", "roll", "pitch", "yawrate") for s in segments if s.kind != "free")
    steps = [[s for s in segments if s.kind != "free"] for segments in found]
    assert [s.cell for s in steps[0]] == [s.cell for s in steps[1]]
    # Targets were sent 15 ms (and the time to the next 2.5 ms loop) before they arrived.
    link = np.array([a.t_step_s - b.t_step_s for a, b in zip(*steps, strict=True)])
    assert np.all((link > 0.008) & (link < 0.05))
    assert 0.012 < np.median(link) < 0.025


@pytest.mark.parametrize("stands", [True, False])
def test_standing_between_two_flights_is_no_flight(fly, stands):
    """Motors off for a while: on the ground the specific force is g; in a fall it is none, and that is flight like any other."""
    recording = fly([(8.0, 0.0, 0.0, 0.0, 0.25), (3.0, 0.0, 0.0, 0.0, 0.0), (8.0, 0.0, 0.0, 0.0, 0.25)]).recording()
    series = {g: s for g, s in recording.series.items() if g != "velocity"}
    if stands:
        t = series["specific_force"].t_s
        series["specific_force"] = type(series["specific_force"])(t, {"f_z_m_s2": np.full(t.size, 9.8)})
    segments = cut(type(recording)(recording.name, series, (), recording.provenance))
    off_s = [(max(s.t_s[0], 108.0), min(s.t_s[-1], 111.0)) for s in segments]
    assert any(b > a for a, b in off_s) is not stands
    later = [s for s in segments if s.t_s[0] > 111.0]
    assert later
    assert all((s.time_since_takeoff_s < 8.0) is stands for s in later)


def test_a_landing_ends_where_the_height_says(fly):
    recording = fly([(8.0, 0.0, 0.0, 0.0, 0.25), (3.0, 0.0, 0.0, 0.0, 0.0), (8.0, 0.0, 0.0, 0.0, 0.25)]).recording()
    t = np.arange(100.0, 119.0, 0.02)
    height = np.interp(t, [100, 106, 107.5, 112.5, 114, 119], [1.0, 1.0, 0.1, 0.1, 1.0, 1.0])
    still = {name: np.zeros(t.size) for name in ("v_x_m_s", "v_y_m_s", "v_z_m_s")}
    series = {g: s for g, s in recording.series.items() if g != "velocity"}
    kind = type(recording.series["velocity"])
    series |= {"velocity": kind(t, still), "height": kind(t, {"height_m": height})}
    segments = cut(type(recording)(recording.name, series, (), recording.provenance))
    lowest = min(float(np.interp(s.t_s, t, height).min()) for s in segments)
    assert lowest > 0.2
    assert {s.t_s[0] < 108 for s in segments} == {True, False}


def test_a_target_read_off_at_the_loggers_times_is_a_line_between_them(fly):
    """Held from one reading to the next, a target that changes all the time would come half a period late; held from half way, a step would
    be asked for before it was."""
    swing = [(0.05, 0.1 * np.sin(0.3 * k), 0.0, 0.0, 0.25) for k in range(200)]
    found = fly(swing).recording()
    own = replace(found.provenance, importer="ardupilot_bin", derived={"roll_ref_rad": "derived"})
    sent, polled = (cut(recording)[1].u["roll_ref_rad"] for recording in (found, replace(found, provenance=own)))
    assert np.median(np.diff(sent[0])) == pytest.approx(0.05, abs=0.011)
    t = np.arange(sent[0][2], sent[0][-3], 0.001)
    assert zero_order_hold(polled, t) == pytest.approx(np.interp(t, *sent), abs=0.0076)  # as much as it moves in 10 ms
    assert np.abs(zero_order_hold(sent, t) - np.interp(t, *sent)).max() > 0.02


def test_a_slow_reading_rests_until_half_way_and_moves_on_a_line():
    t, value = between_polls(np.array([0.0, 0.1, 0.2, 1.2, 1.3]), np.array([0.0, 1.0, 2.0, 7.0, 8.0]))
    at = zero_order_hold((t, value), np.array([0.01, 0.15, 0.199, 0.21, 1.14, 1.16, 1.25, 1.31]))
    assert at == pytest.approx([0.1, 1.5, 1.9, 2.0, 2.0, 7.0, 7.5, 8.0], abs=0.1)
    t, value = between_polls(np.array([0.0, 0.02, 0.04]), np.array([1.0, 2.0, 3.0]))  # fast ones are as good as held
    assert t == pytest.approx([-0.01, 0.01, 0.03])
    assert value.tolist() == [1.0, 2.0, 3.0]


def test_a_table_has_its_edges_to_a_row(campaign):
    recording = campaign.recording()
    row_s = 1.0 / max(s.rate_hz for s in recording.series.values())
    assert cut(recording)[0].context.edge_error_s == pytest.approx(0.5 * row_s)
    log = replace(recording, provenance=replace(recording.provenance, importer="ardupilot_bin"))
    assert cut(log)[0].context.edge_error_s == 0.0


def test_what_no_mark_holds_is_used_too(campaign):
    """Marks of one script must not switch off another's steps, nor what lies between: it was left out in silence."""
    edges = campaign.edges_s()
    leg = "roll_pitch/roll+0.30/r1"
    campaign.markers = [
        Marker(edges[0] - 0.5, "leg", leg, {"leg": leg, "kind": "roll_step"}), phase(edges[0], leg, "step"),
        phase(edges[2] + 1.0, leg, "end"),
        Marker(edges[5] - 0.2, "leg", "descent", {"leg": "descent"}), phase(edges[8], "descent", "end"),
    ]  # fmt: skip
    kinds = [s.kind for s in cut(campaign.recording())]
    assert kinds == ["roll_step", "yaw_rate_step", "throttle_step", "throttle_step", "pitch_step"]


def test_a_stretch_between_marked_steps_that_moves_is_a_window(fly):
    back = [(0.25, 0.1 * (-1.0) ** k, 0.05 * k, 0.0, 0.25) for k in range(12)]
    flight = fly([(2.0, 0.0, 0.0, 0.0, 0.25), (1.0, 0.3, 0.0, 0.0, 0.25), *back, (6.0, 0.0, 0.0, 0.0, 0.25)])
    step = flight.edges_s()[0]
    flight.markers = [
        Marker(step - 0.5, "leg", "a/b/r1", {"leg": "a/b/r1", "kind": "roll_step"}), phase(step, "a/b/r1", "step"),
        phase(step + 0.9, "a/b/r1", "end"),
    ]  # fmt: skip
    found = [s for s in cut(flight.recording()) if s.kind == "free"]
    assert found
    assert all(step < s.t_s[0] < step + 5.0 for s in found)
