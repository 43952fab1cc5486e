"""`Document` to one self-contained HTML page: own style, one copy of plotly's script, no request to anywhere."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from flighttest.datafiles import write_whole
from flighttest.report.document import (
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
from flighttest.report.packing import pack_series, packed, packed_figures, packed_json, plotly_script
from flighttest.report.render.figures import specification

SPECS = "packed-figures"
LEADING = 2  # sentences of the verdict that are set large
PROSE = 18  # characters of a table's cell from which on its column is read as prose
VIEWER_SAMPLES, LEAST_CHANNEL = 300_000, 2000  # samples of all channels together, and of one at the least
VIEWER_CHARACTERS = 230_000  # of them packed: the page stays below 2 MB, of which the plot library is 1.65
THEME_BUTTON = '<button id="theme" type="button">light / dark</button>'


def page_of(document: Document) -> str:
    """The page as text."""
    sections = "\n".join(_section(section) for section in document.sections)
    links = "".join(f'<a href="#{escape(s.id)}">{escape(s.title)}</a>' for s in document.sections if s.title)
    facts = f"<section>{_facts(Facts(tuple(document.facts.items())))}</section>" if document.facts else ""
    blocks = [block for section in document.sections for block in section.blocks]
    viewers = any(isinstance(block, Viewer) for block in blocks)
    figures = viewers or any(isinstance(block, Figure | Choice) for block in blocks)
    scripts = ""
    if figures:
        names = ("unpack.js", "figures.js", *(("viewer.js",) if viewers else ()))
        specs = packed_figures([specification(figure) for figure in _figures(blocks)], SPECS)
        scripts = "\n".join([plotly_script(), specs, *(f"<script>{_asset(name)}</script>" for name in names)])
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(document.title)}</title>
<style>{_asset("style.css")}</style>
</head>
<body>
<header><h1>{escape(document.title)}</h1>{THEME_BUTTON if figures else ""}</header>
<main>
<div class="verdict {document.tone}" role="status">{_verdict(document.verdict)}</div>
<nav>{links}</nav>
{sections}
{facts}
</main>
<footer>{escape(document.footer)}</footer>
{scripts}
</body>
</html>
"""


def write_html(document: Document, path: Path) -> Path:
    """Write the page and give its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, page_of(document))
    return path


def _asset(name: str) -> str:
    return resources.files("flighttest.report.render").joinpath(name).read_text(encoding="utf-8")


def _verdict(text: str) -> str:
    """The first sentences large, the others smaller below."""
    sentences = re.split(r"(?<=[.!?]) +(?=[A-Z0-9])", text)
    first, rest = " ".join(sentences[:LEADING]), " ".join(sentences[LEADING:])
    return escape(first) + (f"<p>{escape(rest)}</p>" if rest else "")


def _section(section: Section) -> str:
    title = f"<h2>{escape(section.title)}</h2>" if section.title else ""
    lead = f'<p class="lead">{escape(section.lead)}</p>' if section.lead else ""
    blocks = "\n".join(map(_block, section.blocks))
    return f'<section id="{escape(section.id)}">{title}{lead}{blocks}</section>'


def _block(block: PageBlock) -> str:
    if isinstance(block, Paragraph):
        return f'<p class="{block.tone}">{_prose(block.text)}</p>'
    if isinstance(block, Bullets):
        return "<ul>" + "".join(f"<li>{_prose(item)}</li>" for item in block.items) + "</ul>"
    if isinstance(block, Facts):
        return _facts(block)
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Code):
        caption = f'<p class="caption">{escape(block.caption)}</p>' if block.caption else ""
        return f"{caption}<pre>{escape(block.text)}</pre>"
    if isinstance(block, Viewer):
        return _viewer(block)
    if isinstance(block, Choice):
        return _choice(block)
    return _figure(block)


def _prose(text: str) -> str:
    """Escaped text with `commands` set as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def _facts(facts: Facts) -> str:
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.pairs) + "</dl>"


def _table(table: Table) -> str:
    side: list[str] = [table.align[i] if i < len(table.align) else "left" for i in range(len(table.columns))]
    for i in range(1, len(side)):
        if side[i] == "left" and any(len(_text(row[i])) >= PROSE for row in table.rows):
            side[i] = "left prose"
    head = "".join(f'<th class="{side[i]}">{escape(name)}</th>' for i, name in enumerate(table.columns))
    body = "".join("<tr>" + "".join(_cell(cell, side[i]) for i, cell in enumerate(row)) + "</tr>" for row in table.rows)
    caption = f'<p class="caption">{escape(table.caption)}</p>' if table.caption else ""
    whole = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    if table.fold:
        rows = f"{len(table.rows)} rows"
        what = f"{escape(table.caption.rstrip('.'))} ({rows})" if table.caption else f"all {rows}"
        return f"<details><summary>{what}</summary>{whole}</details>"
    return whole + caption


def _text(cell: Cell | str) -> str:
    return cell if isinstance(cell, str) else f"{cell.text} {cell.note}"


def _cell(cell: Cell | str, side: str) -> str:
    if isinstance(cell, str):
        return f'<td class="{side}">{_breakable(cell)}</td>'
    note = f"<small>{escape(cell.note)}</small>" if cell.note else ""
    return f'<td class="{side}"><span class="{cell.tone}">{_breakable(cell.text)}</span>{note}</td>'


def _breakable(text: str) -> str:
    """Escaped; a narrow page may break a long name after its underscores and slashes, but no unit."""
    return re.sub(r"(?<=\S{4})([_/])(?=\w\w)", r"\1<wbr>", escape(text))


def _figures(blocks: Sequence[PageBlock]) -> list[Figure]:
    """All figures in the order in which their elements stand in the page."""
    found: list[Figure] = []
    for block in blocks:
        if isinstance(block, Figure):
            found.append(block)
        elif isinstance(block, Choice):
            found += [figure for _, figure in block.figures]
    return found


def _figure(figure: Figure) -> str:
    columns = min(figure.columns, len(figure.panels))
    return (
        f'<figure data-figure style="--columns:{columns}"><div class="legend"></div><div class="plots"></div>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def _choice(choice: Choice) -> str:
    options = "".join(f"<option>{escape(name)}</option>" for name, _ in choice.figures)
    drawn = "".join(
        f"<div{' hidden' if i else ''}>{_figure(figure)}</div>" for i, (_, figure) in enumerate(choice.figures)
    )
    return f'<div class="choice"><label>{escape(choice.what)} <select>{options}</select></label>{drawn}</div>'


def _viewer(viewer: Viewer) -> str:
    """Channels with their level of detail, as many samples of each as let the page stay small."""
    count = sum(len(columns) for _, columns in viewer.groups.values())
    most = max(VIEWER_SAMPLES // max(count, 1), LEAST_CHANNEL)
    key = escape(viewer.id)
    series, data = pack_series(viewer.groups, most)
    element = packed(data, f"{key}-data")
    while len(element) > VIEWER_CHARACTERS and most > LEAST_CHANNEL:
        most = max(int(0.9 * most * VIEWER_CHARACTERS / len(element)), LEAST_CHANNEL)
        series, data = pack_series(viewer.groups, most)
        element = packed(data, f"{key}-data")
    described = {
        "series": series,
        "words": {name: list(words) for name, words in viewer.words.items()},
        "marks": [[m.start_s, m.end_s, m.label, m.kind] for m in viewer.marks],
        "shown": list(viewer.shown),
    }
    return (
        f'<div class="viewer" data-viewer="{key}"><div class="channels"></div><div class="strips"></div>'
        f'<p class="caption">{escape(viewer.caption)}</p></div>'
        f"{packed_json(described, f'{key}-about')}{element}"
    )
