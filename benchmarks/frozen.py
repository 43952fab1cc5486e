"""The frozen bench: the sealed flights of two published boards, diagnosed by the code at hand, against the answers kept beside this file.

    python -m benchmarks.frozen                  # all; `make frozen` is the same
    python -m benchmarks.frozen --only pair      # or --trial 801725741-5, --flown (nothing is flown)
    python -m benchmarks.frozen --accept         # and keep the answers as the new reference

Flights are flown once from their seeds (a quarter of a minute of processor time each) and kept in $FLIGHTTEST_FROZEN, else
~/.cache/flighttest/frozen; answers are kept there by the code that gave them, so that a run that was ended is continued.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import MISSING, fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import flighttest
from flighttest.diagnose import diagnose
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.proof.board_page import rates
from flighttest.proof.cases import Case, draw
from flighttest.proof.flying import case_options, fly_campaign
from flighttest.proof.outcome import Outcome
from flighttest.proof.scoreboard import right, score, wrong
from flighttest.proof.trial import OracleAnswer, opened
from flighttest.segments import Segment, cut
from flighttest.sim import SimOptions

ANSWERS = Path(__file__).with_name("frozen_answers.jsonl")
NOT_OF_THE_ANSWER = ("sim", "proof", "cli", "flight", "link", "report")  # packages a diagnosis does not depend on
BULKY = ("overlays", "residual_map", "regimes", "candidates")
LIMIT_S = 1800
# Only a full diagnosis has these; a published board has names and sizes.
OF_A_DIAGNOSIS = ("verdict", "probability", "values", "located", "base_r2", "gain", "confusable", "cpu_s", "wall_s")


def key_of(case: Case) -> str:
    return f"{case.seed}-{case.index}"


def reference(path: Path = ANSWERS) -> dict[str, tuple[Case, Outcome, str]]:
    """Trial to its case, its answer and the digest of its flight ('' where unknown)."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        data = json.loads(line)
        case, digest = draw(data.pop("seed"), data["index"]), data.pop("flight", "")
        if case.sha256() != data["sha256"]:
            sys.exit(f"trial {key_of(case)} is no longer drawn as it was: cases or effects have changed")
        found[key_of(case)] = case, Outcome.from_json({**data, "hide": case.hide, "truth": case.truth()}), digest
    return found


def line_of(case: Case, outcome: Outcome, digest: str) -> str:
    """One answer as a line; what is not known, or can be drawn again, is left out."""
    usual = {f.name: f.default if f.default is not MISSING else None for f in fields(Outcome)}
    kept = {k: v for k, v in outcome.to_json().items() if v and v == v and v != usual[k] and k not in ("hide", "truth")}
    if outcome.located is not None:
        kept["located"] = outcome.located
    # Six digits show any change that matters.
    rounded = json.loads(json.dumps(kept), parse_float=lambda text: float(f"{float(text):.6g}"))
    return json.dumps({"seed": case.seed, "index": case.index, **rounded, **({"flight": digest} if digest else {})})


def code() -> str:
    """Of all that a diagnosis may depend on."""
    root, digest = Path(flighttest.__file__).parent, hashlib.sha256()
    for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".c")):
        if path.relative_to(root).parts[0] not in NOT_OF_THE_ANSWER:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def fly(case: Case, run: Path) -> None:
    """The run folder of a case."""
    fly_to(run, case_options(case))


def fly_to(run: Path, options: SimOptions) -> None:
    """A run folder, there only when it is whole; without its raw log, which no diagnosis reads."""
    part = run.with_name(f"{run.name}.part{os.getpid()}")
    fly_campaign(options, part)
    (part / "raw.tlog").unlink()
    part.rename(run)


def responses(run: Path) -> tuple[list[Segment], Any]:
    recordings = open_recordings([run])
    return [s for r in recordings for s in cut(r) if s.usable], base_model(recordings, None)


def digest_of(segments: Sequence[Segment]) -> str:
    """Of everything measured, times counted from the step."""
    digest = hashlib.sha256()
    for s in segments:
        digest.update(s.name.encode())
        for values in (s.t_s - s.t_step_s, *(s.y[c] for c in sorted(s.y))):
            digest.update(np.round(values, 6).tobytes())
    return digest.hexdigest()[:12]


def answer(run: Path, path: Path) -> dict[str, Any]:
    """What the code at hand answers about a run: diagnosis.json without its pictures, times, digest of the flight; also written to
    `path`."""
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(LIMIT_S)
    segments, model = responses(run)
    wall, cpu = time.perf_counter(), time.process_time()
    found = diagnose(segments, model).to_json()
    reported = {
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "flight": digest_of(segments),
        "diagnosis": {k: v for k, v in found.items() if k not in BULKY},
    }
    path.write_text(json.dumps(reported), encoding="utf-8")
    return reported


def _too_long(_signal: int, _frame: Any) -> None:
    raise TimeoutError(f"took more than {LIMIT_S} s")


def outcome_of(case: Case, reported: Mapping[str, Any], known: Outcome) -> Outcome:
    """An answer beside the reference's knowledge of the truth. A diagnosis that failed named nothing."""
    measured = OracleAnswer(sizes=known.sizes, classes=known.classes)
    if "diagnosis" not in reported:
        blank = {
            "findings": (),
            "located": (),
            "after": {},
            "heldout": {},
            "baselines": {},
            "verdict": reported["failed"],
        }
        return replace(opened(case, blank, measured), code=code())
    outcome = opened(case, reported["diagnosis"], measured)
    return replace(outcome, cpu_s=reported["cpu_s"], wall_s=reported["wall_s"], code=code())


def as_known(outcome: Outcome, other: Outcome) -> Outcome:
    """An outcome without what is not known of the other one."""
    return outcome if other.verdict else replace(outcome, **{k: getattr(other, k) for k in OF_A_DIAGNOSIS})


def comparison(before: Mapping[str, Outcome], after: Mapping[str, Outcome]) -> Iterator[str]:
    """Totals of the trials that both have, then the trials that changed, those that became worse first."""
    shared = [k for k in after if k in before]
    old = [before[k] for k in shared]
    new = [as_known(after[k], before[k]) for k in shared]
    tables = [dict(rates(score(some))) for some in (old, new, [after[k] for k in shared])]
    yield "| what | reference | now, of those in the reference | now |\n|---|---|---|---|"
    for what in dict.fromkeys(w for t in tables for w in t):
        yield f"| {what} | {' | '.join(t.get(what, '-') for t in tables)} |"
    same = [o.verdict == n.verdict for o, n in zip(old, new, strict=True) if o.verdict]
    yield f"| verdict as in the reference | | {sum(same)} of {len(same)} | |"
    changed = [
        (_grade(n) - _grade(o), k, o, n) for k, o, n in zip(shared, old, new, strict=True) if _said(o) != _said(n)
    ]
    yield f"\n{len(changed)} of {len(shared)} trials changed" + (":" if changed else ".")
    for grade, k, o, n in sorted(changed, key=lambda c: c[:2]):
        word = "worse" if grade < 0 else "better" if grade > 0 else "other"
        hidden = ", ".join(f"{e} {o.sizes.get(e, 0.0):.1f}" for e in o.hide) or "nothing"
        yield f"- {word}: {k} ({o.kind}; hidden: {hidden}): {_in_words(o)} -> {_in_words(n)}"
    held = [score(some)["inside_by_parameter"] for some in (old, new, [after[k] for k in shared])]
    yield "\n| parameters inside their 95 % interval | reference | now, of those in the reference | now |\n|---|---|---|---|"
    for what in sorted({w for h in held for w in h}):
        yield f"| {what} | {' | '.join('{} of {}'.format(*h[what]) if what in h else '-' for h in held)} |"


def _grade(outcome: Outcome) -> int:
    """Right names less wrong ones; outside the catalogue, where any name is wrong, whether it was located."""
    if outcome.kind == "outside":
        return bool(outcome.located) - len(outcome.named)
    return sum(right(outcome, e) for e in outcome.hide) - len(wrong(outcome))


def _said(outcome: Outcome) -> tuple[Any, ...]:
    return frozenset(outcome.named), outcome.named[:1], outcome.verdict, outcome.located


def _in_words(outcome: Outcome) -> str:
    return f"{', '.join(outcome.named) or 'nothing'}{f' ({outcome.verdict})' if outcome.verdict else ''}"


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    home = os.environ.get("FLIGHTTEST_FROZEN") or Path.home() / ".cache" / "flighttest" / "frozen"
    parser.add_argument("--cache", type=Path, default=Path(home), help="where flights and answers are kept")
    parser.add_argument("--only", action="append", choices=("clean", "single", "pair", "outside"), help="such trials")
    parser.add_argument("--trial", action="append", help="SEED-INDEX")
    parser.add_argument("--known", action="store_true", help="only trials with a full answer in the reference")
    parser.add_argument("--flown", action="store_true", help="only trials whose flight is there")
    parser.add_argument("--fly", action="store_true", help="fly what is missing, and no more")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--accept", action="store_true", help="keep the answers as the new reference")
    asked = parser.parse_args(words)
    known = reference()
    chosen = {
        k: (case, before)
        for k, (case, before, _) in known.items()
        if (asked.only is None or case.kind in asked.only)
        and (asked.trial is None or k in asked.trial)
        and (before.verdict or not asked.known)
        and ((asked.cache / "flights" / k).exists() or not asked.flown)
    }
    flights, answers = asked.cache / "flights", asked.cache / "answers" / code()
    for folder in (flights, answers):
        folder.mkdir(parents=True, exist_ok=True)
    after: dict[str, Outcome] = {}
    digests: dict[str, str] = {}
    with ProcessPoolExecutor(asked.workers, get_context("spawn"), max_tasks_per_child=1) as pool:
        lacking = {
            pool.submit(fly, case, flights / k): k for k, (case, _) in chosen.items() if not (flights / k).exists()
        }
        failed = {lacking[f]: str(f.exception()) for f in as_completed(lacking) if f.exception()}
        reported = {k: answers / f"{k}.json" for k in chosen if k not in failed and not asked.fly}
        left = {pool.submit(answer, flights / k, path): k for k, path in reported.items() if not path.exists()}
        for n, f in enumerate(as_completed(left), 1):
            k = left[f]
            if error := f.exception():
                failed[k] = f"{type(error).__name__}: {error}"
            print(f"{k} ({n} of {len(left)}) {failed.get(k, '')}", file=sys.stderr, flush=True)
    if asked.fly:
        print(f"{len(chosen) - len(failed)} of {len(chosen)} flights in {flights}", *failed.items(), sep="\n")
        return
    for k, (case, before) in chosen.items():
        read = (
            {"failed": f"FAILED: {failed[k]}"} if k in failed else json.loads(reported[k].read_text(encoding="utf-8"))
        )
        after[k], digests[k] = outcome_of(case, read, before), read.get("flight", "")
    print("\n".join(comparison({k: before for k, (_, before) in chosen.items()}, after)))
    moved = [k for k, digest in digests.items() if digest and known[k][2] not in ("", digest)]
    if moved:
        print(
            f"\nflights that are not the reference's: {', '.join(moved)}; the simulator has changed, or the machine rounds differently"
        )
    if asked.accept:
        lines = [
            line_of(case, after.get(k, before), digests.get(k) or digest) for k, (case, before, digest) in known.items()
        ]
        ANSWERS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
