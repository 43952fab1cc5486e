"""The frozen bench: answers kept, compared on what both sides have."""

import json
from dataclasses import replace

import pytest

from benchmarks import frozen
from flighttest.proof.cases import draw
from flighttest.proof.outcome import Outcome

FOUND = {
    "verdict": "EXPLAINED", "located": [{"channel": "f_z"}], "heldout": {}, "baselines": {}, "after": {},
    "findings": [
        {
            "term": "throttle_offset", "rivals": [],
            "evidence": {"delta_bic": -50.0, "rms_force_left_m_s2": 0.1, "probability": 0.97},
            "parameters": {"T_min": {"value": 0.03, "std": 0.001, "interval_95": [0.027, 0.033]}},
        },
    ],
}  # fmt: skip


def test_every_trial_of_the_reference_is_still_drawn_as_it_was():
    known = frozen.reference()
    assert len(known) == 351
    kinds = [case.kind for case, _, _ in known.values()]
    assert {k: kinds.count(k) for k in set(kinds)} == {"clean": 150, "single": 106, "pair": 31, "outside": 64}
    assert all(set(o.sizes) == set(case.hide) for case, o, _ in known.values())


def test_an_answer_is_the_same_after_it_went_through_the_table(tmp_path):
    case = draw(801725741, 7)
    known = Outcome(7, case.kind, case.sha256(), case.hide, sizes={"throttle_offset": 1.4})
    reported = {"diagnosis": FOUND, "cpu_s": 10.0, "wall_s": 12.0}
    outcome = frozen.outcome_of(case, reported, known)
    assert outcome.values["throttle_offset"]["T_min"][1:] == (0.03, 0.027, 0.033)
    assert outcome.probability == {"throttle_offset": 0.97}
    (tmp_path / "answers.jsonl").write_text(frozen.line_of(case, outcome, "abc") + "\n")
    (_, read, digest) = frozen.reference(tmp_path / "answers.jsonl")["801725741-7"]
    true = outcome.values["throttle_offset"]["T_min"][0]
    assert (digest, read.values["throttle_offset"]["T_min"][0]) == ("abc", pytest.approx(true, rel=1e-5))
    same = {"values": read.values, "base_r2": 0.0, "gain": 0.0, "coverage": 0.0, "forces": {}, "truth": ""}
    assert replace(read, **same) == replace(outcome, **same)


def outcome(index, kind, hide, named, verdict="", **more):
    sizes = dict.fromkeys(hide, 5.0)
    return Outcome(index, kind, "00", {h: {} for h in hide}, tuple(named), verdict=verdict, sizes=sizes, **more)


def test_what_only_one_side_has_is_not_compared_and_worse_trials_come_first():
    inside, outside = {"voltage_sag": {"sag_v": (5.0, 5.1, 4.9, 5.3)}}, {"voltage_sag": {"sag_v": (5.0, 6.0, 5.9, 6.1)}}
    before = {
        "a": outcome(0, "single", ["voltage_sag"], ["voltage_sag"], "EXPLAINED", values=inside),
        "b": outcome(1, "single", ["voltage_sag"], ["voltage_sag"]),
        "c": outcome(2, "single", ["voltage_sag"], []),
        "d": outcome(3, "clean", [], []),
        "e": outcome(4, "outside", ["swirl"], [], "UNKNOWN_PHYSICS", located=True),
    }
    after = {
        "a": outcome(0, "single", ["voltage_sag"], ["voltage_sag"], "EXPLAINED", values=outside),
        "b": outcome(1, "single", ["voltage_sag"], ["voltage_sag"], "PARTLY", values=outside),
        "c": outcome(2, "single", ["voltage_sag"], ["voltage_sag"], "EXPLAINED", values=inside),
        "d": outcome(3, "clean", [], ["steady_wind"], "EXPLAINED"),
        "e": outcome(4, "outside", ["swirl"], [], "NOTHING_MISSING", located=False),
    }
    text = "\n".join(frozen.comparison(before, after))
    rows = {
        line.split("|")[1].strip(): [c.split(",")[0].strip() for c in line.split("|")[2:5]]
        for line in text.splitlines()
        if line.startswith("|")
    }
    first = next(v for k, v in rows.items() if k.startswith("right class first"))
    assert first == ["2 of 3", "3 of 3", "3 of 3"]
    held = next(v for k, v in rows.items() if k.startswith("parameters of named effects"))
    assert held == ["1 of 1", "0 of 1", "1 of 3"], "trial b and c have no interval in the reference"
    assert rows["physics outside the catalogue, located"] == ["1 of 1", "0 of 1", "0 of 1"]
    changed = [
        line.split(":")[0] + line.split(":")[1].split(" (")[0] for line in text.splitlines() if line.startswith("- ")
    ]
    assert changed == ["- worse d", "- worse e", "- better c"]


def test_a_diagnosis_that_fails_has_named_nothing_and_counts():
    case = draw(801725741, 7)
    known = Outcome(7, case.kind, case.sha256(), case.hide, sizes={"throttle_offset": 5.0})
    failed = frozen.outcome_of(case, {"failed": "FAILED: LinAlgError"}, known)
    assert (failed.named, failed.error, failed.verdict) == ((), "", "FAILED: LinAlgError")
    text = "\n".join(frozen.comparison({"x": replace(known, named=("throttle_offset",))}, {"x": failed}))
    assert "- worse: x" in text


def test_the_command_diagnoses_a_recording_that_is_there_once(tmp_path, monkeypatch, capsys):
    """The answer of unchanged code is read, not computed again; what failed is reported with its trial."""
    key = "801725741-7"
    (tmp_path / "flights" / key).mkdir(parents=True)
    (tmp_path / "answers" / "now").mkdir(parents=True)
    reported = {"diagnosis": FOUND, "cpu_s": 10.0, "wall_s": 12.0, "flight": "another"}
    (tmp_path / "answers" / "now" / f"{key}.json").write_text(json.dumps(reported))
    monkeypatch.setattr(frozen, "code", lambda: "now")
    frozen.main(["--cache", str(tmp_path), "--flown"])
    said = capsys.readouterr().out
    assert "mean square of (probability stated - right or not)" in said
    assert f"flights that are not the reference's: {key}" in said
