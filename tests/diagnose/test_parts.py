"""The parts of a diagnosis against answers known without it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flighttest.diagnose.judge import held_out, held_out_groups
from flighttest.diagnose.noise import Floor, _independent_times, _shared, high_frequency, inflation
from flighttest.diagnose.screen import Ground, Variant, orthonormal, score, shape_settings, with_chance
from made_rows import rows_of

from flighttest.diagnose import fitted, locate, pairs, rivals, run
from flighttest.diagnose.locate import explained_by
from flighttest.diagnose.mass import mass_test
from flighttest.physics.catalogue import catalogue
from flighttest.segments.model import Segment


def test_inflation_of_a_first_order_process(rng):
    rho, n = 0.8, 40000
    x = np.zeros(n)
    e = rng.normal(size=n)
    for k in range(1, n):
        x[k] = rho * x[k - 1] + e[k]
    assert inflation(rows_of(x, np.zeros((n, 0))))[0] == pytest.approx((1 + rho) / (1 - rho), rel=0.15)
    assert inflation(rows_of(e, np.zeros((n, 0))))[0] == pytest.approx(1.0, abs=0.1)


def test_high_frequency_noise_is_seen_below_a_slow_error(rng):
    n = 4000
    slow = 5 * np.sin(np.arange(n) / 60.0)
    found = high_frequency(rows_of(slow + rng.normal(0, 0.3, n), np.zeros((n, 0))))
    assert found["f_z_m_s2"] == pytest.approx(0.3, rel=0.1)


def test_screening_ranks_the_true_column_and_says_what_is_chance(rng):
    n = 4000
    columns = rng.normal(size=(n, 4))
    residual = 0.5 * columns[:, 1] + rng.normal(size=n)
    rows = rows_of(residual, columns)
    ground = Ground.at(rows, ["p0"])
    variants = [Variant(*_variant(f"t{k}", k, columns)) for k in (1, 2, 3)]
    scores = with_chance(ground, [score(ground, v) for v in variants])
    best = min(scores, key=lambda s: s.bic)
    assert best.variant.term.id == "t1"
    assert best.p_value < 0.01
    assert best.estimate[0] == pytest.approx(0.5, abs=0.06)
    assert all(s.bic > best.bic + 100 for s in scores if s is not best)


def test_a_shape_that_declares_no_values_to_try_is_tried_at_its_usual_one():
    sag = catalogue()["voltage_sag"]
    bare = replace(sag, params=tuple(replace(p, screen=()) for p in sag.params))
    assert shape_settings(bare) == [{p.name: p.nominal for p in sag.shapes}]


def _variant(name, k, columns):
    one = columns[:, [k]]
    return SimpleNamespace(id=name), {}, (f"p{k}",), one, one


def test_the_false_alarm_rate_holds_for_the_whole_catalogue(rng):
    alarms = 0
    for _ in range(60):
        columns = rng.normal(size=(800, 12)).cumsum(axis=0)
        rows = rows_of(rng.normal(size=800), columns)
        ground = Ground.at(rows, ["p0", "p1"])
        scores = with_chance(
            ground, [s for k in range(2, 12) if (s := score(ground, Variant(*_variant(f"t{k}", k, columns))))]
        )
        alarms += min(s.p_value for s in scores) <= 0.01
    assert alarms <= 4


def test_a_column_the_base_can_copy_is_no_candidate(rng):
    columns = rng.normal(size=(500, 2))
    rows = rows_of(rng.normal(size=500), columns)
    copy = 3 * columns[:, [0]] - columns[:, [1]]
    assert score(Ground.at(rows, ["p0", "p1"]), Variant(SimpleNamespace(id="t"), {}, ("q",), copy, copy)) is None


def test_held_out_residuals_are_those_of_fits_without_the_fold(rng):
    n = 600
    columns = rng.normal(size=(n, 2))
    y = columns @ [1.0, -2.0] + rng.normal(size=n)
    theta = np.linalg.lstsq(columns, y, rcond=None)[0]
    rows = rows_of(y - columns @ theta, columns, segments=20)
    groups = np.arange(20) // 4
    found = held_out(rows, ("p0", "p1"), groups)
    for fold in range(5):
        inside = (groups % 5)[rows.segment] == fold
        refit = np.linalg.lstsq(columns[~inside], y[~inside], rcond=None)[0]
        np.testing.assert_allclose(found[inside], y[inside] - columns[inside] @ refit, atol=1e-6)


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
    new = {"K": {"value": 50.0 * ratio, "scatter": 0.05}, "d_x": {"value": 0.4 * drag_ratio, "scatter": drag_std * 0.4}}
    found = mass_test(old, new)
    assert found.get("answer") == answer
    assert found["thrust_changed"] == (answer is not None)
    assert (found["sentence"] == "no change of thrust per mass is seen (one above 0.4 % would show)") is (
        answer is None
    )


def test_orthonormal_drops_what_repeats(rng):
    x = rng.normal(size=(50, 2))
    assert orthonormal(np.column_stack([x, x[:, 0] + x[:, 1], np.zeros(50)])).shape == (50, 2)


def test_of_several_amplitudes_only_those_are_asked_for_that_say_something(rng):
    n = 4000
    columns = rng.normal(size=(n, 4))
    rows = rows_of(0.2 * columns[:, 2] + rng.normal(size=n), columns)
    variant = Variant(SimpleNamespace(id="bias"), {}, ("x", "y", "z"), columns[:, 1:], columns[:, 1:])
    found = score(Ground.at(rows, ["p0"]), variant)
    assert found.variant.names == ("y",)
    assert found.own.shape == (n, 1)
    assert found.estimate == pytest.approx([0.2], abs=0.06)
    assert set(found.left_off) == {"x", "z"}
    assert all(error == pytest.approx(1 / np.sqrt(n), rel=0.2) for error in found.left_off.values())


def test_an_effect_in_a_few_responses_is_believed_when_all_of_them_agree(rng):
    n, segments = 4000, 40
    column = np.zeros((n, 1))
    column[: 8 * 100] = rng.normal(size=(800, 1))  # only the first eight responses show it
    base = rng.normal(size=(n, 1))

    def judged(sign):
        rows = rows_of(sign * column[:, 0] + 0.2 * rng.normal(size=n), np.hstack([base, column]), segments)
        ground = Ground.at(rows, ["p0"])
        variants = [Variant(SimpleNamespace(id="few"), {}, ("p1",), column, column)]
        for k in range(30):
            noise = rng.normal(size=(n, 1))
            variants.append(Variant(SimpleNamespace(id=f"n{k}"), {}, ("q",), noise, noise))
        return with_chance(ground, [score(ground, v) for v in variants])[0]

    agreed = judged(np.ones(n))
    assert agreed.plain
    assert agreed.beyond_chance
    mixed = judged(np.repeat(np.where(np.arange(segments) % 2, 1.0, -1.0), n // segments))
    assert not mixed.beyond_chance


def test_what_repeats_share_is_compared_with_their_spread_at_the_same_times():
    at_time = {0: (1.0, 10.0), 1: (90.0, 10.0)}  # late times scatter 90 times as much
    ratio, repeats = _shared([(0, 0.1), (1, 9.0)], at_time)
    assert ratio == pytest.approx(1.0)
    assert repeats == pytest.approx(10.0)
    assert _shared([(0, 9.0)], at_time)[0] == pytest.approx(90.0)


def test_a_response_that_goes_astray_as_a_whole_is_one_observation(rng):
    at_time = dict.fromkeys(range(20), (4.0, 4.0))
    gust = [[(b, float(g)) for b in range(20)] for g in rng.normal(size=40)]
    assert _independent_times(gust, at_time) == pytest.approx(1.0, abs=0.05)
    white = [list(enumerate(rng.normal(size=20).tolist())) for _ in range(40)]
    assert _independent_times(white, at_time) == pytest.approx(20, rel=0.2)


@pytest.mark.parametrize(("amplitude", "ordered"), [(1e-3, False), (6e-3, True)])
def test_what_a_slow_variable_orders_must_exceed_what_estimators_wander_by(amplitude, ordered):
    response = np.repeat(np.arange(20), 50)
    voltage = 24.0 - 0.1 * response
    drift = amplitude * np.where(voltage > 23.0, 1.0, -1.0)
    assert locate._ordered("pitch_rad", drift, {"voltage": voltage}, response, 1e-4, 0) is ordered


def test_without_repeats_the_drift_of_estimates_is_no_mismatch():
    floor = Floor({"pitch_rad": 3e-4}, frozenset(), {})
    assert not floor.exceeded("pitch_rad", "free", 1.7e-3**2, 1000.0)
    assert floor.exceeded("pitch_rad", "free", 8e-3**2, 1000.0)
    repeated = Floor(
        {"pitch_rad": 3e-4}, frozenset({"pitch_rad"}), {}, {("pitch_rad", "pitch_step"): (50.0, 6, 6.0, 5.0)}
    )
    assert repeated.exceeded("pitch_rad", "pitch_step", 1.7e-3**2, 1000.0)
    assert not repeated.exceeded("pitch_rad", "free", 1.7e-3**2, 1000.0)


@pytest.mark.parametrize(
    ("effects", "gain"),
    [
        ((2.0, 1.5, 1.0), (-100 + 500 + 400) / (300 + 700 + 400)),  # worse at the largest place, better all told
        ((2.0, 0.1, 0.1), -100 / 300),  # seen at one place only
        ((0.2, 0.3, 0.1), 500 / 700),  # seen nowhere: the largest
    ],
)
def test_the_gain_is_over_all_places_where_an_effect_would_be_seen(monkeypatch, effects, gain):
    table = {("v", name): np.arange(100) + 100 * k for k, name in enumerate("abc")}
    monkeypatch.setattr(fitted, "places", lambda _rows, _segments: table)
    before, after = (np.sqrt(np.repeat(ss, 100)) for ss in ((4.0, 8.0, 5.0), (5.0, 3.0, 1.0)))
    effect = np.repeat(effects, 100)
    largest = ("v", "abc"[int(np.argmax(effects))])
    floor = SimpleNamespace(of=lambda _channel: 1.0)
    assert fitted._gain(before, after, effect, None, (), floor, largest) == pytest.approx(gain)


@pytest.mark.parametrize(("carriers", "asked"), [(2, np.inf), (4, 14.4), (8, 7.6), (11, 7.6), (20, 5.7), (200, 4.1)])
def test_the_fewer_responses_carry_an_effect_the_larger_it_has_to_be(carriers, asked):
    response = np.repeat(np.arange(carriers + 5), 10)
    rows = SimpleNamespace(segment=response, residual=np.zeros(response.size))
    assert rivals._asked(rows, (response < carriers).astype(float)) == pytest.approx(asked, rel=0.05)


def test_what_would_be_seen_is_told_for_the_usual_shape():
    term = SimpleNamespace(id="thrust_fade", shapes=(SimpleNamespace(name="tau", nominal=60.0),))
    settings = [SimpleNamespace(term=term, shapes={"tau": tau}) for tau in (5.0, 40.0, 300.0)]
    assert rivals._usual(settings) == [settings[1]]


@pytest.mark.parametrize(("size", "error"), [(1.5, "error"), (5.0, "excess error")])
def test_the_side_that_is_named_is_the_one_with_the_error(size, error):
    x = np.linspace(0.0, 10.0, 2000)
    r = np.where(x > 8.0, size, 0.0)
    place = locate._located("v_z_m_s", "thrust", "throttle_step", r, x, "speed_up_m_s", 0.9, 0.005, 1.0, True)
    assert place.regime["above"] == pytest.approx(8.0, abs=0.01)
    assert f"100 % of the {error} lies in 20 % of the samples" in place.sentence


def test_a_curve_is_of_the_steps_that_were_located():
    n = 100
    segments = [SimpleNamespace(kind=kind, maneuver="roll_pitch") for kind in ("roll_step", "pitch_step")]
    rows = SimpleNamespace(
        channels=("roll_rad",),
        channel=np.zeros(2 * n, dtype=int),
        segment=np.repeat([0, 1], n),
        open_residual=np.repeat([1.0, 0.0], n),
    )
    place = SimpleNamespace(
        channel="roll", maneuver="roll_pitch", kind="roll_step", regime={"variable": "tilt_rad"}, unit="rad", floor=0.1
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(locate, "sampled", lambda *_: {"tilt_rad": np.tile(np.linspace(0.0, 0.3, n), 2)})
        (curve,) = locate.regime_curves([place], rows, rows, segments)
    assert curve["before"] == pytest.approx([1.0] * len(curve["before"]))


def test_a_look_ahead_in_vain_leaves_the_search_as_it_was():
    now, other = object(), object()

    def refit(_score, _fitted):
        search.pinned.pop("w_up")
        return other

    candidate = SimpleNamespace(
        beyond_chance=True, bic=-100.0, p_value=0.001, variant=SimpleNamespace(term=SimpleNamespace(id="steady_wind"))
    )
    search = SimpleNamespace(
        base=now, now=now, pinned={"w_up": 0.1}, scores=[candidate], held_columns=lambda: "columns", hold_columns=lambda _found: None,
        linearise=lambda: None, progress=lambda _text: None, refitted_with=refit, judge=lambda *_: SimpleNamespace(kept=False),
    )  # fmt: skip
    bent = SimpleNamespace(term="rate_limit", bic=-1000.0, p_value=0.001)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "best_per_term", lambda scores: scores)
        patch.setattr(pairs, "explained", lambda _base, _now: 0.0)
        assert not pairs.look_ahead(search, [(bent, other)])
    assert (search.now, search.pinned) == (now, {"w_up": 0.1})


@pytest.mark.parametrize(("named", "together"), [(0.0, 1), (1e5, 0)])
def test_two_that_point_at_each_other_are_tried_once_and_not_beside_what_dwarfs_them(named, together):
    def refused(term):
        return SimpleNamespace(term=term, bic=-1000.0, p_value=0.001), SimpleNamespace(other={"a": "b", "b": "a"}[term])

    def candidate(term):
        return SimpleNamespace(
            beyond_chance=True, bic=-100.0, p_value=0.001, variant=SimpleNamespace(term=SimpleNamespace(id=term))
        )

    now, tried = SimpleNamespace(), []
    search = SimpleNamespace(
        base=now, now=now, pinned={}, scores=[], held_columns=lambda: None, hold_columns=lambda _found: None,
        progress=lambda _text: None, refitted_with=lambda _s, fitted: tried.append(fitted),
        judge=lambda *_: SimpleNamespace(kept=False),
    )  # fmt: skip
    search.linearise = lambda: setattr(search, "scores", [candidate(search.now.other)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "best_per_term", lambda scores: scores)
        patch.setattr(pairs, "explained", lambda _base, _now: named)
        assert not pairs.look_ahead(search, [refused("a"), refused("b")])
    assert len(tried) == together


@pytest.mark.parametrize(("alpha", "std", "told"), [(0.03, 0.05, True), (1.7, 0.03, False), (0.1, 0.4, False)])
def test_thrust_that_does_not_follow_the_voltage_is_the_autopilots_doing(alpha, std, told):
    notes = run._compensation({"alpha": {"value": alpha, "std": std}})
    assert bool(notes) is told
    assert run._compensation({}) == []
    if told:
        assert "MOT_BAT_VOLT_MAX" in notes[0]
