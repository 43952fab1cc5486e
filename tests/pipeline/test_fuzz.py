"""Recordings with random defects and damaged files end in an answer or one of our errors; `python -m benchmarks.fuzz` tries more."""

import numpy as np
import pytest

from benchmarks import fuzz, fuzz_files


@pytest.mark.parametrize("seed", range(8))
def test_defects_end_in_an_answer_or_an_error_of_ours(seed, tmp_path):
    table, _ = fuzz.damaged(fuzz.flight(12.0, seed), np.random.default_rng(seed), "t_s")
    table.to_csv(tmp_path / "flight.csv", index=False)
    ends = fuzz.run(tmp_path / "flight.csv", None, ("import", "segment"), tmp_path)
    assert set(ends.split()) <= {"done", "RecordingError"}


def test_an_exception_that_is_none_of_ours_is_not_hidden(tmp_path, monkeypatch):
    def broken(*_args: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(fuzz.analysis, "segment", broken)
    with pytest.raises(ZeroDivisionError):
        fuzz.run(tmp_path / "flight.csv", None, ("segment",), tmp_path)


PAPER = {
    "omega_phi": 14.0, "omega_theta": 13.0, "zeta_phi": 0.6, "zeta_theta": 0.6, "sigma_r": 6.0, "sigma_t": 20.0, "K": 52.0, "alpha": 1.7,
    "d_x": 0.4, "d_y": 0.4, "d_z": 0.5, "T_d": 0.1,
}  # fmt: skip


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_model_file_ends_in_an_answer_or_one_clear_error(seed, tmp_path):
    rng = np.random.default_rng(seed)
    model, other = tmp_path / "model.yaml", tmp_path / "other.yaml"
    step = "{size: 0.3, responses: 4, voltage_v: 24.6, period_s: 0.02, answer: [0.0, 0.1, 0.3]}"
    for path in (model, other):
        path.write_text(
            "format: model/1\nvehicle: {name: heron}\nterms: [body, linear_drag]\nparameters:\n"
            + "".join(
                f"  {n}: {{value: {v}, std: 0.1, interval_95: [{v - 0.2}, {v + 0.2}]}}\n" for n, v in PAPER.items()
            )
            + "constants: {g: 9.81, nominal_voltage_v: 22.2}\ncovariance: {order: [K, alpha], matrix: [[1.0, 0.1], [0.1, 0.04]]}\n"
            f"valid: {{voltage_v: [21.0, 24.0]}}\nfit_quality: {{flown_steps: {{roll: [{step}]}}}}\nruns: [a, b]\n"
        )
    done = fuzz_files.damage(model, rng, [model, other])
    for argv in (
        ["compare", model, other],
        ["export", model, "--to", "json", "-o", tmp_path / "out"],
        ["accept", model],
    ):
        ending = fuzz_files.run([*map(str, argv), *(["--out", str(tmp_path / "runs")] if argv[0] == "accept" else [])])
        assert not ending.wrong, (done, ending.text)


@pytest.mark.parametrize(
    ("code", "out", "err", "as_json", "words"),
    [
        (0, "K is nan m/s^2", "", False, "nan is printed"),
        (0, "x.py:1: FutureWarning: gone", "", False, "a warning of Python"),
        (0, "{", "", True, "no JSON"),
        (7, "", "", False, "exit code 7"),
        (2, "done", "", False, "exit code 2 without an error"),
        (2, "", "error: no such file", False, ""),
        (0, "information at nano scale", "", False, ""),
    ],
)
def test_what_is_wrong_with_an_ending_is_found(code, out, err, as_json, words):
    assert fuzz_files.amiss(code, out, err, as_json).startswith(words)
    assert bool(fuzz_files.amiss(code, out, err, as_json)) == bool(words)


def test_an_exception_of_a_command_is_wrong(monkeypatch):
    def broken(_argv: object) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(fuzz_files, "call", broken)
    assert fuzz_files.run(["models"]).wrong.startswith("ZeroDivisionError")
