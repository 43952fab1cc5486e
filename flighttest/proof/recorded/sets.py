"""`recordings/1`: sets of recordings that others made, what their documentation supports, and which of them are known to differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flighttest.datafiles import read_text
from flighttest.documents import Form, Node, YamlDocument, read_form, require
from flighttest.errors import InputError
from flighttest.physics.catalogue import catalogue

_KEYS = ("format", "sets")
_SET = ("name", "source", "files", "columns", "own", "vehicle", "state", "wind_m_s")
_MOST_WIND_M_S = 100.0


@dataclass(frozen=True)
class RecordedSet:
    """Recordings of one vehicle in one state. source: who made them (a trial draws the source first, then a set of it, then files);
    files: patterns relative to the folder of data; columns: their column map; own: terms that their documentation supports, which are
    no false alarm; vehicle, state: sets of one vehicle whose states differ are known to differ, those of one state not ('' where
    nothing is documented); wind_m_s: velocity of the air, (north, west), by an instrument that the recordings are not of: sets of one
    vehicle are known to differ in it."""

    name: str
    source: str
    files: tuple[str, ...]
    columns: Path | None = None
    own: tuple[str, ...] = ()
    vehicle: str = ""
    state: str = ""
    wind_m_s: tuple[float, float] | None = None

    def found(self, data: Path) -> tuple[Path, ...]:
        """Its files that are here."""
        return tuple(sorted({f for pattern in self.files for f in data.glob(pattern)}))


def read_sets(path: Path) -> tuple[RecordedSet, ...]:
    """The sets that a file declares. InputError lists everything wrong with it."""
    text = read_text(path, InputError, "list of recordings")
    return read_form(text, str(path), Form("recordings", _KEYS, InputError), lambda d, keys: _sets(d, keys, path))


def _sets(document: YamlDocument, fields: Mapping[str, Node], path: Path) -> tuple[RecordedSet, ...]:
    require(document, fields, ("sets",), document.line)
    items = document.items(fields["sets"], "sets") if "sets" in fields else []
    made = [one for item in items if (one := _set(document, item, path)) is not None]
    names = [one.name for one in made]
    for item, one in zip(items, made, strict=False):
        if names.count(one.name) > 1:
            document.wrong(item, f"two sets are called {one.name!r}", "give each a name of its own")
    return tuple(made)


def _set(document: YamlDocument, node: Node, path: Path) -> RecordedSet | None:
    keys = document.mapping(node, _SET)
    require(document, keys, ("name", "source", "files"), node.line, node.path)
    if not {"name", "source", "files"} <= keys.keys():
        return None
    words = {k: document.text(keys[k]) or "" for k in ("name", "source", "vehicle", "state") if k in keys}
    files = [document.text(f) or "" for f in document.items(keys["files"], "file names")]
    own = [document.choice(t, catalogue()) or "" for t in document.items(keys["own"], "terms")] if "own" in keys else []
    columns = document.text(keys["columns"]) if "columns" in keys else None
    wind = document.vector(keys["wind_m_s"], 2, -_MOST_WIND_M_S, _MOST_WIND_M_S, "m/s") if "wind_m_s" in keys else None
    if "wind_m_s" in keys and "vehicle" not in keys:
        document.wrong(
            keys["wind_m_s"], "flights in a known wind are compared by vehicle", "name the vehicle of this set"
        )
    return RecordedSet(
        files=tuple(files), columns=path.parent / columns if columns else None, own=tuple(own),
        wind_m_s=(wind[0], wind[1]) if wind else None, **words,
    )  # fmt: skip
