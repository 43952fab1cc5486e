"""A simulator against reality: what differs beyond the error of both sides, and what that means."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flight import campaign, fly

from flighttest.diagnose.against import (
    Kind,
    Side,
    differences_of,
    errors_of,
    hidden_notes,
    mass_notes,
    shared_limits,
    stamp_variance,
    step_by_step,
)
from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.uncertainty.covariance import cluster_covariance
from flighttest.physics.model import Model
from flighttest.segments.compatibility import Compatibility
from flighttest.segments.model import Segment, SegmentContext

MODEL = Model(("linear_drag", "quadratic_drag"))


def side(model=MODEL, unseen=(), **values):
    full = model.start() | values
    return Side(
        model, full, {n: (0.01 * max(abs(full[n]), 0.1), 30.0) for n in model.names}, dict.fromkeys(unseen, "not flown")
    )


def kinds(found):
    return {d.name: d.kind for d in found}


def test_two_like_sides_do_not_differ():
    assert set(kinds(differences_of(side(), side(K=55.0))).values()) == {Kind.SAME}


def test_a_term_is_lacking_superfluous_or_of_another_value():
    quadratic = next(t for t in MODEL.built_terms if t.id == "quadratic_drag").params[0].name
    assert kinds(differences_of(side(**{quadratic: 0.05}), side()))[quadratic] is Kind.LACKS
    assert kinds(differences_of(side(), side(**{quadratic: 0.05})))[quadratic] is Kind.TOO_MUCH
    assert kinds(differences_of(side(**{quadratic: 0.05}), side(**{quadratic: 0.09})))[quadratic] is Kind.OTHER_VALUE
    assert kinds(differences_of(side(K=60.0), side()))["K"] is Kind.OTHER_VALUE


def test_holm_keeps_two_errors_and_a_half_in_one_of_many_parameters_from_counting():
    found = {d.name: d for d in differences_of(side(K=54.55 * (1 + 0.025 * np.sqrt(2))), side())}
    assert found["K"].p_value < 0.05
    assert found["K"].kind is Kind.SAME


def test_a_difference_of_the_size_that_would_show_does_so_in_four_of_five_pairs():
    least = next(d for d in differences_of(side(), side()) if d.name == "K").detectable
    rng = np.random.default_rng(3)
    std = np.sqrt(2) * 0.01 * 54.55
    shown = [
        next(d for d in differences_of(side(K=54.55 + least + std * e), side()) if d.name == "K").differs
        for e in rng.standard_normal(60)
    ]
    assert 0.65 < np.mean(shown) < 0.93


def test_the_error_of_a_side_is_by_its_responses_where_few_cells_tell_a_parameter():
    # six responses of two cells, whose errors cancel within each cell: what the cells say is luck
    score = np.array([3.0, -3.1, 0.2, 2.9, -3.0, 0.1])[:, None]
    normal = Normal(("d_y",), np.ones((6, 1, 1)), score)
    cells = np.array([0, 0, 0, 1, 1, 1])
    known = cluster_covariance(normal.by(cells), ("d_y",))
    solution = SimpleNamespace(at_bound=(), normal=normal)
    found = SimpleNamespace(solution=solution, covariance=known, problem=SimpleNamespace(cells=cells, segments=()))
    std, dof = errors_of(found)["d_y"]
    assert (known.dof[0], np.sqrt(known.matrix[0, 0])) == pytest.approx((10.0, 1.0 / np.sqrt(6.0)))
    assert std == pytest.approx(np.sqrt(np.sum(score**2) / (6.0 * 5.0)))
    assert dof == pytest.approx(5.0)


def test_a_parameter_on_its_bound_that_nothing_depends_on_has_no_error():
    # The share of the lean angle in a boost that ended at zero: its row of the Hessian is zero, and no eigenvalue was found.
    hessian = np.tile(np.diag([1.0, 0.0]), (6, 1, 1))
    normal = Normal(("boost", "boost_actual"), hessian, np.array([[1.0, 0.0], [-1.0, 0.0]] * 3))
    solution = SimpleNamespace(at_bound=("boost_actual",), normal=normal)
    known, problem = cluster_covariance(normal, ("boost",)), SimpleNamespace(cells=np.arange(6), segments=())
    assert set(errors_of(SimpleNamespace(solution=solution, covariance=known, problem=problem))) == {"boost"}


def test_a_delay_of_the_thrust_has_the_error_of_the_forces_time_stamps():
    # Two flights of one vehicle: their forces were moved by 4.4 +- 0.8 and 1.8 +- 1.2 ms, and with them the delays, 40.3 and 43.3 ms.
    def flown(run, kind, std_s, late_std_s=0.001):
        found = Compatibility(0.0, late_std_s, 0.003, std_s, 0.0, 0.002, 80)
        return Segment(
            f"{run}-{kind}", run, kind, {}, 1, 0.0, np.zeros(1), {}, {}, context=SegmentContext(compatibility=found)
        )

    throttles = [flown("a", "throttle_step", 8e-4)] * 3 + [flown("b", "throttle_step", 16e-4)]
    expected = (0.75 * 8e-4) ** 2 + (0.25 * 16e-4) ** 2
    assert stamp_variance(throttles) == pytest.approx(expected)
    assert stamp_variance([*throttles, flown("c", "roll_step", 4e-3)]) == pytest.approx(expected)
    assert stamp_variance([flown("a", "roll_step", 8e-4)]) == pytest.approx(64e-8)
    assert stamp_variance([flown("a", "throttle_step", 8e-4, late_std_s=0.008)]) == 0.0  # a force that was not moved
    normal = Normal(("T_d_thrust", "K"), np.tile(np.eye(2), (6, 1, 1)), 1e-5 * np.tile([1.0, -1.0], 6).reshape(2, 6).T)
    covariance = cluster_covariance(normal, ("T_d_thrust", "K"))
    problem = SimpleNamespace(cells=np.arange(6), segments=throttles)
    found = errors_of(
        SimpleNamespace(solution=SimpleNamespace(at_bound=(), normal=normal), covariance=covariance, problem=problem)
    )
    assert found["T_d_thrust"][0] == pytest.approx(np.sqrt(expected), rel=0.01)
    assert found["K"][0] < 1e-4


def test_a_limit_is_in_the_model_of_one_side_alone():
    limited = MODEL.with_terms("rate_limit")
    name = next(p.name for p in limited.params if p.name not in MODEL.names)
    assert kinds(differences_of(side(limited), side()))[name] is Kind.LACKS
    assert kinds(differences_of(side(), side(limited)))[name] is Kind.TOO_MUCH
    assert kinds(differences_of(side(limited), side(unseen=["rate_limit"])))[name] is Kind.UNTESTED


@pytest.mark.parametrize("limit", [3.0, np.inf])
def test_a_limit_that_one_diagnosis_missed_is_in_the_model_of_a_side_that_it_serves(limit):
    segments = fly(campaign(1, throttles=False, yaws=False), rate_limit=limit)
    base = Model()
    limited = base.with_terms("rate_limit")
    found = SimpleNamespace(model=base, values=base.start(), accepted=())
    other = SimpleNamespace(model=limited, values={**limited.start(), "rate_max": 3.2}, accepted=("rate_limit",))
    assert shared_limits(segments, found, other) == (("rate_limit",) if limit == 3.0 else ())
    assert shared_limits(segments, other, other) == ()


def test_what_one_side_does_not_determine_is_not_tested():
    other = side()
    del other.errors["alpha"]
    row = next(d for d in differences_of(side(alpha=3.0), other) if d.name == "alpha")
    assert (row.kind, row.why) == (Kind.UNTESTED, "the simulated recordings do not determine it")


def test_attitude_loops_that_one_side_could_not_show_are_no_difference():
    blind = replace(MODEL, attitude_loops=False)
    for found in (differences_of(side(blind), side()), differences_of(side(), side(blind))):
        assert {d.kind for d in found} == {Kind.SAME, Kind.UNTESTED}
        assert next(d for d in found if d.name == "omega_phi").why == "one side has no attitude references"


def test_all_forces_by_one_ratio_is_mass():
    start = MODEL.start()
    lighter = side(**{n: 1.1 * start[n] for n in ("K", "d_x", "d_y", "d_z")})
    (said,) = mass_notes(differences_of(lighter, side()), lighter, side())
    assert "the mass changed by -9.1 %" in said


def test_terms_that_hide_in_what_differs_are_named_with_the_flight_that_shows_them():
    start = MODEL.start()
    base = MODEL.without_terms("quadratic_drag")
    more = side(base, **{n: 1.2 * start[n] for n in ("d_x", "d_y", "d_z")})
    (said,) = hidden_notes(differences_of(more, side(base)), base)
    assert "another value of d_x, d_y, d_z may stand for quadratic_drag (fly speed_dash)" in said
    assert hidden_notes(differences_of(side(base), side(base)), base) == ()


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_steps_that_both_sides_flew_are_compared_by_their_means(offset):
    t = np.arange(0.0, 1.0, 0.02)

    def step(k, off):
        wobble = 0.001 * (-1) ** k
        return Segment(
            f"s{k}",
            "r",
            "roll_step",
            {"amplitude_rad": 0.2},
            k,
            0.0,
            t,
            {"roll_rad": 0.2 * (t > 0.1) + off + wobble},
            {},
        )

    (found,) = step_by_step([step(k, offset) for k in range(2)], [step(k, 0.0) for k in range(2)])
    assert found.rms == pytest.approx(offset, abs=1e-9)
    assert found.scatter == pytest.approx(0.001 * np.sqrt(2), rel=1e-6)
    assert found.repeats == (2, 2)
