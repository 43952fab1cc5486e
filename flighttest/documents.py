"""YAML documents that people write: read safely, with the line of every value, and with all their problems at once.

PyYAML's safe loader forgets where a value stood and lets a later key silently overwrite an earlier one, so the node tree is
walked here instead. Anchors and aliases are refused (a few lines of them expand to gigabytes); size and depth are capped.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, TypeAlias, TypeVar, cast

import yaml

from flighttest.datafiles import MAX_DEPTH
from flighttest.datafiles import SCRIPT_BYTES as MAX_BYTES
from flighttest.errors import FileProblem, InputError

MAX_NODES = 100_000

Plain = str | int | float | bool | None
T = TypeVar("T")


@dataclass(frozen=True)
class Node:
    """A value and where it stands: `value` is a scalar, a dict of text to Node, or a list of Nodes."""

    value: Plain | dict[str, Node] | list[Node]
    line: int
    path: str

    def plain(self) -> Any:
        """The value without positions, as the safe loader would give it."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value


def kind_of(value: object) -> str:
    """How a person would call this value: 'text', 'a number', 'a list', ..."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "yes/no"
    if isinstance(value, (int, float)):
        return "a number"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, dict):
        return "a block of keys"
    return f"text ({str(value)[:30]!r})"


# Plain data as YAML and JSON hold it: the type of blocks whose keys the user chooses.
PlainData: TypeAlias = "bool | int | float | str | Sequence[PlainData] | Mapping[str, PlainData] | None"


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that `word` is a part or a misspelling of, if any: at most a third of the letters are others (of `step`, which is
    offered for `stpe`, two of five are missing in `stateX`)."""
    names = list(known)
    misspelt = difflib.get_close_matches(word, names, n=1, cutoff=2 / 3)
    parts = [k for k in difflib.get_close_matches(word, names) if word in k or k in word]
    return next(iter(misspelt + parts), None)


class _Refused(Exception):
    """A file that must not be read: what is wrong, and on which line."""

    def __init__(self, line: int, what: str, hint: str) -> None:
        super().__init__(what)
        self.line, self.what, self.hint = line, what, hint


class _Watched(yaml.SafeLoader):
    """The safe loader, which gives up at an anchor or beyond a size before it builds anything of it."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._count = 0

    def get_event(self) -> Any:
        """The next event, once it is known to be harmless."""
        event: Any = super().get_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1 if event.start_mark else 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            hint = "write the value out where it is needed"
            raise _Refused(line, "anchors and aliases (& and *) are not allowed", hint)
        self._count += 1
        self._depth += isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent))
        self._depth -= isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent))
        if self._depth > MAX_DEPTH or self._count > MAX_NODES:
            hint = "it is not a file of this kind"
            raise _Refused(line, "the file is nested too deeply or holds too many values", hint)
        return event


class YamlDocument:
    """One file being read. Every problem found is kept; `root` is None when the text is no YAML mapping at all."""

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self.problems: list[FileProblem] = []
        self.root: Node | None = None
        if len(text.encode("utf-8", "replace")) > MAX_BYTES:
            self.problem(1, "", f"the file is larger than {MAX_BYTES} bytes", "it is not a file of this kind")
            return
        try:
            node = yaml.compose(text, Loader=_Watched)
            if node is not None:
                self.root = self._convert(node, "")
        except _Refused as refused:
            self.problem(refused.line, "", refused.what, refused.hint)
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            what = getattr(error, "problem", None) or str(error).splitlines()[0]
            self.problem(
                mark.line + 1 if mark else 1, "", f"this is not YAML: {what}", "check quotes, indentation and colons"
            )
        if self.root is None and not self.problems:
            self.problem(1, "", "the file is empty", "")
        if self.root is not None and not isinstance(self.root.value, dict):
            self.problem(self.root.line, "", f"expected keys and values, found {kind_of(self.root.value)}")
            self.root = None

    @property
    def line(self) -> int:
        """Where its keys begin: the line of what is missing at its top."""
        return self.root.line if self.root is not None else 1

    def problem(self, line: int, path: str, what: str, hint: str = "") -> None:
        """Note one thing that is wrong."""
        self.problems.append(FileProblem(self.file, line, path, what, hint))

    def wrong(self, node: Node, what: str, hint: str = "") -> None:
        """Note one thing that is wrong with this value."""
        self.problem(node.line, node.path, what, hint)

    def raise_problems(self, error: type[InputError]) -> None:
        """Raise `error` with everything found, in the order of the file; do nothing when all is well."""
        if self.problems:
            raise error.of(sorted(set(self.problems), key=lambda p: (p.line, p.path)))

    def check_format(self, name: str) -> None:
        """The file must state `format: <name>/1`."""
        if self.root is None or not isinstance(self.root.value, dict):
            return
        node = self.root.value.get("format")
        if node is None:
            self.problem(1, "format", "the file does not state what it is", f"add the line `format: {name}/1`")
        elif node.value != f"{name}/1":
            family, _, version = str(node.value).partition("/")
            if family == name:
                self.wrong(
                    node, f"version {version or 'nothing'} of this format is not known", f"this program reads {name}/1"
                )
            else:
                self.wrong(node, f"expected `{name}/1`, found {str(node.plain())[:40]!r}", f"write `format: {name}/1`")

    # Values. Each getter notes what is wrong and gives None (or the default), so that reading goes on.

    def mapping(self, node: Node, known: Iterable[str], what: str = "key") -> dict[str, Node]:
        """The children of a mapping; keys that are not known are problems."""
        if not isinstance(node.value, dict):
            self.wrong(
                node, f"expected a block of keys, found {kind_of(node.value)}", f"known keys: {', '.join(known)}"
            )
            return {}
        known = list(known)
        for key, child in node.value.items():
            if key not in known:
                guess = nearest(key, known)
                hint = f"did you mean `{guess}`?" if guess else f"known: {', '.join(known)}"
                self.wrong(child, f"unknown {what} `{key[:60]}`", hint)
        return {key: child for key, child in node.value.items() if key in known}

    def number(self, node: Node, low: float, high: float, unit: str = "", hint: str = "") -> float | None:
        """A finite number in [low, high]."""
        value = node.value
        if isinstance(value, str):
            # YAML 1.1 reads 1e-3 as text; a person means the number.
            try:
                value = float(value)
            except ValueError:
                value = node.value
        unit_words = f" in {unit}" if unit else ""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            hint = hint or (
                f"write the number alone{unit_words and ',' + unit_words}" if isinstance(value, str) else ""
            )
            self.wrong(node, f"expected a number{unit_words}, found {kind_of(value)}", hint)
            return None
        number = float(value)
        if not math.isfinite(number):
            self.wrong(node, "this is not a finite number", hint or f"write a number{unit_words}")
            return None
        if not low <= number <= high:
            self.wrong(node, f"{number:g} {unit}".strip() + f" is outside {low:g} to {high:g}", hint)
            return None
        return number

    def numbers(self, node: Node, low: float, high: float, unit: str = "", hint: str = "") -> tuple[float, ...] | None:
        """One number or a list of numbers, as a tuple; None when any of them is wrong."""
        children = node.value if isinstance(node.value, list) else [node]
        if not children:
            self.wrong(node, "the list is empty", "write at least one number")
            return None
        found = [self.number(child, low, high, unit, hint) for child in children]
        return None if any(n is None for n in found) else tuple(n for n in found if n is not None)

    def vector(self, node: Node, size: int, low: float, high: float, unit: str = "") -> tuple[float, ...] | None:
        """A list of exactly `size` numbers."""
        if not isinstance(node.value, list) or len(node.value) != size:
            count = f"a list of {len(node.value)}" if isinstance(node.value, list) else kind_of(node.value)
            self.wrong(node, f"expected a list of {size} numbers{f' in {unit}' if unit else ''}, found {count}")
            return None
        return self.numbers(node, low, high, unit)

    def span(self, node: Node, low: float, high: float, unit: str = "") -> tuple[float, float] | None:
        """A list [low, high] of two numbers, the first smaller than the second."""
        pair = self.vector(node, 2, low, high, unit)
        if pair is None:
            return None
        if not pair[0] < pair[1]:
            self.wrong(node, f"{pair[0]:g} is not below {pair[1]:g}", "write the lower number first")
            return None
        return pair[0], pair[1]

    def integer(self, node: Node, low: int, high: int) -> int | None:
        """A whole number in [low, high]."""
        number = self.number(node, low, high)
        if number is None:
            return None
        if number != int(number):
            self.wrong(node, f"{number:g} is not a whole number")
            return None
        return int(number)

    def text(self, node: Node, longest: int = 2000) -> str | None:
        """Text (a bare number or date counts as text)."""
        if node.value is None or isinstance(node.value, (dict, list, bool)):
            self.wrong(node, f"expected text, found {kind_of(node.value)}")
            return None
        text = str(node.value)
        if len(text) > longest:
            self.wrong(node, f"the text is longer than {longest} characters")
            return None
        return text

    def flag(self, node: Node) -> bool | None:
        """Yes or no."""
        if not isinstance(node.value, bool):
            self.wrong(node, f"expected yes or no, found {kind_of(node.value)}", "write true or false")
            return None
        return node.value

    def choice(self, node: Node, options: Iterable[str]) -> str | None:
        """One of a few words."""
        options = list(options)
        if not isinstance(node.value, str) or node.value not in options:
            guess = nearest(str(node.value), options) if isinstance(node.value, str) else None
            found = f"`{str(node.value)[:40]}`" if isinstance(node.value, (str, int, float)) else kind_of(node.value)
            hint = f"did you mean `{guess}`?" if guess else f"one of: {', '.join(options)}"
            self.wrong(node, f"{found} is not one of the choices", hint)
            return None
        return node.value

    def items(self, node: Node, what: str) -> list[Node]:
        """The elements of a list."""
        if not isinstance(node.value, list):
            self.wrong(node, f"expected a list of {what}, found {kind_of(node.value)}", "start each with a dash")
            return []
        if not node.value:
            self.wrong(node, f"the list of {what} is empty")
        return node.value

    # From text to nodes.

    def _convert(self, node: yaml.Node, path: str) -> Node:
        line = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            children: dict[str, Node] = {}
            for key_node, value_node in node.value:
                key = str(key_node.value) if isinstance(key_node, yaml.ScalarNode) else "?"
                here = f"{path}.{key[:60]}" if path else key[:60]
                key_line = key_node.start_mark.line + 1
                if not isinstance(key_node, yaml.ScalarNode):
                    self.problem(key_line, path, "a key must be one word", "")
                    continue
                if key in children:
                    self.problem(key_line, here, "this key is here twice", f"the first is on line {children[key].line}")
                    continue
                converted = self._convert(value_node, here)
                # An empty value carries the mark of what follows; the key's line is where a person looks.
                children[key] = Node(converted.value, key_line, here) if converted.value is None else converted
            return Node(children, line, path)
        if isinstance(node, yaml.SequenceNode):
            return Node([self._convert(child, f"{path}[{i}]") for i, child in enumerate(node.value)], line, path)
        return Node(self._scalar(node, line, path), line, path)

    def _scalar(self, node: yaml.Node, line: int, path: str) -> Plain:
        standard = {"null", "bool", "int", "float", "str", "timestamp", "value", "merge"}
        if node.tag.removeprefix("tag:yaml.org,2002:") not in standard:
            self.problem(line, path, f"the tag {node.tag[:40]} is not allowed", "write plain values")
            return str(node.value)
        try:
            value = yaml.constructor.SafeConstructor().construct_object(node)
            if isinstance(value, int):
                float(value)  # where one is beyond all floats, every reader of numbers would have to know
        except (ValueError, OverflowError, KeyError, AttributeError, yaml.YAMLError):
            # An impossible date or a number of hundreds of digits.
            self.problem(line, path, f"cannot make sense of {str(node.value)[:40]!r}", "")
            return None
        if isinstance(value, date):
            return value.isoformat()
        return value if isinstance(value, (str, int, float, bool)) or value is None else str(node.value)


def require(
    document: YamlDocument, fields: Mapping[str, Node], names: Iterable[str], line: int, path: str = ""
) -> None:
    """Note every name that is missing from `fields`."""
    for name in names:
        if name not in fields:
            document.problem(line, f"{path}.{name}" if path else name, "this key is missing", f"add `{name}:`")


@dataclass(frozen=True)
class Form:
    """A kind of file that people write: it states `format: <name>/1` and has only these keys at its top. error: of its problems."""

    name: str
    keys: tuple[str, ...]
    error: type[InputError]


def read_form(text: str, file: str, form: Form, build: Callable[[YamlDocument, dict[str, Node]], T]) -> T:
    """What `build` makes of the keys at the top of a document; all problems found until then are raised at once, with `file` as their file.

    build: notes what is wrong in the document and goes on; what it returns counts only where it noted nothing.
    """
    document = YamlDocument(file, text)
    document.check_format(form.name)
    built = build(document, document.mapping(document.root, form.keys)) if document.root is not None else None
    document.raise_problems(form.error)  # a document without a root has problems
    return cast(T, built)


class _Plain(yaml.SafeDumper):
    """Writes a value out each time it occurs: the reader refuses anchors and aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_str(self, data: str) -> Any:
        """Text; with a next-line character in quotes that escape it, for readers take a bare one for a line break."""
        return self.represent_scalar("tag:yaml.org,2002:str", data, style='"' if "\x85" in data else None)


_Plain.add_representer(str, _Plain.represent_str)


def write_text(data: Mapping[str, object]) -> str:
    """YAML that `YamlDocument` reads back, keys in the order given; its lines are whole on a terminal of 80 columns (PyYAML breaks
    them behind the word that passes its width)."""
    return str(yaml.dump(dict(data), Dumper=_Plain, sort_keys=False, width=64, allow_unicode=True))
