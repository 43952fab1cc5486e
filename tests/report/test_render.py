"""One document, three renderings: a page that needs nothing else, a terminal of any width, plain JSON."""

import csv
import io
import json
import re
import shlex
import struct
import sys
import zlib
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import plotly.graph_objects as go
import pyarrow.parquet as pq
import pytest
from plotly.offline import get_plotlyjs
from rich.console import Console

from flighttest.report.document import (
    OMITTED,
    Bullets,
    Cell,
    Choice,
    Code,
    Document,
    Facts,
    Figure,
    Panel,
    Paragraph,
    Section,
    Table,
    Trace,
)
from flighttest.report.packing import MIDDLE, MISSING, plotly_without_maps, unpacked
from flighttest.report.render import figures, html, terminal
from flighttest.report.render.figure_files import write_figures
from flighttest.report.render.plain import plain
from flighttest.report.render.plotly_figure import LIGHT
from flighttest.report.render.svg import WIDTH, as_svg
from flighttest.report.tables import write_tables
from tests.widths import drawn, troubles

T = np.linspace(0.0, 1.0, 30)


def traces():
    y = np.sin(T)
    y[3] = np.nan
    return (
        Trace(T, y, "measured", "measured", "markers"),
        Trace(T, y, "simulated", "simulated"),
        Trace(T, y, "command", "reference", "steps"),
        Trace(T, y, "with bars", "other", "errorbars", spread=np.full(30, 0.1)),
        Trace(T, y, "hidden", "no_drag", shown=False),
    )


def document():
    heat = Trace([1.0, 2.0], ["a_x", "a_z"], "share", "other", "heat", z=[[0.1, np.nan], [0.4, 0.2]])
    path = Trace(T, T, "height, m", "model", "track", z=T)
    figure = Figure(
        "f",
        (
            Panel("roll </script>", "s", "rad", traces()),
            Panel("map", "m", "", (heat,)),
            Panel("path", "east, m", "north, m", (path,), equal=True),
        ),
        "caption",
    )
    table = Table(
        ("name", "value"), (("K", Cell("54.6", "good", "m/s^2")), ("<b>", "1")), ("left", "right"), "a caption"
    )
    long = Table(("n",), tuple((str(i),) for i in range(40)), fold=True)
    blocks = (
        Paragraph("prose"),
        Bullets(("one", "two")),
        Facts((("a", "b"),)),
        table,
        long,
        Code("x: 1\ny: 2"),
        figure,
    )
    return Document(
        "title & more", "the verdict", "warn", (Section("s", "Section", blocks, "lead"),), {"vehicle": "hexa"}, "foot"
    )


def test_the_page_is_self_contained():
    page = html.page_of(document())
    outside = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", outside)
    assert "@import" not in outside
    assert page.count('id="packed-plotly"') == 1
    assert b"plotly.js v" in unpacked(page, "packed-plotly")[:200]


def test_a_page_without_figures_carries_no_script():
    page = html.page_of(Document("t", "v", sections=(Section("s", "S", (Paragraph("p"),)),)))
    assert "<script" not in page
    assert len(page) < 20_000


def _pixels(png):
    data, at = b"", 8
    while at < len(png):
        (size,) = struct.unpack(">I", png[at : at + 4])
        data += png[at + 8 : at + 8 + size] if png[at + 4 : at + 8] == b"IDAT" else b""
        at += size + 12
    return zlib.decompress(data)


def test_without_what_draws_png_the_rest_is_written_and_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "resvg_py", None)
    written = write_figures(document(), tmp_path)
    assert [p.suffix for p in written.files] == [".svg", ".csv"]
    assert "pip install 'flighttest[png]'" in written.sentence(tmp_path)


def figures_in(page, key):
    """The specifications that a page holds, whole again."""
    data = unpacked(page, f"{key}-data")

    def whole(value):
        if not (isinstance(value, dict) and set(value) >= {"at", "n"}):
            return value
        if "low" not in value:
            return [None if np.isnan(v) else float(v) for v in np.frombuffer(data, "<f4", value["n"], value["at"])]
        coded = np.frombuffer(data, "<i2", value["n"], value["at"])
        return [None if c == MISSING else value["low"] + (int(c) + MIDDLE) * value["step"] for c in coded]

    specs = json.loads(unpacked(page, key))
    for spec in specs:
        for panel in spec["panels"]:
            panel["data"] = [{k: whole(v) for k, v in trace.items()} for trace in panel["data"]]
    return specs


def test_text_is_escaped_and_specs_survive_the_script_element():
    page = html.page_of(document())
    assert "&lt;b&gt;" in page
    assert "title &amp; more" in page
    specs = figures_in(page, html.SPECS)
    assert len(specs) == 1
    assert specs[0]["panels"][0]["layout"]["title"]["text"] == "roll </script>"


def test_figures_hold_their_numbers_to_a_screens_accuracy():
    t = np.linspace(0.0, 2.0, 50)
    y = np.where(t > 1.0, np.sin(9.0 * t), np.nan)
    tiny = 10.0 ** (-6.0 * t)
    plain_panel = Panel("a", "s", "m", (Trace(t, y, "y"), Trace(t, 1e6 * t, "big")))
    log_panel = Panel("b", "s", "m", (Trace(t, tiny, "tiny"),), log="y")
    page = html.page_of(
        Document("t", "v", sections=(Section("s", "S", (Figure("f", (plain_panel, log_panel), "c"),)),))
    )
    (spec,) = figures_in(page, html.SPECS)
    (first, big), (last,) = (panel["data"] for panel in spec["panels"])
    assert [v is None for v in first["y"]] == list(np.isnan(y))
    assert np.allclose([v for v in first["y"] if v is not None], y[np.isfinite(y)], atol=3e-5)
    assert np.allclose(big["y"], 1e6 * t, atol=70.0)
    assert np.allclose(last["y"], tiny, rtol=1e-4, atol=0.0), "twelve decades"


def test_every_figure_is_written_as_svg_and_png_with_its_numbers(tmp_path):
    resvg = pytest.importorskip("resvg_py", reason="draws PNG (extra `png`)")
    shown = document()
    written = write_figures(shown, tmp_path / "new")
    (picture, image, numbers) = written.files
    assert written.figures == 1
    assert written.sentence(Path("new")) == "1 figures written to new as SVG, PNG and CSV"
    png = image.read_bytes()
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", png[16:24])
    assert width == 2 * 2 * WIDTH, "two pixels per px"
    assert height > 2 * 2 * 100
    wordless = re.sub("<text.*?</text>", "", picture.read_text())
    without = bytes(resvg.svg_to_bytes(svg_string=wordless, zoom=2.0))
    assert len(_pixels(png)) == len(_pixels(without))
    letters = np.count_nonzero(np.frombuffer(_pixels(png), np.uint8) != np.frombuffer(_pixels(without), np.uint8))
    assert letters > 5000, "a font that is not found leaves a picture without a word"
    svg = ElementTree.parse(picture).getroot()
    assert float(svg.get("width")) == 2 * WIDTH, "three panels, two in a row"
    rows = list(csv.reader(numbers.open()))
    assert rows[0] == ["panel", "x_label", "y_label", "trace", "x", "y", "z"]
    assert [r for r in rows if r[0] == "map"][1][4:] == ["2.0", "a_x", "nan"]
    assert len([r for r in rows if r[3] == "measured"]) == T.size
    two = Choice(
        "response", "response", (("a/b r1", shown.sections[0].blocks[-1]), ("c", shown.sections[0].blocks[-1]))
    )
    both = Document("t", "v", sections=(Section("s", "S", (two,)),))
    assert [p.name for p in write_figures(both, tmp_path).files][::3] == ["response-a_b_r1.svg", "response-c.svg"]
    page = html.page_of(both)
    assert page.count("<option>") == page.count("<figure data-figure") == 2


def test_commands_in_prose_are_set_as_code():
    page = html.page_of(Document("t", "v", sections=(Section("s", "S", (Paragraph("run `flighttest <x>` now"),)),)))
    assert "<code>flighttest &lt;x&gt;</code>" in page


def test_plotly_accepts_every_panel():
    colours = re.compile(r'"@heat"')
    for panel in figures.specification(document().sections[0].blocks[-1])["panels"]:
        text = colours.sub('[[0,"#fff"],[1,"#000"]]', json.dumps(panel))
        go.Figure(json.loads(re.sub(r'"@\w+"', '"#123456"', text)))


def test_the_page_has_a_colour_for_every_role():
    script = (Path(figures.__file__).parent / "figures.js").read_text()
    from typing import get_args

    from flighttest.report.document import Role

    for role in get_args(Role):
        assert len(re.findall(rf"\b{role}: \"#", script)) == 2, role  # light and dark


@pytest.mark.parametrize("width", [50, 80, 140])
def test_the_terminal_keeps_its_width(width):
    out = io.StringIO()
    Console(file=out, width=width, color_system=None).print(terminal.render(document()))
    lines = out.getvalue().splitlines()
    assert max(len(line.rstrip()) for line in lines) <= width
    text = out.getvalue()
    assert "the verdict" in text
    assert "... 28 more rows: --all shows them, --csv DIR writes them" in " ".join(text.split())
    assert "39" in drawn(document(), width, everything=True).split()


@pytest.mark.parametrize("width", [40, 80, 120])
@pytest.mark.parametrize("columns", [2, 7, 19])
def test_no_table_loses_a_column_or_cuts_a_heading(width, columns):
    heads = tuple(f"heading{i} of{i}" for i in range(columns))
    rows = tuple(tuple(f"{'word ' * (i % 4)}cell{i}x{r}" for i in range(columns)) for r in range(3))
    align = tuple("right" if i % 3 == 1 else "left" for i in range(columns))
    wide = Document("t", "v", sections=(Section("s", "S", (Table(heads, rows, align, detail=(1,)),)),))
    assert troubles(wide, width) == []
    shown = drawn(wide, width, everything=True).split()
    assert all(f"cell{i}x{r}" in shown for i in range(columns) for r in range(3))
    assert "heading1" not in drawn(wide, width).replace("columns heading1 of1", "").split()


def test_a_heading_that_is_cut_is_seen(monkeypatch):
    wide = Document("t", "v", sections=(Section("s", "S", (Table(("name", "a long heading"), (("x", "1"),)),)),))
    monkeypatch.setattr(terminal, "width_shared", lambda spans, available: dict.fromkeys(spans, 4))
    assert any("cut" in words for words in troubles(wide, 80))


def test_a_sentence_stands_for_a_long_block_unless_everything_is_asked_for():
    table = Table(("effect", "why"), (("wind", "still air"),), brief="One effect could not be seen: wind.")
    code = Code("format: maneuver/1\nname: next", "the script", "--all shows the script.")
    made = Document("d", "v", sections=(Section("s", "Limits", (table, code)),))
    short, whole = (drawn(made, 80, everything=e) for e in (False, True))
    assert "One effect could not be seen: wind." in short
    assert "--all shows the script." in short
    assert "still air" not in short
    assert "maneuver/1" not in short
    assert "still air" in whole
    assert "maneuver/1" in whole
    assert "could not be seen" not in whole


def test_every_table_is_written_whole_as_csv_and_parquet(tmp_path):
    table = Table(
        ("name", "value", ""), (("K", Cell("54.6", "good", "m/s^2"), "yes"), ("a,b", "-", "")), detail=(2,), fold=True
    )
    numbers = Table(("n", "n"), (("1", "2"), ("3", "-")))
    shown = Document("t", "v", sections=(Section("found", "S", (table, numbers)),))
    assert [p.name for p in write_tables(shown, tmp_path / "new", "csv")] == ["found.csv", "found-2.csv"]
    lines = (tmp_path / "new" / "found.csv").read_text().splitlines()
    assert lines == ["name,value,note", "K,54.6 m/s^2,yes", '"a,b",-,']
    write_tables(shown, tmp_path, "parquet")
    read = pq.read_table(tmp_path / "found-2.parquet").to_pydict()
    assert read == {"n": [1.0, 3.0], "n 2": [2.0, None]}


def test_plain_json_has_no_nan_and_keeps_enum_names():
    class Colour(Enum):
        RED = "is a sentence"

    @dataclass
    class Thing:
        a: float
        b: np.ndarray
        c: Colour
        f: object = print

    data = plain(Thing(float("nan"), np.array([1.0, np.inf]), Colour.RED))
    assert data == {"a": None, "b": [1.0, None], "c": "RED"}
    json.dumps(data, allow_nan=False)


def test_a_long_command_keeps_the_indent_of_its_lines_and_goes_on_deeper():
    command = "flighttest twin demo/model.yaml \\\n    --replay demo/spot_check --set battery=-1"
    page = Document("t", "v", "plain", (Section("next", "Next", (Code(command),)),))

    def lines(width):
        console = Console(width=width, file=io.StringIO())
        console.print(terminal.render(page))
        return [
            line.rstrip() for line in console.file.getvalue().splitlines() if line.startswith("  ") and line.strip()
        ]

    assert lines(80) == ["  flighttest twin demo/model.yaml \\", "      --replay demo/spot_check --set battery=-1"]
    assert lines(40) == [
        "  flighttest twin demo/model.yaml \\",
        "      --replay demo/spot_check --set \\",
        "        battery=-1",
    ]


def test_a_page_carries_no_program_for_street_maps():
    """It was a tenth of every report, which took one of 116 responses beyond 2 MB."""
    whole, own = get_plotlyjs(), plotly_without_maps()
    assert len(own) < 0.95 * len(whole)
    assert own.count("Plotly") == whole.count("Plotly")


def test_what_is_to_be_copied_stays_whole():
    """A path longer than the line was broken within by the program: what was copied from it was two words."""
    path = "/data/" + "x" * 90 + "/model.yaml"
    run = f"flighttest run {path} --vehicle vehicle.yaml --connect udpin:0.0.0.0:14550 --set-params"
    blocks = (
        Bullets((f"Say more, then fly again with `{run}`, which asks for more than one line of a terminal.",)),
        Facts((("model", path), ("next", run), ("short", "flighttest status"))),
        Code("terms: [body]\nname: " + "y " * 60),
    )
    text = drawn(
        Document("t", "v", facts={"run": path, "why": "word " * 30}, sections=(Section("s", "S", blocks),)), 80
    )
    lines = [line.rstrip() for line in text.splitlines()]
    assert text.count(path) == 4
    assert "name: " + ("y " * 60).strip() in lines
    assert "short  flighttest status" in lines
    joined = " ".join(" ".join(lines).replace("\\ ", "").split())
    assert joined.count(run) == 2, "the shell joins what ends in a backslash"
    assert all(len(line) <= 80 for line in lines if path not in line and "y y" not in line)


@pytest.mark.parametrize("width", range(40, 121, 5))
def test_a_name_with_spaces_is_not_broken_where_it_is_quoted(width):
    """`--resume 'v \\` and `r/2026-...'` on the next line: what was pasted named no folder."""
    words = [
        "flighttest",
        "run",
        "--resume",
        "my  flights/2026-11-28T20-33-57-roll_pitch",
        "it's",
        "--set-params",
        "--waive",
        "fence",
    ]
    command = shlex.join(words)
    text = drawn(
        Document("t", "v", sections=(Section("s", "S", (Bullets((f"31 steps are missing: `{command}` flies.",)),)),)),
        width,
    )
    pasted = text.split("`")[1]
    assert shlex.split(pasted.replace("\\\n", "")) == words


def test_the_first_two_sentences_of_the_verdict_are_large():
    page = html.page_of(Document("t", "One is 1.5 m. Two is so. 3 follow. And more."))
    assert '<div class="verdict plain" role="status">One is 1.5 m. Two is so.<p>3 follow. And more.</p></div>' in page


def test_a_narrow_page_breaks_names_and_no_units():
    table = Table(("a", "b"), (("heading_rate_reference", "1.2 rad/s"), ("a_b<c_dd>", "x")))
    page = html.page_of(Document("t", "v", sections=(Section("s", "", (table,)),)))
    assert ">heading_<wbr>rate_<wbr>reference<" in page
    assert ">1.2 rad/s<" in page
    assert "a_b&lt;c_<wbr>dd&gt;" in page


def barred(second):
    bars = (
        Trace(["a", "b"], [1.0, np.nan], "one", "before", "bars"),
        Trace(["a", "b"], second, "two", "after", "bars"),
    )
    return Figure("bars", (Panel("p", "", "y", bars),), "c")


def test_bars_stand_side_by_side_only_where_they_share_a_place():
    modes = [figures.specification(barred(y))["panels"][0]["layout"]["barmode"] for y in ([2.0, 1.0], [np.nan, 1.0])]
    assert modes == ["group", "overlay"]
    assert {e["dash"] for e in figures.specification(barred([1.0, 1.0]))["legend"]} == {"solid"}


def test_bars_and_error_bars_are_drawn_over_names_in_svg():
    svg = as_svg(barred([2.0, 1.0]))
    boxes = list(ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}rect"))[1:]
    heights = [float(r.get("height")) for r in boxes]
    assert len(boxes) == 3
    assert heights[1] == pytest.approx(2 * heights[0], rel=0.01)
    assert ">a</text>" in svg
    assert ">b</text>" in svg
    spread = Trace(["a", "b"], [0.0, 1.0], "one", "other", "errorbars", spread=np.array([5.0, np.nan]))
    svg = as_svg(Figure("f", (Panel("p", "", "y", (spread,)),), "c"))
    assert svg.count("<circle") == 2
    assert svg.count(f'stroke="{LIGHT["other"]}"/>') == 1


def test_a_logarithmic_axis_writes_its_numbers_in_full():
    def ticks(high):
        line = Trace([0.3, high], [1.0, 2.0], "l", "model")
        return figures.specification(Figure("f", (Panel("p", "f, Hz", "y", (line,), log="x"),), "c"))["panels"][0][
            "layout"
        ]["xaxis"]

    assert {"0.5", "1", "2", "5", "10"} <= set(ticks(20.0)["ticktext"])
    assert "5" not in ticks(1e5)["ticktext"]
    assert "100" in ticks(1e5)["ticktext"]


def test_a_tooltip_names_every_variable_with_its_unit():
    heat = Trace(["roll step"], ["velocity up"], "noise floors", "other", "heat", z=[[2.0]])
    track = Trace([0.0], [1.0], "height, m", "model", "track", z=[5.0])
    line = Trace([0.0], [1.0], "measured", "measured")
    bars = Trace(["roll"], [1.0], "twin", "before", "bars")
    panels = (
        Panel("where", "", "", (heat,)),
        Panel("map", "east, m", "north, m", (track,)),
        Panel("roll", "time, s", "roll, rad", (line,)),
        Panel("error", "", "noise floors", (bars,)),
    )
    shown = [p["data"][0]["hovertemplate"] for p in figures.specification(Figure("f", panels, "c"))["panels"]]
    assert [text.removesuffix("<extra></extra>") for text in shown] == [
        "%{y}, %{x}<br><b>%{z:.3g}</b> %{fullData.name}",
        "east %{x:.4g} m<br>north %{y:.4g} m<br>height %{marker.color:.4g} m",
        "<b>%{fullData.name}</b><br>time %{x:.4g} s<br>roll %{y:.4g} rad",
        "<b>%{fullData.name}</b><br>%{x}<br>noise floors %{y:.4g}",
    ]


def test_a_terminal_shows_the_first_rows_and_all_of_them_where_asked():
    table = Table(("n",), tuple((f"row {i}",) for i in range(9)), caption="why", brief_rows=4)
    first, omitted = (
        Section("s", "First", (table,)),
        Section("o", "Omitted", (Table(("n",), (("x",),), brief=OMITTED),)),
    )
    page = Document("t", "v", "good", (first, omitted))
    consoles = [Console(width=80, file=io.StringIO()) for _ in range(2)]
    for console, whole in zip(consoles, (False, True), strict=True):
        console.print(terminal.render(page, whole))
    shown, everything = (console.file.getvalue().strip() for console in consoles)
    assert [word in shown for word in ("row 3", "row 4", "5 more rows")] == [True, False, True]
    assert "omitted" in shown.splitlines()[-1]
    assert [word in everything for word in ("row 8", "more row")] == [True, False]
