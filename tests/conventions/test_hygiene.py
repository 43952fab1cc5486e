"""Conventions that a machine can check."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path

import pytest

parsed = cache(ast.parse)  # every module once, for all tests
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


def test_a_public_name_is_defined_once_in_its_package(repository):
    where: dict[tuple[str, str], list[str]] = {}
    for path in modules(repository):
        package = path.relative_to(repository).parts[1]
        for node in parsed(path.read_text()).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                where.setdefault((package, node.name), []).append(path.name)
    twice = {key: files for key, files in where.items() if len(files) > 1}
    assert not twice


def types_of(source: str) -> list[str]:
    """Public classes and named types of a module: names that begin with a capital and are no constants."""
    names = [node.name for node in parsed(source).body if isinstance(node, ast.ClassDef)]
    for node in parsed(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            names += map(ast.unparse, node.targets if isinstance(node, ast.Assign) else [node.target])
    return [name for name in names if re.fullmatch(r"[A-Z]\w*[a-z]\w*", name)]


# Types of the same name in more than one module, with the reason.
SAME_NAME = {
    "BoolArray": "an array type, the same wherever it is named",
    "FloatArray": "an array type, the same wherever it is named",
    "IndexArray": "an array type, the same wherever it is named",
    "IntArray": "an array type, the same wherever it is named",
    "Fitted": "the answer of `fit`; in the comparison of terms a model at its optimum",
    "State": "a state that a term owns; in the likelihood weights where a solver is",
}


def test_a_type_has_one_meaning_in_the_whole_program(repository):
    where: dict[str, list[str]] = {}
    for path in modules(repository):
        for name in types_of(path.read_text()):
            where.setdefault(name, []).append(path.relative_to(repository).as_posix())
    assert {name for name, paths in where.items() if len(paths) > 1} == set(SAME_NAME), "name it by what it is of"


# Functions of the same name in more than one package below the verbs, with the reason.
SAME_FUNCTION = {
    "size_in_floors": "the oracle shares nothing with the diagnosis that it judges",
}
VERBS = ("flighttest/cli/", "flighttest/api/", "flighttest/pipeline/")  # one verb has one name in each of these layers


def test_a_function_has_one_meaning_below_the_verbs(repository):
    where: dict[str, set[str]] = {}
    for path in modules(repository):
        if not path.relative_to(repository).as_posix().startswith(VERBS):
            for node in parsed(path.read_text()).body:
                if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                    where.setdefault(node.name, set()).add(path.relative_to(repository).as_posix())
    twice = {name: sorted(paths) for name, paths in where.items() if len(paths) > 1}
    assert set(twice) == set(SAME_FUNCTION), twice


def test_the_search_for_types_sees_classes_and_aliases():
    assert types_of("class A1b: ...\nVerdict = Literal['a']\nSeries: TypeAlias = int\nLEVEL = 1\n_Own = int\nx = 1") == [
        "A1b", "Verdict", "Series",
    ]  # fmt: skip


def exported(source: str) -> tuple[set[str], list[str] | None]:
    """What a module defines or, where it is a package, takes from its own modules, for others; and what its `__all__` lists, if it has
    one."""
    offered, said = set(), None
    for node in parsed(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            offered.add(node.name)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flighttest."):
            offered |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            said = ast.literal_eval(node.value)
    used = {node.id for node in ast.walk(parsed(source)) if isinstance(node, ast.Name)}
    return {name for name in offered - used if not name.startswith("_")}, said


def test_what_a_package_offers_is_in_its_list(repository):
    lacking = {}
    for path in modules(repository):
        offered, said = exported(path.read_text())
        if path.name == "__init__.py" and not offered <= set(said or ()):
            lacking[path.relative_to(repository).as_posix()] = sorted(offered - set(said or ()))
    assert not lacking, "taken into the package for others, and not in its __all__"


def test_what_a_module_says_it_offers_is_there(repository):
    for path in modules(repository):
        _, said = exported(path.read_text())
        if said is not None:
            module = importlib.import_module(
                ".".join(path.relative_to(repository).with_suffix("").parts).removesuffix(".__init__")
            )
            assert len(said) == len(set(said))
            assert not [name for name in said if not hasattr(module, name)], path


# Where a dictionary of anything crosses from one module to another: only what writes or reads it as a whole, or what somebody else defines.
EDGES = {
    "flighttest/api/answers.py: Answer.data": "what --json prints of any answer",
    "flighttest/api/inputs.py: paths_in(options)": "any of the typed options",
    "flighttest/cli/show.py: Show.json(data)": "prints any answer",
    "flighttest/cli/show.py: Show.line(data)": "prints any answer",
    "flighttest/cli/show.py: Show.result(data)": "prints any answer",
    "flighttest/documents.py: write_text(data)": "writes any document",
    "flighttest/pipeline/results.py: Result.data": "what --json prints of any answer",
    "flighttest/proof/outcome.py: Outcome.from_json(data)": "reads a line of proof.json",
    "flighttest/proof/outcome.py: Outcome.to_json()": "writes a line of proof.json",
    "flighttest/report/packing.py: PanelSpec.data": "traces as of plotly.js",
    "flighttest/report/packing.py: PanelSpec.layout": "layout as of plotly.js",
    "flighttest/script/model.py: Maneuver.settings": "checked against the profile's own fields",
    "flighttest/twin/rotorpy_commands.py: Commands.__init__(identified)": "written out beside a model, for another program",
    "flighttest/vehicle/identity.py: from_data(data)": "reads what somebody may have written",
}
ANYTHING = r"\b(dict|Mapping|MutableMapping)\[str, (Any|object)\]"


def aliases_of_anything(sources: list[str]) -> str:
    """Names that modules give to such a type, as a pattern; one that matches nothing where there are none."""
    found = {
        ast.unparse(target)
        for source in sources
        for node in parsed(source).body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if re.fullmatch(ANYTHING, ast.unparse(node.value))
    }
    return rf"\b({'|'.join(sorted(found))})\b" if found else r"(?!)"


def untyped(source: str, aliases: str = r"(?!)") -> list[str]:
    """Public functions' parameters and results, and fields of public classes, with a dictionary of anything in their type."""

    def loose(annotation: ast.expr | None) -> bool:
        return annotation is not None and bool(re.search(f"{ANYTHING}|{aliases}", ast.unparse(annotation)))

    def of(body: list[ast.stmt], within: str = "") -> list[str]:
        found = []
        for node in body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found += of(node.body, f"{node.name}.")
            elif isinstance(node, ast.FunctionDef) and (not node.name.startswith("_") or node.name == "__init__"):
                taken = [a for a in (*node.args.args, *node.args.kwonlyargs, node.args.vararg) if a is not None]
                found += [f"{within}{node.name}({a.arg})" for a in taken if loose(a.annotation)]
                found += [f"{within}{node.name}()"] if loose(node.returns) else []
            elif within and isinstance(node, ast.AnnAssign) and loose(node.annotation):
                found += [f"{within}{ast.unparse(node.target)}"]
        return found

    return of(parsed(source).body)


def test_no_dictionary_of_anything_crosses_from_one_module_to_another(repository):
    sources = {path.relative_to(repository).as_posix(): path.read_text() for path in modules(repository)}
    aliases = aliases_of_anything(list(sources.values()))
    found = {
        f"{path}: {name}"
        for path, source in sources.items()
        if not path.startswith(OWN_SETTINGS)
        for name in untyped(source, aliases)
    }
    assert found == set(EDGES), "give it a type: a dataclass, or a TypedDict where it is a documented format"


# The profiles of scripts read settings that their own fields declare, and that the loader has checked.
OWN_SETTINGS = "flighttest/script/profiles/"


def test_the_search_for_dictionaries_of_anything_sees_them():
    source = "Data = Mapping[str, Any]\nclass A:\n    x: Mapping[str, Any]\n"
    source += "    def __init__(self, y: list[dict[str, object]]) -> None: ...\n"
    source += "    def __getstate__(self) -> dict[str, Any]: ...\ndef f(z: Sequence[Data]) -> int: ...\ndef g() -> dict[str, Any]: ..."
    assert untyped(source, aliases_of_anything([source])) == ["A.x", "A.__init__(y)", "f(z)", "g()"]


def compared_sentences(source: str) -> list[str]:
    """Comparisons with a text of several words, and of a verdict, status or tone with any text: enumerations and typed fields decide."""
    found = []
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Compare):
            texts = [c.value for c in ast.walk(node) if isinstance(c, ast.Constant) and isinstance(c.value, str)]
            outcome = [n for n in (node.left, *node.comparators) if isinstance(n, ast.Attribute) and n.attr in OUTCOMES]
            if any(re.search(r"[a-z] [a-z]", text) for text in texts) or (outcome and any(texts)):
                found.append(ast.unparse(node))
    return found


OUTCOMES = {"verdict", "status", "sentence", "reason", "why", "message"}


def test_no_sentence_decides(repository):
    found = {p.relative_to(repository).as_posix(): compared_sentences(p.read_text()) for p in modules(repository)}
    assert not {path: lines for path, lines in found.items() if lines}, "compare a member of an enumeration"


@pytest.mark.parametrize("source", ["x == 'not identifiable'", "'did you mean' in line", "w.verdict == 'wind'"])
def test_the_search_for_compared_sentences_sees_each_way(source):
    assert compared_sentences(source) == [source]


def coroutines(source: str) -> list[int]:
    """Lines where a generator takes what it is sent, or hands another one's requests on: its caller cannot call it."""
    statements = {id(n.value) for n in ast.walk(parsed(source)) if isinstance(n, ast.Expr)}
    return [
        n.lineno
        for n in ast.walk(parsed(source))
        if isinstance(n, ast.Yield | ast.YieldFrom) and id(n) not in statements
    ]


@pytest.mark.slow
def test_plans_are_made_by_plain_functions(repository):
    found = {p.relative_to(repository).as_posix(): coroutines(p.read_text()) for p in modules(repository)}
    assert not {path: lines for path, lines in found.items() if lines}, "call the function"


def test_the_search_for_coroutines_sees_both_ways():
    assert coroutines("def f():\n    x = yield 1\n    y = yield from f()\n    yield x") == [2, 3]


PRIVATE = re.compile(r"_(?!_)\w+")
# Names with an underscore of other libraries: pymavlink's time of a message, ctypes' and namedtuples' methods.
FOREIGN = {"_timestamp", "_fields_", "_replace", "_asdict"}


def private_names(source: str) -> set[str]:
    """Names with an underscore that a test takes from a module of the package, or puts another thing in the place of."""
    tree = parsed(source)
    modules, taken = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flighttest"):
            modules |= {alias.asname or alias.name for alias in node.names}
            taken |= {alias.name for alias in node.names if PRIVATE.fullmatch(alias.name)}
        if isinstance(node, ast.Import):
            modules |= {alias.asname or alias.name for alias in node.names if alias.name.startswith("flighttest")}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            taken |= {node.attr} if PRIVATE.fullmatch(node.attr) else set()
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("flighttest."):
            taken |= {part for part in node.value.split(".") if PRIVATE.fullmatch(part)}
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr") and len(node.args) > 1:
            named = node.args[1]
            if isinstance(named, ast.Constant) and isinstance(named.value, str) and PRIVATE.fullmatch(named.value):
                taken.add(named.value)
    return taken - FOREIGN


def private_attributes(source: str) -> int:
    """How often a test reads an attribute with an underscore of an object that is not its own."""
    return sum(
        isinstance(node, ast.Attribute)
        and bool(PRIVATE.fullmatch(node.attr))
        and node.attr not in FOREIGN
        and ast.unparse(node.value) not in ("self", "cls", "os", "ctypes")
        for node in ast.walk(parsed(source))
    )


# Tests that still look into an object, and how often: a number may only fall.
INTO_OBJECTS = {
    "tests/faults/endurance.py": 2,
    "tests/flight/test_fence.py": 1,
    "tests/flight/test_recorder.py": 2,
    "tests/flight/test_replanning.py": 4,
    "tests/link/test_link.py": 6,
    "tests/link/test_signing.py": 1,
}


def test_tests_look_into_no_object(repository):
    counts = {
        p.relative_to(repository).as_posix(): private_attributes(p.read_text())
        for p in (repository / "tests").rglob("*.py")
    }
    more = {path: n for path, n in counts.items() if n > INTO_OBJECTS.get(path, 0)}
    assert not more, "test what is public, or make it so"


def test_the_search_for_private_attributes_sees_them():
    assert private_attributes("made.plant._x\nself._x\nf()._y") == 2


def test_tests_are_of_public_behaviour(repository):
    found = {
        p.relative_to(repository).as_posix(): private_names(p.read_text()) for p in (repository / "tests").rglob("*.py")
    }
    assert not {path: names for path, names in found.items() if names}, (
        "test what is public, or make it so, with its contract"
    )


@pytest.mark.parametrize(
    "source",
    [
        "from flighttest.plan.check import _x",
        "from flighttest.plan import check\ncheck._x(1)",
        "def f(patch):\n    patch.setattr('flighttest.plan.check._x', 1)",
        "def f(patch, module):\n    patch.setattr(module, '_x', 1)",
    ],
)
def test_the_search_for_private_names_sees_each_way(source):
    assert private_names(source) == {"_x"}


def printing_calls(source: str) -> list[int]:
    """Lines that print: print(), click.echo/secho, sys.stdout/stderr.write, or a rich Console being made."""
    lines = []
    for node in ast.walk(parsed(source)):
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
    for node in ast.walk(parsed(source)):
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


# One per process, by its nature: what a copied process was given to work on.
GLOBALS = {"flighttest/pipeline/parallel.py: _given"}


def mutable_globals(source: str) -> list[str]:
    """What a module keeps between calls: functions of arguments whose results are cached, names changed by `global`, and containers of the
    module that its functions add to. A cached function without arguments is a constant made on first use."""
    tree = parsed(source)
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    kept = []
    for f in functions:
        cached = any(
            re.fullmatch(r"(functools\.)?(lru_cache|cache)(\(.*\))?", ast.unparse(d)) for d in f.decorator_list
        )
        kept += [f.name] if cached and ast.unparse(f.args) else []
        kept += [name for n in ast.walk(f) if isinstance(n, ast.Global) for name in n.names]
    containers = {
        ast.unparse(target)
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(node.value, ast.Dict | ast.List | ast.Set | ast.DictComp | ast.ListComp | ast.SetComp)
        or re.match(r"(dict|list|set|defaultdict|OrderedDict|Weak\w+|deque)\(", ast.unparse(node.value))
    }
    changes = r"(append|add|update|setdefault|pop|popitem|clear|extend|insert|remove|discard|appendleft)"
    for f in functions:
        for n in ast.walk(f):
            if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute) and re.fullmatch(changes, n.func.attr):
                kept += [ast.unparse(n.func.value)] if ast.unparse(n.func.value) in containers else []
            if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store | ast.Del):
                kept += [ast.unparse(n.value)] if ast.unparse(n.value) in containers else []
    return sorted(set(kept))


def test_no_module_keeps_what_an_object_should_own(repository):
    found = {
        f"{path.relative_to(repository).as_posix()}: {name}"
        for path in modules(repository)
        for name in mutable_globals(path.read_text())
    }
    assert found == GLOBALS, "let the object own it whose life it shares"


@pytest.mark.parametrize(
    "source",
    [
        "@lru_cache(maxsize=4)\ndef kept(x): ...",
        "@functools.cache\ndef kept(x): ...",
        "def f():\n    global kept\n    kept = 1",
        "kept = {}\ndef f(x):\n    kept[x] = 1",
        "kept: list[int] = []\ndef f(x):\n    kept.append(x)",
    ],
)
def test_the_search_for_mutable_globals_sees_each_kind(source):
    assert mutable_globals(source) == ["kept"]
