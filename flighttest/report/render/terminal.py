"""`Document` to a rich renderable. Pure: width and colour belong to the console that draws it."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.padding import Padding
from rich.panel import Panel as Box
from rich.table import Table as Grid
from rich.text import Text

from flighttest.report.document import Block, Bullets, Cell, Code, Document, Facts, Figure, Paragraph, Section, Table

STYLE = {"plain": "", "good": "green", "warn": "yellow", "bad": "bold red", "quiet": "dim"}
FOLDED_ROWS = 12
LABEL_WIDTH = 28  # first columns up to this wide are never folded
ROOMY_WIDTH = 110  # columns of a terminal that has room for everything


def render(document: Document) -> RenderableType:
    """The whole document: verdict in a box, facts, then the sections."""
    verdict = Text(document.verdict, style=f"bold {STYLE[document.tone]}".strip())
    parts: list[RenderableType] = [
        Box(
            verdict,
            title=document.title,
            title_align="left",
            border_style=STYLE[document.tone] or "cyan",
            padding=(0, 1),
        )
    ]
    if document.facts:
        parts.append(_facts(Facts(tuple(document.facts.items()))))
    parts.extend(drawn for section in document.sections if (drawn := _section(section)) is not None)
    if document.footer:
        parts.append(Padding(Text(document.footer, style="dim"), (1, 0, 0, 0)))
    return Group(*parts)


def _section(section: Section) -> RenderableType | None:
    blocks = [drawn for block in section.blocks if (drawn := _block(block)) is not None]
    head: list[RenderableType] = []
    if section.title:
        head.append(Text(section.title, style="bold cyan"))
    if section.lead:
        head.append(Text(section.lead))
    if not section.lead and not blocks:
        return None  # nothing but pictures: they are in the HTML report
    return Padding(Group(*head, *blocks), (1, 0, 0, 0))


def _block(block: Block) -> RenderableType | None:
    if isinstance(block, Paragraph):
        return Text(block.text, style=STYLE[block.tone])
    if isinstance(block, Bullets):
        grid = Grid.grid(padding=(0, 1))
        grid.add_column(no_wrap=True)
        grid.add_column(overflow="fold")  # a command that lost its end cannot be copied
        for item in block.items:
            grid.add_row("  -", item)
        return grid
    if isinstance(block, Facts):
        return _facts(block)
    if isinstance(block, Table):
        return _Sized(block)
    if isinstance(block, Code):
        return _code(block)
    if isinstance(block, Figure):
        return None  # pictures are in the HTML report
    return None


def _code(block: Code) -> RenderableType:
    drawn: RenderableType = Text(f"  {block.text}", style="cyan")
    if "\n" in block.text and not block.text.startswith("flighttest "):
        from rich.syntax import Syntax

        drawn = Syntax(block.text, "yaml", theme="ansi_dark", background_color="default", word_wrap=False)
    return Group(Text(block.caption, style="dim"), drawn) if block.caption else drawn


def _facts(facts: Facts) -> RenderableType:
    grid = Grid.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column()
    for name, value in facts.pairs:
        grid.add_row(name, value)
    return grid


class _Sized:
    """A table that leaves out its roomy columns where the terminal is narrow."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield _table(self._table, options.max_width >= ROOMY_WIDTH)


def _table(table: Table, roomy: bool) -> RenderableType:
    grid = Grid(box=None, header_style="dim", padding=(0, 1, 0, 0), show_edge=False, title_justify="left")
    shown = [i for i in range(len(table.columns)) if roomy or i not in table.roomy]
    for index in shown:
        name = table.columns[index]
        align = table.align[index] if index < len(table.align) else "left"
        short = index == 0 and all(len(_cell(row[0]).plain) <= LABEL_WIDTH for row in table.rows)
        grid.add_column(name, justify=align, overflow="fold", no_wrap=align == "right" or short)
    rows = table.rows[:FOLDED_ROWS] if table.fold else table.rows
    for row in rows:
        grid.add_row(*(_cell(row[i]) for i in shown))
    parts: list[RenderableType] = [grid]
    hidden = len(table.rows) - len(rows)
    if hidden > 0:
        parts.append(
            Text(
                f"... and {hidden} more (all of them with --json, and in the HTML report where one is written)",
                style="dim",
            )
        )
    if table.caption:
        parts.append(Text(table.caption, style="dim italic"))
    return Group(*parts)


def _cell(cell: Cell | str) -> Text:
    if isinstance(cell, str):
        return Text(cell)
    text = Text(cell.text, style=STYLE[cell.tone])
    if cell.note:
        text.append(f" {cell.note}", style="dim")
    return text
