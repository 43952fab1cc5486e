"""Sealed cases and their scoreboard: drawn from a seed, hashed before, counted right."""

import csv
import hashlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.physics.catalogue import catalogue
from flighttest.proof import flying, proving, trial
from flighttest.proof.board_page import markdown
from flighttest.proof.cases import cases_of, draw
from flighttest.proof.flying import CAMPAIGN, fly_campaign
from flighttest.proof.outcome import Outcome, closed_loop_pole_s
from flighttest.proof.prove import ProofRequest, run_trials
from flighttest.proof.scoreboard import score, share_interval
from flighttest.sim.options import SimOptions
from flighttest.sim.plants.rotor_effects import EFFECTS
from flighttest.sim.plants.rotor_vehicle import random_rotor


def test_a_case_is_its_seed_and_the_seal_is_its_truth():
    assert draw(5, 3) == draw(5, 3)
    assert draw(5, 3) != draw(6, 3)
    case = draw(5, 3)
    assert case.sha256() == hashlib.sha256(case.truth().encode()).hexdigest()
    assert json.loads(case.truth())["seed"] == 5


def test_every_kind_is_drawn_and_only_known_effects_are_hidden():
    cases = [draw(1, k) for k in range(200)]
    assert {c.kind for c in cases} == {"clean", "single", "pair", "outside"}
    for c in cases:
        assert len(c.hide) == {"clean": 0, "single": 1, "pair": 2, "outside": 1}[c.kind]
        for name, keys in c.hide.items():
            assert set(keys) <= set(EFFECTS[name].keys)
            assert EFFECTS[name].known == (c.kind != "outside")
            assert (name in catalogue()) == EFFECTS[name].known


def outcome(index, kind, hide=(), named=(), sizes=None, classes=None, **more):
    sizes = dict.fromkeys(hide, 5.0) if sizes is None else sizes
    return Outcome(
        index,
        kind,
        "00",
        {h: {} for h in hide},
        tuple(named),
        sizes=sizes,
        classes=classes or {h: (h,) for h in hide},
        **more,
    )


def test_counts_are_of_what_they_say():
    outcomes = [
        outcome(0, "clean"),
        outcome(1, "clean", named=["steady_wind"]),
        outcome(2, "single", ["ground_effect"], ["ground_effect"], base_r2=0.99),
        outcome(3, "single", ["steady_wind"], ["accelerometer_bias"]),
        outcome(
            4,
            "single",
            ["throttle_curve"],
            ["voltage_sag"],
            classes={"throttle_curve": ("throttle_curve", "voltage_sag")},
        ),
        outcome(5, "single", ["quadratic_drag"], [], sizes={"quadratic_drag": 1.2}),
        outcome(6, "pair", ["ground_effect", "steady_wind"], ["steady_wind", "ground_effect"]),
        outcome(7, "pair", ["ground_effect", "steady_wind"], ["steady_wind"]),
        outcome(8, "outside", ["updraft"], [], located=True, coverage=0.95),
        outcome(9, "outside", ["swirl"], ["steady_wind"], located=True, coverage=0.85),
        outcome(10, "single", error="could not fly"),
    ]
    s = score(outcomes)
    assert s["first"] == (2, 3)
    assert s["absorbed"] == (1, 1)
    assert s["false_alarms"] == (1, 2)
    assert s["pairs"] == (1, 2)
    assert s["outside_misnamed"] == (1, 2)
    assert s["outside_located"] == (2, 2)
    assert s["coverage_within"] == (1, 2)
    assert s["coverage_mean"] == pytest.approx(0.9)
    assert [m["index"] for m in s["misses"]] == [1, 3, 7, 9]
    assert {p["n"] for p in s["power"] if p["from"] == 1.0} == {1}
    text = markdown(outcomes, 1)
    assert "1 of 2, 50 %" in text
    assert "trial 3: steady_wind (5.0 floors): named accelerometer_bias" in text


def test_a_scoreboard_of_one_kind_has_no_empty_rows():
    text = markdown([outcome(0, "outside", ["resonance"], ["throttle_offset"])], 1)
    assert "outside the catalogue, wrongly named: 1 of 1" in text
    assert "none flown" not in text
    assert "## Power" not in text


def test_what_the_firmware_adds_by_itself_is_no_false_alarm():
    outcomes = [
        outcome(0, "clean", own=("angle_boost",)),
        outcome(1, "clean", named=["steady_wind"], own=("angle_boost",)),
    ]
    assert score(outcomes)["false_alarms"] == (1, 2)
    assert "generator: `sitl`" in markdown(outcomes, 1, "sitl")


def test_only_what_a_vehicle_can_hide_from_its_firmware_is_drawn():
    drawn = [draw(5, k, "sitl") for k in range(300)]
    hidden = {name for case in drawn for name in case.hide}
    assert {"ground_effect", "steady_wind", "slung_payload", "tether"} <= hidden
    assert not hidden & {"angle_boost", "reference_shaping", "attitude_offset", "attitude_priority"}


@pytest.mark.sitl
def test_the_real_firmware_flies_a_sealed_campaign(tmp_path, arducopter):
    script = CAMPAIGN[: CAMPAIGN.index("steps:")] + (
        "steps:\n  - attitude_step: {axis: [roll], amplitude_rad: 0.3, sign: both, hold_s: 0.8, coast_s: 1.0}\n"
        "repeat: {each: 1, order: interleaved}\n"
    )
    options = SimOptions(airframe="rotor", vehicle_seed=3, hide={"steady_wind": {}})
    segments = fly_campaign(options, tmp_path, "sitl", script)
    assert sorted(s.kind for s in segments) == ["roll_step", "roll_step"]
    assert all("roll_shaped_rad" in s.y for s in segments)


def test_binomial_interval_against_the_table():
    assert share_interval(19, 20) == pytest.approx((0.7513, 0.9987), abs=2e-4)
    assert share_interval(0, 150)[1] == pytest.approx(0.0243, abs=2e-4)


def test_trials_of_one_kind_are_the_first_such_of_the_seed():
    some = cases_of(7, 4, kind="outside")
    every = [replace(draw(7, k), drift=1.0) for k in range(some[-1].index + 1)]
    assert some == [c for c in every if c.kind == "outside"]
    assert cases_of(7, 3) == every[:3]


def test_sensors_of_a_trial_drift_and_those_of_the_frozen_bench_and_of_a_firmware_do_not():
    (one,), (firmware,), frozen = cases_of(7, 1), cases_of(7, 1, "sitl"), draw(7, 0)
    assert (one.drift, firmware.drift, frozen.drift) == (1.0, 0.0, 0.0)
    assert json.loads(one.truth())["drift"] == 1.0
    assert "drift" not in frozen.truth()
    assert flying.case_options(one).drift == 1.0
    assert flying.case_options(one, quiet=True).drift == 0.0


def test_a_seed_is_drawn_on_until_enough_trials_are_clean():
    cases = cases_of(7, 6, clean=5)
    assert cases[:6] == cases_of(7, 6)
    last = cases[-1].index
    assert [c.index for c in cases[6:]] == [k for k in range(6, last + 1) if draw(7, k).kind == "clean"]
    assert sum(c.kind == "clean" for c in cases) == 5
    assert cases_of(7, 6, clean=1) == cases_of(7, 6)


def test_what_ends_a_proof_loses_no_trial_that_is_done(tmp_path, monkeypatch):
    def flown(case):
        if case.index == 2:
            raise MemoryError
        return outcome(case.index, "clean")

    monkeypatch.setattr("flighttest.proof.trial.run_trial", flown)
    with pytest.raises(MemoryError):
        proving.prove(ProofRequest(4, 7), output=tmp_path)
    truths = (tmp_path / "truths.jsonl").read_text().splitlines()
    assert [hashlib.sha256(t.encode()).hexdigest() for t in truths] == [c.sha256() for c in cases_of(7, 4)]
    kept = json.loads((tmp_path / "proof.json").read_text())
    assert [o["index"] for o in kept["outcomes"]] == [0, 1]
    assert "seed 7; 2 trials" in (tmp_path / "proof.md").read_text()
    rows = list(csv.DictReader((tmp_path / "seals.csv").open()))
    assert [(r["trial"], r["sha256"]) for r in rows] == [(str(o["index"]), o["sha256"]) for o in kept["outcomes"]]


def test_a_proof_that_was_interrupted_is_continued(tmp_path, monkeypatch):
    flown = []

    def trial(case):
        flown.append(case.index)
        if flown == [0, 1, 2]:
            raise KeyboardInterrupt
        more = {"base_r2": 0.9, "gain": 0.5, "coverage": 0.95, "forces": {"updraft": (1.0, 0.9)}}
        return replace(outcome(case.index, case.kind, ["updraft"], ["steady_wind"], **more), sha256=case.sha256())

    monkeypatch.setattr("flighttest.proof.trial.run_trial", trial)
    monkeypatch.setattr(proving, "commit_of", lambda _folder: "commit abc")
    proving.prove(ProofRequest(4, 7), output=tmp_path)
    kept = (tmp_path / "proof.json").read_text()
    monkeypatch.setattr(proving, "commit_of", lambda _folder: "commit def")
    for other, what in (
        ({"seed": 8}, "of seed 7"),
        ({"seed": None}, "of seed 7"),
        ({"seed": 7, "kind": "clean"}, "not be drawn"),
    ):
        with pytest.raises(InputError, match=what):
            proving.prove(ProofRequest(4, **other), output=tmp_path)
    assert (tmp_path / "proof.json").read_text() == kept
    result = proving.prove(ProofRequest(4, 7), output=tmp_path)
    assert flown == [0, 1, 2, 2, 3]
    assert [o.index for o in result.value] == [0, 1, 2, 3]
    assert result.value[0] == replace(trial(cases_of(7, 1)[0]), code="commit abc"), (
        "as it was, after it went through a file"
    )
    assert "4 flown; code: commit abc (2 trials), commit def (2 trials)" in (tmp_path / "proof.md").read_text()


def test_a_folder_with_something_else_is_not_written_over(tmp_path):
    (tmp_path / "proof.json").write_text('{"seed": 7}')
    with pytest.raises(InputError, match="this proof cannot be continued"):
        proving.prove(ProofRequest(1, 7), output=tmp_path)
    assert (tmp_path / "proof.json").read_text() == '{"seed": 7}'


def test_no_trials_prove_nothing():
    with pytest.raises(InputError, match="at least 1 is needed"):
        run_trials(ProofRequest(0))


def test_magnitudes_are_judged_by_what_the_base_leaves_and_by_the_parameters_both_have():
    """An effect's parameters count at its worst; zero ones count only in the intervals."""
    values = {
        "steady_wind": {
            "w_north": (2.0, 1.8, 1.6, 2.0),
            "w_west": (-1.0, -1.05, -1.25, -0.85),
            "w_up": (0.0, 0.5, 0.3, 0.7),
        }
    }
    more = {"forces": {"steady_wind": (0.5, 0.45)}, "values": values, "base_r2": 0.9, "gain": 0.5, "coverage": 0.95}
    seen = outcome(0, "single", ["steady_wind"], ["steady_wind"], **more)
    small = replace(
        seen, index=1, sizes={"steady_wind": 1.0}, values={"steady_wind": {"w_north": (2.0, 9.0, 8.8, 9.2)}}
    )
    found = score([seen, small])
    assert found["force_ratio_median_error"] == pytest.approx(0.1)
    assert (found["value_median_error"], found["values"]) == (pytest.approx(0.1), 1)
    assert found["values_inside"] == (2, 3)
    assert found["value_median_width"] == pytest.approx(0.15)
    assert found["inside_by_parameter"]["steady_wind: w_up"] == (0, 1)
    assert Outcome.from_json(json.loads(json.dumps(seen.to_json()))) == seen
    assert "worst parameter of a named effect: median error 10 % over 1 effects" in markdown([seen], seed=0)


@pytest.mark.parametrize("lag_s", [0.0175, 0.03, 0.06])
def test_a_lag_within_the_hidden_loops_is_compared_as_the_pole_it_makes_of_them(lag_s):
    """Against the eigenvalues of the loop's own states: angle, rate, moment of the rotors, moment asked for."""
    vehicle, taus = random_rotor(7), []
    for omega, zeta in ((vehicle.omega_roll, vehicle.zeta_roll), (vehicle.omega_pitch, vehicle.zeta_pitch)):
        rotor = 1.0 / vehicle.rotor_lag_s
        a = [
            [0, 1, 0, 0],
            [0, 0, 1, 0],
            [0, 0, -rotor, rotor],
            [-(omega**2) / lag_s, -2 * zeta * omega / lag_s, 0, -1 / lag_s],
        ]
        poles = np.linalg.eigvals(np.array(a))
        taus.append(-1.0 / max(p.real for p in poles if abs(p.imag) < 1e-6))
    assert closed_loop_pole_s(vehicle, lag_s) == pytest.approx(np.mean(taus), rel=1e-6)


def test_a_campaign_without_a_step_is_no_trial(monkeypatch):
    """A vehicle that does not settle flies on freely; what was hidden has then no twin to be measured by, and no size of nothing."""
    free = SimpleNamespace(kind="free", usable=True)
    monkeypatch.setattr("flighttest.proof.trial.fly_campaign", lambda *_: (free, free))
    flown = trial.run_trial(draw(5, 3))
    assert flown.error.startswith("no step of the campaign was flown")
    assert "1 trials, 0 flown" in markdown([flown], seed=5)


def test_probabilities_stated_beside_names_are_held_against_how_often_the_names_are_right():
    sure = [
        outcome(
            k, "single", ["updraft"], ["updraft" if k else "swirl"], probability={"updraft" if k else "swirl": 0.93}
        )
        for k in range(4)
    ]
    unsure = outcome(4, "clean", named=["steady_wind"], probability={"steady_wind": 0.6})
    elsewhere = outcome(5, "outside", ["swirl"], ["steady_wind"], probability={"steady_wind": 0.7})
    found = score([*sure, unsure, elsewhere])
    assert [(r["from"], r["right"], r["stated"]) for r in found["reliability"]] == [
        (0.5, (0, 2), pytest.approx(0.65)),
        (0.9, (3, 4), pytest.approx(0.93)),
    ]
    assert found["brier"] == pytest.approx((3 * 0.07**2 + 0.93**2 + 0.6**2 + 0.7**2) / 6)
    text = markdown([*sure, unsure], seed=1)
    assert "| 90 to 95 % | 93 % | 3 of 4, 75 %" in text
    assert "## Reliability" not in markdown([outcome(0, "single", ["swirl"], ["swirl"])], seed=1)
