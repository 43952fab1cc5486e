"""What is done when nothing more joins: remainders of an equation go, and a model with fewer names is looked for."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from flighttest.diagnose.fitted import Fitted, Judged, judge, preferred
from made_rows import rows_of

from flighttest.diagnose import another_way as other
from flighttest.diagnose import remainders
from flighttest.diagnose import search as search_module
from flighttest.diagnose.search import Search, silent
from flighttest.physics.model import Model

PLACE = ("roll_rad", "roll_step")


def judged(term, size, place=PLACE, gain=0.5):
    effect = np.zeros(20)
    effect[:10] = size
    return Judged(term, -100.0, 2.0, place, gain, 0.001, effect, effect)


def ended(*terms):
    search = SimpleNamespace(
        judged={j.term: j for j in terms},
        refused={},
        now=SimpleNamespace(rows=SimpleNamespace(open_residual=np.zeros(20), segment=np.zeros(20, dtype=int))),
        bench=SimpleNamespace(segments=(SimpleNamespace(kind="roll_step"),)),
        floor=SimpleNamespace(at=lambda _channel, _kind: 1.0, of=lambda _channel: 1.0),
        progress=lambda _text: None,
        without=lambda term: SimpleNamespace(rows=search.now.rows, without=term),
    )
    search.judge = lambda term, _before, _after, _p: search.judged[term]
    return search


@pytest.fixture(autouse=True)
def two_places(monkeypatch):
    table = {PLACE: np.arange(10), ("v_z_m_s", "throttle_step"): np.arange(10, 20)}
    monkeypatch.setattr(remainders, "places", lambda _rows, _segments: table)


def test_what_mends_another_equation_is_not_named():
    search = ended(judged("reference_shaping", 1.0), judged("rate_limit", 0.02), judged("attitude_extra_pole", 0.01))
    remainders.drop_remainders(search)
    assert list(search.judged) == ["reference_shaping"]
    assert search.now.without == "rate_limit"
    assert "2.0 % of what reference_shaping does" in search.refused["rate_limit"].reason


def test_a_small_effect_where_nothing_else_acts_stays():
    small = judged("rotor_speed_lag", 0.0, ("v_z_m_s", "throttle_step"))
    small = replace(small, effect=np.r_[np.zeros(10), np.full(10, 0.02)])
    search = ended(judged("reference_shaping", 1.0), small, judged("rate_limit", 0.3))
    remainders.drop_remainders(search)
    assert set(search.judged) == {"reference_shaping", "rotor_speed_lag", "rate_limit"}


def test_what_takes_little_of_what_stays_is_no_name_for_it():
    search = ended(judged("throttle_curve", 1.0, gain=0.07))
    remainders.drop_remainders(search)
    assert search.judged == {}
    assert "takes 7 % of the error where it shows" in search.refused["throttle_curve"].reason


def test_beside_a_copy_an_effect_is_judged_again_without_it():
    search = ended(judged("steady_wind", 1.0, gain=0.2), judged("throttle_curve", 1.0, gain=0.1))
    again = {"steady_wind": judged("steady_wind", 1.0, gain=0.6)}
    search.judge = lambda term, _before, _after, _p: again[term]
    remainders.drop_remainders(search)
    assert list(search.judged) == ["steady_wind"]


@pytest.mark.parametrize(("by_the_others", "stays"), [(8.0, True), (1.5, False)])
def test_what_only_steps_call_for_that_nobody_explains_is_no_name(monkeypatch, by_the_others, stays):
    term = replace(judged("throttle_offset", 1.0), effect=np.r_[np.full(10, 1.0), np.full(10, 0.8)])
    search = ended(term)
    # Four floors stay in throttle steps, where the term does 0.8 of one.
    left = np.r_[np.full(10, 0.1), np.full(10, 4.0)]
    search.now.rows = SimpleNamespace(open_residual=left, segment=np.repeat([0, 1], 10))
    search.bench.segments = (SimpleNamespace(kind="roll_step"), SimpleNamespace(kind="throttle_step"))
    asked = []
    monkeypatch.setattr(remainders, "size_without", lambda _now, _term, rest: asked.append(rest) or by_the_others)
    remainders.drop_remainders(search)
    assert ("throttle_offset" in search.judged) is stays
    np.testing.assert_array_equal(asked[0], np.repeat([True, False], 10))
    if not stays:
        assert "only throttle steps show it" in search.refused["throttle_offset"].reason


@pytest.mark.parametrize("by_the_way", [0.0, 0.6, 1.4])
def test_what_stays_in_a_channel_that_hardly_shows_a_term_is_none_of_its_business(monkeypatch, by_the_way):
    term = judged("throttle_offset", 3.0)
    search = ended(replace(term, effect=np.r_[np.full(10, 3.0), np.full(10, by_the_way)]))
    search.now.rows = SimpleNamespace(
        open_residual=np.r_[np.zeros(10), np.full(10, 4.0)], segment=np.repeat([0, 1], 10)
    )
    search.bench.segments = (SimpleNamespace(kind="roll_step"), SimpleNamespace(kind="throttle_step"))
    monkeypatch.setattr(
        remainders, "places", lambda _r, _s: {PLACE: np.arange(10), ("v_y_m_s", "throttle_step"): np.arange(10, 20)}
    )
    monkeypatch.setattr(remainders, "size_without", lambda *_: pytest.fail("nothing stays where the term acts"))
    remainders.drop_remainders(search)
    assert list(search.judged) == ["throttle_offset"]


@pytest.mark.parametrize(
    ("shown", "left_in"), [("v_z_m_s", "f_z_m_s2"), ("v_z_m_s", "a_z_m_s2"), ("v_z_m_s", "v_z_m_s")]
)
@pytest.mark.parametrize(("takes", "asked"), [(0.3, True), (6.0, False)])
def test_what_stays_counts_in_a_velocity_and_in_the_force_on_it_unless_the_term_takes_more(
    monkeypatch, shown, left_in, takes, asked
):
    first, second = (shown, "roll_step"), (left_in, "throttle_step")
    term = judged("throttle_offset", 1.0, first)
    search = ended(replace(term, effect=np.r_[np.full(10, 1.0), np.full(10, takes)]))
    search.now.rows = SimpleNamespace(
        open_residual=np.r_[np.full(10, 0.1), np.full(10, 4.0)], segment=np.repeat([0, 1], 10)
    )
    search.bench.segments = (SimpleNamespace(kind="roll_step"), SimpleNamespace(kind="throttle_step"))
    monkeypatch.setattr(remainders, "places", lambda _r, _s: {first: np.arange(10), second: np.arange(10, 20)})
    monkeypatch.setattr(remainders, "size_without", lambda *_: 1.5)
    remainders.drop_remainders(search)
    assert ("throttle_offset" not in search.judged) is asked


def test_the_size_that_some_rows_alone_give_a_term(rng):
    columns = rng.normal(size=(800, 2))
    rows = replace(rows_of(rng.normal(size=800), columns), names=("K", "T_min"))
    fitted = SimpleNamespace(
        model=Model(("throttle_offset",)),
        names=rows.names,
        state=SimpleNamespace(values={"K": 50.0, "T_min": 0.5}),
        rows=rows,
    )
    some = rows.segment < 10
    assert remainders.size_without(fitted, "throttle_offset", some) == pytest.approx(0.5 / (1 / np.sqrt(400)), rel=0.4)
    # Three responses say nothing of how responses scatter.
    assert remainders.size_without(fitted, "throttle_offset", rows.segment < 3) == np.inf
    rows.jacobian[some, 1] = 0.0
    assert remainders.size_without(fitted, "throttle_offset", some) == 0.0


@dataclass
class Scripted(Search):
    """A search whose course is known: what is found depends on what the pool lacks."""

    course: dict = field(default_factory=dict)

    def go_on(self):
        ids = {t.id for t in self.pool}
        found = self.judged or self.course["without a" if "a" not in ids else "all"]
        self.judged = {t: judged(t, 1.0) for t in found}


def searched(monkeypatch, worth, alternative):
    found = {"all": ["a", "b", "c"], "without a": alternative}
    pool = tuple(SimpleNamespace(id=t) for t in "abcde")
    monkeypatch.setattr(other, "worth", lambda s: worth[tuple(s.judged)])
    monkeypatch.setattr(other, "drop_remainders", lambda _search: None)
    search = Scripted(SimpleNamespace(segments=()), pool, np.zeros(3, dtype=np.intp), course=found)
    search.base = search.now = SimpleNamespace(rows=None)
    search.go_on()
    return other.another_way(search)


def test_where_nothing_is_found_without_the_first_name_the_search_is_not_repeated(monkeypatch):
    walked = []
    usual = Scripted.go_on
    monkeypatch.setattr(Scripted, "go_on", lambda self: walked.append(len(self.pool)) or usual(self))
    search, said = searched(monkeypatch, {}, [])
    assert (list(search.judged), said) == (["a", "b", "c"], "")
    assert walked == [5, 4]  # the search itself, and once without its first name


def test_fewer_names_that_explain_nearly_as_much_are_believed(monkeypatch):
    search, said = searched(monkeypatch, {("a", "b", "c"): 1000.0, ("d", "e"): 970.0}, ["d", "e"])
    assert list(search.judged) == ["d", "e"]
    assert said.startswith("a, b and c together would explain these flights as well as d and e")


def test_fewer_names_that_explain_less_are_not(monkeypatch):
    search, said = searched(monkeypatch, {("a", "b", "c"): 1000.0, ("d", "e"): 900.0}, ["d", "e"])
    assert (list(search.judged), said) == (["a", "b", "c"], "")


def test_another_course_that_explains_more_is_taken(monkeypatch):
    search, said = searched(monkeypatch, {("a", "b", "c"): 1000.0, ("b", "c", "d", "e"): 1200.0}, ["b", "c", "d", "e"])
    assert (list(search.judged), said) == (["b", "c", "d", "e"], "")


def test_what_only_lacks_a_term_is_no_other_course(monkeypatch):
    search, said = searched(monkeypatch, {("a", "b", "c"): 1000.0, ("b", "c"): 990.0}, ["b", "c"])
    assert (list(search.judged), said) == (["a", "b", "c"], "")


def test_a_second_course_is_not_tried_for_two_terms(monkeypatch):
    monkeypatch.setattr(other, "worth", lambda _s: pytest.fail("no second search was due"))
    search = Scripted(SimpleNamespace(segments=()), (), np.zeros(3, dtype=np.intp), judged={"a": 1, "b": 2})
    assert other.another_way(search) == (search, "")


@pytest.mark.parametrize(("refused_bic", "asked"), [(-509.0, True), (-240.0, False)])
def test_what_is_refused_although_it_improves_more_is_looked_into_first(monkeypatch, refused_bic, asked):
    def scored(term, bic):
        variant = SimpleNamespace(term=SimpleNamespace(id=term), names=("a",), open_columns=np.ones((4, 1)))
        return SimpleNamespace(variant=variant, bic=bic, beyond_chance=True, estimate=np.ones(1), p_value=0.001)

    def search_of(look_ahead):
        found = SimpleNamespace(
            now=SimpleNamespace(rows=None), floor=1.0, judged={}, refused={}, look_ahead=look_ahead, progress=silent,
            scores=[scored("reference_shaping", -500.0), scored("rate_limit", -300.0)],
            bench=SimpleNamespace(block="roll_pitch", segments=()), _worst=lambda: 0.0, refitted_with=lambda s: s.variant.term.id,
        )  # fmt: skip
        bent = replace(judged("reference_shaping", 1.0), bic=refused_bic, reason="shaping_tc runs to its bound")
        table = {"reference_shaping": bent, "rate_limit": replace(judged("rate_limit", 1.0), bic=-232.0)}
        found.judge = lambda term, _before, _after, _p: table[term]
        found.take = lambda fitted, *_judged: taken.append(fitted)
        return found

    monkeypatch.setattr(search_module, "best_per_term", lambda scores: scores)
    monkeypatch.setattr(search_module, "size_in_floors", lambda *_: (5.0, PLACE))
    taken, looked = [], []
    assert Search._forward(
        search_of(lambda _search, refused: bool(looked.append([j.term for j, _ in refused])) or asked)
    )
    assert looked == ([["reference_shaping"]] if asked else [])
    assert taken == ([] if asked else ["rate_limit"])


@pytest.mark.parametrize(
    ("worst", "parts", "taken"),
    [(50.0, np.ones(40), ["motor_saturation"]), (50.0, np.tile([1.0, -1.0], 20), []), (1.1, np.ones(40), [])],
)
def test_where_much_is_wrong_and_no_score_stands_out_refits_are_asked(monkeypatch, worst, parts, taken):
    variant = SimpleNamespace(term=SimpleNamespace(id="motor_saturation"), names=("a",), open_columns=np.ones((4, 1)))
    hidden = SimpleNamespace(variant=variant, bic=-195.0, beyond_chance=False, estimate=np.ones(1), p_value=0.5)
    joined = []
    search = SimpleNamespace(
        now=SimpleNamespace(rows=None, names=("K",)), floor=1.0, judged={}, refused={}, look_ahead=None, progress=silent, scores=[hidden],
        bench=SimpleNamespace(block="translation", segments=()), _worst=lambda: worst,
        refitted_with=lambda _s: SimpleNamespace(names=("K", "T_max")),
        judge=lambda term, _before, _after, _p: replace(judged(term, 1.0), bic=-900.0),
        take=lambda _fitted, judged: joined.append(judged.term),
    )  # fmt: skip
    monkeypatch.setattr(search_module, "best_per_term", lambda scores: scores)
    monkeypatch.setattr(search_module, "size_in_floors", lambda *_: (5.0, PLACE))
    monkeypatch.setattr(search_module, "parts_of", lambda _rows, _own: parts)
    monkeypatch.setattr(search_module, "plain", lambda _parts, _bic: False)
    Search._forward(search)
    assert joined == taken


@pytest.mark.parametrize("diverged", [np.nan, np.inf, 1e200])
def test_a_term_with_which_the_simulation_diverges_is_dropped_with_its_reason(diverged):
    rng = np.random.default_rng(3)
    sound = rows_of(rng.normal(size=800), rng.normal(size=(800, 2)))
    broken = replace(sound, jacobian=sound.jacobian * diverged)
    before, after = (Fitted(Model(), ("p0", "p1"), None, rows) for rows in (sound, broken))
    nothing = judge("voltage_sag", before, after, 0.001, None, np.zeros(20, dtype=int), ())
    assert not nothing.kept
    assert "not finite" in nothing.reason
    assert preferred(before, after)
    assert not preferred(after, before)
    # Without it the flights cannot be simulated: it stays.
    assert judge("voltage_sag", after, before, 0.001, None, np.zeros(20, dtype=int), ()).kept
