"""`flighttest prove` as a result: the scoreboard as a document for people and as data for programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flighttest.errors import InputError
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.proof.board_page import SEALS, code_of, markdown, rates, seals, share
from flighttest.proof.outcome import Outcome
from flighttest.proof.prove import AnyCase, ProofRequest, commit_of, read_proof, run_trials, write_proof
from flighttest.proof.scoreboard import score
from flighttest.report.document import Document, Section, Table
from flighttest.sim.sitl.launcher import find_arducopter


def prove(asked: ProofRequest, output: Path | None = None, progress: Progress = SILENT) -> Result:
    """Sealed trials and their scoreboard; with `output` the truths are written there before the first flight (truths.jsonl), and
    proof.json, proof.md and seals.csv anew with every trial.

    A proof of the same seed that is there already is continued; InputError for one of another, which would be lost.
    """
    if asked.generator == "sitl":
        find_arducopter()  # raises, with what to do, where there is none
    begun = read_proof(output) if output is not None else None
    if begun is not None and begun[0] != asked.seed:
        raise InputError(
            f"{output} holds a proof of seed {begun[0]}",
            f"continue it with --seed {begun[0]}, or give --output another folder",
        )

    def keep(done: Sequence[Outcome], drawn_from: int) -> None:
        if output is not None:
            write_proof(done, drawn_from, output)
            page = markdown(done, drawn_from, asked.generator, asked.kind)
            (output / "proof.md").write_text(page, encoding="utf-8")
            (output / SEALS).write_text(seals(done), encoding="utf-8")

    def seal(cases: Sequence[AnyCase]) -> None:
        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
            lines = "".join(f"{case.truth()}\n" for case in cases)
            (output / "truths.jsonl").write_text(lines, encoding="utf-8")

    commit = commit_of(Path(__file__).parents[1])
    before = begun[1] if begun is not None else ()
    outcomes, used = run_trials(asked, progress.stage, keep, commit, before, seal)
    code = code_of(outcomes)
    found = score(outcomes)
    misses = tuple((str(m["index"]), m["hidden"], f"{m['size']:.1f}", m["why"]) for m in found["misses"])
    sections = (
        Section("scoreboard", "Scoreboard", blocks=(Table(("what", "result"), tuple(rates(found))),)),
        Section("misses", "Misses", blocks=(Table(("trial", "hidden", "noise floors", "what happened"), misses),)),
    )
    verdict = f"{len(outcomes)} sealed trials of seed {used}: right class first in {share(*found['first'])}."
    data = {
        "format": "proof/1",
        "seed": used,
        "commit": code,
        "generator": asked.generator,
        "score": found,
        "outcomes": [o.to_json() for o in outcomes],
    }
    return Result(
        Document("proof", verdict, "plain", sections, {"seed": str(used), "code": code}), data, Status.DONE, outcomes
    )
