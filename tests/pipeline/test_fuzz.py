"""Recordings with random defects end in an answer or one of our errors; `python -m benchmarks.fuzz` tries as many as one likes."""

import numpy as np
import pytest

from benchmarks import fuzz


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
