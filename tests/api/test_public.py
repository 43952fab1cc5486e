"""The public interface: its names, that they are imported on first use only, and that inner packages do not hide them."""

import ast
import importlib
import subprocess
import sys

import pytest

import flighttest as ft
from flighttest.cli.main import cli

VERBS = {
    "read", "segment", "fit", "validate", "diagnose", "check_validity", "terms", "models", "plan", "fly", "simulate",
}  # fmt: skip
# Commands that have another name here: `import` is a word of Python, `check` gives a plan, and `status` is more than a status.
NAMED = {"check": "plan", "sim": "simulate", "status": "check_validity", "import": "import_log"}
METHODS = {"export": "FittedModel"}


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_verbs_are_public_and_the_list_is_sorted():
    assert set(ft.__all__) >= VERBS
    assert ft.__all__ == sorted(ft.__all__)


@pytest.mark.parametrize("command", list(cli.commands))
def test_every_command_is_a_verb(command):
    name = NAMED.get(command, command.replace("-", "_"))
    assert hasattr(getattr(ft, METHODS[command]) if command in METHODS else ft, name)


@pytest.mark.parametrize("name", ft.__all__)
def test_every_public_name_can_be_had_and_is_described(name):
    found = getattr(ft, name)
    assert name in dir(ft)
    assert name == "__version__" or (found.__doc__ or "").strip()


def test_a_type_checker_sees_the_same_names_from_the_same_modules(repository):
    tree = ast.parse((repository / "flighttest" / "__init__.py").read_text())
    block = next(n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    typed = {alias.name: node.module for node in block.body for alias in node.names}
    assert sorted(typed) == ft.__all__
    for name, module in typed.items():
        assert getattr(ft, name) is getattr(importlib.import_module(module), name)


def test_the_import_loads_nothing_heavy():
    loaded = run("import sys, flighttest; print(' '.join(sys.modules))").split()
    assert not {"numpy", "casadi", "pandas", "click", "importlib.metadata"} & set(loaded)
    assert [m for m in loaded if m.startswith("flighttest")] == ["flighttest"]


def test_reading_and_planning_wait_for_no_other_part():
    code = "import sys, flighttest as ft; ft.read; ft.FlighttestError; ft.fly; print(' '.join(sys.modules))"
    assert not {"casadi", "pandas", "plotly"} & set(run(code).split())


@pytest.mark.parametrize("name", ["plan", "diagnose", "twin"])
def test_a_package_of_a_verbs_name_does_not_take_its_place(name):
    package = importlib.import_module(f"flighttest.{name}")
    assert package.__path__
    assert getattr(ft, name).__module__ in ("flighttest.api.verbs", "flighttest.api.comparing")


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'segments_of'"):
        ft.segments_of  # noqa: B018


def test_the_package_is_the_program():
    done = subprocess.run(
        [sys.executable, "-m", "flighttest", "--version"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.split() == ["flighttest,", "version", ft.__version__]
