"""The flight while it happens: one line for a log file, a picture for a terminal. Pure functions of the progress."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text


def line(progress: Any) -> str:
    """One plain line."""
    return str(progress)


def picture(progress: Any) -> RenderableType:
    """What moves now, what comes next, margins, link, and how to stop."""
    return Group(Text(str(progress)))
