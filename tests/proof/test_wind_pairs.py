"""Pairs of flights in winds that were measured: how they are drawn, what of a diagnosis is right, what is counted."""

import json
from itertools import islice

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.proof.board_page import rates
from flighttest.proof.outcome import Outcome
from flighttest.proof.recorded import cases, sets, trial, wind_pairs
from flighttest.proof.recorded.wind_pairs import ANOTHER, CHANGED, WindDifference, agrees
from flighttest.proof.scoreboard import score

LIST = """
format: recordings/1
sets:
  - {name: calm, source: tunnel, files: ["calm/*"], vehicle: one, wind_m_s: [0, 0]}
  - {name: windy, source: tunnel, files: ["windy/*"], vehicle: one, wind_m_s: [-4.2, 0]}
  - {name: elsewhere, source: tunnel, files: ["elsewhere/*"], vehicle: two, wind_m_s: [-9, 0]}
"""
SETS = {"calm": (0.0, 0.0), "windy": (-4.2, 0.0), "elsewhere": (-9.0, 0.0)}


@pytest.fixture
def listed(tmp_path):
    damaged = "".join(
        f'  - {{name: state {k}, source: bench, files: ["state{k}/*"], vehicle: small, state: s{k}}}\n'
        for k in range(16)
    )
    (tmp_path / "list.yaml").write_text(LIST + damaged)
    for folder in (*SETS, *(f"state{k}" for k in range(16))):
        for k in range(3):
            path = tmp_path / "data" / folder / f"{k}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("t_s\n")
    return sets.read_sets(tmp_path / "list.yaml"), tmp_path / "data"


def natural(listed, seed, count):
    drawn = (c for c in cases.drawn_cases(seed, *listed) if c.kind == "natural")
    return list(islice(drawn, count))


def test_a_pair_of_winds_is_of_one_vehicle_in_a_drawn_order(listed):
    pairs = [c for c in natural(listed, 3, 200) if c.winds]
    assert all(len(c.files) == len(set(c.files)) == 2 and not c.earlier for c in pairs)
    assert all([SETS[f.split("/")[0]] for f in c.files] == list(c.winds) for c in pairs)
    assert all(c.differs == (c.winds[0] != c.winds[1]) for c in pairs)
    assert {c.differs for c in pairs if "elsewhere" in c.name} == {
        False
    }  # another vehicle is compared with itself only
    different = [c.winds[1][0] - c.winds[0][0] for c in pairs if c.differs]
    assert {np.sign(d) for d in different} == {-1.0, 1.0}
    same = [c.files for c in pairs if not c.differs]
    assert {a > b for a, b in same} == {True, False}


def test_sources_are_drawn_alike_however_many_sets_they_have(listed):
    pairs = natural(listed, 4, 200)
    assert 0.4 < np.mean([bool(c.winds) for c in pairs]) < 0.6


def test_only_a_pair_of_winds_has_winds_in_its_seal(listed):
    drawn = list(islice(cases.drawn_cases(5, *listed), 60))
    assert all(("winds" in json.loads(c.truth())) == bool(c.winds) for c in drawn)
    assert any(c.winds for c in drawn)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("files: [x], wind_m_s: [1, 0]", "vehicle"),
        ("files: [x], vehicle: v, wind_m_s: 4.2", "2 numbers"),
        ("files: [x], vehicle: v, wind_m_s: [400, 0]", "outside"),
    ],
)
def test_a_wind_that_cannot_be_compared_is_refused(tmp_path, line, says):
    path = tmp_path / "list.yaml"
    path.write_text(f"format: recordings/1\nsets:\n  - {{name: a, source: b, {line}}}\n")
    with pytest.raises(InputError, match=says):
        sets.read_sets(path)


@pytest.mark.parametrize(
    ("found", "std", "right"), [(5.1, 0.1, True), (5.3, 0.1, False), (6.1, 1.0, True), (6.3, 1.0, False)]
)
def test_an_estimate_agrees_within_two_standard_errors_or_one_metre_per_second(found, std, right):
    assert agrees(found, 4.2, std) is right


def diagnosis(winds, named=("steady_wind",)):
    rows = [
        {"flight": f"flight {k}", "w_north": n, "w_west": w, "w_north_std": sn, "w_west_std": sw}
        for k, ((n, sn), (w, sw)) in enumerate(winds, 1)
    ]
    return {"verdict": "EXPLAINED", "findings": [{"term": t} for t in named], "winds": rows}


STILL, FANNED = ((0.2, 0.3), (0.0, 0.2)), ((-4.6, 0.8), (0.1, 0.2))


@pytest.mark.parametrize(
    ("known", "winds", "named", "said"),
    [
        ((-4.2, 0.0), (STILL, FANNED), ("steady_wind",), (CHANGED,)),
        ((4.2, 0.0), (FANNED, STILL), ("steady_wind",), (CHANGED,)),
        ((4.2, 0.0), (STILL, FANNED), ("steady_wind",), (ANOTHER,)),  # the other flight was in the wind
        ((-8.5, 0.0), (STILL, FANNED), ("steady_wind",), (ANOTHER,)),  # twice as much
        ((0.0, -4.2), (STILL, FANNED), ("steady_wind",), (ANOTHER,)),  # from the side
        ((-4.2, 0.0), (STILL, FANNED), ("attitude_offset",), ()),  # no wind is named
        ((-4.2, 0.0), (STILL, ((-4.6, 3.0), (0.1, 0.2))), ("steady_wind",), ()),  # a difference that may be none is no answer
        ((0.0, 0.0), (STILL, FANNED), ("steady_wind",), (CHANGED,)),
        ((0.0, 0.0), (FANNED, ((-5.4, 0.8), (0.1, 0.2))), ("steady_wind",), ()),
        ((0.0, 0.0), (STILL, ((1.1, 0.1), (0.0, 0.1))), ("steady_wind",), ()),  # less than the fans are known to
        # What the heading does not show has a large error in both, and takes nothing from what it shows.
        ((-4.2, 0.0), (((0.0, 0.5), (3.0, 4.0)), ((-4.2, 0.5), (3.1, 4.0))), ("steady_wind",), (CHANGED,)),
    ],
)  # fmt: skip
def test_winds_are_distinguished_by_the_difference_of_two_flights(known, winds, named, said):
    found = wind_pairs.wind_difference(diagnosis(winds, named), ("flight 1", "flight 2"))
    assert wind_pairs.named_change(found, known) == said


def test_the_error_of_a_difference_is_that_of_both_flights_along_what_is_missing():
    found = WindDifference((4.0, 0.0), (0.2, 5.0))
    assert not found.agrees((2.0, 0.0))
    assert found.agrees((4.0, 9.0))
    difference = wind_pairs.wind_difference(diagnosis((STILL, FANNED)), ("flight 1", "flight 2"))
    assert difference.std == pytest.approx((np.hypot(0.3, 0.8), np.hypot(0.2, 0.2)))
    assert wind_pairs.wind_difference(diagnosis((STILL,)), ("flight 1", "flight 2")) is None


def pair(index, known, winds):
    found = wind_pairs.wind_difference(diagnosis(winds), ("flight 1", "flight 2")) if winds else None
    hide = {CHANGED: {}} if any(known) else {}
    values = wind_pairs.compared_values(found, known)
    return Outcome(index, "natural", "", hide, wind_pairs.named_change(found, known), values=values)


def test_pairs_of_winds_are_counted_among_all_pairs_and_apart():
    outcomes = [
        pair(0, (-4.2, 0.0), (STILL, FANNED)),
        pair(1, (-8.5, 0.0), (STILL, FANNED)),  # a change, but not this one
        pair(2, (-4.2, 0.0), ()),
        pair(3, (0.0, 0.0), (STILL, FANNED)),
        pair(4, (0.0, 0.0), ()),
        Outcome(5, "natural", "", {CHANGED: {}}, (CHANGED,)),
        Outcome(6, "natural", "", {}, ()),
    ]
    found = score(outcomes)
    assert (found["changes"], found["wind_changes"]) == ((2, 4), (1, 3))
    assert (found["unchanged"], found["wind_unchanged"]) == ((2, 3), (1, 2))
    assert {m["index"]: m["why"] for m in found["misses"]} == {
        1: f"named {ANOTHER}", 2: "named nothing", 3: f"named {CHANGED}",
    }  # fmt: skip
    assert sum("wind that was measured" in what or "winds that were measured" in what for what, _ in rates(found)) == 2
    assert not any("measured" in what for what, _ in rates(score(outcomes[5:])))
    again = Outcome.from_json(json.loads(json.dumps(outcomes[0].to_json())))
    assert again.values == outcomes[0].values


@pytest.mark.slow
def test_a_flight_with_the_fans_and_one_without_are_distinguished_blind(repository, shared_data, monkeypatch):
    seen = []
    asked = trial.run_diagnosis

    def diagnosed(segments, recordings, *others):
        seen.extend([*(r.name for r in recordings), *(s.run for s in segments)])
        return asked(segments, recordings, *others)

    monkeypatch.setattr(trial, "run_diagnosis", diagnosed)
    listed = sets.read_sets(repository / "examples" / "recordings" / "public.yaml")
    drawn = (c for c in natural((listed, shared_data), 1, 200) if c.winds)
    fanned = (c for c in drawn if c.winds == ((-8.5, 0.0), (0.0, 0.0)))
    case = next(c for c in fanned if all("L1" in str(path) for path in c.files))  # one controller
    found = trial.run_recorded(case)
    assert not found.error
    assert found.named == (CHANGED,)
    assert set(found.hide) == {CHANGED}
    true, value, low, high = found.values["steady_wind"]["w_north"]
    assert true == 8.5
    assert low < value < high
    assert set(seen) == {"flight 1", "flight 2"}  # no name of a file, which states the wind
