"""Files that a program wrote: written whole or not at all; read only up to a size, without anchors and to a depth: they may come from
anywhere.

For files that people write see `documents`, which keeps the line of every value.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import UnionType
from typing import Any, NotRequired, Required, Union, get_args, get_origin, get_type_hints, is_typeddict

import yaml

from flighttest.errors import InputError

SCRIPT_BYTES = 300_000  # of what people write, and of models
DATA_BYTES = 4_000_000  # a manifest with 1,500 parameters and its notes takes 0.1 MB
MOST_VALUES = 100_000_000  # of one table: ten hours of three columns at 1 kHz
MAX_DEPTH = 40  # our own files are nested 8 deep
_NUMBER_DIGITS = 250  # a float64 has 309 before its point; hexadecimal ones of YAML hold a fifth more
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's own reads a manifest ten times as fast


class _Refused(ValueError):
    """The text is not a file that this program writes; why."""


def write_whole(path: Path, text: str) -> None:
    """Write a text file in UTF-8 such that a program killed in between leaves what was there before, and so does a full disk, without half
    a file beside it. OSError as of `Path.write_text`, which names the file."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    with naming(path):
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink()
            raise


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """An OSError that comes of what is written to a file names it: one of a write itself, on a full disk, does not by itself."""
    try:
        yield
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def read_bytes(path: Path, error: type[InputError], what: str, most: int = DATA_BYTES, remedy: str = "") -> bytes:
    """The bytes of a file; `error` where it cannot be read or is larger than `most`: of such a one nothing is kept in memory."""
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as failure:
        reason = failure.strerror or str(failure)
        raise error(f"{path}: this {what} cannot be read: {reason}", remedy or "check the path") from failure
    except ValueError as failure:
        raise error(f"{str(path)!r} is not a path: {failure}", "check the path") from failure
    if len(data) > most:
        raise error(f"{path}: the file is larger than {most} bytes", remedy or f"it is no {what}")
    return data


def read_text(path: Path, error: type[InputError], what: str, most: int = SCRIPT_BYTES) -> str:
    """The text of a file a person named; `error` with a remedy when it cannot be read."""
    try:
        return read_bytes(path, error, what, most).decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(f"{path}: this {what} is not UTF-8 text", "save it as plain UTF-8 text") from failure


def read_yaml(path: Path, error: type[InputError], what: str, remedy: str) -> Any:
    """The data of a YAML file that a program wrote. `error` with `remedy` where it is none."""
    data = read_bytes(path, error, what, remedy=remedy)
    try:
        text = data.decode("utf-8")
        _look_through(yaml.parse(text, Loader=_LOADER))
        return yaml.load(text, Loader=_LOADER)  # a safe loader
    except (yaml.YAMLError, ValueError, OverflowError) as failure:
        raise error(f"{path}: this {what} cannot be read: {_first_line(failure)}", remedy) from failure


def read_json(path: Path, error: type[InputError], what: str, remedy: str) -> Any:
    """The data of a JSON file that a program wrote. `error` with `remedy` where it is none."""
    try:
        return parse_json(read_bytes(path, error, what, remedy=remedy).decode("utf-8"))
    except ValueError as failure:
        raise error(f"{path}: this {what} cannot be read: {_first_line(failure)}", remedy) from failure


def parse_json(text: str) -> Any:
    """The data of a JSON text. ValueError where it is none, or nested too deeply."""
    try:
        data = json.loads(text, parse_int=_whole)
    except RecursionError:
        raise _Refused("it is nested too deeply") from None
    level = [data]
    for _ in range(MAX_DEPTH):
        level = [child for value in level for child in _children(value)]
        if not level:
            return data
    raise _Refused("it is nested too deeply")


def _whole(digits: str) -> int:
    """An integer that a float can hold."""
    if len(digits) > _NUMBER_DIGITS:
        raise _Refused(f"a number of {len(digits)} digits")
    return int(digits)


def _children(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def type_mismatch(data: Any, kind: Any, place: str = "") -> str:
    """Where the data of a file is not of the type that its writer states, in one clause; '' where it is. A number may be null (not known).

    kind: of TypedDict, dict, list, str, int, float, bool and None. place: of the data in its file.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if is_typeddict(kind) and isinstance(data, dict):
        fields = _fields(kind)
        missing = next((name for name, (_, required) in fields.items() if required and name not in data), "")
        inside = (type_mismatch(data[n], of, f"{place}.{n}".lstrip(".")) for n, (of, _) in fields.items() if n in data)
        return f"{place}.{missing} is missing".lstrip(".") if missing else next(filter(None, inside), "")
    if origin is dict and isinstance(data, dict):
        return next(filter(None, (type_mismatch(v, parts[1], f"{place}.{k}".lstrip(".")) for k, v in data.items())), "")
    if origin is list and isinstance(data, list):
        return next(filter(None, (type_mismatch(v, parts[0], f"{place}[{i}]") for i, v in enumerate(data))), "")
    if origin in (Union, UnionType):
        fits = any(not type_mismatch(data, one) for one in parts)
    elif kind in (int, float):
        fits = data is None or (isinstance(data, int | float) and not isinstance(data, bool))
    else:
        fits = kind is Any or (isinstance(kind, type) and not is_typeddict(kind) and isinstance(data, kind))
    return "" if fits else f"{place} is {str(data)[:30]!r}"


def _fields(kind: Any) -> dict[str, tuple[Any, bool]]:
    """The keys of a TypedDict: the type of each, and whether it must be there."""
    found = {}
    for name, stated in get_type_hints(kind, include_extras=True).items():
        marked = get_origin(stated) in (Required, NotRequired)
        required = get_origin(stated) is Required if marked else bool(kind.__total__)
        found[name] = (get_args(stated)[0] if marked else stated, required)
    return found


def _look_through(events: Iterable[Any]) -> None:
    """Refuse what grows in memory or in time: before anything is built of it."""
    depth = 0
    for event in events:
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise _Refused("anchors and aliases (& and *) are not allowed")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise _Refused("it is nested too deeply")
        bare = event.value if isinstance(event, yaml.ScalarEvent) and event.implicit[0] else ""
        if len(bare) > _NUMBER_DIGITS and bare.lstrip("+-.")[:1].isdigit():
            raise _Refused(f"a number of {len(bare)} digits")


def _first_line(error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    if mark is not None:  # of YAML: its first line says only what was being read
        return f"line {mark.line + 1}: {getattr(error, 'problem', None) or 'this is not YAML'}"
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def check_writable(folder: Path | None) -> None:
    """InputError before any work where nothing could be written after it into a folder, which may have to be made then."""
    if folder is None:
        return
    nearest = next(p for p in (folder, *folder.parents) if p.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror})", "name a folder that can be written"
        ) from error
