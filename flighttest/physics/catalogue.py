"""Every `Term` there is: module-level ones in `physics.terms`, and those of the entry-point group `flighttest.terms`."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from flighttest.errors import ModelError
from flighttest.physics import terms as _terms
from flighttest.physics.core import Term


@cache
def catalogue() -> Mapping[str, Term]:
    """Term id to term, sorted by id, read-only. ModelError where two terms share an id."""
    found: dict[str, Term] = {}
    modules = [importlib.import_module(f"{_terms.__name__}.{m.name}") for m in pkgutil.iter_modules(_terms.__path__)]
    candidates = [value for module in modules for value in vars(module).values() if isinstance(value, Term)]
    for entry in entry_points(group="flighttest.terms"):
        loaded = entry.load()
        candidates += (
            [loaded] if isinstance(loaded, Term) else [v for v in vars(loaded).values() if isinstance(v, Term)]
        )
    for term in candidates:
        if found.setdefault(term.id, term) is not term:
            raise ModelError(f"two terms are called {term.id!r}", "give one of them another id")
    return MappingProxyType(dict(sorted(found.items())))
