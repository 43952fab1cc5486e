"""A mismatch that a model had in its own flights, alike, is no change of the vehicle; one that came is, beside it, too."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flight import campaign, fly

from flighttest.diagnose import Verdict, diagnose
from flighttest.diagnose.step_error import StepError, between, errors_from, rows_of
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import Model
from flighttest.pipeline.diagnosis.diagnose import looked_for
from flighttest.pipeline.validity.evidence import appeared, as_old, doubtful
from flighttest.pipeline.validity.known_mismatch import KnownMismatch, nearest

NOTHING = ()  # a catalogue that names nothing


NOT_LOOKED_FOR = {
    "verdict": Verdict.EXPLAINED, "complete": True, "not_needed": (), "untestable": (), "smallest_detectable": {}, "winds": (),
}  # fmt: skip


def tilts(seed, only=NOTHING, **hidden):
    return diagnose(fly(campaign(2, throttles=False, yaws=False), seed=seed, **hidden), only=only)


@pytest.fixture(scope="module")
def own():
    return tilts(7, rate_limit=4.0)


@pytest.fixture(scope="module")
def again():
    return tilts(8, rate_limit=4.0)


def accepted(found, **other):
    """A model of a diagnosis; that left less than a fifth of what it had found."""
    return ModelFile(
        Model(("body", "linear_drag")),
        {},
        {},
        (),
        np.eye(0),
        {},
        diagnosed={**looked_for(found), "verdict": "EXPLAINED", **other},
    )


@pytest.mark.slow
def test_what_the_models_own_flights_left_alike_is_no_change(own, again):
    assert again.verdict is Verdict.UNKNOWN_PHYSICS
    stored = accepted(own)
    assert appeared(again, stored) == ()
    assert doubtful(again, stored) == ""
    (said,) = as_old(again, stored)
    assert "the model's own flights were missed alike in pitch of pitch steps" in said
    assert "and roll of roll steps" in said
    assert [a.term for a in appeared(again, accepted(own, left=[]))] == [""], "nothing is known of what it left"
    assert as_old(again, accepted(own, left=[])) == ()


@pytest.mark.slow
def test_a_mismatch_that_grew_or_is_elsewhere_is_a_change(own, again):
    stored = accepted(own)
    (new,) = appeared(tilts(8, rate_limit=1.2), stored)
    assert new.term == ""
    (new,) = appeared(tilts(8, rate_limit=4.0, payload=(0.3, 1.0)), stored)
    assert new.sentence.startswith(("Velocity", "Specific force"))
    assert [a.term for a in appeared(again, accepted(tilts(7)))] == [""], "the model's own flights left none"


@pytest.mark.slow
def test_a_name_for_what_was_there_alike_is_no_change(own):
    found = tilts(8, only=("rate_limit",), rate_limit=4.0)
    assert found.accepted == ("rate_limit",)
    assert appeared(found, accepted(own)) == ()
    (said,) = as_old(found, accepted(own))
    assert said.startswith("whether rate_limit came")
    (new,) = appeared(found, accepted(tilts(7)))
    assert new.term == "rate_limit"


@pytest.mark.slow
def test_an_effect_that_came_beside_what_was_there_is_a_change(own):
    found = tilts(8, only=("velocity_latency",), rate_limit=4.0, latency=0.12)
    assert found.accepted == ("velocity_latency",)
    assert [a.term for a in appeared(found, accepted(own))] == ["velocity_latency"]


@pytest.mark.slow
def test_a_name_for_what_was_there_names_nothing_that_stays_beside_it(own):
    """A payload that nothing was offered for, beside a rate limit that was there."""
    found = tilts(8, only=("rate_limit",), rate_limit=4.0, payload=(0.3, 1.0))
    assert found.accepted == ("rate_limit",)
    assert found.verdict is Verdict.PARTLY
    (new,) = appeared(found, accepted(own))
    assert new.term == ""
    assert new.sentence.startswith(("Velocity", "Specific force"))


def error(mean, responses=3, variance=0.0, first=0, amplitude=0.3):
    return StepError(
        "pitch_rad", "pitch_step", {"amplitude_rad": amplitude}, responses, first, np.array(mean), variance
    )


@pytest.mark.parametrize(
    ("before", "beside", "old"),
    [(1.0, 0.0, True), (0.6, 0.0, True), (0.4, 0.0, False), (9.0, 0.4, True), (9.0, 0.6, False), (0.0, 1.0, False)],
)
def test_most_of_what_was_found_was_there_and_less_than_half_is_beside_it(before, beside, old):
    """Mean squares in those of what was found: of what was there, and of what came."""
    phase = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    there, new = np.sqrt(2.0 * before) * np.sin(phase), np.sqrt(2.0 * beside) * np.cos(phase)
    kept = accepted(SimpleNamespace(**NOT_LOOKED_FOR, left=[error(there + 1e-6)]))
    where = {"floors": 0.5, "where": {"channel": "pitch", "kind": "pitch_step"}}
    named = SimpleNamespace(term="rate_limit", title="Rate limit", sentence="it is there", evidence=where)
    place = SimpleNamespace(channel="pitch", kind="pitch_step", rmse=np.sqrt(5.0), floor=2.0)
    found = SimpleNamespace(errors=[error(there + new)], noise_floor={"pitch": {"value": 2.0}}, findings=[named])
    known = KnownMismatch(found, kept)
    assert bool(known.of_finding(named)) is old
    assert bool(known.of_place(place)) is old


def test_what_single_responses_differ_by_is_no_difference_of_steps(rng):
    wrong = 0.3 * np.sin(np.arange(40) / 5.0)

    def flown(n):
        each = wrong + rng.normal(0, 1.0, (n, wrong.size))
        return error(each.mean(axis=0), n, float(each.var(axis=0, ddof=1).mean()) if n > 1 else np.nan)

    pairs = [(flown(3), flown(2), flown(1)) for _ in range(300)]
    assert np.mean([a.power for a, _, _ in pairs]) == pytest.approx(np.mean(wrong**2), rel=0.1)
    assert abs(np.mean([between(b, a) for a, b, _ in pairs])) < 0.02
    assert abs(np.mean([between(c, a) for a, _, c in pairs])) < 0.02, (
        "flown once: as a response of the model's own flights"
    )


def test_errors_are_compared_at_the_same_times():
    assert between(error([0.0, 1.0, 2.0]), error([1.0, 2.0, 9.0], first=1)) == 0.0
    assert between(error([np.nan, 1.0, 2.0]), error([5.0, 1.0, 3.0])) == pytest.approx(0.5)
    assert np.isnan(between(error([1.0]), error([1.0], first=5)))


def test_what_a_model_file_keeps_is_what_was_left():
    shared = error([0.1, np.nan, -0.2], variance=0.001)
    left = [shared, replace(shared, variance=np.nan), replace(shared, channel="r_rad_s", variance=0.1)]
    (kept,) = errors_from(rows_of(left))
    assert (kept.channel, kept.kind, kept.cell, kept.responses, kept.first) == (
        "pitch_rad",
        "pitch_step",
        {"amplitude_rad": 0.3},
        3,
        0,
    )
    assert kept.mean == pytest.approx(shared.mean, nan_ok=True)
    assert kept.variance == shared.variance
    (empty,) = errors_from([{**rows_of(left)[0], "mean": None, "cell": None}])
    assert np.isnan(between(shared, empty)), "a model file edited by hand"


def test_a_step_is_held_against_the_one_most_like_it():
    errors = [error([0.0], amplitude=a) for a in (-0.2, 0.2, 0.5)]
    assert nearest(errors, error([0.0], amplitude=0.3)).cell == {"amplitude_rad": 0.2}
    assert nearest([], error([0.0])) is None
