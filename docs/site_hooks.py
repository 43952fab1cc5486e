"""Hooks of mkdocs: the site loads nothing from the network, its search included; wide tables have room.

The theme's offline search asks a server for the script that runs it in a page opened as a file; search_worker.js is used instead.
"""

from __future__ import annotations

import re
from typing import Any

ASKED = "https://unpkg.com/iframe-worker/shim"
LOADS = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\ssrc=["']?(?:https?:)?//[^>]*>|<link\b[^>]*\shref=["']?(?:https?:)?//[^>]*>"""
)

WIDE = 7  # columns: such a table takes the room of the table of contents, too
CELL = re.compile(r"<t([dh])\b[^>]*>.*?</t\1>", re.DOTALL)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page's text, what is folded read as Markdown, too; a page with a wide table is shown without its table of contents."""
    if has_wide_table(markdown):
        page.meta["hide"] = ["toc"]
    return markdown.replace("<details>", '<details markdown="1">')


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    """The page's body: names in capitals may break behind `_` in the cells of tables."""
    return breakable(html)


def has_wide_table(markdown: str) -> bool:
    """Whether a table of the page has more columns than fit beside the table of contents."""
    return any(re.fullmatch(r"(\|:?-+:?)+\|", line) and line.count("|") > WIDE + 1 for line in markdown.splitlines())


def breakable(html: str) -> str:
    """The body with a place to break behind each `_` between capitals in a cell."""
    return CELL.sub(lambda cell: re.sub(r"(?<=[A-Z]_)(?=[A-Z])", "<wbr>", cell[0]), html)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """The finished page."""
    return without_network(output, page.file.src_uri)


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """A finished page of the theme's own (404.html)."""
    return without_network(output, template_name) if template_name.endswith(".html") else output


def without_network(html: str, name: str) -> str:
    """The page with the local script. PluginError where it loads anything else from the network."""
    html = html.replace(ASKED, "search_worker.js")
    if found := LOADS.search(html):
        from mkdocs.exceptions import PluginError  # of the site's own environment: tests read this module without it

        raise PluginError(f"{name} loads from the network: {found[0]}")
    return html
