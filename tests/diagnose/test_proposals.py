"""Which subsets are refitted: sizes predicted of a linear model against its refits, and what is too small for a name."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import responses, rows_of

from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.diagnose.selection.candidates import Candidate
from flighttest.diagnose.selection.comparison import LEAST_FLOORS
from flighttest.diagnose.selection.proposals import PredictedSizes, proposals
from flighttest.diagnose.selection.subsets import Scored

N, FLOOR = 1000, 0.5


def candidate(name, columns, nominal=1e3):
    columns = np.asarray(columns, dtype=float).reshape(len(columns), -1)
    names = tuple(f"{name}{k}" for k in range(columns.shape[1]))
    params = tuple(SimpleNamespace(name=n, nominal=nominal, off=0.0, prior_std=3.0 * abs(nominal)) for n in names)
    return Candidate(SimpleNamespace(id=name, params=params), {}, names, columns, lambda: columns)


def never(_candidate):
    return False


def sizes(base, candidates):
    rows = rows_of(np.zeros(len(base)), base)
    floor = NoiseFloor({"f_z_m_s2": FLOOR, "v_z_m_s": 1.0}, frozenset(), {})
    return PredictedSizes(rows, rows.names, candidates, responses(), floor)


def predictions(columns, y):
    """Of a least squares fit."""
    return columns @ np.linalg.lstsq(columns, y, rcond=None)[0]


def test_the_predicted_size_of_a_linear_model_is_what_its_refits_differ_by(rng):
    """Columns that are alike, so that the rest takes back much of each."""
    common = rng.normal(size=(N, 1))
    base, a, b = (rng.normal(size=(N, k)) + 2.0 * common for k in (3, 2, 1))
    y = a @ [1.0, 0.5] - 2.0 * b[:, 0] + rng.normal(size=N)
    every = np.hstack([base, a, b])
    x = np.linalg.lstsq(every, y, rcond=None)[0][3:]
    found = sizes(base, [candidate("a", a), candidate("b", b)])
    fall = [
        np.sqrt(np.mean((predictions(every, y) - predictions(np.hstack([base, rest]), y)) ** 2)) / FLOOR
        for rest in (b, a)
    ]
    assert found.least([Scored((0, 1), 1.0, x)])[0] == pytest.approx(min(fall), rel=1e-6)
    alone = np.linalg.lstsq(np.hstack([base, a]), y, rcond=None)[0][3:]
    change = predictions(np.hstack([base, a]), y) - predictions(base, y)
    several = found.least([Scored((0, 1), 1.0, x), Scored((0,), 1.0, alone)])
    assert several[1] == pytest.approx(np.sqrt(np.mean(change**2)) / FLOOR, rel=1e-6)


def test_the_size_of_a_unit_is_what_the_base_does_not_take_back(rng):
    base, a = rng.normal(size=(N, 2)), rng.normal(size=(N, 2))
    one, other = candidate("a", a), candidate("b", 3.0 * a)
    rest = a - base @ np.linalg.lstsq(base, a, rcond=None)[0]
    expected = np.sqrt(np.mean(rest**2, axis=0)) / FLOOR
    assert sizes(base, [one, other]).of_units(other) == pytest.approx(3.0 * expected)


def test_others_with_a_narrow_prior_take_nothing_back(rng):
    a = rng.normal(size=(N, 1))
    alike = Scored((0, 1), 1.0, np.array([1.0, 10.0]))
    for usual, left in ((1e3, 0.0), (1e-6, np.sqrt(np.mean(a**2)) / FLOOR)):
        found = sizes(np.zeros((N, 0)), [candidate("a", a, usual), candidate("b", a, usual)])
        assert found.least([alike])[0] == pytest.approx(left, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(("share", "refitted"), [(0.7, False), (0.8, True), (1.0, True)])
def test_what_is_surely_too_small_for_a_name_is_not_refitted(rng, share, refitted):
    """Sizes are predicted to a few per cent, and one of 1.0 may have a name."""
    a = rng.normal(size=(N, 1))
    found = sizes(np.zeros((N, 0)), [candidate("a", a)])
    size = share * LEAST_FLOORS * FLOOR / np.sqrt(np.mean(a**2))
    asked = [Scored((0,), 5.0, np.array([size]))]
    assert bool(proposals(asked, found, never)) is refitted


def test_a_subset_with_a_term_that_is_too_small_is_left_to_the_one_without_it(rng):
    a, b = rng.normal(size=(N, 1)), rng.normal(size=(N, 1))
    found = sizes(np.zeros((N, 0)), [candidate("a", a), candidate("b", b)])
    both, one = Scored((0, 1), 9.0, np.array([1.0, 0.1])), Scored((0,), 8.0, np.array([1.0]))
    assert proposals([both, one], found, never) == [one]


def test_what_is_asked_for_whatever_its_score_is_tried_once_and_alone(rng):
    a = rng.normal(size=(N, 1))
    found = sizes(np.zeros((N, 0)), [candidate("linear", a), candidate("shaped", a)])
    linear, shaped = (Scored((k,), odds, np.array([1e-3])) for k, odds in enumerate((5.0, -5.0)))
    both = Scored((0, 1), 9.0, np.array([1e-3, 1e-3]))
    assert proposals([both, linear, shaped], found, never) == []
    assert proposals([both, linear, shaped], found, lambda c: c.term.id == "shaped") == [shaped]
    large = Scored((1,), 5.0, np.array([10.0]))
    assert proposals([large], found, lambda _: True) == [large]
