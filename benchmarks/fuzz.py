"""Recordings with random defects through the commands: no traceback, one clear error at most.

python -m benchmarks.fuzz [COUNT] [FIRST_SEED] [--verbs segment,fit,diagnose] [RECORDING.csv COLUMNS.yaml]
python -m benchmarks.fuzz [COUNT] [FIRST_SEED] --verbs status,validate,compare,export,twin,accept,models,report,runs,show,import_raw

Defects: gaps, stuck channels, swapped axes, constant inputs, jumps, five samples, a clock that runs back, values that are not numbers, of a
simulated flight or of a table that is given. Prints one line per recording: how it ended, and in how many seconds. The second form damages
the files of run folders and models (see `fuzz_files`).
"""

from __future__ import annotations

import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks import fuzz_files
from flighttest.errors import FlighttestError
from flighttest.logs.tables.columns import load_columns
from flighttest.pipeline.diagnosis import diagnose as diagnosis
from flighttest.pipeline.identification import fitting as analysis
from flighttest.pipeline.recordings import sources

VERBS = ("import", "segment", "fit")


def flight(seconds: float, seed: int, rate_hz: float = 50.0) -> pd.DataFrame:
    """A table of channels: somebody weaves about in gusts; nothing in it is meant to be right, only to look like a flight."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    roll, pitch = 0.2 * np.sin(1.3 * t), 0.15 * np.sin(0.9 * t + 1.0)
    throttle = (0.2 + 0.02 * np.sign(np.sin(0.7 * t))) / np.cos(roll) / np.cos(pitch)
    a_t = 49.0 * throttle
    ax, ay = a_t * np.sin(pitch), -a_t * np.sin(roll)
    vx, vy, vz = (np.cumsum(a - a.mean()) / rate_hz for a in (ax, ay, a_t * np.cos(roll) * np.cos(pitch) - 9.81))
    columns = {
        "t_s": t, "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": 0.1 * t,
        "p_rad_s": np.gradient(roll, t), "q_rad_s": np.gradient(pitch, t), "r_rad_s": 0.1 + 0.0 * t,
        "roll_ref_rad": roll, "pitch_ref_rad": pitch, "throttle": throttle,
        "f_x_m_s2": -0.3 * vx, "f_y_m_s2": -0.3 * vy, "f_z_m_s2": a_t - 0.3 * vz,
        "v_x_m_s": vx, "v_y_m_s": vy, "v_z_m_s": vz, "p_z_m": 5.0 + np.cumsum(vz) / rate_hz,
        "voltage_v": 23.0 - 0.01 * t,
    }  # fmt: skip
    noisy = [c for c in columns if c not in ("t_s", "throttle", "roll_ref_rad", "pitch_ref_rad")]
    return pd.DataFrame(
        {c: v + (0.01 * rng.standard_normal(t.size) if c in noisy else 0.0) for c, v in columns.items()}
    )


def damaged(table: pd.DataFrame, rng: np.random.Generator, time_column: str) -> tuple[pd.DataFrame, list[str]]:
    """One to three defects."""
    made, reported = table.copy(), []
    numbers = [c for c in made.columns if c != time_column and pd.api.types.is_numeric_dtype(made[c])]
    for _ in range(int(rng.integers(1, 4))):
        kind = str(
            rng.choice(
                [
                    "gap",
                    "stuck",
                    "swapped",
                    "constant",
                    "jump",
                    "few",
                    "nan",
                    "huge",
                    "back",
                    "dropped",
                    "repeated",
                    "slow",
                ]
            )
        )
        n = len(made)
        if n < 4 or not numbers:
            break
        a = int(rng.integers(0, n - 2))
        b = min(n, a + int(rng.integers(1, max(n // 3, 2))))
        column = str(rng.choice(numbers))
        reported.append(f"{kind}({column})")
        match kind:
            case "gap":
                made = made.drop(made.index[a:b]).reset_index(drop=True)
            case "stuck":
                made.loc[a:b, column] = made[column].iloc[a]
            case "swapped":
                other = str(rng.choice(numbers))
                made[[column, other]] = made[[other, column]].to_numpy()
            case "constant":
                made[column] = float(rng.choice([0.0, 1.0, -1.0, 1e-9]))
            case "jump":
                made.loc[a:, column] = made[column].iloc[a:] + float(rng.normal(0.0, 3.0 + made[column].abs().max()))
            case "few":
                made = made.iloc[: int(rng.integers(1, 8))].reset_index(drop=True)
            case "nan":
                made.loc[a:b, column] = np.nan
            case "huge":
                made.loc[a, column] = float(rng.choice([1e30, -1e30, np.inf]))
            case "back":
                made.loc[a:, time_column] = made[time_column].iloc[a:] - float(rng.uniform(0.0, 20.0))
            case "dropped":
                made = made.drop(columns=[column])
                numbers.remove(column)
            case "repeated":
                made = pd.concat([made.iloc[:b], made.iloc[a:]]).reset_index(drop=True)
            case "slow":
                made = made.iloc[:: int(rng.integers(2, 60))].reset_index(drop=True)
    return made, reported


def run(path: Path, columns: Path | None, verbs: tuple[str, ...], folder: Path) -> str:
    """How each verb ended, joined; an exception that is none of ours passes on."""
    ends = []
    for verb in verbs:
        try:
            match verb:
                case "import":
                    sources.import_log(path, folder / "run", columns)
                case "segment":
                    analysis.segment([path], columns)
                case "fit":
                    analysis.fit([path], folder / "model.yaml", columns)
                case "diagnose":
                    diagnosis.diagnose([path], output=folder / "diagnosis", reading=sources.Reading(columns))
            ends.append("done")
        except FlighttestError as error:
            ends.append(type(error).__name__)
    return " ".join(ends)


def main(arguments: list[str]) -> int:
    verbs = VERBS
    if "--verbs" in arguments:
        at = arguments.index("--verbs")
        verbs = tuple(arguments[at + 1].split(","))
        arguments = arguments[:at] + arguments[at + 2 :]
    numbers = [int(a) for a in arguments if a.isdigit()]
    count, first = (*numbers, *(20, 0)[len(numbers) :])[:2]
    if set(verbs) <= set(fuzz_files.VERBS):
        with tempfile.TemporaryDirectory() as name:
            return int(fuzz_files.main(verbs, count, first, Path(name)) > 0)
    files = [Path(a) for a in arguments if not a.isdigit()]
    columns = files[1] if len(files) > 1 else None
    given = pd.read_csv(files[0]) if files else None
    if given is not None:
        given = given.astype(dict.fromkeys(given.select_dtypes("number"), float))  # of which defects make any number
    time_column = load_columns(columns).columns["t_s"].columns[0] if columns is not None else "t_s"
    failed, ends = 0, Counter[str]()
    warnings.simplefilter("ignore")
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        table, reported = damaged(flight(30.0, seed) if given is None else given, rng, time_column)
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / "flight.csv"
            table.to_csv(path, index=False)
            try:
                end = run(path, columns, verbs, Path(name))
                ends[end] += 1
            except Exception:  # noqa: BLE001  what is looked for
                failed += 1
                last = traceback.format_exc().strip().splitlines()
                end = f"TRACEBACK {last[-1]}  {last[-3].strip() if len(last) > 2 else ''}"
        seconds = time.process_time() - begun
        slow = "SLOW " if seconds > fuzz_files.SLOW_S else ""
        print(f"seed {seed} {', '.join(reported)}: {end}, {slow}{seconds:.0f} s", flush=True)
    print(
        f"{failed} of {count} ended in a traceback; " + ", ".join(f"{n} x {e}" for e, n in ends.most_common()),
        flush=True,
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
