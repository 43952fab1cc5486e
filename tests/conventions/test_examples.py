"""The notebooks in examples/ and the README's Python run, and the notebooks show what they print."""

import contextlib
import importlib.util
import json
import lzma
import re
from pathlib import Path

import pytest

NOTEBOOKS = ("concealed_effect", "recorded_log")


@pytest.fixture(scope="module")
def notebooks(repository):
    spec = importlib.util.spec_from_file_location("docs_notebooks", repository / "docs" / "notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stable(notebook: dict) -> list[list[str]]:
    """What each cell shows: the kinds of its outputs, and the lines it prints that hold no number."""
    shown = []
    for cell in notebook["cells"]:
        outputs = cell.get("outputs", ())
        lines = [line for o in outputs for line in "".join(o.get("text", "")).splitlines()]
        shown.append([*(o["output_type"] for o in outputs), *(line for line in lines if not re.search(r"\d", line))])
    return shown


def test_every_notebook_is_tried(repository):
    assert tuple(sorted(p.stem for p in (repository / "examples").glob("*.ipynb"))) == NOTEBOOKS


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_shows_what_it_prints(notebooks, repository, name):
    kept = json.loads((repository / "examples" / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert stable(notebooks.execute(kept)) == stable(kept), "run: python docs/notebooks.py"


def test_a_cell_that_fails_is_not_passed_over(notebooks):
    cell = {"cell_type": "code", "source": ["assert 1 == 2"], "outputs": []}
    with pytest.raises(AssertionError):
        notebooks.execute({"cells": [cell]})


@pytest.mark.slow
def test_the_readmes_python_runs(repository, tmp_path, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (repository / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    packed = repository / "tests" / "data" / "sitl_roll_pitch.tlog.xz"
    (tmp_path / "flight.tlog").write_bytes(lzma.decompress(packed.read_bytes()))
    with contextlib.chdir(tmp_path):
        exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert "a_t <- a_t / (1 - R^2 / (16 z^2))" in capsys.readouterr().out
    assert (tmp_path / "model.yaml").is_file()


@pytest.mark.parametrize("name", sorted(p.stem for p in (Path(__file__).parents[2] / "benchmarks").glob("*.py")))
def test_what_a_benchmark_imports_exists(name):
    """One imported a module that had another name by then, and nothing noticed."""
    importlib.import_module(f"benchmarks.{name}")
