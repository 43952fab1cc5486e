"""Completion in a shell: names of the program's own (shipped maneuvers, terms of the catalogue) beside files."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem


def maneuver(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Shipped maneuvers that begin so; else files, of which a script may be one."""
    from flighttest.api.catalogue import shipped_maneuvers

    return _beginning(begun, shipped_maneuvers()) or [CompletionItem(begun, type="file")]


def term(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Terms of the catalogue that begin so."""
    from flighttest.api.catalogue import terms

    return _beginning(begun, tuple(terms))


def _beginning(begun: str, names: tuple[str, ...]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(begun)]
