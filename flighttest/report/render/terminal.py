"""`Document` to a rich renderable. Pure: width and colour belong to the console that draws it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.panel import Panel as Box
from rich.table import Table as Grid
from rich.text import Text

from flighttest.report.document import (
    OMITTED,
    Bullets,
    Cell,
    Choice,
    Code,
    Document,
    Facts,
    Figure,
    PageBlock,
    Paragraph,
    Section,
    Table,
    Viewer,
)

STYLE = {"plain": "", "good": "green", "warn": "yellow", "bad": "bold red", "quiet": "dim"}
FOLDED_ROWS = 12
LABEL_WIDTH = 28  # first columns up to this wide are never folded
SHORT_WIDTH = 14  # other columns up to this wide are not, either
WORD_WIDTH = 24  # longer words (paths) are folded within


def render(document: Document, everything: bool = False) -> RenderableType:
    """The whole document: verdict in a box, facts, then the sections. everything: also what tables leave out for one screen."""
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
        parts.append(_Facts(Facts(tuple(document.facts.items()))))
    shown = [section for section in document.sections if everything or not section.detail]
    hidden = [
        s.title.lower() for s in document.sections if not everything and (_omits(s) if s in shown else not _pictures(s))
    ]
    parts.extend(drawn for section in shown if (drawn := _section(section, everything)) is not None)
    if hidden:
        parts += ["", _Prose(f"--all shows more: {', '.join(hidden)}", "dim")]
    if document.footer:
        parts += ["", _Prose(document.footer, "dim")]
    return Group(*parts)


def _omits(section: Section) -> bool:
    """Whether a block of it is shown only where everything is asked for, and nothing stands for it."""
    return any(isinstance(b, Table | Code | Bullets) and b.brief == OMITTED for b in section.blocks)


def _pictures(section: Section) -> bool:
    """Whether it holds nothing that a terminal can show."""
    return all(isinstance(block, Figure | Choice | Viewer) for block in section.blocks)


def _section(section: Section, everything: bool) -> RenderableType | None:
    blocks = [drawn for block in section.blocks if (drawn := _block(block, everything)) is not None]
    head: list[RenderableType] = []
    if section.title:
        head.append(Text(section.title, style="bold cyan"))
    if section.lead:
        head.append(_Prose(section.lead))
    if not blocks and (not section.lead or _pictures(section)):
        return None  # nothing but pictures: they are in the HTML report
    return Group("", *head, *blocks)


def _block(block: PageBlock, everything: bool) -> RenderableType | None:
    if isinstance(block, Table | Code | Bullets) and block.brief and not everything:
        return None if block.brief == OMITTED else _Prose(block.brief)
    if isinstance(block, Paragraph):
        return _Prose(block.text, STYLE[block.tone])
    if isinstance(block, Bullets):
        return Group(*(_Prose(item, head="  - ") for item in block.items))
    if isinstance(block, Facts):
        return _Facts(block)
    if isinstance(block, Table):
        return _Sized(block, everything)
    if isinstance(block, Code):
        return _code(block)
    return None  # pictures are in the HTML report


def _code(block: Code) -> RenderableType:
    if "\n" in block.text and not block.text.startswith("flighttest "):
        from rich.syntax import Syntax

        syntax = Syntax("", "yaml", theme="ansi_dark", background_color="default")
        drawn: RenderableType = _whole(syntax.highlight(block.text.rstrip("\n")))
    else:
        drawn = _Prose(block.text, "cyan", "  ", command=True)
    return Group(_Prose(block.caption, "dim"), drawn) if block.caption else drawn


def _whole(text: Text) -> Text:
    """The text as it stands: what is longer than the terminal is wide goes on in its next row and is still one line where it is copied."""
    text.no_wrap, text.overflow = True, "ignore"
    return text


class _Prose:
    """Text in the width there is, its lines behind `head` and then as far in. It folds between words; a command goes on behind a
    backslash, and a word longer than the line (a path) stays whole, so that both can be copied."""

    def __init__(self, text: str, style: str = "", head: str = "", command: bool = False) -> None:
        self._text, self._style, self._head, self._command = text, style, head, command

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        head = self._head
        for line in self._text.split("\n"):
            spaces = " " * (len(line) - len(line.lstrip()))
            for folded in _folded(line, options.max_width - cell_len(head + spaces), self._command):
                yield _whole(Text(head + spaces + folded, style=self._style))
                head = " " * cell_len(head)


_WORDS = re.compile(r"""(?:'[^']*'|"[^"]*"|\S)+""")  # of a command: what is in quotes is one word, with its spaces


def _folded(text: str, available: int, command: bool = False) -> list[str]:
    """Lines of at most `available` cells, except where one word is longer: `text` broken between words, and within a command (the whole
    text, or in backticks) only where it is longer than a line, behind backslashes and with what follows two deeper."""
    lines = [""]
    command = command or text.startswith("flighttest ")
    for piece in [text.strip()] if command else re.split(r"(`flighttest [^`]*`\S*)", text.strip()):
        inside = command or piece.startswith("`")
        long = inside and cell_len(piece) > available
        words = [piece] if inside and not long else _WORDS.findall(piece) if inside else piece.split()
        for k, word in enumerate(words):
            end = " \\" if long and k < len(words) - 1 else ""
            if lines[-1] and cell_len(f"{lines[-1]} {word}{end}") > available and word != "\\":
                lines[-1] += " \\" if long and k else ""
                lines.append(f"  {word}" if long and k else word)
            else:
                lines[-1] = f"{lines[-1]} {word}" if lines[-1] else word
    return lines


class _Facts:
    """Names, and their values in a column behind them; a value with a word longer than the column is wide stands below its name."""

    def __init__(self, facts: Facts) -> None:
        self._pairs = facts.pairs

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        indent = max((cell_len(name) for name, _ in self._pairs), default=0) + 2
        available = options.max_width - indent
        for name, value in self._pairs:
            lines = [line for part in value.split("\n") for line in _folded(part, available)]
            if any(cell_len(line) > available for line in lines):
                yield Text(name, style="dim")
                yield _Prose(value, head="  ")
                continue
            for k, line in enumerate(lines):
                start = "" if k else name
                yield _whole(Text.assemble((start + " " * (indent - cell_len(start)), "dim"), line))


class _Sized:
    """A table in the width there is: text columns fold between words, and what still does not fit follows below as further blocks of
    columns, each after the first column again. No heading is cut and no column of the table is lost."""

    def __init__(self, table: Table, everything: bool) -> None:
        self._table = table
        self._everything = everything

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        table = self._table
        chosen = [i for i in range(len(table.columns)) if self._everything or i not in table.detail]
        most = table.brief_rows or (FOLDED_ROWS if table.fold else len(table.rows))
        rows = table.rows if self._everything else table.rows[:most]
        for index, block in enumerate(_blocks(table, chosen, options.max_width)):
            if index:
                yield Text("")
            grid = Grid(box=None, header_style="dim", padding=(0, 1, 0, 0), show_edge=False, title_justify="left")
            for i, width in block.items():
                align = table.align[i] if i < len(table.align) else "left"
                grid.add_column(table.columns[i], justify=align, overflow="fold", width=width)
            for row in rows:
                grid.add_row(*(_cell(row[i]) for i in block))
            yield grid
        left_out = _left_out(len(table.rows) - len(rows), [table.columns[i] for i in table.detail if i not in chosen])
        if left_out:
            yield _Prose(left_out, "dim")
        if table.caption:
            yield _Prose(table.caption, "dim italic")


def _left_out(rows: int, columns: Sequence[str]) -> str:
    """What `--all` would show beside this, '' where nothing."""
    what = ([f"{rows} more row{'s' if rows > 1 else ''}"] if rows > 0 else []) + (
        [f"columns {', '.join(columns)}"] if columns else []
    )
    return f"... {'; '.join(what)}: --all shows them, --csv DIR writes them" if what else ""


def _blocks(table: Table, chosen: Sequence[int], available: int) -> list[dict[int, int]]:
    """Columns (by position) with their widths, in as many blocks as the available width needs."""
    wanted = {i: max(_lengths(table, i)) for i in chosen}
    least = {i: min(wanted[i], max(1, available - 1), _least(table, i)) for i in chosen}
    blocks: list[list[int]] = [[]]
    for i in chosen:
        if len(blocks[-1]) > 1 and sum(least[k] + 1 for k in (*blocks[-1], i)) > available:
            blocks.append([chosen[0]] if least[chosen[0]] + least[i] + 2 <= available else [])
        blocks[-1].append(i)
    return [width_shared({i: (least[i], wanted[i]) for i in block}, available) for block in blocks if block]


def width_shared(spans: Mapping[int, tuple[int, int]], available: int) -> dict[int, int]:
    """A width per column between its least and its wanted one; what is over goes to the narrowest that needs more, sign by sign."""
    widths = {i: least for i, (least, _) in spans.items()}
    for _ in range(available - sum(w + 1 for w in widths.values())):
        wanting = [i for i in widths if widths[i] < spans[i][1]]
        if not wanting:
            break
        widths[min(wanting, key=widths.__getitem__)] += 1
    return widths


def _lengths(table: Table, index: int) -> list[int]:
    return [cell_len(t) for t in (table.columns[index], *(_cell(row[index]).plain for row in table.rows))]


def _least(table: Table, index: int) -> int:
    """The width below which a heading or a number of the column would be cut: numbers and short labels stay whole, text folds between
    words of usual length."""
    lengths = _lengths(table, index)[1:]
    heading = max((cell_len(word) for word in table.columns[index].split()), default=0)
    right = index < len(table.align) and table.align[index] == "right"
    if right or (index == 0 and max(lengths, default=0) <= LABEL_WIDTH):
        return max(heading, *lengths, 1)
    if max(lengths, default=0) <= SHORT_WIDTH:
        return max(heading, *lengths, 1)
    words = (cell_len(word) for row in table.rows for word in _cell(row[index]).plain.split())
    return max(heading, min(max(words, default=1), WORD_WIDTH))


def _cell(cell: Cell | str) -> Text:
    if isinstance(cell, str):
        return Text(cell)
    text = Text(cell.text, style=STYLE[cell.tone])
    if cell.note:
        text.append(f"{' ' if cell.text == '-' else ': '}{cell.note}", style="dim")
    return text
