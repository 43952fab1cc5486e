"""Hooks of mkdocs: the site loads nothing from the network, its search included.

The theme's offline search asks a server for the script that runs it in a page opened as a file; search_worker.js is used instead.
"""

from __future__ import annotations

import re
from typing import Any

ASKED = "https://unpkg.com/iframe-worker/shim"
LOADS = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\ssrc=["']?(?:https?:)?//[^>]*>|<link\b[^>]*\shref=["']?(?:https?:)?//[^>]*>"""
)


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
