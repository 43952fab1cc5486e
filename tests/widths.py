"""What a terminal would spoil of a document: headings cut, columns lost, lines longer than it is wide."""

from __future__ import annotations

import io
import re
from dataclasses import replace

from rich.cells import cell_len
from rich.console import Console

from flighttest.report.document import Cell, Document, Section, Table
from flighttest.report.render import terminal


def drawn(document: Document, width: int, everything: bool = False) -> str:
    """The text that a terminal of so many columns shows."""
    out = io.StringIO()
    Console(file=out, width=width, color_system=None).print(terminal.render(document, everything), crop=False)
    return out.getvalue()


def too_long(line: str, width: int) -> bool:
    """Whether a terminal of so many columns would have to break the line, and it is not one word (a path to be copied, in quotes where it
    has spaces)."""
    words = line.removesuffix(" \\").strip().removeprefix("- ")
    return cell_len(line.rstrip()) > width and " " in words and re.fullmatch(r"'[^']*'\S*", words) is None


def widest(table: Table) -> Table:
    """The table with the rows alone that decide how wide its columns are: those of the longest cell and the longest word of each."""

    def lengths(row: tuple[Cell | str, ...], index: int) -> tuple[int, int]:
        text = row[index] if isinstance(row[index], str) else f"{row[index].text}: {row[index].note}"
        return cell_len(text), max((cell_len(word) for word in text.split()), default=0)

    sized = [[lengths(row, index) for index in range(len(table.columns))] for row in table.rows]
    columns, ways = range(len(table.columns)), range(2)
    kept = {max(range(len(sized)), key=lambda r, i=i, k=k: sized[r][i][k]) for i in columns for k in ways if sized}
    return replace(table, rows=tuple(table.rows[r] for r in sorted(kept)))


def troubles(whole: Document, width: int) -> list[str]:
    """A sentence for each thing that is wrong, of what is shown first and of everything; of a table the widest rows are drawn."""
    found = []
    document = replace(
        whole,
        sections=tuple(
            replace(section, blocks=tuple(widest(b) if isinstance(b, Table) else b for b in section.blocks))
            for section in whole.sections
        ),
    )
    tables = [block for section in document.sections for block in section.blocks if isinstance(block, Table)]
    for everything in (False, True):
        text = drawn(document, width, everything) if tables or not everything else ""
        found += [f"{width}: too long: {line!r}" for line in text.splitlines() if too_long(line, width)]
        if "\u2026" in text and "\u2026" not in str(whole):
            found.append(f"{width}: something is cut short in {document.title!r}")
    for table in tables:
        chosen = [c for i, c in enumerate(table.columns) if i not in table.detail]
        for columns, everything in ((chosen, False), (table.columns, True))[: 2 if table.detail else 1]:
            bare = Table(table.columns, table.rows, table.align, "", table.fold, table.detail)
            words = drawn(Document("", "", sections=(Section("s", "", (bare,)),)), width, everything).split()
            lost = [word for heading in columns for word in heading.split() if word not in words]
            found += [f"{width}: the heading {word!r} of {table.columns} is cut" for word in lost]
    return found
