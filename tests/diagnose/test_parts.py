"""The parts of a diagnosis against answers known without it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import responses, rows_of
from scipy import stats

from flighttest.diagnose import conclusion, next_flight
from flighttest.diagnose.findings import parameter_in_words
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Located
from flighttest.diagnose.residuals import locate
from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor, high_frequency, independent_times, shared_error
from flighttest.diagnose.residuals.locate import explained_by
from flighttest.diagnose.selection import detectability
from flighttest.diagnose.selection.comparison import log_odds_asked
from flighttest.diagnose.selection.held_out import (
    ParameterPrior,
    PredictionErrors,
    gains_held_out,
    held_out,
    held_out_groups,
    places,
)
from flighttest.estimation.linearisation import orthonormal
from flighttest.estimation.problem import Noise
from flighttest.physics.catalogue import catalogue
from flighttest.segments.model import Segment


def test_high_frequency_noise_is_seen_below_a_slow_error(rng):
    n = 4000
    slow = 5 * np.sin(np.arange(n) / 60.0)
    found = high_frequency(rows_of(slow + rng.normal(0, 0.3, n), np.zeros((n, 0))))
    assert found["f_z_m_s2"] == pytest.approx(0.3, rel=0.1)


def test_held_out_residuals_are_those_of_fits_without_the_fold(rng):
    n = 600
    columns = rng.normal(size=(n, 2))
    y = columns @ [1.0, -2.0] + rng.normal(size=n)
    theta = np.linalg.lstsq(columns, y, rcond=None)[0]
    rows = rows_of(y - columns @ theta, columns, segments=20)
    groups = np.arange(20) // 4
    found = held_out(
        rows, ("p0", "p1"), groups, ParameterPrior(np.full(2, -np.inf), np.full(2, np.inf), np.full(2, 1e3))
    )
    for fold in range(5):
        inside = (groups % 5)[rows.segment] == fold
        refit = np.linalg.lstsq(columns[~inside], y[~inside], rcond=None)[0]
        np.testing.assert_allclose(found[inside], y[inside] - columns[inside] @ refit, atol=1e-6)


def test_a_parameter_without_effect_takes_nothing_from_the_others(rng):
    columns = np.stack([rng.normal(size=600), np.zeros(600)], axis=1)
    rows, groups = rows_of(2.0 * columns[:, 0], columns, segments=20), np.arange(20) // 4
    prior = ParameterPrior(np.full(2, -np.inf), np.full(2, np.inf), np.array([1e3, 1e-9]))
    for fold in prior.without_each_fold(columns, rows.residual, (groups % 5)[rows.segment]):
        assert fold.step == pytest.approx([2.0, 0.0], abs=1e-6)
        assert np.sqrt(np.diag(fold.covariance)) == pytest.approx([1.0 / np.sqrt(480.0), 1e-9], rel=0.1)


def test_parameters_without_a_fold_stay_inside_their_bounds(rng):
    """The second parameter moves one fold only: of the others any value of it would do, and noise would choose a wild one."""
    n = 600
    columns = rng.normal(size=(n, 2))
    rows = rows_of(np.zeros(n), columns, segments=20)
    groups = np.arange(20) // 4
    first = (groups % 5)[rows.segment] == 0
    columns[~first, 1] = 1e-4 * rng.normal(size=int(np.sum(~first)))
    rows = rows_of(rng.normal(size=n), columns, segments=20)
    free = held_out(
        rows, ("p0", "p1"), groups, ParameterPrior(np.full(2, -np.inf), np.full(2, np.inf), np.full(2, 1e3))
    )
    bounded = held_out(rows, ("p0", "p1"), groups, ParameterPrior(np.full(2, -0.5), np.full(2, 0.5), np.full(2, 1e3)))
    assert np.sqrt(np.mean(free[first] ** 2)) > 20.0
    assert np.sqrt(np.mean(bounded[first] ** 2)) < 1.5
    np.testing.assert_allclose(bounded[~first], free[~first], atol=1e-6)


def test_held_out_groups_are_cells_flights_or_pieces():
    def segment(kind, run, t, **cell):
        return SimpleNamespace(kind=kind, run=run, t_s=np.array([t, t + 1]), cell_key=(kind, tuple(cell.items())))

    steps = [segment("roll_step", "a", t, amplitude=t % 5) for t in range(20)]
    groups, what = held_out_groups(steps)
    assert what == "steps"
    assert len(set(groups)) == 5
    flights = [segment("free", f"flight{k % 4}", k) for k in range(12)]
    assert held_out_groups(flights)[1] == "flights"
    groups, what = held_out_groups([segment("free", "one", k) for k in range(12)])
    assert what == "pieces of the flight"
    assert list(groups) == sorted(groups)


@pytest.mark.parametrize(("count", "there"), [(59, False), (60, True)])
def test_a_place_has_sixty_samples_at_least(count, there):
    rows = rows_of(np.zeros(count), np.zeros((count, 0)), segments=1)
    assert bool(places(rows, responses(1, count))) is there


def test_explained_variance_sees_a_regime_and_nothing_in_noise(rng):
    response = np.repeat(np.arange(30), 50)
    height = np.tile(np.linspace(5, 0, 50), 30)
    residual = np.where(height < 1, 2.0, 0.0) + rng.normal(0, 0.5, 1500)
    share, p = explained_by(residual, height, response, 0)
    assert share > 0.4
    assert p < 0.01
    share, p = explained_by(rng.normal(size=1500), height, response, 0)
    assert share < 0.05
    assert p > 0.01


def test_what_is_the_same_everywhere_is_explained_by_no_variable(rng):
    response = np.repeat(np.arange(30), 50)
    share, p = explained_by(0.5 + rng.normal(0, 0.3, 1500), rng.normal(size=1500), response, 0)
    assert share < 0.05
    assert p > 0.01


@pytest.mark.parametrize(("flights", "voltage_shows"), [(1, True), (2, False), (12, True)])
def test_two_flights_at_two_voltages_do_not_show_which_of_their_differences_it_was(rng, flights, voltage_shows):
    """Six flights of two vehicles, one of them with fuller batteries: `battery voltage explains 57 % of the residual's variance`."""
    response = np.repeat(np.arange(48), 20)
    flight = response * flights // 48
    voltage = 3.2 + 0.3 * (response >= 24) + 0.001 * response
    residual = np.where(voltage > 3.4, 0.5, -0.5) + rng.normal(0, 0.1, 960)
    share, p = explained_by(residual, voltage, response, 0, flight)
    assert (share > 0.25 and p <= 1 / 200) is voltage_shows
    assert locate.ordered_by_a_variable("a_z_m_s2", residual, {"U": voltage}, response, 0.1, 0, flight) is voltage_shows


def test_what_a_variable_orders_within_flights_is_seen_beside_their_differences(rng):
    response = np.repeat(np.arange(24), 50)
    flight = response // 12
    height = np.tile(np.linspace(5, 0, 50), 24)
    residual = np.where(height < 1, 2.0, 0.0) + np.where(flight, 0.5, -0.5) + rng.normal(0, 0.3, 1200)
    assert explained_by(residual, height, response, 0, flight)[1] <= 1 / 200


@pytest.mark.parametrize(
    ("levels", "within", "said"),
    [
        ((0.6, 0.6, -0.5, -0.5), 0.05, True),
        ((0.6, 0.6, -0.5, -0.5), 2.0, False),  # by chance
        ((0.07, 0.07, -0.06, -0.06), 0.005, False),  # accelerometers drift by as much
        ((0.6,), 0.05, False),
    ],
)
def test_flights_that_differ_as_a_whole_are_said_to(rng, levels, within, said):
    """Flights of two small vehicles differed in thrust by 5 %, which the disturbance of each window took up without a word."""
    shape = rng.permutation(np.linspace(-1.5, 1.5, 6))
    sentence = conclusion.unlike_flights({f"flight{k}": level + within * shape for k, level in enumerate(levels)})
    assert bool(sentence) is said
    if said:
        assert "-0.5 m/s^2 (flight2) to +0.6 (flight0)" in sentence
    assert conclusion.unlike_flights({}) == ""


def test_what_a_body_rate_orders_is_located_by_it(rng):
    """Elevons of a tail-sitter push forward as they pitch it: 0.9 m/s^2 of residual, 46 % of it a function of the pitch rate."""
    t = np.arange(50) / 50
    rates = [np.sin(2 * np.pi * t + k) for k in range(12)]
    flown = [Segment("s", "r", "free", {}, 0, 0.0, t, {"q_rad_s": q, "p_rad_s": np.cos(q)}, {}) for q in rates]
    variables = {n: np.concatenate([locate.regime_variables(s)[n] for s in flown]) for n in ("p_rad_s", "q_rad_s")}
    residual, response = 0.9 * np.concatenate(rates) + rng.normal(0, 0.3, 600), np.repeat(np.arange(12), 50)
    assert locate.ordered_by_a_variable("a_x_m_s2", residual, {"q": variables["q_rad_s"]}, response, 0.1, 0)
    assert explained_by(residual, variables["q_rad_s"], response, 0)[0] > 0.6
    assert locate.VARIABLES["q_rad_s"] == ("pitch rate", "rad/s")


def test_a_heading_is_the_same_after_a_turn_all_around(rng):
    t, level = np.arange(50) / 50, np.zeros(50)
    yaws = [2 * np.pi * k + np.linspace(-3, 3, 50) for k in range(12)]
    flown = [
        Segment("s", "r", "free", {}, 0, 0.0, t, {"roll_rad": level, "pitch_rad": level, "yaw_rad": yaw}, {})
        for yaw in yaws
    ]
    headings = [locate.regime_variables(s)["heading_rad"] for s in flown]
    np.testing.assert_allclose(headings, np.tile(np.linspace(-3, 3, 50), (12, 1)), atol=1e-9)
    residual = np.sin(np.concatenate(headings)) + rng.normal(0, 0.3, 600)
    assert explained_by(residual, np.concatenate(headings), np.repeat(np.arange(12), 50), 0)[0] > 0.6


@pytest.mark.parametrize(
    ("ratio", "drag_ratio", "drag_std", "answer"),
    [
        (0.9, 0.9, 0.002, "mass"),
        (0.9, 1.0, 0.002, "thrust"),
        (0.9, 0.9, 0.1, "thrust or mass"),
        (1.0, 1.0, 0.002, None),
    ],
)
def test_thrust_or_mass(ratio, drag_ratio, drag_std, answer):
    old = {"K": (50.0, 0.05), "d_x": (0.4, drag_std * 0.4)}
    new = {"K": (50.0 * ratio, 0.05), "d_x": (0.4 * drag_ratio, drag_std * 0.4)}
    found = mass_test(old, new)
    assert found.get("answer") == answer
    assert found["thrust_changed"] == (answer is not None)
    assert (found["sentence"] == "no change of thrust per mass is seen (one above 0.4 % would show)") is (
        answer is None
    )


def test_thrust_is_compared_at_the_voltage_flown():
    """An alpha of -2 for 1.7 halves K at a nominal voltage a fifth above the one flown, and moves no thrust."""
    before = {"K": (50.0, 0.05)}
    carried = (6.0 / 7.4) ** (-2.0 - 1.7)
    assert mass_test(before, {"K": (50.0 / carried, 0.05)}, carried)["thrust_ratio"] == pytest.approx(1.0)
    assert mass_test(before, {"K": (50.0 / carried, 0.05)})["thrust_ratio"] == pytest.approx(1.0 / carried)


def test_orthonormal_drops_what_repeats(rng):
    x = rng.normal(size=(50, 2))
    assert orthonormal(np.column_stack([x, x[:, 0] + x[:, 1], np.zeros(50)])).shape == (50, 2)


def test_what_repeats_share_is_compared_with_their_spread_at_the_same_times():
    at_time = {0: (1.0, 10.0), 1: (90.0, 10.0)}  # late times scatter 90 times as much
    ratio, repeats = shared_error([(0, 0.1), (1, 9.0)], at_time)
    assert ratio == pytest.approx(1.0)
    assert repeats == pytest.approx(10.0)
    assert shared_error([(0, 9.0)], at_time)[0] == pytest.approx(90.0)


def test_a_response_that_goes_astray_as_a_whole_is_one_observation(rng):
    at_time = dict.fromkeys(range(20), (4.0, 4.0))
    gust = [[(b, float(g)) for b in range(20)] for g in rng.normal(size=40)]
    assert independent_times(gust, at_time) == pytest.approx(1.0, abs=0.05)
    white = [list(enumerate(rng.normal(size=20).tolist())) for _ in range(40)]
    assert independent_times(white, at_time) == pytest.approx(20, rel=0.2)


@pytest.mark.parametrize(("share", "ordered"), [(0.5, False), (3.0, True)])
@pytest.mark.parametrize(("channel", "drift"), [("pitch_rad", 2e-3), ("r_rad_s", 5e-3), ("a_z_m_s2", 0.1)])
def test_what_a_slow_variable_orders_must_exceed_what_estimators_wander_by(channel, drift, share, ordered):
    response = np.repeat(np.arange(20), 50)
    voltage = 24.0 - 0.1 * response
    slow = share * drift * np.where(voltage > 23.0, 1.0, -1.0)
    assert locate.ordered_by_a_variable(channel, slow, {"voltage": voltage}, response, 1e-4, 0) is ordered


def test_without_repeats_the_drift_of_estimates_is_no_mismatch():
    floor = NoiseFloor({"pitch_rad": 3e-4}, frozenset(), {})
    assert not floor.exceeded("pitch_rad", "free", 1.7e-3**2, 1000.0)
    assert floor.exceeded("pitch_rad", "free", 8e-3**2, 1000.0)
    repeated = NoiseFloor(
        {"pitch_rad": 3e-4}, frozenset({"pitch_rad"}), {}, {("pitch_rad", "pitch_step"): (50.0, 6, 6.0, 5.0)}
    )
    assert repeated.exceeded("pitch_rad", "pitch_step", 1.7e-3**2, 1000.0)
    assert not repeated.exceeded("pitch_rad", "free", 1.7e-3**2, 1000.0)


@pytest.mark.parametrize(
    ("rms_m_s", "lasts_s", "exceeded"), [(0.075, 3.0, False), (0.075, 0.5, True), (0.12, 3.0, True)]
)
def test_without_repeats_a_velocity_integrates_the_drift_of_an_accelerometer(rms_m_s, lasts_s, exceeded):
    floor = NoiseFloor({"v_z_m_s": 0.01}, frozenset(), {})
    assert floor.exceeded("v_z_m_s", "pitch_step", rms_m_s**2, 1000.0, lasts_s) is exceeded


def test_what_would_be_seen_is_reported_for_the_usual_value_of_a_nonlinear_parameter():
    term = SimpleNamespace(id="thrust_fade", shapes=(SimpleNamespace(name="tau", nominal=60.0),))
    settings = [SimpleNamespace(term=term, shape={"tau": tau}) for tau in (5.0, 40.0, 300.0)]
    assert detectability.usual_settings(settings) == [settings[1]]


def test_an_effect_of_the_smallest_size_reported_is_named_four_times_in_five(rng, monkeypatch):
    monkeypatch.setattr(detectability, "weights_of", lambda *_: lambda rows: np.ones(rows.residual.size))
    column = rng.normal(size=(2000, 1))
    rows = rows_of(np.zeros(2000), np.ones((2000, 1)))
    candidate = SimpleNamespace(
        term=SimpleNamespace(id="a", shapes=()), shape={}, names=("a0",), columns=column, unprofiled=lambda: column
    )
    search = SimpleNamespace(
        now=SimpleNamespace(rows=rows, names=("p0",)), candidates=[candidate], pool=tuple(range(30)),
        estimator=SimpleNamespace(segments=responses(20, 100)), sizes=SimpleNamespace(of_units=lambda _: np.full(1, 1e9)),
    )  # fmt: skip
    level, name = detectability.detectable(search)["a"]
    assert name == "a0"
    mean = level * np.linalg.norm(
        column - column.mean()
    )  # of the evidence's normal variable, whose square is twice the nats
    asked = np.sqrt(2.0 * log_odds_asked(30))
    assert stats.norm.sf(asked - mean) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("level", "said"), [(1.9, None), (2.1, "2.1 times its usual size"), (101.0, "would not have shown")]
)
def test_what_shows_only_at_more_than_twice_its_usual_size_could_not_be_seen(level, said):
    term = catalogue()["quadratic_drag"]
    name, usual = term.amplitudes[0].name, abs(term.amplitudes[0].nominal)
    search = SimpleNamespace(pool=(term,), members=frozenset())
    found = detectability.untestable(search, {term.id: (level * usual, name)})
    assert (said in found[0].why) if said else not found


@pytest.mark.parametrize(("size", "error"), [(1.5, "error"), (5.0, "excess error")])
def test_the_side_that_is_named_is_the_one_with_the_error(size, error):
    x = np.linspace(0.0, 10.0, 2000)
    r = np.where(x > 8.0, size, 0.0)
    place = locate.located_at(
        "v_z_m_s", "thrust", "throttle_step", r, locate.Orders("speed_up_m_s", x, 0.9, 0.005), 1.0, True
    )
    assert place.regime["above"] == pytest.approx(8.0, abs=0.01)
    assert f"100 % of the {error} lies in 20 % of the samples" in place.sentence
    assert ("0.671 m/s, no more than repeats differ by, but ordered, above" in place.sentence) is (size < 2.0)
    assert ("where repeats differ by 1," in place.sentence) is (size > 2.0)


def test_a_curve_is_of_the_steps_that_were_located():
    n = 100
    segments = [SimpleNamespace(kind=kind, maneuver="roll_pitch") for kind in ("roll_step", "pitch_step")]
    rows = SimpleNamespace(
        channels=("roll_rad",),
        channel=np.zeros(2 * n, dtype=int),
        segment=np.repeat([0, 1], n),
        unprofiled_residual=np.repeat([1.0, 0.0], n),
    )
    place = SimpleNamespace(
        channel="roll", maneuver="roll_pitch", kind="roll_step", regime={"variable": "tilt_rad"}, unit="rad", floor=0.1
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(locate, "sampled", lambda *_: {"tilt_rad": np.tile(np.linspace(0.0, 0.3, n), 2)})
        (curve,) = locate.regime_curves([place], rows, rows, segments)
    assert curve["before"] == pytest.approx([1.0] * len(curve["before"]))


@pytest.mark.parametrize(("alpha", "std", "reported"), [(0.03, 0.05, True), (1.7, 0.03, False), (0.1, 0.4, False)])
def test_thrust_that_does_not_follow_the_voltage_is_the_autopilots_doing(alpha, std, reported):
    notes = conclusion.compensated_voltage({"alpha": {"value": alpha, "std": std}})
    assert bool(notes) is reported
    assert conclusion.compensated_voltage({}) == []
    if reported:
        assert "MOT_BAT_VOLT_MAX" in notes[0]


@pytest.mark.parametrize(
    ("variable", "recorded", "channel", "peak", "noted"),
    [
        ("time_since_takeoff_s", False, "v_z", -1.4, True),
        ("time_since_takeoff_s", False, "v_z", 1.4, False),  # thrust that rises is not of a battery that runs down
        ("time_since_takeoff_s", False, "v_x", -1.4, False),
        ("time_since_takeoff_s", True, "v_z", -1.4, False),
        ("throttle", False, "v_z", -1.4, False),
    ],
)
def test_a_battery_that_was_not_recorded_is_named_where_thrust_falls_with_time(
    variable, recorded, channel, peak, noted
):
    place = Located(channel, "hop", "free", {"variable": variable, "above": 6.8}, 0.2, 0.1, "", 1.4, 0.03, "m/s", peak)
    notes = conclusion.unrecorded_battery([place], recorded)
    assert bool(notes) is noted
    assert all("v_z" in n and "record its voltage" in n for n in notes)


@pytest.mark.parametrize(
    ("regime", "peak", "named", "rotor_height_m", "noted"),
    [
        ({"variable": "height_m", "below": 0.11}, 0.8, (), 0.2, True),
        ({"variable": "height_m", "below": 0.11}, -0.8, (), 0.2, False),
        ({"variable": "height_m", "above": 0.11}, 0.8, (), 0.2, False),
        ({"variable": "throttle", "below": 0.11}, 0.8, (), 0.2, False),
        ({"variable": "height_m", "below": 0.11}, 0.8, ("ground_effect",), 0.2, False),
        ({"variable": "height_m", "below": 0.11}, 0.8, (), 0.02, False),
    ],
)
def test_more_lift_near_the_ground_without_a_name_asks_for_the_height_of_the_rotors(
    regime, peak, named, rotor_height_m, noted
):
    """Six flights of a Crazyflie close to the ground: no name with rotors 0.2 m above the recorded height, ground effect with 0 m."""
    place = Located("a_z", "free", "free", regime, 0.7, 0.15, "", 0.3, 0.1, "m/s^2", peak)
    notes = conclusion.rotor_height_taken([place], named, rotor_height_m)
    assert bool(notes) is noted
    assert all("give rotor_height_m" in n for n in notes)


@pytest.mark.parametrize(
    ("interval", "more", "words"),
    [
        ([0.4, 0.6], {}, "tc 0.5 ± 0.1 s"),
        ([-2.0, 0.6], {}, "tc 0.5 s, 95 % interval -2 to 0.6"),
        ([0.4, 0.6], {"at_bound": True}, "tc 0.5 s, its bound"),
    ],
)
def test_an_interval_that_a_bound_cuts_is_given_by_both_ends(interval, more, words):
    """A share of a pole was shown as -0.92 ± 1.5, though its interval reached from bound to bound."""
    row = {"value": 0.5, "std": 0.05, "unit": "s", "interval_95": interval, "scatter": 0.05, **more}
    assert parameter_in_words("tc", row) == words


def test_a_channel_that_is_masked_everywhere_is_not_compared():
    """As horizontal channels are where no attitude was recorded."""
    rows = SimpleNamespace(
        channels=("f_z_m_s2", "v_x_m_s"), segment=np.repeat(np.arange(4), 5), channel=np.zeros(20, int)
    )
    floor = NoiseFloor({"f_z_m_s2": 0.1, "v_x_m_s": 0.1}, frozenset(), {})
    residual = np.linspace(-1.0, 1.0, 20)
    found = gains_held_out(
        PredictionErrors(rows, residual), PredictionErrors(rows, 0.5 * residual), np.arange(4), floor
    )
    assert list(found) == ["f_z_m_s2"]
    assert found["f_z_m_s2"]["rmse_after"] == pytest.approx(0.5 * found["f_z_m_s2"]["rmse_before"])


def test_a_rehearsed_channel_that_was_never_recorded_says_nothing():
    """A recording without pitch has no noise of pitch, but a rehearsed pitch step has pitch."""
    block = SimpleNamespace(disturbances=("roll_d_rad", "pitch_d_rad"))
    problem = SimpleNamespace(parts=[SimpleNamespace(outputs=("roll_rad", "pitch_rad"), block=block)])
    made = next_flight.with_unrecorded(Noise({"roll_rad": 0.02}, {"roll_d_rad": 0.3}), problem)
    assert made.channel == {"roll_rad": 0.02, "pitch_rad": next_flight.UNRECORDED}
    assert made.disturbance["roll_d_rad"] == 0.3
    assert made.disturbance["pitch_d_rad"] > 0.0


@pytest.mark.parametrize(("kind", "located"), [("free", False), ("roll_step", True)])
def test_in_free_flight_a_disturbance_of_each_response_is_no_mismatch(rng, kind, located):
    noise, push = rng.normal(0, 0.02, 1000), np.repeat(rng.normal(0, 0.5, 20), 50)
    rows = replace(
        rows_of(noise, np.zeros((1000, 0)), channel=np.ones(1000, dtype=int)), unprofiled_residual=noise + push
    )
    flown = tuple(replace(s, kind=kind) for s in responses())
    assert bool(locate.locate(rows, flown, NoiseFloor({"v_z_m_s": 0.03}, frozenset(), {}))) is located


@pytest.mark.parametrize(("jumps", "located"), [(True, False), (False, True)])
def test_in_free_flight_jumps_of_a_position_are_noise_and_what_lasts_is_not(rng, jumps, located):
    x = rng.normal(0, 0.01, 1000)
    if jumps:
        x[rng.choice(1000, 20, replace=False)] += 1.0
    else:
        x += 0.14 * np.sin(np.arange(1000) / 15.0)
    rows = rows_of(x, np.zeros((1000, 0)), channel=np.ones(1000, dtype=int))
    flown = tuple(replace(s, kind="free") for s in responses())
    assert bool(locate.locate(rows, flown, NoiseFloor({"v_z_m_s": 0.03}, frozenset(), {}))) is located


@pytest.mark.parametrize(
    ("channel", "recorded", "variable"),
    [
        ("r_rad_s", "r_rad_s", None),
        ("r_rad_s", "q_rad_s", "q_rad_s"),
        ("v_z_m_s", "v_z_m_s", None),
        ("a_z_m_s2", "v_z_m_s", "speed_up_m_s"),
        ("pitch_rad", "pitch_rad", None),
        ("a_z_m_s2", "pitch_rad", "tilt_rad"),
    ],
)
def test_what_a_channel_measures_does_not_order_its_own_residual(rng, channel, recorded, variable):
    """A yaw rate that no model predicts is all residual, and by itself explained in full; so is a velocity by the vertical speed, which is
    the same measurement, and an angle by the tilt."""
    x = np.sin(np.arange(1000) / 15.0 + np.repeat(rng.uniform(0, 6, 20), 50)) + rng.normal(0, 0.05, 1000)
    rows = replace(rows_of(x, np.zeros((1000, 0)), channel=np.zeros(1000, dtype=int)), channels=(channel, "other"))
    still = dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad", "v_x_m_s", "v_y_m_s", "v_z_m_s"), np.zeros(50))
    measured = 0.2 * (x + 2.0)
    flown = tuple(
        replace(s, kind="free", y=still | {recorded: measured[50 * k : 50 * k + 50]}) for k, s in enumerate(responses())
    )
    (place,) = locate.locate(rows, flown, NoiseFloor({channel: 0.01, "other": 0.03}, frozenset(), {}))
    assert place.regime.get("variable") == variable
