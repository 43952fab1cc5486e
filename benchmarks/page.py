"""Write a measured table into its page: between `<!-- measured: NAME -->` and `<!-- end -->`."""

from __future__ import annotations

import re
from pathlib import Path


def write_block(page: Path, benchmark: str, table: str) -> None:
    """Replace what a benchmark measured before. benchmark: its file, as the page names it. SystemExit where the page has no such block."""
    block = re.compile(rf"(<!-- measured: {re.escape(benchmark)} -->\n).*?(<!-- end -->)", re.DOTALL)
    text = page.read_text(encoding="utf-8")
    if not block.search(text):
        raise SystemExit(f"{page} has no block for {benchmark}")
    page.write_text(block.sub(lambda m: m.group(1) + table + m.group(2), text), encoding="utf-8")
