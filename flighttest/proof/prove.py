"""The trials of a proof: draw, fly, diagnose without the truth, open; over the cores of this machine or of others."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from flighttest.datafiles import read_json
from flighttest.errors import InputError
from flighttest.proof import trial
from flighttest.proof.cases import Case, CaseKind, Generator, cases_of, first_of
from flighttest.proof.outcome import Outcome
from flighttest.proof.recorded.cases import RecordedCase, drawn_cases
from flighttest.proof.recorded.sets import read_sets
from flighttest.proof.recorded.trial import run_recorded
from flighttest.proof.transplanted_noise import with_real_noise

Report = Callable[[str], None]
AnyCase = Case | RecordedCase


@dataclass(frozen=True)
class ProofRequest:
    """A proof as it is asked for. seed: a new one is drawn where None; kind: only such trials; clean: at least so many with nothing hidden,
    as `cases_of`; workers: processes of this machine; scheduler: address of a Dask scheduler instead. recordings: list of recorded flights
    (recordings/1) that the generator 'recorded' draws from, and 'rotor' takes the noise of half of its trials from; data: the folder that
    its files are relative to."""

    trials: int
    seed: int | None = None
    generator: Generator = "rotor"
    kind: CaseKind | None = None
    clean: int = 0
    workers: int = 1
    scheduler: str | None = None
    recordings: Path | None = None
    data: Path | None = None


def _cases(asked: ProofRequest, seed: int) -> Sequence[AnyCase]:
    given = asked.recordings is not None or asked.data is not None
    if asked.generator == "sitl" and given:
        raise InputError(
            "the generator 'sitl' takes no recordings",
            "add --generator recorded or rotor, or leave --recordings and --data out",
        )
    if given or asked.generator == "recorded":
        if asked.recordings is None or asked.data is None:
            raise InputError(
                f"the generator {asked.generator!r} needs recordings and their folder",
                "name their list with --recordings FILE and their folder with --data DIR",
            )
        sets, data = read_sets(asked.recordings), asked.data.resolve()
        if asked.generator == "recorded":
            return first_of(drawn_cases(seed, sets, data), asked.trials, asked.kind, asked.clean)
    cases = cases_of(seed, asked.trials, asked.generator, asked.kind, asked.clean)
    return with_real_noise(cases, sets, data) if given else cases


def run_trials(
    asked: ProofRequest,
    report: Report = lambda _text: None,
    keep: Callable[[Sequence[Outcome], int], None] = lambda _outcomes, _seed: None,
    code: str = "",
    before: Sequence[Outcome] = (),
    seal: Callable[[Sequence[AnyCase]], None] = lambda _cases: None,
) -> tuple[list[Outcome], int]:
    """Outcomes in order of the trials, and the seed they were drawn from.

    keep: given the outcomes so far, and the seed, whenever a trial is opened. code: as `Outcome.code`.
    before: outcomes of an earlier part of the same proof, which are not flown again. seal: given all cases before the first is flown.
    Every seal is announced before its trial starts. An interrupt ends the proof and keeps the trials that are done.
    """
    if asked.trials < 1:
        raise InputError(f"{asked.trials} trials: at least 1 is needed", "give --trials 1 or more")
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if asked.seed is None else asked.seed
    cases = _cases(asked, seed)
    seals = {case.index: case.sha256() for case in cases}
    done = list(before)
    if any(seals.get(outcome.index) != outcome.sha256 for outcome in done):
        raise InputError(
            "the earlier part of this proof has trials that would not be drawn now: another generator or kind, more trials, or older code",
            "ask for it as it was begun, or give --output another folder",
        )
    seal(cases)
    left = [case for case in cases if case.index not in {outcome.index for outcome in done}]
    for case in left:
        report(f"sealed trial {case.index}: SHA-256 {seals[case.index]}")
    try:
        for outcome in _outcomes(left, asked.workers, asked.scheduler):
            done.append(replace(outcome, code=code))
            keep(sorted_outcomes(done), seed)
            report(f"trial {outcome.index} opened ({len(done)} of {len(cases)})")
    except KeyboardInterrupt:
        report(f"interrupted: {len(done)} trials are done")
    return sorted_outcomes(done), seed


def _run(case: AnyCase) -> Outcome:
    return run_recorded(case) if isinstance(case, RecordedCase) else trial.run_trial(case)


def sorted_outcomes(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """As the trials were drawn."""
    return sorted(outcomes, key=lambda o: o.index)


def _outcomes(cases: Sequence[AnyCase], workers: int, scheduler: str | None) -> Iterator[Outcome]:
    if scheduler is not None:
        try:
            from distributed import Client
            from distributed import as_completed as finished
        except ImportError as error:
            raise InputError(
                "--scheduler needs the package `distributed`", "pip install flighttest[cluster]"
            ) from error
        with Client(scheduler) as client:
            yield from (f.result() for f in finished(client.map(_run, list(cases))))
        return
    if workers <= 1:
        yield from map(_run, cases)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            yield from (f.result() for f in as_completed([pool.submit(_run, c) for c in cases]))
        finally:  # an interrupt waits for the trials that fly, not for those that have not begun
            pool.shutdown(wait=False, cancel_futures=True)


def commit_of(folder: Path) -> str:
    """The commit this code is of, where it is a work tree; else 'installed package'."""
    try:
        made = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], cwd=folder, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "installed package"
    return f"commit {made.stdout.strip()}"


def write_proof(outcomes: Sequence[Outcome], seed: int, folder: Path) -> None:
    """proof.json: every outcome with its opened truth."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {"format": "proof/1", "seed": seed, "outcomes": [o.to_json() for o in outcomes]}
    (folder / "proof.json").write_text(json.dumps(data, indent=1, default=float) + "\n", encoding="utf-8")


def read_proof(folder: Path) -> tuple[int, list[Outcome]] | None:
    """Seed and outcomes of the proof that `write_proof` has put into a folder; None where there is none."""
    path = folder / "proof.json"
    if not path.exists():
        return None
    try:
        data = read_json(path, InputError, "proof", "give --output another folder")
        return int(data["seed"]), [Outcome.from_json(o) for o in data["outcomes"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: this proof cannot be continued ({type(error).__name__}: {error})",
            "give --output another folder",
        ) from error
