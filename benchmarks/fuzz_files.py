"""Run folders and model files with random damage through the commands that read them: an answer, or one clear error.

Called by `python -m benchmarks.fuzz [COUNT] [FIRST_SEED] --verbs status,validate,...`. Two short flights with fits, one along a path, a
diagnosis and an accepted model are flown once on the built-in vehicle; each case damages one or two files of a copy that the command
reads, and calls it as a person would.

Damage: files cut short, empty, missing, replaced by a folder or by another file, unreadable (as root only under
`setpriv --bounding-set=-dac_override,-dac_read_search`), with bytes changed; values of YAML and JSON of another type, not finite, out of
range, missing or unknown; columns of tables that are gone, text, not finite, out of order, or of no rows.

Wrong are: an exception that is none of ours, a warning of Python, `nan` or `inf` in what is printed, --json that is none, an exit code
that is none of ours, a minute of processor time.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from flighttest.cli.main import call

VERBS = (
    "status", "validate", "compare", "export", "twin", "accept", "models", "report", "runs", "show", "import_raw",
)  # fmt: skip
VALUES = (
    None, float("nan"), float("inf"), -1.0, 0, 1e308, -1e-320, 10**40, 10**350, "text", "", [], {}, True, [1, 2, 3], {"a": 1},
    [[]], "2026-13-45", "../../x", "1e-3", "\t", "NaN",
)  # fmt: skip
TABLE_KINDS = (
    "gone", "text", "nan", "inf", "order", "no rows", "one row", "huge", "whole", "unknown", "no metadata", "twice", "nested",
)  # fmt: skip
SLOW_S = 60.0


@dataclass(frozen=True)
class Ending:
    """How a command ended: exit code, what it printed, and what is wrong with that (empty: nothing)."""

    code: int | None
    text: str
    wrong: str


def make_folder(folder: Path) -> None:
    """The undamaged files: two short flights with fits, one that follows a path, a diagnosis, and the accepted model."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = str(folder / "runs")
    for argv in (
        ["run", "spot_check", "--seed", "3", "--only", "fit", "--yes"],
        ["run", "spot_check", "--seed", "4", "--only", "fit", "--yes"],
        ["run", "lateral_stop", "--seed", "5", "--only", "fly", "--yes"],
    ):
        with _quiet():
            if call([*argv, "--out", runs]):
                raise RuntimeError(f"{argv} failed")
    flown = [str(run) for run in sorted((folder / "runs").iterdir())]
    with _quiet():
        call(["diagnose", *flown[:2], "-o", str(folder / "diagnosis"), "--accept"])
    (folder / "vehicle.yaml").write_text(
        "format: vehicle/1\nname: paper\nnominal_voltage_v: 22.2\nmass_kg: 2.9\nrotor_height_m: 0.2\n"
        "components:\n  battery: {id: sim, model: 6S 10 Ah}\n  propellers: {id: sim}\n  motors: {id: sim}\n  payload: {id: none}\n"
    )


@contextmanager
def _quiet() -> Iterator[None]:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        yield


def command(verb: str, folder: Path, rng: np.random.Generator) -> tuple[list[str], list[Path]]:
    """A command line, and the files that it reads."""
    runs, model, vehicle = folder / "runs", folder / "diagnosis" / "model.yaml", folder / "vehicle.yaml"
    one, two, free = sorted(run for run in runs.iterdir() if run.name != "models")
    out, fits = folder / "out", [one / "fit.yaml", two / "fit.yaml"]
    accepted = sorted((runs / "models").rglob("*.yaml"))
    listed = [p for p in (*files_of(one), *files_of(two), *files_of(free)) if p.suffix in (".yaml", ".jsonl", ".json")]
    known = ["--out", runs, "--vehicle", vehicle]
    ways: dict[str, list[tuple[list[object], list[Path]]]] = {
        "status": [
            ([*known], [*listed, *accepted, *accepted, vehicle]),
            ([two, "--model", model, "--out", runs], [*files_of(two), model, model]),
            ([one, two, "-o", out, "--out", runs], [*files_of(one), *files_of(two), *accepted]),
        ],
        "validate": [
            ([free, "-o", f"{out}.html"], [*files_of(free), *accepted]),
            ([model, free], [*files_of(free), model]),
            ([model, free, "--previous", fits[0]], [model, fits[0]]),
        ],
        "compare": [([one, two], fits), ([model, fits[0]], [model, fits[0]]), ([one, model], [fits[0], model])],
        "export": [
            ([*given, "--to", to, "-o", out], files)
            for to in ("casadi", "c", "json", "fmu", "rotorpy", "ardupilot")
            for given, files in (([model], [model]), (known, [*accepted, vehicle]))
        ],
        "twin": [
            ([model, "--verify", two, "--offline", "-o", out], [model, model, *files_of(two)]),
            ([model, "--replay", two, "--set", "K=+10%"], [model, model, *files_of(two)]),
        ],
        "accept": [
            ([what, "--out", runs], [held, *accepted])
            for what, held in ((folder / "diagnosis", model), (model, model), (one, fits[0]))
        ],
        "models": [([runs], accepted)],
        "report": [([what], files_of(what)) for what in (one, folder / "diagnosis", free)],
        "runs": [([runs], [*listed, *fits]), ([runs, "--html"], [*listed, *fits])],
        "show": [([one, "-o", f"{out}.html"], files_of(one))],
        "import_raw": [([one / "raw.tlog", "-o", out], [one / "raw.tlog"])],
    }
    words, files = ways[verb][int(rng.integers(len(ways[verb])))]
    return [verb.removesuffix("_raw"), *map(str, words)], files


def files_of(folder: Path) -> list[Path]:
    """Every file below a folder."""
    return sorted(p for p in folder.rglob("*") if p.is_file())


def damage(path: Path, rng: np.random.Generator, others: list[Path]) -> str:
    """Damage one file; what was done, in words."""
    kinds: list[Callable[[Path, np.random.Generator, list[Path]], str]] = [
        _cut, _emptied, _gone, _a_folder, _bytes, _replaced, _unreadable]  # fmt: skip
    own: list[Callable[[Path, np.random.Generator, list[Path]], str]] = {
        ".yaml": [_values, _values, _values, _indented, _keys],
        ".json": [_values, _values, _keys],
        ".jsonl": [_lines, _lines],
        ".parquet": [_table, _table, _table],
    }.get(path.suffix, [])  # type: ignore[assignment]
    chosen = own if own and rng.random() < 0.75 else kinds
    try:
        done = chosen[int(rng.integers(len(chosen)))](path, rng, others)
    except (OSError, ValueError, yaml.YAMLError, pa.ArrowException):
        done = "damaged already"
    return f"{path.name}: {done}"


def _cut(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    data = path.read_bytes()
    at = int(rng.integers(0, max(len(data), 1)))
    path.write_bytes(data[:at])
    return f"cut to {at} of {len(data)} bytes"


def _emptied(path: Path, *_: object) -> str:
    path.write_bytes(b"")
    return "emptied"


def _gone(path: Path, *_: object) -> str:
    path.unlink()
    return "missing"


def _a_folder(path: Path, *_: object) -> str:
    path.unlink()
    path.mkdir()
    return "a folder"


def _bytes(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    data = np.frombuffer(path.read_bytes(), np.uint8).copy()
    if data.size:
        data[rng.integers(0, data.size, int(rng.integers(1, 20)))] = rng.integers(0, 256)
    path.write_bytes(data.tobytes())
    return "bytes changed"


def _replaced(path: Path, rng: np.random.Generator, others: list[Path]) -> str:
    other = others[int(rng.integers(len(others)))]
    if other.is_file() and other != path:
        path.write_bytes(other.read_bytes())
    return f"replaced by {other.name}"


def _unreadable(path: Path, *_: object) -> str:
    path.chmod(0)
    return "unreadable"


def _indented(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    lines = path.read_text(errors="replace").splitlines()
    at = int(rng.integers(len(lines))) if lines else 0
    lines[at : at + 1] = ["\t" + line for line in lines[at : at + 1]]
    path.write_text("\n".join(lines))
    return f"a tab in line {at + 1}"


def _places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, child in children:
        yield (*path, key)
        yield from _places(child, (*path, key))


def _edited(path: Path, rng: np.random.Generator, edit: Callable[[Any, Any], str]) -> str:
    text = path.read_text()
    data = json.loads(text) if path.suffix == ".json" else yaml.load(text, Loader=yaml.CSafeLoader)
    places = list(_places(data))
    if not places:
        return "nothing in it"
    depth = int(rng.integers(1, 1 + max(map(len, places))))  # as often near the top as far down
    near = [p for p in places if len(p) <= depth]
    place = near[int(rng.integers(len(near)))]
    above = data
    for key in place[:-1]:
        above = above[key]
    said = edit(above, place[-1])
    path.write_text(
        json.dumps(data) if path.suffix == ".json" else yaml.dump(data, Dumper=yaml.CSafeDumper, sort_keys=False)
    )
    return f"{'.'.join(map(str, place))}: {said}"


def _values(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    def edit(above: Any, key: Any) -> str:
        above[key] = VALUES[int(rng.integers(len(VALUES)))]
        return f"is {above[key]!r}"

    return _edited(path, rng, edit)


def _keys(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    def edit(above: Any, key: Any) -> str:
        if rng.random() < 0.7:
            del above[key]
            return "deleted"
        if isinstance(above, dict):
            above["unheard_of"] = deepcopy(above[key])
        else:
            above.append(deepcopy(above[key]))
        return "twice"

    return _edited(path, rng, edit)


def _lines(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    lines = path.read_text(errors="replace").splitlines()
    at = int(rng.integers(len(lines))) if lines else 0
    line = lines[at] if lines else "{}"
    new = [
        line[: len(line) // 2], "null", "[]", "{}", '{"t_s": NaN, "kind": "note", "label": "x"}', '{"t_s": "x", "kind": 3, "label": null}',
        line.replace('"t_s": ', '"t_s": -'), line.replace('"kind"', '"sort"'), line.replace('"data": {', '"data": [{') , "",
    ][int(rng.integers(10))]  # fmt: skip
    lines[at : at + 1] = [new]
    path.write_text("\n".join(lines))
    return f"line {at + 1} is {new[:60]!r}"


def _table(path: Path, rng: np.random.Generator, _: list[Path]) -> str:
    held = pq.read_table(path)
    meta, table = held.schema.metadata, held.to_pandas()
    column = str(rng.choice(list(table.columns)))
    n, a = len(table), int(rng.integers(0, max(len(table), 1)))
    number = pd.api.types.is_float_dtype(table[column])
    kind = str(rng.choice(TABLE_KINDS))
    match kind:
        case "gone":
            table = table.drop(columns=[column])
        case "text":
            table[column] = "x"
        case "nan" if number:
            table.loc[a:, column] = np.nan
        case "inf" if number and n:
            table.loc[a, column] = float(rng.choice([np.inf, -np.inf, 1e308]))
        case "order":
            table = table.iloc[::-1]
        case "no rows":
            table = table.iloc[:0]
        case "one row":
            table = table.iloc[:1]
        case "huge" if number:
            table[column] = table[column] * 1e200
        case "whole" if number:
            table[column] = table[column].fillna(0.0).clip(-1e9, 1e9).astype(int)
        case "unknown":
            table = table.rename(columns={column: "unheard_of"})
        case "twice":
            table = pd.concat([table, table])
        case "nested":
            table[column] = [[1.0, 2.0]] * n
    new = pa.Table.from_pandas(table, preserve_index=False)
    kept = {k: v for k, v in (meta or {}).items() if k != b"pandas"}
    pq.write_table(new.replace_schema_metadata(None if kind == "no metadata" else kept), path)
    return f"{column} {kind}"


def run(argv: list[str]) -> Ending:
    """The command as a person calls it."""
    out, err = io.StringIO(), io.StringIO()
    begun, code, wrong = time.process_time(), None, ""
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.simplefilter("ignore", RuntimeWarning)  # as the program does
        warnings.simplefilter("ignore", ResourceWarning)
        try:
            code = call(argv)
        except BaseException:  # noqa: BLE001  what is looked for
            last = traceback.format_exc().strip().splitlines()
            wrong = f"{last[-1]}  {[line.strip() for line in last if 'flighttest/' in line][-1:]}"
    text = out.getvalue() + err.getvalue()
    took = time.process_time() - begun
    if not wrong:
        wrong = amiss(code, out.getvalue(), err.getvalue(), "--json" in argv)
    if not wrong and took > SLOW_S:
        wrong = f"took {took:.0f} s"
    return Ending(code, text, wrong)


def amiss(code: int | None, out: str, err: str, as_json: bool) -> str:
    """What is wrong with what a command printed."""
    text = out + err
    if "Warning:" in text:
        return "a warning of Python: " + next(line for line in text.splitlines() if "Warning:" in line)
    if found := re.search(r"(?<![\w.])[-+]?(nan|inf)(?![\w.])", text):
        return f"{found.group()} is printed: " + next(line for line in text.splitlines() if found.group() in line)
    if as_json and code in (0, 1, 2, 3, 4):
        try:
            json.loads(out)
        except ValueError as error:
            return f"no JSON: {error}"
    if code not in (0, 1, 2, 3, 4):
        return f"exit code {code}"
    if code == 2 and not as_json and "error: " not in err:
        return "exit code 2 without an error"
    return ""


def main(verbs: tuple[str, ...], count: int, first: int, folder: Path) -> int:
    """`count` cases of each verb; prints those that ended wrongly, then how often each exit code came. The number that ended wrongly."""
    good, case, failed = folder / "good", folder / "case", 0
    if not good.exists():
        make_folder(good)
    for verb in verbs:
        codes = Counter[str]()
        for seed in range(first, first + count):
            rng = np.random.default_rng([seed, VERBS.index(verb)])
            shutil.copytree(good, case)
            argv, files = command(verb, case, rng)
            argv += ["--json"] if rng.random() < 0.3 else []
            chosen = [files[int(i)] for i in rng.integers(len(files), size=int(rng.integers(1, 3)))]
            done = [damage(path, rng, files) for path in chosen if path.is_file()]
            ending = run(argv)
            shutil.rmtree(case)
            codes[f"exit {ending.code}"] += 1
            if ending.wrong:
                failed += 1
                said = " ".join(argv).replace(str(case), "CASE")
                print(f"{verb} seed {seed}: {said}: {'; '.join(done)}: {ending.wrong}", flush=True)
        print(f"{verb}: {count} cases, " + ", ".join(f"{n} x {c}" for c, n in sorted(codes.items())), flush=True)
    return failed
