"""Proof on real recordings: what is added to them, how trials are drawn, what is counted."""

from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.frames import G_M_S2
from flighttest.pipeline.recordings.sources import open_recording
from flighttest.proof.outcome import Outcome
from flighttest.proof.prove import ProofRequest, run_trials
from flighttest.proof.recorded import cases, sets, trial
from flighttest.proof.recorded.injection import inject
from flighttest.proof.recorded.side_by_side import OracleVehicle
from flighttest.proof.recorded.wind_pairs import CHANGED
from flighttest.proof.scoreboard import score
from flighttest.recording.model import Provenance, Recording, Series

HOVER = 0.4
VEHICLE = OracleVehicle(gain_m_s2=G_M_S2 / HOVER, ramp_1_s=20.0, drag_1_s=(0.0, 0.0, 0.0), answer_1_s=1.0)
SPAN = (1.0, 19.0)


def hovering(forward_m_s=0.0, tilt_rad=0.0):
    """Level flight at a constant speed, without noise."""
    t = np.arange(0.0, 20.0, 0.02)
    flat = np.zeros(t.size)
    columns = {
        "attitude": {"roll_rad": flat, "pitch_rad": flat + tilt_rad, "yaw_rad": flat},
        "rates": {"p_rad_s": flat, "q_rad_s": flat, "r_rad_s": flat},
        "reference": {"roll_ref_rad": flat, "pitch_ref_rad": flat + tilt_rad, "throttle": flat + HOVER},
        "specific_force": {"f_x_m_s2": flat, "f_y_m_s2": flat, "f_z_m_s2": flat + G_M_S2},
        "velocity": {"v_x_m_s": flat + forward_m_s, "v_y_m_s": flat, "v_z_m_s": flat},
        "height": {"height_m": flat + 5.0},
    }
    series = {group: Series(t, values) for group, values in columns.items()}
    return Recording("hover", series, (), Provenance("a test", "table"))


def added(effects, recording=None, vehicle=VEHICLE, steps=()):
    """What an injection adds: channel to (times, difference)."""
    before = recording or hovering()
    after = inject(before, effects, vehicle, (SPAN,), steps)
    return {
        name: (s.t_s, after.series[group].columns[name] - values)
        for group, s in before.series.items()
        for name, values in s.columns.items()
    }


def test_nothing_added_leaves_a_recording_as_it_is():
    assert all(np.allclose(change, 0.0, atol=1e-9) for _, change in added({}).values())


def test_where_no_controller_answers_a_loss_of_thrust_is_integrated():
    """v = -g depth (t - tau (1 - exp(-t / tau))), in a step that lasts all the flight."""
    depth, tau = 0.05, 6.0
    change = added({"thrust_fade": {"fade_depth": depth, "fade_tau": tau}}, steps=(SPAN,))
    t, v = change["v_z_m_s"]
    inside = (t > SPAN[0]) & (t < SPAN[1] - 0.1)
    since = t[inside] - SPAN[0]
    assert v[inside] == pytest.approx(-G_M_S2 * depth * (since - tau * (1 - np.exp(-since / tau))), abs=0.02)
    assert np.all(change["throttle"][1] == 0.0)


def test_a_controller_answers_between_steps_and_commands_hold_within():
    fade = {"thrust_fade": {"fade_depth": 0.05, "fade_tau": 2.0}}
    t, throttle = added(fade, steps=((8.0, 9.0),))["throttle"]
    within = throttle[(t > 8.02) & (t < 8.98)]
    assert np.ptp(within) == 0.0
    assert within[0] == pytest.approx(HOVER * 0.05, rel=0.15)  # what hovered before the step
    assert throttle[np.searchsorted(t, 18.0)] == pytest.approx(HOVER * 0.05, rel=0.1)


def test_drag_is_that_of_the_velocity_through_the_air():
    t, f = added({"quadratic_drag": {"k_x": 0.03}}, hovering(4.0), steps=(SPAN,))["f_x_m_s2"]
    assert f[np.searchsorted(t, SPAN[0] + 0.05)] == pytest.approx(-0.03 * 16.0, rel=0.02)


def test_a_load_hangs_in_equilibrium_when_the_controller_answers():
    t, v = added({"slung_payload": {"payload_ratio": 0.1, "cable_m": 0.8, "swing_damping": 0.05}})["v_z_m_s"]
    assert np.max(np.abs(v[t < 18.9])) < 0.3
    assert abs(v[np.searchsorted(t, 18.0)]) < 0.02


def test_instruments_change_what_they_read_and_nothing_else():
    change = added({"accelerometer_bias": {"bias_x": 0.2}, "velocity_latency": {"velocity_latency": 0.1}})
    t, f = change["f_x_m_s2"]
    assert np.allclose(f[(t > 1.0) & (t < 18.9)], 0.2)
    assert all(np.allclose(change[c][1], 0.0) for c in ("v_x_m_s", "throttle", "roll_rad", "f_y_m_s2"))


@pytest.mark.parametrize(
    ("filters", "late_s", "period_s"),
    [({}, 0.0, None), ({"specific_force": 10.0, "rates": 40.0}, 0.0169, None), ({}, 0.0, 0.04)],
)
def test_an_accelerometer_off_the_centre_shows_rotations_behind_its_own_filter(filters, late_s, period_s):
    """f_y of an arm r_x ahead is r_x r': of a turn of 3 Hz, as late as sqrt(2) / (2 pi) (1 / 10 Hz - 1 / 40 Hz) behind the gyroscope's;
    also by a gyroscope recorded every 0.04 s, between whose samples a line loses 9 % of it."""
    flown, w, arm = hovering(), 2 * np.pi * 3.0, 0.1
    t = flown.series["rates"].t_s
    if period_s:
        t = np.arange(t[0], t[-1], period_s)
    still = dict.fromkeys(flown.series["rates"].columns, np.zeros(t.size))
    rates = Series(t, {**still, "r_rad_s": np.sin(w * t)})
    flown = replace(
        flown, series={**flown.series, "rates": rates}, provenance=Provenance("a test", "table", filters=filters)
    )
    times, f = added({"imu_lever_arm": {"arm_x": arm, "arm_y": 0.0, "arm_z": 0.0}}, flown, steps=(SPAN,))["f_y_m_s2"]
    inside = (times > 2.0) & (times < 18.0)
    assert f[inside] == pytest.approx(arm * w * np.cos(w * (times[inside] - late_s)), abs=0.03 * arm * w)


def test_what_is_added_passes_the_known_filters_of_the_instruments():
    """A force and a rate at once had a load's cable 0.796 +- 0.0012 m long by a diagnosis that has the filter, for 0.8 m."""
    effects = {
        "thrust_fade": {"fade_depth": 0.1, "fade_tau": 0.5},
        "roll_pitch_coupling": {"pitch_to_roll": 0.5, "roll_to_pitch": 0.0},
    }
    flown = hovering()
    t = flown.series["reference"].t_s
    columns = {**flown.series["reference"].columns, "pitch_ref_rad": 0.1 * np.sin(2 * np.pi * t)}
    flown = replace(flown, series={**flown.series, "reference": Series(t, columns)})
    known = Provenance("a test", "table", filters={"specific_force": 10.0, "rates": 5.0})
    at_once, late = (added(effects, one, steps=(SPAN,)) for one in (flown, replace(flown, provenance=known)))
    inside = (t > 1.1) & (t < 18.0)
    for channel, hz in (("f_z_m_s2", 10.0), ("p_rad_s", 5.0), ("roll_rad", np.inf)):
        earlier = np.interp(t - np.sqrt(2.0) / (2.0 * np.pi * hz), *at_once[channel])
        assert late[channel][1][inside] == pytest.approx(earlier[inside], abs=0.03 * np.ptp(earlier)), channel


@pytest.mark.parametrize(("lowest_m", "taken"), [(0.06, True), (0.05, False), (-1.7, False)])
def test_ground_effect_is_added_above_the_ground_alone(lowest_m, taken):
    """The estimated height of a pilot's log is below the ground for half of its flight: an R^2 of 0.005 m^2 had 11 noise floors there."""
    flown = hovering()
    t = flown.series["height"].t_s
    low = Series(t, {"height_m": np.where(t < 5.0, lowest_m, 5.0)})
    flown = replace(flown, series={**flown.series, "height": low})
    stub = SimpleNamespace(
        recordings=(flown,), size=lambda _effects: 4.0, departure_m_s=lambda _effects: 0.1,
        lowest_m=lambda: trial.FlownTrial.lowest_m(SimpleNamespace(recordings=(flown,))),
    )  # fmt: skip
    case = SimpleNamespace(order=("ground_effect",), sizes=(4.0,), signs=(1.0, 1.0, 1.0))
    assert bool(trial.sized_effects(case, stub)) is taken


def test_where_a_gyroscope_was_not_recorded_no_turn_is_made_up():
    """Across 4 s without a sample a spline of a turn of 3 Hz has accelerations that nothing showed: a line has 0.5 rad/s^2 at most."""
    flown, arm = hovering(), 0.1
    t = flown.series["rates"].t_s
    kept = t[(t < 8.0) | (t > 12.0)]
    still = dict.fromkeys(flown.series["rates"].columns, np.zeros(kept.size))
    rates = Series(kept, {**still, "r_rad_s": np.sin(2 * np.pi * 3.0 * kept)})
    flown = replace(flown, series={**flown.series, "rates": rates})
    times, f = added({"imu_lever_arm": {"arm_x": arm, "arm_y": 0.0, "arm_z": 0.0}}, flown, steps=(SPAN,))["f_y_m_s2"]
    assert np.max(np.abs(f[(times > 8.1) & (times < 11.9)])) < 0.5 * arm


def test_a_rate_limit_slows_a_recorded_tilt():
    flown = hovering()
    reference = dict(flown.series["reference"].columns)
    t = flown.series["reference"].t_s
    reference["roll_ref_rad"] = np.where(t > 5.0, 0.4, 0.0)
    flown = replace(flown, series={**flown.series, "reference": Series(t, reference)})
    times, roll = added({"rate_limit": {"rate_max": 0.5}}, flown, steps=(SPAN,))["roll_rad"]
    assert roll[np.searchsorted(times, 5.3)] < -0.05
    assert abs(roll[np.searchsorted(times, 12.0)]) < 0.01
    # Loops follow the autopilot's own target: one that never moves asks for no rate.
    shaped = Series(t, {"roll_shaped_rad": np.zeros(t.size), "pitch_shaped_rad": np.zeros(t.size)})
    behind = replace(flown, series={**flown.series, "shaped": shaped})
    assert np.allclose(added({"rate_limit": {"rate_max": 0.5}}, behind, steps=(SPAN,))["roll_rad"][1], 0.0)


LIST = """
format: recordings/1
sets:
  - {name: new, source: somebody, files: ["new/*"], own: [throttle_curve], vehicle: one, state: undamaged}
  - {name: cut, source: somebody, files: ["cut/*"], vehicle: one, state: cut}
  - {name: alone, source: another, files: ["alone.csv"]}
"""


@pytest.fixture
def listed(tmp_path):
    for name in ("new/1.csv", "new/2.csv", "new/3.csv", "cut/1.csv", "cut/2.csv", "alone.csv"):
        path = tmp_path / "data" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("t_s\n")
    (tmp_path / "list.yaml").write_text(LIST)
    return sets.read_sets(tmp_path / "list.yaml"), tmp_path / "data"


def test_trials_are_drawn_from_the_seed_alone_and_hide_nothing_that_is_documented(listed):
    first, again = (list(islice(cases.drawn_cases(5, *listed), 60)) for _ in range(2))
    assert [c.sha256() for c in first] == [c.sha256() for c in again]
    assert {c.kind for c in first} == {kind for kind, _ in cases.SHARES}
    assert all(c.order for c in first if c.kind in ("single", "pair"))
    assert all("throttle_curve" not in c.order for c in first if c.name == "new")
    assert "data" not in first[0].truth()  # no folder of a machine is in what is sealed
    natural = [c for c in first if c.kind == "natural"]
    assert {c.differs for c in natural} == {True, False}
    assert all(not set(c.files) & set(c.earlier) for c in natural)
    assert all(c.differs == (c.files[0].split("/")[0] != c.earlier[0].split("/")[0]) for c in natural)


def test_a_list_of_recordings_says_what_is_wrong_with_it(tmp_path):
    path = tmp_path / "list.yaml"
    path.write_text(
        "format: recordings/1\nsets:\n  - {name: a, source: b, files: [x], own: [no_such_term]}\n  - {name: c}\n"
    )
    with pytest.raises(InputError) as wrong:
        sets.read_sets(path)
    assert "no_such_term" in str(wrong.value)
    assert "source" in str(wrong.value)
    path.write_text("format: recordings/1\nsets:\n  - {name: a, source: b, files: [x]}\n")
    with pytest.raises(InputError, match="none of the recordings"):
        next(cases.drawn_cases(1, sets.read_sets(path), tmp_path))


def test_of_a_long_recording_a_part_is_taken():
    t = np.arange(0.0, 400.0, 0.02)
    flown = hovering()
    height = Series(t, {"height_m": np.where((t > 10) & (t < 390), 5.0, 0.0)})
    throttle = Series(t, {"throttle": np.where((t > 10) & (t < 390), HOVER, 0.0)})
    flown = replace(flown, series={"height": height, "reference": throttle})
    first, last = (trial.part(flown, begin).series["height"].t_s for begin in (0.0, 1.0))
    assert first[-1] - first[0] == pytest.approx(cases.PART_S, abs=0.1)
    assert last[-1] > 380.0
    assert first[0] < 20.0
    assert trial.part(hovering(), 0.5).series["height"].t_s.size == 1000


def outcome(index, kind, hide=(), named=(), sizes=()):
    return Outcome(index, kind, "", {e: {} for e in hide}, tuple(named), sizes=dict(sizes))


def test_pairs_of_campaigns_are_counted_by_their_flag_and_are_no_clean_trials():
    outcomes = [
        outcome(0, "natural", [CHANGED], [CHANGED]),
        outcome(1, "natural", [CHANGED]),
        outcome(2, "natural", [], [CHANGED]),
        outcome(3, "natural"),
        outcome(4, "clean"),
    ]
    found = score(outcomes)
    assert found["changes"] == (1, 2)
    assert found["unchanged"] == (1, 2)
    assert found["false_alarms"] == (0, 1)
    assert {m["index"] for m in found["misses"]} == {1, 2}


def test_recordings_are_of_the_generator_that_takes_them(tmp_path):
    with pytest.raises(InputError, match="takes no recordings"):
        run_trials(ProofRequest(1, 1, "sitl", data=tmp_path))
    with pytest.raises(InputError, match="needs recordings"):
        run_trials(ProofRequest(1, 1, generator="recorded", data=tmp_path))


@pytest.mark.slow
def test_the_public_list_is_read_and_a_real_hop_is_diagnosed_blind(repository, shared_data):
    listed = sets.read_sets(repository / "examples" / "recordings" / "public.yaml")
    assert all(one.found(shared_data) for one in listed)
    case = next(c for c in cases.drawn_cases(1, listed, shared_data) if c.kind == "single")
    hop = next(str(f.relative_to(shared_data)) for f in listed[0].found(shared_data))
    case = replace(case, name=listed[0].name, files=(hop,), columns=None, order=("velocity_latency",), sizes=(1.5,))
    found = trial.run_recorded(case)
    assert not found.error
    assert found.sha256 == case.sha256()
    assert set(found.hide) == {"velocity_latency"}
    assert found.sizes["velocity_latency"] > trial.LEAST_SHARE * 1.5


def test_every_set_in_a_known_state_is_of_one_vehicle(repository, shared_data):
    """Flights of two vehicles in a pair differ by 2 to 6 % of thrust, as much as the propellers that were cut: a pair that mixed them was
    flagged for the wrong reason, or not at all."""
    listed = sets.read_sets(repository / "examples" / "recordings" / "public.yaml")
    known = [one for one in listed if one.source == "propeller damage"]
    for one in known:
        assert one.vehicle, one.name
        assert one.state, one.name
        (vehicle,) = {f.name.split("_")[0] for f in one.found(shared_data)}
        assert f" {vehicle}, " in one.vehicle, one.name
    assert len({f for one in known for f in one.found(shared_data)}) == 74
    assert len({one.vehicle for one in known}) == 4


def test_a_vehicle_that_answers_late_is_controlled_no_faster_than_it_can_be():
    """With lags of two seconds a loop of 2 rad/s is unstable: a throttle of 432 had been added to a recording."""
    slow = replace(VEHICLE, ramp_1_s=0.5, delay_s=0.18, answer_1_s=2.0)
    change = added(
        {"throttle_curve": {"curvature": 0.5}, "thrust_fade": {"fade_depth": 0.1, "fade_tau": 2.0}}, vehicle=slow
    )
    assert np.max(np.abs(change["v_z_m_s"][1])) < 5.0
    throttle = HOVER + change["throttle"][1]
    assert throttle.min() >= 0.0
    assert throttle.max() <= 1.0
    assert replace(slow, ramp_1_s=20.0, delay_s=0.02).bandwidth_1_s == 2.0


def test_a_load_does_not_fall_in_a_step():
    t, v = added(
        {"slung_payload": {"payload_ratio": 0.15, "cable_m": 0.8, "swing_damping": 0.05}}, steps=((4.0, 14.0),)
    )["v_z_m_s"]
    assert np.max(np.abs(v[t < 18.9])) < 0.5


@pytest.mark.parametrize(("departure_m_s", "taken"), [(4.9, True), (5.1, False)])
def test_an_effect_that_would_have_made_it_another_flight_is_not_added(departure_m_s, taken):
    """Six times the usual translational lift threw a vehicle 24 m upwards, at 14 m/s."""
    flown = SimpleNamespace(
        recordings=(hovering(),), size=lambda _effects: 4.0, departure_m_s=lambda _effects: departure_m_s
    )
    case = SimpleNamespace(order=("thrust_fade",), sizes=(4.0,), signs=(1.0, 1.0, 1.0))
    assert bool(trial.sized_effects(case, flown)) is taken


@pytest.mark.slow
def test_the_size_of_an_effect_is_of_what_it_changes_and_not_of_other_windows_or_another_optimum(
    shared_data, monkeypatch
):
    """On this flight nothing at all had 0.47 noise floors, and a small asymmetry of thrust 1.85, as had any effect that moved a cut:
    windows of free flight were compared by their number."""
    log = open_recording(shared_data / "arducopter_logs" / "sitl_4.7dev_steps.tlog")
    flown = trial.FlownTrial.of((trial.part(log, 0.157),), 11.1, 0.82, (log,))
    assert flown.size({}) < 0.01
    assert (
        flown.size({"thrust_asymmetry": {"ln_sigma_ratio": 1.5}}) < 1.3
    )  # 0.5 to 1.0 by where the first window begins
    assert flown.size({"accelerometer_bias": {"bias_x": -0.25, "bias_y": 0.2, "bias_z": 0.3}}) > 10.0
    # Half a minute of it need not determine what the whole log does.
    monkeypatch.setattr(trial, "PART_S", 30.0)
    short = (trial.part(log, 0.5),)
    assert trial.FlownTrial.of(short, 11.1, 0.82, (log,)).vehicle == flown.vehicle
    assert trial.FlownTrial.of(short, 11.1, 0.82, short).vehicle != flown.vehicle
