"""`status` misses nothing: every parameter of a model is tested or listed, and an effect that came makes it stale."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.diagnose import Verdict as Found
from flighttest.errors import FitError
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.pipeline.validity import status
from flighttest.pipeline.validity.evidence import (
    ASKED,
    OF_THE_DAY,
    POWER,
    appeared,
    as_old,
    doubtful,
    may_have_been_missed,
    not_seen,
    subsets_of,
    untested,
    untested_sentences,
)
from flighttest.pipeline.validity.status import ENOUGH_HISTORY, discrepancy_allowed
from flighttest.report.sections.validity import status_document
from flighttest.validity.assess import RecordingEvidence, assess
from flighttest.validity.compare import Estimates, subset_tests
from flighttest.validity.model import Appeared, NotSeen, ValidityVerdict

TERMS = ("body", "linear_drag", "quadratic_drag")


def stored(terms=TERMS, diagnosed=None):
    model = Model(terms)
    values = model.start({n: 0.05 for n in ("k_x", "k_y", "k_z") if n in model.names})
    known = {n: StoredParameter(v, model.param[n].unit, 0.01 * abs(v) + 1e-6) for n, v in values.items()}
    order = tuple(known)
    matrix = np.diag([float(known[n].std) ** 2 for n in order])
    return ModelFile(model, known, values, order, matrix, {}, diagnosed=diagnosed or {})


def estimates(model, names, **factors):
    values = np.array([model.values[n] * factors.get(n, 1.0) for n in names])
    return Estimates("x", tuple(names), values, np.diag((0.01 * np.abs(values)) ** 2))


@pytest.mark.parametrize("reported", [("K", "sigma_t"), ("d_z",), ("d_z", "omega_phi", "T_d_thrust", "k_x")])
def test_every_parameter_is_tested_or_listed(reported):
    model = stored()
    subsets = subsets_of(model.model)
    assert {n for names in subsets.values() for n in names} == set(model.model.names)
    tests = subset_tests(estimates(model, model.model.names), estimates(model, reported), subsets=subsets)
    missed = untested(model, subsets, tests, {"d_x": 0.1, "d_y": None}, {"d_x": 0.02})
    shown = {n for t in tests for n in t.shifts}
    assert shown | {u.parameter for u in missed} == set(model.model.names)
    assert not shown & {u.parameter for u in missed}
    d_x = next(u for u in missed if u.parameter == "d_x")
    expected = np.hypot(np.hypot(0.1, model.parameters["d_x"].std), 0.02 * model.values["d_x"]) / model.values["d_x"]
    assert 2.5 * expected < d_x.smallest < 4.0 * expected
    (words,) = [w for w in untested_sentences(missed) if w.startswith("drag: ")]
    assert "d_x would have shown from" in words
    assert "d_y" in words.partition("not at all")[0]
    assert "fly roll_pitch" in words


@pytest.mark.parametrize(("name", "subset"), [("k_x", "quadratic_drag"), ("T_d_thrust", "delay"), ("d_x", "drag")])
def test_a_change_of_any_parameter_makes_the_model_stale(name, subset):
    model = stored()
    names = model.model.names

    def verdict(factor):
        new = estimates(model, names, **{name: factor})
        both = {"model_fingerprint": {}, "vehicle_fingerprint": None, "subsets": subsets_of(model.model)}
        return assess(stored=estimates(model, names), new=RecordingEvidence(runs=[new], spread={"d_x": 0.03}), **both)

    found = verdict(1.6)
    assert found.verdict is ValidityVerdict.STALE
    assert [t.subset for t in found.tests if t.alarm] == [subset]
    assert verdict(1.02).verdict is ValidityVerdict.CURRENT


def test_what_a_campaign_measured_between_its_conditions_does_not_hold_what_campaigns_differ_by():
    """Two days of one undamaged small quadrotor: 2.3 % of thrust in 4.1 standard errors, by a K said to differ by 0.4 %."""
    model = stored()
    model.fit_quality["discrepancy"] = {"K": 0.006, "sigma_t": 0.02}
    base = estimates(model, model.model.names)
    assert discrepancy_allowed(model, base, ()) == pytest.approx({"K": 0.01, "sigma_t": 0.02})
    own = discrepancy_allowed(model, base, [base] * ENOUGH_HISTORY)
    assert own["K"] < 0.006, "its own campaigns hold the difference"


def finding(term, value=1.0, std=0.01):
    parameters = {p.name: {"value": value, "std": std} for p in catalogue()[term].amplitudes}
    return SimpleNamespace(term=term, title=term.title(), sentence=f"{term} of some size", parameters=parameters)


def diagnosis(*terms, verdict=Found.EXPLAINED, repeated=True):
    located = (SimpleNamespace(sentence="f_z below 1 m", repeated=repeated),)
    return SimpleNamespace(findings=tuple(map(finding, terms)), verdict=verdict, located=located)


def test_an_effect_that_came_is_distinguished_from_one_that_was_not_looked_for():
    known = stored(
        diagnosed={
            "verdict": "NOTHING_MISSING",
            "untestable": ["slung_payload"],
            "smallest_detectable": {"ground_effect": 0.01},
        }
    )
    (new,) = appeared(diagnosis("ground_effect"), known)
    assert (new.term, new.unseen) == ("ground_effect", False)
    assert "would have from 0.01 on" in new.sentence
    (new,) = appeared(diagnosis("slung_payload"), known)
    assert new.unseen
    assert appeared(diagnosis("quadratic_drag", "steady_wind"), known) == ()
    assert appeared(diagnosis("ground_effect"), stored()) == (), (
        "never diagnosed: it may have been there from the start"
    )
    (new,) = appeared(diagnosis(verdict=Found.UNKNOWN_PHYSICS), known)
    assert new.term == ""
    assert doubtful(diagnosis(verdict=Found.UNKNOWN_PHYSICS), known) == ""
    assert appeared(diagnosis(verdict=Found.UNKNOWN_PHYSICS), stored(diagnosed={"verdict": "PARTLY"})) == ()


def test_an_effect_that_the_own_flights_may_have_missed_is_no_change():
    """Two sessions of one undamaged small quadrotor: a throttle offset of 0.11 +- 0.05 in the later one made the model stale, whose own
    flights "would have shown it from 0.16 on"."""
    known = stored(diagnosed={"verdict": "NOTHING_MISSING", "smallest_detectable": {"throttle_offset": 0.158}})
    small = SimpleNamespace(findings=(finding("throttle_offset", 0.113, 0.027),), verdict=Found.EXPLAINED, located=())
    assert appeared(small, known) == ()
    (said,) = as_old(small, known)
    assert "T_min is 0.11 ± 0.053, and one of up to 0.24 may have been in the model's own flights" in said
    large = SimpleNamespace(findings=(finding("throttle_offset", -0.3, 0.027),), verdict=Found.EXPLAINED, located=())
    assert [a.term for a in appeared(large, known)] == ["throttle_offset"]
    assert as_old(large, known) == ()


@pytest.mark.parametrize("std", [0.01, 0.2, 0.5, 1.0])
def test_an_effect_that_was_always_there_seldom_comes_out_as_a_change(std):
    """Level 1: of unchanged effects of any size under 1 % are missed first and a change then; with the level itself up to a fifth."""
    rng = np.random.default_rng(3)
    before = 1.0 / (ASKED + POWER)
    rates, naive = [], []
    for size in np.arange(0.2, 3.0, 0.1):
        missed = size + before * rng.standard_normal(40000) < ASKED * before
        later = size + std * rng.standard_normal(40000)
        rates.append(np.mean(missed & (later > may_have_been_missed(1.0, std))))
        naive.append(np.mean(missed & (later > 1.0)))
    assert max(rates) < 0.01
    assert max(naive) > 0.03


def test_a_mismatch_without_a_name_in_steps_flown_once_is_a_doubt():
    """Two of eight unchanged vehicles were called stale for 2.0 and 2.3 times a floor that no repeat measures: gusts do that, too."""
    known = stored(diagnosed={"verdict": "NOTHING_MISSING"})
    once = diagnosis(verdict=Found.UNKNOWN_PHYSICS, repeated=False)
    assert appeared(once, known) == ()
    assert "f_z below 1 m" in doubtful(once, known)
    assert doubtful(diagnosis(repeated=False), known) == ""
    assert doubtful(once, stored(diagnosed={"verdict": "PARTLY"})) == ""


def test_a_doubt_makes_the_model_neither_stale_nor_current():
    model = stored()
    same = estimates(model, model.model.names)
    doubted = assess(
        model_fingerprint=None,
        vehicle_fingerprint=None,
        stored=same,
        new=RecordingEvidence(runs=[same], doubtful="F_z is off."),
    )
    assert doubted.verdict is ValidityVerdict.UNKNOWN
    assert doubted.fly == ("spot_check",)
    assert "f_z is off" in doubted.sentence


def test_an_effect_that_came_makes_the_model_stale():
    model = stored()
    same = estimates(model, model.model.names)
    new = Appeared("ground_effect", "Ground effect", "R2_m2 of 0.1", False)
    found = assess(
        model_fingerprint={}, vehicle_fingerprint=None, stored=same, new=RecordingEvidence(runs=[same], appeared=(new,))
    )
    assert found.verdict is ValidityVerdict.STALE
    assert "what the model does not have: ground effect" in found.sentence
    assert found.fly
    assert "New: R2_m2 of 0.1." in str(status_document(found, {}, (), brief=True).sections)


def test_what_the_models_flights_could_not_have_shown_is_not_said_to_be_new():
    model = stored()
    same = estimates(model, model.model.names)
    old = Appeared("reference_shaping", "Reference shaping", "shaping_tc of 0.15 s", True)
    new = Appeared("ground_effect", "Ground effect", "R2_m2 of 0.1", False)

    def answer(*appeared):
        evidence = RecordingEvidence(runs=[same], appeared=appeared)
        return assess(model_fingerprint={}, vehicle_fingerprint=None, stored=same, new=evidence)

    found = answer(old)
    assert found.verdict is ValidityVerdict.STALE, "the model does not describe what was flown"
    assert "what the model lacks: reference shaping" in found.sentence
    assert (
        "nothing need have changed on the vehicle; diagnose this recording together with those flights"
        in found.sentence
    )
    assert not found.fly, "the flights are there"
    page = str(status_document(found, {}, (), brief=True).sections)
    assert "Not seen before: shaping_tc of 0.15 s." in page
    assert "New: " not in page
    both = answer(old, new)
    assert (
        "does not have: ground effect. The new recording shows what the model lacks: reference shaping" in both.sentence
    )
    assert both.fly


def looked_for(model, hidden, found=()):
    """A diagnosis that looked for the whole catalogue. hidden: term to whether its channels were recorded."""
    others = [t for t in catalogue() if t not in (*model.terms, *hidden, *found)]
    return SimpleNamespace(
        findings=tuple(map(finding, found)),
        not_needed=tuple(others),
        untestable=tuple(SimpleNamespace(term=t, recorded=there) for t, there in hidden.items()),
        smallest_detectable={"slung_payload": 0.009, "ground_effect": 4.1},
        smallest_units={"slung_payload": "payload_ratio", "ground_effect": "m^2 (R2_m2)"},
    )


def test_every_effect_is_in_the_model_or_seen_or_listed_with_the_size_that_would_have_shown():
    known = stored(diagnosed={"verdict": "NOTHING_MISSING"})
    hidden = {"ground_effect": True, "motor_saturation": True, "axial_inflow": False}
    listed = not_seen(looked_for(known.model, hidden, ("vortex_ring",)), known)
    names = [e.term for e in listed]
    assert sorted([*names, "vortex_ring", *OF_THE_DAY, *known.model.terms]) == sorted(
        {*catalogue(), *known.model.terms}
    )
    by_name = {e.term: e for e in listed}
    assert by_name["ground_effect"] == NotSeen("ground_effect", "aerodynamics", 4.1, "m^2 (R2_m2)", True, "two_heights")
    assert (by_name["slung_payload"].smallest, by_name["slung_payload"].hidden) == (0.009, False)
    assert (by_name["motor_saturation"].smallest, by_name["motor_saturation"].hidden) == (None, True)
    assert by_name["axial_inflow"].fly == "", "no flight shows it while a channel is missing"


def test_an_effect_that_could_be_there_unseen_is_stated_beside_current():
    model = stored()
    same = estimates(model, model.model.names)
    could = NotSeen("ground_effect", "aerodynamics", 4.1, "m^2 (R2_m2)", True, "two_heights")
    not_there = NotSeen("slung_payload", "payload", 0.009, "payload_ratio", False, "lateral_stop")
    never = NotSeen("motor_saturation", "propulsion", None, "", True, "thrust")

    def answer(*effects):
        new = RecordingEvidence(runs=[same], not_seen=effects)
        return assess(model_fingerprint={}, vehicle_fingerprint=None, stored=same, new=new)

    found = answer(could, not_there, never)
    assert found.verdict is ValidityVerdict.CURRENT
    assert "none of 3 effects that the model does not have; 2 of them could be there unseen" in found.sentence
    assert found.sentence.endswith("at twice the usual size: ground_effect, motor_saturation.")
    assert "unseen" not in answer(not_there).sentence
    assert "effects" not in answer().sentence, "they were not looked for"
    brief = str(status_document(found, {}, (), brief=True).sections)
    assert "1 effect that the model does not have would have shown at twice the usual size or less" in brief
    assert "ground_effect from 4.1 m\u00b2 (R2_m2) on; motor_saturation not at all" in brief
    brief = str(status_document(answer(could, never), {}, (), brief=True).sections)
    assert "No effect that the model does not have would have shown" in brief
    rows = next(s for s in status_document(found, {}, ()).sections if s.id == "effects").blocks[0].rows
    assert [row[1] for row in rows] == ["ground_effect", "slung_payload", "motor_saturation"]
    assert "0.0090 payload_ratio" in str(rows[1])


def test_a_flight_is_judged_no_farther_than_the_models_own_flights_looked(monkeypatch):
    """Neither its parameters nor what it shows beside them: of what comes later, nothing is known to have changed."""
    whole, part = SimpleNamespace(usable=True), SimpleNamespace(usable=True)
    asked = []
    monkeypatch.setattr(status, "cut_all", lambda *_: (whole,))
    monkeypatch.setattr(status, "today_fingerprint", lambda *_: None)
    monkeypatch.setattr(status.matched_pair, "as_long_as", lambda _kept, _segments: (part,))
    monkeypatch.setattr(status, "motor_load", lambda _usable: None)
    monkeypatch.setattr(status, "hover", lambda *_: None)
    monkeypatch.setattr(status, "battery_of", lambda _recordings: None)
    monkeypatch.setattr(status, "effects", lambda segments, *_: asked.append(("effects", list(segments))))

    def no_fit(_stored, usable, *_):
        asked.append(("estimated", list(usable)))
        raise FitError("none", "")

    monkeypatch.setattr(status, "reestimate", no_fit)
    shown: list[object] = ["an effect"]
    monkeypatch.setattr(status, "shows_more", lambda *_: bool(shown))
    model = stored(diagnosed={"verdict": "EXPLAINED"})
    of_the_whole = SimpleNamespace(findings=(), located=(), untestable=(), not_needed=(), verdict=Found.NOTHING_MISSING)
    status.gather_evidence(model, status.Today((SimpleNamespace(name="a"),)), diagnosed=of_the_whole)
    assert asked == [("effects", [part]), ("estimated", [part])]
    asked.clear()
    shown.clear()
    of_the_whole.smallest_detectable, of_the_whole.smallest_units = {}, {}
    status.gather_evidence(model, status.Today((SimpleNamespace(name="a"),)), diagnosed=of_the_whole)
    assert asked == [("estimated", [part])], "a diagnosis that shows nothing new is not made again"
