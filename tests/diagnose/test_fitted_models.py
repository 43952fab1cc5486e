"""What a search keeps of its refits: the same model once, a start that is finite, gains that went astray."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import responses, rows_of

from flighttest.diagnose.selection.comparison import Fitted
from flighttest.diagnose.selection.fitted_models import FittedModels, astray
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

NUMBERS = SimpleNamespace(residual=np.zeros(1), jacobian=np.zeros((1, 1)))
QUIET = Noise({}, {})
SEGMENTS, EACH = 20, 50


@pytest.mark.parametrize(
    ("name", "factor", "gone"),
    [("sigma_t", 2.9, False), ("sigma_t", 3.1, True), ("K", 0.32, True), ("T_d_thrust", 0.2, False)],
)
def test_a_gain_or_lag_is_astray_beyond_a_factor_of_three_and_a_delay_never(name, factor, gone):
    origin = {"sigma_t": 20.0, "K": 50.0, "T_d_thrust": 0.04}
    assert astray(tuple(origin), origin | {name: factor * origin[name]}, origin) is gone
    assert not astray((), origin | {name: factor * origin[name]}, origin)


class Likelihoods:
    """An estimator whose every fit of a model gains what `gains` states for its terms; compared: what each was compared with."""

    segments = ()

    def __init__(self):
        self.compared = []

    def problem(self, model):
        return SimpleNamespace(names=model.names)

    def fit(self, model, start, names, *, compared_with=None, reported=False):
        self.compared.append(("".join(sorted(model.terms)), compared_with))
        return Optimum(dict.fromkeys(names, 1.0), {}, QUIET, 0.0, start.log_likelihood)

    def moved(self, model, at, values=None):
        return SimpleNamespace(values=at.values, log_likelihood=0.0, objective=0.0)

    def linearise(self, model, at, names):
        return None


@dataclass(frozen=True)
class Named:
    """A model of terms that have no parameters."""

    terms: tuple
    names: tuple = ()
    params: tuple = ()

    def without_terms(self, term):
        return Named(tuple(t for t in self.terms if t != term))


def found(*terms, likelihood):
    return Fitted(Named(terms), (), Optimum({}, {}, QUIET, 0.0, likelihood), None)


def test_a_model_that_diverges_without_one_of_its_terms_is_fitted_from_the_base():
    class Diverging(Likelihoods):
        def moved(self, model, at, values=None):
            stable = all(at.values[n] >= 0.0 for n in at.values)
            return Optimum(at.values | (values or {}), {}, QUIET, 0.0 if stable else np.inf, 0.0)

        def fit(self, model, start, names, *, compared_with=None, reported=False):
            self.compared.append(start)
            return start

    estimator = Diverging()
    drag = SimpleNamespace(id="a", amplitudes=(SimpleNamespace(name="k", off=0.0),))
    base = Fitted(Named(()), (), SimpleNamespace(values={"d": 1.0}, objective=0.0), NUMBERS)
    models = FittedModels(estimator, (drag, SimpleNamespace(id="b", amplitudes=())), base=base)
    at = Optimum({"d": -2.0, "k": 5.0}, {}, QUIET, 0.0, 9.0)
    models.without("b", Fitted(Named(("a", "b")), (), at, NUMBERS))
    assert [s.values for s in estimator.compared] == [{"d": 1.0, "k": 0.0}]


def test_a_smaller_model_is_fitted_once_for_comparisons_and_again_where_one_is_closer_or_it_stays():
    estimator = Likelihoods()
    models = FittedModels(estimator, tuple(SimpleNamespace(id=t) for t in "abc"))
    rough = models.without("b", found("a", "b", likelihood=1000.0))
    assert models.without("c", found("a", "c", likelihood=2000.0)) is rough
    assert estimator.compared == [("a", 1000.0)]
    models.without("c", found("a", "c", likelihood=20.0))
    assert estimator.compared[1:] == [("a", 20.0)]
    exact = models.refined(models.without("c", found("a", "c", likelihood=20.0)))
    assert estimator.compared[2:] == [("a", None)]
    assert models.refined(exact) is models.without("b", found("a", "b", likelihood=1.0)) is exact
    assert len(estimator.compared) == 3


class Stuck(Likelihoods):
    """An estimator that estimates `ends` where it is asked to, with standard errors of `error`."""

    def __init__(self, ends, error=0.02):
        super().__init__()
        self.ends, self.asked, self.error = ends, [], error
        self.segments = responses(SEGMENTS, EACH)

    def problem(self, model):
        return SimpleNamespace(names=tuple(self.ends))

    def fit(self, model, start, names, *, compared_with=None, reported=False):
        self.asked.append(names)
        return Optimum({**start.values, **{n: self.ends[n] for n in names}}, {}, QUIET, 0.0)

    def moved(self, model, at, values=None):
        return Optimum({**at.values, **(values or {})}, {}, QUIET, 0.0)

    def linearise(self, model, at, names):
        rng = np.random.default_rng(0)
        columns = rng.normal(size=(SEGMENTS * EACH, len(names))) * (SEGMENTS * EACH) ** -0.5 / self.error
        return rows_of(rng.normal(size=SEGMENTS * EACH), columns, SEGMENTS, names=names)


@pytest.mark.parametrize(
    ("term", "ends", "error", "held"),
    [
        ("steady_wind", {"w_north": 2.0, "w_up": -3.0}, 0.02, ("w_up",)),  # at its bound, which is another effect
        ("steady_wind", {"w_north": 20.0, "w_up": 0.5}, 0.02, ()),  # a wind can be all there is of it
        ("quadratic_drag", {"k_x": 0.05, "k_z": -0.2}, 0.02, ("k_z",)),  # a drag that pushes
        ("quadratic_drag", {"k_x": 0.05, "k_z": -0.1}, 0.02, ("k_z",)),
        ("quadratic_drag", {"k_x": 0.05, "k_z": -0.1}, 0.08, ()),  # within its error of nothing
        ("quadratic_drag", {"k_x": -0.1, "k_z": -0.2}, 0.02, ()),  # nothing of it is drag
    ],
)
def test_what_is_not_the_effect_of_its_term_is_held_and_the_rest_estimated(term, ends, error, held):
    """A drag of k_x 0.050 and k_y 0.059 on the real firmware's log was refused for a k_z of -0.2, its bound."""
    model, estimator = Model(("linear_drag", term)), Stuck({"K": 50.0, **ends}, error)
    models = FittedModels(estimator, (catalogue()[term],))
    start = Optimum({"K": 50.0, **dict.fromkeys(ends, 0.0)}, {}, QUIET, 0.0)
    fitted = models.fit(model, start, frozenset())
    kept = tuple(n for n in estimator.ends if n not in held)
    assert estimator.asked == [tuple(estimator.ends), *([kept] if held else [])]
    assert fitted.names == kept
    assert all(fitted.at.values[n] == 0.0 for n in held)
