import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flighttest.script.load import parse_script
from flighttest.script.profiles import PROFILES, Chirp, Piece, Ramp, Timeline


def cells(step, unit=1.0, head=""):
    script = parse_script(f"format: maneuver/1\n{head}\nsteps:\n  - {step}\n")
    (maneuver,) = script.steps
    return PROFILES[maneuver.profile].cells(maneuver.settings, unit)


def test_a_timeline_is_right_continuous_and_ends_level():
    timeline = Timeline((Piece("a", 0.3, throttle=0.1), Piece("b", 0.2, roll_rad=0.4)), hover_throttle=0.18)
    assert timeline(0.0).throttle == 0.1
    assert timeline(0.29999).throttle == 0.1
    assert timeline(0.3).roll_rad == 0.4
    assert timeline(0.1 + 0.2).roll_rad == 0.4  # 0.30000000000000004
    assert timeline(0.3 - 1e-12).roll_rad == 0.4
    assert timeline(99.0).roll_rad == 0.0
    assert timeline(99.0).throttle == 0.18
    assert timeline.duration_s == pytest.approx(0.5)


def test_level_flight_throttle_is_raised_by_tilt_unless_the_autopilot_does_it():
    pieces = (Piece("tilt", 1.0, roll_rad=0.5, pitch_rad=0.2),)
    assert Timeline(pieces, 0.18)(0.5).throttle == pytest.approx(0.18 / (math.cos(0.5) * math.cos(0.2)))
    assert Timeline(pieces, 0.18, angle_boost=True)(0.5).throttle == 0.18


@given(st.floats(0, 20), st.floats(0, 20))
def test_timelines_have_no_memory(first, second):
    timeline = Timeline((Piece("a", 1.0, roll_rad=Ramp(0, 0.3, 1.0)), Piece("b", 9.0, pitch_rad=0.1)), 0.2)
    once = timeline(first)
    timeline(second)
    assert timeline(first) == once


def test_attitude_steps_are_both_signs_of_both_axes():
    found = cells("attitude_step: {axis: [roll, pitch], amplitude_rad: [0.2, 0.3, 0.5], sign: both}")
    assert len(found) == 12
    assert {cell.kind for cell in found} == {"roll_step", "pitch_step"}
    for cell in found:
        (record,) = (piece for piece in cell.lead if piece.record)
        asked = record.roll_rad if cell.kind == "roll_step" else record.pitch_rad
        opposed = cell.counter.roll_rad if cell.kind == "roll_step" else cell.counter.pitch_rad
        assert asked == cell.values["amplitude_rad"] == -opposed
        assert sum(piece.duration_s for piece in cell.tail) >= 1.0


def test_a_banked_turn_is_whole_so_that_the_vehicle_is_at_rest_after_it():
    found = cells("banked_turn: {tilt_rad: 0.4, rate_rad_s: [1, 2], sign: both}")
    assert [cell.values["rate_rad_s"] for cell in found] == [1.0, -1.0, 2.0, -2.0]
    for cell in found:
        (turn,) = (piece for piece in cell.lead if piece.record)
        assert turn.roll_rad == 0.4
        assert abs(turn.yaw_rate_rad_s) * turn.duration_s == pytest.approx(2 * math.pi)


@pytest.mark.parametrize("reversals", [1, 2, 3, 4])
def test_doublets_end_at_rest_where_they_began_to_move(reversals):
    (cell,) = cells(f"doublet: {{axis: pitch, amplitude_rad: 0.2, sign: positive, reversals: {reversals}}}")
    assert sum(piece.pitch_rad * piece.duration_s for piece in cell.lead) == pytest.approx(0.0, abs=1e-12)


def test_three_two_one_one():
    (cell,) = cells("3-2-1-1: {axis: roll, amplitude_rad: 0.1, sign: positive, unit_s: 0.3}")
    assert [(round(p.duration_s / 0.3), p.roll_rad) for p in cell.lead[1:]] == [
        (3, 0.1),
        (2, -0.1),
        (1, 0.1),
        (1, -0.1),
    ]


def test_throttle_pairs_in_units_of_hover():
    (cell,) = cells("throttle_pair: {throttle_0: 0.5, throttle_1: 2}", unit=0.25, head="throttle_unit: hover")
    assert cell.values == {"throttle_0": 0.125, "throttle_1": 0.5}
    assert cell.label == "0.50-2.00"
    assert [piece.throttle for piece in cell.lead] == [None, 0.125, 0.5]
    assert cell.stops == ("vertical",)


def test_equal_throttles_are_no_step():
    found = cells("throttle_pair: {throttle_0: [0.1, 0.2], throttle_1: [0.1, 0.2]}")
    assert [cell.label for cell in found] == ["0.10-0.20", "0.20-0.10"]


def test_only_what_may_be_shortened_is():
    (cell,) = cells("throttle_pair: {throttle_0: 0.1, throttle_1: 0.3, hold_0_s: 0.4, record_1_s: {up_to: 1}}")
    assert set(cell.shortest_s) == {"step"}


def test_yaw_steps_carry_the_sign_of_nwu():
    labels = {cell.label: cell.lead[1].yaw_rate_rad_s for cell in cells("yaw_rate_step: {rate_rad_s: [1, 2]}")}
    assert labels == {"yaw+1.00": 1.0, "yaw-1.00": -1.0, "yaw+2.00": 2.0, "yaw-2.00": -2.0}


def test_a_chirp_sweeps_its_frequencies():
    chirp = Chirp(1.0, 1.0, 3.0, 10.0)
    assert chirp(0.0) == 0.0
    crossings = sum(chirp(t / 1000) * chirp((t + 1) / 1000) < 0 for t in range(1, 10000))
    assert crossings == pytest.approx(2 * 2.0 * 10.0, abs=1)  # mean of 1 and 3 Hz for 10 s
    late = sum(chirp(9 + t / 1000) * chirp(9 + (t + 1) / 1000) < 0 for t in range(1000))
    assert late == pytest.approx(2 * 2.9, abs=1)


def test_free_flight_is_timed_by_its_pace():
    (cell,) = cells("free_flight: {waypoints: [[0, 0, 5], [3, 4, 5], [3, 4, 7]], speed_m_s: 2, settle_s: 1}")
    assert [point[0] for point in cell.waypoints] == pytest.approx([0.0, 2.5, 3.5])
    assert cell.lead[0].duration_s == pytest.approx(4.5)


def test_sweeps_need_the_size_of_their_input():
    from flighttest.errors import ScriptError

    with pytest.raises(ScriptError, match="needs `rate_rad_s`"):
        cells("chirp: {input: yaw_rate, amplitude_rad: 0.1}")


@pytest.mark.parametrize("profile", ["throttle_pair", "tilt_throttle"])
def test_a_throttle_step_between_equal_throttles_is_none(profile):
    same = {"throttle_0": (0.18,), "throttle_1": (0.18,)}
    assert "no step" in PROFILES[profile].check(same)
    assert PROFILES[profile].check(same | {"throttle_1": (0.18, 0.3)}) is None
