"""Wrong invocations of every command, generated from the option table: each parameter in turn is given what it cannot take."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from flighttest.cli.main import cli
from flighttest.recording import Provenance, Recording, Series
from flighttest.recording.store import write_recording

WORDS: dict[str, tuple[str, ...]] = {
    "connect": ("http://x", "tcp:", "tcp:nowhere", "udpin:0.0.0.0:99999", "serial:", "serial:/dev/nope:x", ""),
    "hide": ("nonsense", "ground_effect:R2_m2=x", "ground_effect:nope=1", "ground_effect:R2_m2=-5", ":"),
    "waive": ("nonsense", ""),
    "terms": ("nonsense", ""),
    "ids": ("nonsense",),
    "freeze": ("nonsense", "K=x"),
    "tie": ("nonsense", "K=nope"),
    "scheduler": ("nonsense",),
    "scripts": ("nonsense", ""),
    "kind": ("nonsense",),
}
ANYTHING_GOES = {"weather", "seed"}
NEEDED = {"run": ("scripts",), "report": ("folder",)}  # parameters that a wrong value of another one is tried beside


@dataclass(frozen=True)
class Wrong:
    """One wrong invocation: its words, and what is wrong with them."""

    argv: tuple[str, ...]
    what: str


def make_files(folder: Path) -> dict[str, Path]:
    """Things that are no file of the kind they are given for."""
    folder.mkdir(parents=True)
    t_s = np.arange(200) * 0.02
    series = {
        "attitude": Series(t_s, {"roll_rad": np.sin(t_s)}),
        "reference": Series(t_s, {"throttle": 0.4 + 0.1 * np.sin(t_s)}),
    }
    recording = Recording("r", series, (), Provenance("a.csv", "table", ""))
    good = folder / "good"
    write_recording(good, recording)
    made = {
        "missing": folder / "nowhere" / "file.yaml",
        "a folder": folder / "empty_folder",
        "an empty file": folder / "empty.yaml",
        "junk": folder / "junk.bin",
        "text": folder / "text.yaml",
        "a list": folder / "list.yaml",
    }
    made["a folder"].mkdir()
    made["an empty file"].touch()
    made["junk"].write_bytes(bytes(range(256)) * 20)
    made["text"].write_text("no file of ours: [\n")
    made["a list"].write_text("- 1\n- 2\n")
    for name in ("manifest.yaml", "channels/attitude.parquet", "events.jsonl"):
        broken = folder / f"truncated_{Path(name).stem}"
        shutil.copytree(good, broken)
        data = (broken / name).read_bytes()
        (broken / name).write_bytes(data[: len(data) // 2])
        if name != "events.jsonl":  # half a list of events is read as far as it goes
            made[f"a run with half of {Path(name).name}"] = broken
    made["a run without channels"] = folder / "no_channels"
    shutil.copytree(good, made["a run without channels"])
    shutil.rmtree(made["a run without channels"] / "channels")
    made["a path with a zero byte"] = Path(f"{folder}/a\0b")
    made["a long name"] = folder / ("x" * 300)
    return made


def values_of(parameter: click.Parameter, files: dict[str, Path]) -> Iterator[tuple[str, str]]:
    """Values that a parameter cannot take, each with a word for it."""
    kind = parameter.type
    if isinstance(kind, click.Choice):
        yield "nonsense", "no choice"
    elif isinstance(kind, click.IntRange | click.FloatRange):
        yield "x", "no number"
        yield "-5", "too small"
    elif kind is click.INT:
        yield "x", "no number"
    elif isinstance(kind, click.Path):
        if parameter.name in ("output", "out", "csv", "parquet", "figures"):
            yield "/proc/nope/x", "cannot be written"
            yield f"{files['junk']}/x", "below a file"
            return
        for what, path in files.items():
            yield str(path), what
    else:
        for word in WORDS.get(str(parameter.name), ()):
            yield word, "no such word" if word else "an empty word"


def invocations(folder: Path) -> list[Wrong]:
    """Every parameter of every command with every value it cannot take, the others as they should be where they are needed."""
    files = make_files(folder)
    good = {
        "runs": str(folder / "good"),
        "log": str(folder / "good"),
        "folder": str(folder / "good"),
        "scripts": "yaw_rate",  # the shipped script that is planned fastest
    }
    found = []
    for name, command in cli.commands.items():
        found.append(Wrong((name, "--nonsense"), "an unknown option"))
        if any(p.required for p in command.params):
            found.append(Wrong((name,), "nothing given"))
        for parameter in command.params:
            if (isinstance(parameter, click.Option) and parameter.is_flag) or parameter.name in ANYTHING_GOES:
                continue
            beside: list[str] = []
            for other in command.params:
                if other is parameter or not (other.required or other.name in NEEDED.get(name, ())):
                    continue
                value = good.get(
                    str(other.name), "json" if isinstance(other.type, click.Choice) else str(folder / "out")
                )
                beside += [*(other.opts[-1:] if isinstance(other, click.Option) else ()), value]
            for value, what in values_of(parameter, files):
                given = (parameter.opts[-1], value) if isinstance(parameter, click.Option) else (value,)
                argv = (name, *given, *beside) if parameter.param_type_name == "argument" else (name, *beside, *given)
                found.append(Wrong(argv, f"{parameter.name}: {what}"))
    return found
