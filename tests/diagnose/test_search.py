"""The course of a search, where what every refit finds is known."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import evidence, rows_of

from flighttest.diagnose.selection import aliases as aliases_module
from flighttest.diagnose.selection import search as search_module
from flighttest.diagnose.selection.aliases import Alias, aliases_of
from flighttest.diagnose.selection.candidates import Candidate, candidates_at
from flighttest.diagnose.selection.comparison import Fitted
from flighttest.diagnose.selection.fitted_models import FittedModels
from flighttest.diagnose.selection.search import Search
from flighttest.diagnose.selection.subsets import Scored
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

NUMBERS = SimpleNamespace(residual=np.zeros(1), jacobian=np.zeros((1, 1)))
NO_NUMBERS = SimpleNamespace(residual=np.zeros(1), jacobian=np.full((1, 1), np.nan))

QUIET = Noise({}, {})


def fitted(*terms):
    return Fitted(SimpleNamespace(terms=tuple(sorted(terms))), (), SimpleNamespace(objective=1.0), NUMBERS)


@dataclass
class ScriptedModels(FittedModels):
    """What was refitted with candidates."""

    refits: list = field(default_factory=list)

    def fit(self, model, start, inactive, reported=False):
        return fitted(*model.terms) if reported else fitted()

    def with_candidates(self, among, members, scored):
        made = fitted(*among.model.terms, *(c.term.id for c in members))
        self.refits.append("".join(made.model.terms))
        return made

    def beside(self, kept, term, rest):
        return fitted(*kept.model.terms, term)


@dataclass
class Scripted(Search):
    """Scores by set of terms; what refits find of a term beside others: nats, or why it cannot be."""

    scores: dict = field(default_factory=dict)
    finds: dict = field(default_factory=dict)
    asked: list = field(default_factory=list)
    answered: list = field(default_factory=list)
    lacking: bool = False
    bare: tuple = ()  # terms without a linear coefficient
    bent: tuple = ()  # terms with nonlinear parameters beside them
    loose: tuple = ()  # these with states of their own that are free at the start of a response

    @property
    def refits(self):
        """Of what with what."""
        return self.models.refits

    def linearise(self):
        self.candidates = [
            SimpleNamespace(
                term=SimpleNamespace(
                    id=t.id,
                    shapes=("s",) if t.id in (*self.bent, *self.loose) else (),
                    states=(SimpleNamespace(free=False), SimpleNamespace(free=t.id in self.loose)),
                ),
                names=() if t.id in self.bare else ("c",),
            )
            for t in self.pool
            if t.id not in self.members
        ]
        position = {c.term.id: j for j, c in enumerate(self.candidates)}
        self.scored = [
            Scored(tuple(position[t] for t in terms), value, np.zeros(len(terms)))
            for terms, value in sorted(self.scores.items(), key=lambda kv: -kv[1])
            if set(terms) <= set(position)
        ]
        self.subsets = SimpleNamespace(terms=lambda s: frozenset(self.candidates[j].term.id for j in s.members))
        self.sizes = SimpleNamespace(candidates=self.candidates, least=lambda subsets: np.full(len(subsets), 9.0))
        self.lack_of_fit = self.lacking

    def _evidence(self, term, found):
        if not any(of is found and t == term for t, of in self.answered):
            self.asked.append(term)
        self.answered.append((term, found))
        return self.known(term, found)

    def known(self, term, found):
        """What a refit without a term finds."""
        value = self.finds.get(("".join(found.model.terms), term), self.finds.get(term, 100.0))
        rest = fitted(*(t for t in found.model.terms if t != term))
        how = value if isinstance(value, dict) else {"inadmissible" if isinstance(value, str) else "nats": value}
        if isinstance(value, tuple):
            how = dict(zip(("inadmissible", "nats"), value, strict=True))
        return evidence(term, **how, without=rest)


@pytest.fixture
def made():
    """The searches that were begun, the last one last."""
    return []


@pytest.fixture
def searched(monkeypatch, made):
    monkeypatch.setattr(search_module, "floor_of", lambda *_: SimpleNamespace())

    def run(scores, finds, better=1.0, stays=0.0, **how):
        monkeypatch.setattr(search_module, "share_left", lambda *_: stays)
        monkeypatch.setattr(search_module, "log_evidence", lambda *_: {"": better})
        pool = tuple(SimpleNamespace(id=t, params=(SimpleNamespace(drift=float(t == "d")),)) for t in "abcd")
        estimator = SimpleNamespace(insensitive=lambda *_: frozenset(), segments=())
        table = {tuple(k): v for k, v in scores.items()}
        models = ScriptedModels(estimator, pool)
        search = Scripted(models, np.zeros(3, dtype=int), scores=table, finds=finds, **how)

        def least_needed_first(terms, found, *_):
            known = {t.id: search.known(t.id, found) for t in terms}
            return sorted(terms, key=lambda t: (bool(known[t.id].inadmissible), known[t.id].nats))

        monkeypatch.setattr(search_module, "least_needed_first", least_needed_first)
        monkeypatch.setattr(search_module, "inadmissible", lambda t, found, *_: search.known(t.id, found).inadmissible)
        made.append(search)
        search.run(None, None)
        return search

    return run


def test_the_best_subset_is_refitted_and_what_it_needs_is_named(searched):
    search = searched({"a": 5.0, "b": 4.0, "ab": 9.0}, {})
    assert search.refits == ["ab"]
    assert search.members == search.named == {"a", "b"}


def test_what_has_odds_against_it_is_not_refitted(searched):
    assert searched({"a": -0.1, "b": -3.0}, {}).refits == []


@pytest.mark.parametrize("how", ["bare", "bent"])
def test_where_something_is_missing_nonlinear_terms_are_refitted_whatever_their_score(searched, how):
    """Of two roll steps that nothing repeated, a third pole of 9 noise floors had odds against it, and 4500 nats once it was refitted."""
    scores, finds = {"a": -5.0, "b": -9.0, "ab": -2.0}, {"a": 0.0, "b": 0.0}
    assert searched(scores, finds, lacking=True, **{how: ("b",)}).refits == ["b"]
    assert searched(scores, finds, lacking=False, **{how: ("b",)}).refits == []


def test_beside_a_named_term_the_score_of_a_coefficient_holds(searched):
    """A load of 1 % on a cable of 4 m was named beside a sagging voltage, for what the equations leave."""
    scores, finds = {"a": 5.0, "b": -9.0}, {}
    assert searched(scores, finds, lacking=True, bent=("b",)).named == {"a"}
    assert searched(scores, finds, lacking=True, bare=("b",)).named == {"a", "b"}


@pytest.mark.parametrize(("stays", "named"), [(0.3, {"a", "b"}), (0.1, {"a"})])
def test_a_load_that_swings_as_windows_begin_is_refitted_whatever_its_score_while_much_stays(searched, stays, named):
    """Beside a translational lift a load of 0.3 of the mass had log odds of -4 and 29,000 nats; for the 5 % that a saturation of the motors
    leaves, a load of 0.025 on 12 m of cable was named."""
    scores, finds = {"a": 5.0, "b": -9.0}, {}
    assert searched(scores, finds, lacking=True, loose=("b",), stays=stays).named == named
    assert searched(scores, finds, lacking=False, loose=("b",), stays=stays).named == {"a"}
    alone = searched({"b": -9.0}, finds, lacking=True, loose=("b",), stays=stays)
    assert alone.named == {"b"}


def test_a_term_that_left_is_not_proposed_again_from_the_same_model(searched):
    search = searched({"ab": 12.0, "a": 10.0, "b": 5.0}, {"a": 0.0})
    assert search.refits == ["ab"]
    assert search.named == {"b"}
    assert set(search.rejected) == {"a"}
    search = searched({"a": 10.0, "ac": 9.0}, {"a": 0.0})
    assert search.refits == ["a"]
    assert search.named == frozenset()


def test_a_term_that_left_beside_another_that_left_later_is_tried_again(searched):
    search = searched({"abc": 10.0, "b": 5.0}, {("abc", "b"): 0.0, ("ac", "c"): 0.0})
    assert search.refits == ["abc", "ab"]
    assert search.named == {"a", "b"}


def test_a_term_that_left_beside_one_that_cannot_be_is_asked_of_by_itself(searched):
    """A rate feedforward is what a reference shaping of no length does, too: it left beside one, which then was at its bound."""
    finds = {("ab", "a"): 0.0, ("ab", "b"): ("it is at its bound", 93.0), "b": ("it is at its bound", 93.0), "a": 94.0}
    search = searched({"ab": 12.0, "a": 10.0}, finds)
    assert search.refits == ["ab", "a"]
    assert search.named == {"a"}


def test_a_term_that_is_not_needed_beside_a_better_one_that_was_refused_is_not_named(searched):
    """Half an angle boost, refused at its bound with 93 nats, and a translational lift of 12 nats: neither is there."""
    scores, bound = {"a": 10.0, "b": 8.0}, "it is at its bound"
    search = searched(scores, {"a": (bound, 93.0), "b": 12.0, ("ab", "b"): 0.0})
    assert search.named == frozenset()
    assert "beside a" in search.rejected["b"].why_not
    assert searched(scores, {"a": (bound, 93.0), "b": 12.0}).named == {"b"}  # it is needed beside a
    assert searched(scores, {"a": (bound, 11.0), "b": 12.0, ("ab", "b"): 0.0}).named == {"b"}  # a explains no more


def test_a_term_that_is_not_needed_beside_a_better_one_too_small_for_a_name_is_not_named(searched):
    """A lag of the rotors' speed of 0.47 noise floors and 4,765 nats, and an asymmetry of the spin-up of 0.77 and 1,022: neither is named,
    in whatever order they are tried."""
    finds = {"a": {"nats": 93.0, "floors": 0.5}, "b": 12.0, ("ab", "a"): 50.0, ("ab", "b"): 0.0}
    for scores in ({"a": 10.0, "b": 8.0}, {"a": 8.0, "b": 10.0}):
        search = searched(scores, finds)
        assert search.named == frozenset()
        assert "beside a" in search.rejected["b"].why_not
        assert "too small" in search.rejected["a"].why_not
        assert searched(scores, finds | {("ab", "b"): 20.0, ("ab", "a"): 0.0}).named == {"b"}  # it is needed beside a
        assert searched(scores, finds | {"a": {"nats": 11.0, "floors": 0.5}}).named == {"b"}  # a explains no more


@pytest.mark.parametrize(("drifts", "named"), [("d", set()), ("a", {"b"})])
def test_what_is_not_needed_beside_what_instruments_drift_by_is_not_named(searched, drifts, named):
    """An accelerometer's bias of 0.08 m/s^2, as instruments have, and an offset of the attitude of 9 mrad that takes its place."""
    scores = {drifts: 10.0, "b": 8.0}
    finds = {drifts: {"nats": 93.0, "nothing": "it may be nothing"}, "b": 12.0}
    both = "".join(sorted((drifts, "b")))
    search = searched(scores, finds | {(both, "b"): 0.0, (both, drifts): finds[drifts]})
    assert search.named == named
    assert search.members == named | ({"d"} if drifts == "d" else set())
    assert search.rejected[drifts].why_not == "it may be nothing"


def test_what_instruments_drift_by_is_proposed_again_where_it_came_with_what_does_not_stay(searched):
    finds = {"d": {"nats": 93.0, "nothing": "it may be nothing"}, "a": {"nats": 50.0, "floors": 0.5}, "b": 12.0}
    search = searched({"a": 12.0, "bd": 10.0, "d": 8.0}, finds | {("abd", "b"): 0.0})
    assert search.members == {"d"}
    assert not search.named
    search = searched({"bd": 10.0}, finds)
    assert search.members == {"b", "d"}
    assert search.named == {"b"}


def test_what_is_named_beside_a_term_that_goes_is_judged_anew(searched):
    scores = {"bc": 10.0, "a": 8.0}
    finds = {"a": {"nats": 93.0, "floors": 0.5}, ("abc", "a"): 50.0, ("abc", "b"): 0.0, "b": 12.0}
    search = searched(scores, finds)
    assert search.members == search.named == {"c"}
    assert searched(scores, finds | {("c", "c"): 0.0}).named == frozenset()


@pytest.mark.parametrize("reason", ["inadmissible", "nothing"])
def test_a_term_beside_which_one_that_explains_more_cannot_be_leaves_in_its_place(searched, reason):
    """A third pole of 185 nats bent a reference shaping of 92,000 until its feedforward was at its bound. Beside a rate limit of 330 nats
    the three parameters of a shaping of 380 had intervals wider than their values, and the rate limit was named."""
    refused = {reason: "it is not known", "nats": 93.0}
    search = searched({"ab": 10.0}, {("ab", "a"): refused, ("ab", "b"): 12.0, "a": 93.0})
    assert search.named == {"a"}
    assert "a, which explains more, cannot be beside it (it is not known)" in search.rejected["b"].why_not
    # Not where it cannot be by itself, either, nor where the other one explains more.
    assert searched({"ab": 10.0}, {"a": refused, "b": 12.0}).named == {"b"}
    assert searched({"ab": 10.0}, {("ab", "a"): refused, "a": 93.0, "b": 200.0}).named == {"b"}


def test_an_older_term_is_asked_only_once_the_newcomers_stay(searched):
    search = searched({"a": 10.0, "b": 8.0}, {("ab", "b"): 0.0})
    assert search.asked == ["a", "b", "a", "a"]  # a alone; b beside it, which leaves; what stays, and as it is reported


def test_a_term_that_is_not_needed_leaves_before_the_others_are_asked(searched):
    search = searched({"abc": 10.0}, {("abc", "b"): 0.0})
    assert search.asked == ["b", "a", "c", "a", "c"]  # each of what stays once more as it is reported
    search = searched({"abc": 10.0}, {("abc", "b"): "it is at its bound", ("ac", "a"): 20.0})
    assert search.asked == ["a", "c", "b", "a", "c", "a", "c"]  # inadmissible ones are asked last


def test_beside_another_term_it_may_be_needed_unless_it_cannot_be(searched):
    search = searched({"a": 10.0, "b": 8.0}, {("a", "a"): 0.0})
    assert search.refits == ["a", "b", "ab"]
    assert search.named == {"a", "b"}
    search = searched({"a": 10.0, "b": 8.0}, {("a", "a"): "it is at its bound"})
    assert search.refits == ["a", "b"]
    assert search.named == {"b"}


def test_what_is_not_needed_at_the_optimum_that_is_reported_leaves(searched, monkeypatch):
    """An interval that held nothing was printed beside a name: the search had stopped where it did not."""
    finds = {}

    def reported(self, model, start, inactive, reported=False):
        finds["a"] = 0.0 if reported else 100.0
        return fitted(*model.terms) if reported else fitted()

    monkeypatch.setattr(ScriptedModels, "fit", reported)
    monkeypatch.setattr(ScriptedModels, "refined", lambda self, one: one)
    search = searched({"a": 10.0}, finds)
    assert search.named == frozenset()
    assert set(search.rejected) == {"a"}
    assert {c.term.id for c in search.candidates} == set("abcd")  # beside the model that is left


def test_a_model_is_never_replaced_by_one_that_holds_less(searched):
    # Beside b, a is not needed, and then b is not, either.
    finds = {("ab", "a"): 0.0, ("b", "b"): 0.0}
    search = searched({"a": 10.0, "b": 8.0}, finds)
    assert search.refits == ["a", "ab"]
    assert search.members == search.named == {"a"}
    assert set(search.rejected) == {"b"}


@pytest.mark.parametrize(("better", "named"), [(0.5, {"b"}), (-0.5, {"a"})])
def test_other_terms_take_its_place_where_they_predict_better(searched, better, named):
    search = searched({"a": 10.0, "b": 8.0}, {("ab", "a"): 0.0}, better)
    assert search.members == search.named == named


def test_the_newcomer_leaves_before_an_older_term_and_an_impossible_one_last(searched):
    # Without the newcomer b, a is what it was.
    search = searched({"a": 10.0, "b": 8.0}, {("ab", "a"): 5.0, ("ab", "b"): 6.0})
    assert search.named == {"a"}
    # c is impossible only beside b, which is not needed.
    search = searched({"bc": 10.0}, {("bc", "c"): "it is at its bound", ("bc", "b"): 0.0})
    assert search.named == {"c"}


def test_an_interrupted_search_keeps_what_it_had(searched, made, monkeypatch):
    usual = Scripted.linearise

    def interrupted(self):
        if self.named:
            raise KeyboardInterrupt
        usual(self)

    monkeypatch.setattr(Scripted, "linearise", interrupted)
    with pytest.raises(KeyboardInterrupt):
        searched({"a": 10.0, "b": 8.0}, {})
    assert made[0].members == made[0].named == {"a"}
    assert made[0].candidates == []  # their columns were of the model before


@pytest.mark.parametrize("what", [{"at": SimpleNamespace(objective=np.inf)}, {"rows": NO_NUMBERS}])
def test_a_refit_that_is_not_finite_is_a_dropped_candidate(searched, monkeypatch, what):
    usual = ScriptedModels.with_candidates

    def diverging(self, among, members, scored):
        found = usual(self, among, members, scored)
        return replace(found, **what) if "a" in found.model.terms else found

    monkeypatch.setattr(ScriptedModels, "with_candidates", diverging)
    search = searched({"a": 10.0, "b": 8.0}, {})
    assert search.refits == ["a", "b", "ab"]
    assert search.named == {"b"}


def test_a_refit_whose_algebra_fails_is_a_dropped_candidate(searched, monkeypatch):
    usual = ScriptedModels.with_candidates

    def failing(self, among, members, scored):
        found = usual(self, among, members, scored)
        if "a" in found.model.terms:
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return found

    monkeypatch.setattr(ScriptedModels, "with_candidates", failing)
    assert searched({"a": 10.0, "b": 8.0}, {}).named == {"b"}


@pytest.mark.parametrize(("nats", "confusable"), [(-5.0, True), (2.0, True), (2.9, True), (4.0, False), (5.9, False)])
def test_a_rival_is_within_chance_up_to_odds_of_twenty(nats, confusable):
    assert Alias("b", 0.95, nats).confusable is confusable


@pytest.mark.parametrize(("cosine", "tried"), [(0.85, False), (0.88, False), (0.92, True), (0.96, True)])
def test_what_points_elsewhere_is_not_refitted_in_its_place(monkeypatch, rng, cosine, tried):
    n = 400
    base, effect, other = np.linalg.qr(rng.normal(size=(n, 3)))[0].T
    rows = rows_of(np.zeros(n), base[:, None])
    model = SimpleNamespace(term_of=lambda _name: "body")
    without = Fitted(model, ("p0",), SimpleNamespace(objective=1.0), rows)
    column = (cosine * effect + np.sqrt(1 - cosine**2) * other + 3.0 * base)[:, None]
    alike = Candidate(SimpleNamespace(id="b"), {}, ("b0",), column, lambda: column)
    asked = []
    monkeypatch.setattr(
        FittedModels, "with_candidates", lambda _self, _among, members, _s: asked.append(members) or without
    )
    monkeypatch.setattr(aliases_module, "inadmissible", lambda *_: "")
    monkeypatch.setattr(aliases_module, "floor_of", lambda *_: None)
    monkeypatch.setattr(aliases_module, "log_evidence", lambda *_: {"": 1.0})
    pool = tuple(SimpleNamespace(id=t) for t in "ab")
    models = FittedModels(SimpleNamespace(segments=()), pool)
    search = Search(models, np.zeros(1, dtype=int), now=without, candidates=[alike])
    search.evidence = {"a": replace(evidence("a", without=without), profiled=5.0 * effect)}
    (alias,) = aliases_of(search, "a")
    assert alias.cosine == pytest.approx(cosine)
    assert bool(asked) is tried
    assert alias.confusable is tried


class Half:
    """An estimator of one column per name; what is asked of `broken` is not a number."""

    def __init__(self, broken):
        self.broken = broken

    def problem(self, model):
        return SimpleNamespace(names=tuple(model.names))

    def derivatives(self, _model, _at, names, _values):
        return [np.stack([np.full((1, 4), np.nan if n in self.broken else 1.0) for n in names], axis=2)]

    def differences(self, _model, _at, others):
        for changed, values in others:
            bad = any(t in changed.terms for t in ("rate_limit",)) and values["rate_max"] > 6.0
            yield [np.full((1, 4, 1), np.inf if bad else 1.0)]


def test_a_candidate_whose_simulation_is_not_finite_is_dropped():
    model = Model()
    known = catalogue()
    terms = [known[t] for t in ("steady_wind", "accelerometer_bias", "rate_limit")]
    rows = SimpleNamespace(profiled=lambda raw: raw[0][0], unprofiled=list)
    at = Optimum(dict(model.start()), {}, Noise({}, {}), 0.0)
    found = candidates_at(Half(("w_north",)), model, at, rows, terms)
    assert {c.term.id for c in found} == {"accelerometer_bias", "rate_limit"}
    assert all(c.shape["rate_max"] <= 6.0 for c in found if c.term.id == "rate_limit")
    assert len([c for c in found if c.term.id == "rate_limit"]) >= 1
