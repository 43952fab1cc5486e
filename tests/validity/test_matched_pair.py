"""Like steps against like: what a model gets wrong about a step cancels, a change of the vehicle does not."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from flighttest.identify.fit import fit
from flighttest.identify.models.model_file import from_fit
from flighttest.identify.selection import problem_of
from flighttest.pipeline.store.history import watched
from flighttest.validity import compare, matched_pair
from flighttest.validity.between_campaigns import prior
from tests.identify import campaign

# Thrust that no K fits: the vehicle gives more or less of it from one step to the next, as a curved throttle or a slow motor does.
MISSED = {(0.05, 0.25): 0.06, (0.10, 0.25): 0.05, (0.05, 0.30): -0.05, (0.10, 0.35): -0.06, (0.15, 0.30): 0.04, (0.30, 0.10): -0.04,
          (0.15, 0.35): -0.04, (0.25, 0.10): 0.05}  # fmt: skip
SPOT = list(MISSED)[:2]  # both of them steps that the vehicle answers with more than the model


@pytest.fixture(scope="module")
def made():
    def flown(seed, steps=MISSED, repeats=1, volts=23.0, more_s=0.0, **factors):
        rng = np.random.default_rng(seed)
        found = []
        for repeat in range(repeats):
            for t0, t1 in steps:
                truth = {n: v * factors.get(n, 1.0) for n, v in campaign.TRUTH.items()}
                truth["K"] *= 1.0 + MISSED[t0, t1]
                refs = {"throttle": [(-9.0, t0), (0.0, t1)]}
                cell = {"throttle_0": t0, "throttle_1": t1}
                name = f"t{len(found)}"
                record = campaign.RECORD_S[t1] + more_s
                found.append(
                    campaign.response(
                        rng, name, "throttle_step", cell, repeat, refs, record, volts + 0.4 * repeat, truth
                    )
                )
        return found

    return flown


@pytest.fixture(scope="module")
def stored(made):
    found = fit(made(1, repeats=2))
    kept = matched_pair.steps_flown(found.solution.normal, found.problem.segments, found.model.nominal_voltage_v)
    return (
        found,
        from_fit(found),
        matched_pair.matched_pairs_from(yaml.safe_load(yaml.safe_dump(matched_pair.matched_pair_data(kept)))),
    )


def compared(stored, segments):
    found, model, kept = stored
    return matched_pair.compare_matched(
        kept,
        watched(model, "model"),
        found.values,
        found.noise,
        problem_of(segments, found.model, values=found.values),
    )


def shift(found, name="K"):
    i = found.after.names.index(name)
    value = found.before.values[i]
    return (found.after.values[i] - value) / value, np.sqrt(found.after.covariance[i, i]) / value


def test_what_the_model_gets_wrong_cancels(stored, made):
    for seed, factor in ((2, 1.0), (3, 0.95)):
        found = compared(stored, made(seed, K=factor))
        change, std = shift(found)
        assert change == pytest.approx(factor - 1.0, abs=0.012)
        assert abs(change - (factor - 1.0)) < 4.0 * std
        assert std < 0.01, "the steps' own misfit of 5 % is no doubt"
        base = watched(stored[1], "model")
        (test,) = [
            t for t in compare.subset_tests(base, base, matched=found) if t.subset == "thrust" and "K" in t.shifts
        ]
        assert test.alarm is (factor < 1.0)
        assert test.matched == len(MISSED)


def test_a_few_of_the_steps_are_compared_with_those_alone(stored, made):
    """Both steps of this spot check are among those that the model gets wrong by 5 % in one direction."""
    spot = made(4, steps=SPOT, repeats=3)
    change, _ = shift(compared(stored, spot))
    assert abs(change) < 0.015
    alone = fit(spot, frozen={n: stored[0].values[n] for n in ("alpha", "sigma_t", "d_z")})
    assert alone.values["K"] / stored[0].values["K"] - 1.0 > 0.03, "estimated from these steps alone, K came out higher"


def test_a_flight_at_another_voltage_is_as_doubtful_as_alpha(stored, made):
    near, far = (shift(compared(stored, made(5, volts=v)))[1] for v in (23.2, 21.5))
    assert far > near
    away = np.log(21.5 / 23.2)
    assert far > 0.9 * abs(away) * prior("alpha") * stored[0].values["alpha"]


def test_no_like_steps_no_comparison(stored, made):
    other = [replace(s, cell={"throttle_0": 0.12, "throttle_1": 0.22}) for s in made(6)[:3]]
    assert compared(stored, other) is None


def test_a_record_longer_than_the_models_own_is_compared_as_far_as_these_go(stored, made):
    """Dashes whose record was a second longer than that of the model's steps of the same size: a damping of the load that had not changed
    was 18 % less, and as far as the model's own flights had looked, 7 %."""
    kept = stored[2]
    longer = made(7, more_s=0.5)
    cut = matched_pair.as_long_as(kept, longer)
    for whole, part in zip(made(7), cut, strict=True):
        assert part.seconds == pytest.approx(whole.seconds, abs=0.02)
        assert all(values.shape == part.t_s.shape for values in part.y.values())
    assert matched_pair.as_long_as(kept, cut) == cut, "what is no longer stays as it is"
    longest = max(s.seconds for s in made(7))
    (other,) = matched_pair.as_long_as(kept, [replace(longer[0], cell={"throttle_0": 0.12, "throttle_1": 0.22})])
    assert other.seconds <= longest + 0.02, "another step: no longer than any of its kind"
    left = replace(
        longer[0], u={"throttle": (np.array([-9.0, 0.0, 0.4]) + longer[0].t_step_s, np.array([0.05, 0.25, 0.18]))}
    )
    (part,) = matched_pair.as_long_as(kept, [left])
    assert part.seconds == pytest.approx(0.4, abs=0.02), "a command that parts earlier is another step from there on"
    for held_s, ends_s in ((0.5, 0.4), (0.42, kept[0].seconds)):
        (part,) = matched_pair.as_long_as([replace(s, held_s=held_s) for s in kept], [left])
        assert (part.seconds == pytest.approx(0.4, abs=0.02)) is (ends_s == 0.4), (
            "0.1 s apart, and as far as targets are"
        )
    unknown = replace(longer[0], kind="roll_step")
    assert matched_pair.as_long_as(kept, [unknown]) == (unknown,), "of a kind that was not flown nothing is known"
    old = [replace(s, seconds=float("nan")) for s in kept]
    assert matched_pair.as_long_as(old, longer) == tuple(longer), "a model that was written without them"


@pytest.mark.parametrize(
    "data", [None, [], {"order": ["K"]}, {"order": ["K"], "flown": [{"kind": "x"}]}, ["roll_step"]]
)
def test_a_model_without_steps_keeps_none(data):
    assert matched_pair.matched_pairs_from(data) == ()
