"""Conventions that a machine can check."""

import ast
from pathlib import Path

import pytest

MAX_LINES = 400
MAX_MODULES = 12  # a listing that is read at a glance
PRINTER = "flighttest/cli/show.py"


def modules(repository: Path) -> list[Path]:
    return sorted((repository / "flighttest").rglob("*.py"))


def test_no_module_swells(repository):
    long = {}
    for path in modules(repository):
        count = len(path.read_text().splitlines())
        if count > MAX_LINES:
            long[str(path.relative_to(repository))] = count
    assert not long, f"split by meaning: modules above {MAX_LINES} lines: {long}"


def test_a_package_of_more_than_a_dozen_modules_is_divided(repository):
    count: dict[str, int] = {}
    for path in modules(repository):
        if not path.name.startswith("__"):
            folder = path.parent.relative_to(repository).as_posix()
            count[folder] = count.get(folder, 0) + 1
    assert not {folder: n for folder, n in count.items() if n > MAX_MODULES}, "divide by meaning into sub-packages"


# Public names that two modules of one package still share.
TWICE = {
    "diagnose": {"compare"},
    "pipeline": {"accept", "of_manifest"},
    "report": {"render"},
    "sim": {"serve_inherited"},
}


def test_a_public_name_is_defined_once_in_its_package(repository):
    where: dict[tuple[str, str], list[str]] = {}
    for path in modules(repository):
        package = path.relative_to(repository).parts[1]
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                where.setdefault((package, node.name), []).append(path.name)
    twice = {key: files for key, files in where.items() if len(files) > 1}
    assert not {key: files for key, files in twice.items() if key[1] not in TWICE.get(key[0], set())}
    gone = {(package, name) for package, names in TWICE.items() for name in names} - set(twice)
    assert not gone, "take these out of TWICE"


def printing_calls(source: str) -> list[int]:
    """Lines that print: print(), click.echo/secho, sys.stdout/stderr.write, or a rich Console being made."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        if (
            name in {"print", "rich.print", "click.echo", "click.secho", "sys.stdout.write", "sys.stderr.write"}
            or name.split(".")[-1] == "Console"
        ):
            lines.append(node.lineno)
    return lines


def test_only_show_prints(repository):
    found = {}
    for path in modules(repository):
        name = path.relative_to(repository).as_posix()
        lines = printing_calls(path.read_text())
        if lines and name != PRINTER:
            found[name] = lines
    assert not found, f"only {PRINTER} prints: {found}"


@pytest.mark.parametrize(
    "source", ["print('x')", "click.echo('x')", "import sys\nsys.stdout.write('x')", "c = rich.console.Console()"]
)
def test_the_print_check_sees_printing(source):
    assert printing_calls(source)


def unfinished(source: str) -> list[int]:
    lines = [n for n, line in enumerate(source.splitlines(), 1) if any(w in line for w in ("TODO", "FIXME", "XXX"))]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Raise) and node.exc is not None and "NotImplementedError" in ast.unparse(node.exc):
            lines.append(node.lineno)
    return lines


def test_nothing_is_left_unfinished(repository):
    found = {}
    for path in modules(repository):
        lines = unfinished(path.read_text())
        if lines:
            found[path.relative_to(repository).as_posix()] = lines
    assert not found


def test_the_unfinished_check_sees_stubs():
    assert unfinished("def f():\n    raise NotImplementedError\n") == [2]
