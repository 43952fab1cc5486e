"""What decides, loosened: does a test fail?

    python -m tests.mutants                       # all; `make mutants` is the same
    python -m tests.mutants gate                  # of the modules whose path holds a word

In a copy of the project, one change at a time: a constant twice or half as large, a condition of the gate or the supervisor that always or
never holds. Then the tests of that module run. A change with which all of them pass is a survivor: the rule has no test, or no effect.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("flighttest", "tests", "maneuvers", "sitl", "docs", "benchmarks", "examples", "pyproject.toml", "README.md")
LIMIT_S = 600
Place = tuple[int, int, int, int]

GATE = ("tests/flight/test_gate_boundaries.py", "tests/flight/test_unseen.py")
ABORT = ("tests/flight/test_late_modes.py", "tests/flight/test_one_way_links.py", "tests/flight/test_two_faults.py")
NEAR_GROUND = ("tests/flight/test_near_ground.py",)
CONDITIONS: dict[str, tuple[str, ...]] = {
    "flight/gate.py": GATE,
    "flight/execution/supervisor.py": (*NEAR_GROUND, *ABORT, *GATE),
}
SELECTION = tuple(
    f"tests/diagnose/test_{part}.py"
    for part in (
        "search",
        "proposals",
        "subsets",
        "comparison",
        "absence",
        "parts",
        "discrepancy",
        "findings",
        "fitted_models",
    )
)
CONSTANTS: dict[str, tuple[str, ...]] = {
    "diagnose/selection/fitted_models.py": SELECTION,
    "diagnose/selection/aliases.py": SELECTION,
    "diagnose/selection/proposals.py": SELECTION,
    "diagnose/selection/subsets.py": SELECTION,
    "diagnose/selection/comparison.py": SELECTION,
    "diagnose/selection/candidates.py": SELECTION,
    "diagnose/selection/held_out.py": SELECTION,
    "diagnose/selection/detectability.py": SELECTION,
    "diagnose/residuals/lack_of_fit.py": SELECTION,
    "diagnose/residuals/discrepancy.py": SELECTION,
    "diagnose/residuals/outlying.py": ("tests/diagnose/test_outlying.py",),
    "diagnose/kinematics.py": ("tests/diagnose/test_kinematics.py",),
    "identify/free_flight/loops.py": ("tests/identify/test_attitude_loops.py",),
    "estimation/gauss_newton.py": ("tests/estimation",),
    "estimation/likelihood_weights.py": ("tests/estimation",),
    "estimation/uncertainty/covariance.py": ("tests/estimation",),
    "estimation/uncertainty/discrepancy.py": ("tests/estimation",),
    "flight/gate.py": GATE,
    "flight/execution/supervisor.py": (*NEAR_GROUND, *ABORT, *GATE),
    "validity/compare.py": ("tests/validity",),
    "validity/battery.py": ("tests/validity",),
    "validity/cusum.py": ("tests/validity",),
    "validity/between_campaigns.py": ("tests/validity",),
    "validity/matched_pair.py": ("tests/validity",),
}
# Of these a factor of two changes the time taken, a resolution far below what matters, or a picture, and no answer.
NO_DECISION = {
    "diagnose/kinematics.py": ("DRAWS",),
    "diagnose/selection/subsets.py": ("CHUNK", "LARGEST", "SETTINGS"),
    "diagnose/selection/held_out.py": ("BOOTSTRAPS", "FOLDS", "RIDGE"),
    "diagnose/selection/detectability.py": ("NEVER",),
    "diagnose/residuals/lack_of_fit.py": ("BIN_S",),
    "diagnose/residuals/discrepancy.py": ("LONGEST_S",),
    "estimation/gauss_newton.py": ("MAX_ITERATIONS", "MAX_REJECTIONS"),
    "estimation/likelihood_weights.py": ("LARGEST", "RIDGE", "NOISE_STEPS", "NOISE_TOLERANCE"),
    "flight/gate.py": ("EPSILON",),
    "validity/compare.py": ("MANY",),
    "validity/matched_pair.py": ("ROUNDS", "STILL"),
}


@dataclass(frozen=True)
class Mutant:
    """A change of one place of a module. at: (line, column, end line, end column) of what `text` replaces."""

    module: str
    at: Place
    text: str
    what: str
    tests: tuple[str, ...]

    def applied(self, source: str) -> str:
        """The module with it."""
        lines = source.splitlines(keepends=True)
        begin, column, end, end_column = self.at
        first, last = (lines[begin - 1].encode()[:column].decode(), lines[end - 1].encode()[end_column:].decode())
        return "".join([*lines[: begin - 1], first + self.text + last, *lines[end:]])


def place(node: ast.expr) -> Place:
    """Where an expression is."""
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return node.lineno, node.col_offset, node.end_lineno, node.end_col_offset


def constants(module: str, tests: tuple[str, ...]) -> Iterator[Mutant]:
    """Numbers named in capitals at the top of a module, twice and half as large."""
    for node in ast.parse((ROOT / "flighttest" / module).read_text(encoding="utf-8")).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else None
        if not isinstance(target, ast.Name) or not target.id.strip("_").isupper():
            continue
        assert isinstance(node, ast.Assign)
        if target.id in NO_DECISION.get(module, ()):
            continue
        try:
            value = eval(compile(ast.Expression(node.value), module, "eval"), {"__builtins__": {}})
        except (NameError, TypeError):
            continue  # not a plain number
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        for other in (2 * value, max(1, value // 2) if isinstance(value, int) else 0.5 * value):
            if other != value:
                yield Mutant(module, place(node.value), repr(other), f"{target.id} = {other:g} for {value:g}", tests)


def conditions(module: str, tests: tuple[str, ...]) -> Iterator[Mutant]:
    """Each test of an `if` and each side of an `and` or `or`, as if it always and as if it never held."""
    source = (ROOT / "flighttest" / module).read_text(encoding="utf-8")
    found: dict[Place, str] = {}
    whole: dict[tuple[Place, str], str] = {}
    for node in ast.walk(ast.parse(source)):
        asked: list[ast.expr] = []
        if isinstance(node, (ast.If, ast.IfExp)):
            asked = [node.test]
        elif isinstance(node, ast.BoolOp):
            asked = node.values
        elif isinstance(node, ast.Compare) and len(node.ops) > 1:
            # One side of `low <= x <= high` dropped.
            sides = [node.left, *node.comparators]
            for k, op in enumerate(node.ops):
                kept = ast.unparse(ast.Compare(sides[k], [op], [sides[k + 1]]))
                whole[place(node), kept] = f"line {node.lineno}: {ast.unparse(node)} is {kept}"
        for one in asked:
            found[place(one)] = ast.unparse(one)
    for at, text in sorted(found.items()):
        for value in ("True", "False"):
            yield Mutant(module, at, value, f"line {at[0]}: {text} is {value}", tests)
    for (at, kept), what in sorted(whole.items()):
        yield Mutant(module, at, kept, what, tests)


def mutants(words: list[str]) -> list[Mutant]:
    """All of the modules whose path holds one of the words, or of all modules."""
    found = [m for module, tests in CONDITIONS.items() for m in conditions(module, tests)]
    found += [m for module, tests in CONSTANTS.items() for m in constants(module, tests)]
    return [m for m in found if not words or any(w in m.module for w in words)]


def copied(into: Path) -> Path:
    """A copy of the project in which the tests run."""
    for name in FOLDERS:
        source, target = ROOT / name, into / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, target)
    return into


def passes(project: Path, tests: tuple[str, ...]) -> bool:
    """Whether all of these tests pass there."""
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(project)}
    try:
        done = subprocess.run(words, cwd=project, env=environment, capture_output=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode not in (0, 1):
        raise RuntimeError(f"the tests did not run: {done.stdout.decode()[-2000:]}{done.stderr.decode()[-2000:]}")
    return done.returncode == 0


def survives(mutant: Mutant, project: Path) -> bool:
    """Whether every test passes with it."""
    path = project / "flighttest" / mutant.module
    original = path.read_text(encoding="utf-8")
    _write(path, mutant.applied(original))
    try:
        return passes(project, mutant.tests)
    finally:
        _write(path, original)


def _write(module: Path, source: str) -> None:
    """Replace a module, and what was compiled of it: two sources of one size and one second are the same to Python."""
    module.write_text(source, encoding="utf-8")
    for compiled in (module.parent / "__pycache__").glob(f"{module.stem}.*"):
        compiled.unlink()


def survivors(some: list[Mutant], workers: int) -> list[Mutant]:
    """Those with which all tests pass; each worker has a copy of the project."""
    began, found, shares = time.monotonic(), [], [some[k::workers] for k in range(workers)]

    def work(share: list[Mutant]) -> list[Mutant]:
        with tempfile.TemporaryDirectory() as folder:
            project = copied(Path(folder))
            for tests in dict.fromkeys(m.tests for m in share):
                if not passes(project, tests):
                    raise RuntimeError(f"without any change {' '.join(tests)} do not pass")
            left = []
            for mutant in share:
                lives = survives(mutant, project)
                print(f"{'SURVIVES' if lives else 'caught  '} {mutant.module} {mutant.what}", flush=True)
                left += [mutant] if lives else []
            return left

    with ThreadPoolExecutor(workers) as pool:
        for one in pool.map(work, [s for s in shares if s]):
            found += one
    print(f"{len(found)} of {len(some)} survive; {time.monotonic() - began:.0f} s")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD", help="only modules whose path holds it")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--list", action="store_true", help="print the changes and run nothing")
    asked = parser.parse_args()
    some = mutants(asked.words)
    if asked.list:
        print("\n".join(f"{m.module} {m.what}" for m in some))
        return
    sys.exit(1 if survivors(some, asked.workers) else 0)


if __name__ == "__main__":
    main()
