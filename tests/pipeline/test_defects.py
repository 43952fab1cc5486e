"""Recordings with random defects: imported, cut and fitted, or refused with one clear error; never a traceback of ours."""

import numpy as np
import pandas as pd
import pytest

from flighttest.errors import FlighttestError
from flighttest.pipeline.identification.fitting import fit, segment
from flighttest.pipeline.recordings.sources import import_log

SEEDS = range(16)


def small(synthetic, rng):
    """Some 10 to 30 s of the synthetic flight."""
    table = pd.DataFrame(synthetic.flight(seed=int(rng.integers(1 << 30))))
    length = int(rng.choice([5, 60, 500, 1000, 1500]))
    begin = int(rng.integers(0, max(len(table) - length, 1)))
    return table.iloc[begin : begin + length].reset_index(drop=True)


def gap(table, rng):
    begin = int(rng.integers(0, len(table)))
    return table.drop(table.index[begin : begin + int(rng.integers(1, 300))]).reset_index(drop=True)


def stuck(table, rng):
    name = rng.choice(table.columns[1:])
    begin = int(rng.integers(0, len(table)))
    table.loc[begin:, name] = table[name].iloc[begin]
    return table


def swapped(table, rng):
    a, b = rng.choice(table.columns[1:], 2, replace=False)
    table[[a, b]] = table[[b, a]].to_numpy()
    return table


def constant(table, rng):
    table[rng.choice(table.columns[1:])] = float(rng.choice([0.0, 0.3, -1.0]))
    return table


def jump(table, rng):
    table.loc[int(rng.integers(0, len(table))) :, rng.choice(table.columns)] += float(rng.choice([1.0, -50.0, 1e4]))
    return table


def missing(table, rng):
    name = rng.choice(table.columns)
    table.loc[rng.random(len(table)) < rng.choice([0.1, 0.9, 1.1]), name] = np.nan
    return table


def repeated(table, rng):
    table.iloc[1:, 0] = np.where(rng.random(len(table) - 1) < 0.3, table.iloc[:-1, 0], table.iloc[1:, 0])
    return table


def huge(table, rng):
    at = rng.integers(0, len(table), 3)
    table.loc[at, rng.choice(table.columns)] = float(rng.choice([1e6, -1e12, 1e300, np.inf]))
    return table


def scaled(table, rng):
    name = rng.choice(table.columns[1:])
    table[name] = table[name] * float(rng.choice([-1.0, 57.3, 1e3, 1e-6]))
    return table


def dropped(table, rng):
    return table.drop(columns=rng.choice(table.columns, int(rng.integers(1, 5)), replace=False))


DEFECTS = (gap, stuck, swapped, constant, jump, missing, repeated, huge, scaled, dropped)


def damaged(synthetic, seed):
    """A small flight with one to three defects."""
    rng = np.random.default_rng(seed)
    table = small(synthetic, rng)
    for k in rng.integers(0, len(DEFECTS), int(rng.integers(1, 4))):
        if len(table) > 2 and table.shape[1] > 6:
            table = DEFECTS[k](table, rng)
    return table


@pytest.mark.parametrize("seed", SEEDS)
def test_a_damaged_recording_is_fitted_or_refused_in_words(synthetic, tmp_path, seed):
    path = tmp_path / "a.csv"
    damaged(synthetic, seed).to_csv(path, index=False)
    try:
        import_log(path, tmp_path / "run")
        segment([tmp_path / "run"])
        found = fit([tmp_path / "run"], tmp_path / "model.yaml").value
    except FlighttestError:
        return  # one clear error; anything else fails this test
    for e in found.estimates.values():
        assert np.isfinite(e.value), e
        assert e.std is None or np.isfinite(e.std), e
