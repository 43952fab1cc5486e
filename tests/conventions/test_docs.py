"""Prose that can be computed is computed: the generated parts of the docs are current."""

import html
import importlib.util
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
import yaml


def loaded(path):
    """A program of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def generate(repository):
    return loaded(repository / "docs" / "generate.py")


def test_generated_docs_are_current(generate):
    assert generate.stale() == [], "run make docs"


@pytest.fixture(scope="module")
def term_figures(repository):
    return loaded(repository / "docs" / "term_figures.py")


def numbers_of(caption):
    """Residual without the term, with it, and noise floor, as a figure's caption has them."""
    found = re.search(r"residual ([\d.]+) .* without the term, ([\d.]+) with it, noise floor ([\d.]*\d)", caption)
    return [float(number) for number in found.groups()]


def test_every_term_has_a_figure_in_which_its_absence_shows(generate, term_figures):
    assert {p.stem for p in term_figures.FOLDER.glob("*.svg")} == set(term_figures.catalogue())
    for term_id in term_figures.catalogue():
        without, with_term, floor = numbers_of(generate.figure_caption(term_id))
        shows = without - with_term > term_figures.SHOWS * floor
        assert shows, term_id
        assert (term_figures.FOLDER / f"{term_id}.svg").stat().st_size < 20_000


def test_a_figure_is_what_the_program_draws(generate, term_figures):
    drawn = term_figures.draw(term_figures.catalogue()["heading_hold"])
    again = drawn.split("<title>")[1].split("</title>")[0]
    kept = generate.figure_caption("heading_hold")
    assert again.partition("residual")[0] == kept.partition("residual")[0]
    assert numbers_of(again) == pytest.approx(numbers_of(kept), rel=0.2)


def test_a_figure_compares_both_fits_on_one_response(term_figures, monkeypatch):
    """A fit with a coupling takes two axes together, so that its responses come in another order than those of the fit without."""

    def responses(*offsets):
        t = np.arange(5.0)
        return [
            SimpleNamespace(
                name=f"run: {offset}",
                channels=(SimpleNamespace(channel="v", measured=t + offset, simulated=t + offset - error, floor=0.01),),
            )
            for offset, error in offsets
        ]

    of = {"without": responses((0.0, 0.1), (9.0, 0.2)), "with": responses((9.0, 0.0), (0.0, 0.0))}
    monkeypatch.setattr(term_figures, "fitted_responses", of.get)
    name, before, after = term_figures.most_different("without", "with")
    assert name == "9.0"
    assert np.array_equal(before.measured, after.measured)


def test_the_check_sees_a_stale_page(generate, tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "DOCS", tmp_path)
    (tmp_path / "terms.md").write_text("<!-- generated: terms -->\nold\n<!-- end -->\n")
    assert generate.stale() == ["cli.md", "finding_things.md", "flight_states.svg", "glossary.md", "terms.md"]


def test_every_command_has_help_and_json(generate):
    for name, command in generate.cli.commands.items():
        assert command.help, name
        assert any("--json" in option.opts for option in command.params), name


def commands_of(text):
    """Words of every `flighttest ...` in code, up to what a shell would take for another command."""
    code = [*re.findall(r"```\w*\n(.*?)```", text, re.DOTALL), *re.findall(r"`(flighttest [^`\n]+)`", text)]
    lines = [line.strip().removeprefix("$ ") for block in code for line in block.replace("\\\n", " ").splitlines()]
    return [re.split(r" [|#>] ", line)[0].split()[1:] for line in lines if line.startswith("flighttest ")]


def wrong_in(words, commands):
    """What is wrong with a command line of the docs, '' where nothing is."""
    if not words or words[0].startswith("-") or words[0].isupper():
        return ""
    if words[0] not in commands:
        return f"there is no command {words[0]}"
    known = {o for p in commands[words[0]].params for o in p.opts} | {"--help", "-h"}
    unknown = [w for w in words if w.startswith("-") and re.match(r"--?[a-z]", w) and w.rstrip(".,;:)") not in known]
    return f"{words[0]} has no {' '.join(unknown)}" if unknown else ""


def test_commands_in_the_docs_exist_with_their_options(generate, repository):
    pages = [p for p in (repository / "docs").glob("*.md") if p.name != "cli.md"]
    tried = [
        (page.name, words) for page in [*pages, repository / "README.md"] for words in commands_of(page.read_text())
    ]
    assert len(tried) > 60
    found = [
        f"{page}: {' '.join(words)}: {why}" for page, words in tried if (why := wrong_in(words, generate.cli.commands))
    ]
    assert not found


def test_the_check_sees_commands_that_do_not_exist(generate):
    assert wrong_in(["fitt", "x"], generate.cli.commands)
    assert wrong_in(["fit", "x", "--nope"], generate.cli.commands)
    assert commands_of("a `flighttest fit x` b\n```\n$ flighttest show y | tail\n```") == [["show", "y"], ["fit", "x"]]


def test_every_page_is_in_the_site_and_says_the_version_that_is(repository):
    site = yaml.safe_load((repository / "mkdocs.yml").read_text())
    pages = [v for entry in site["nav"] for v in entry.values()]
    named = {p for v in pages for p in ([v] if isinstance(v, str) else [q for one in v for q in one.values()])}
    assert named == {p.name for p in (repository / "docs").glob("*.md")}
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    assert yaml.safe_load((repository / "CITATION.cff").read_text())["version"] == project["version"]
    install = (repository / "docs" / "install.md").read_text()
    for dependency in project["dependencies"]:
        assert re.split(r"[<>=]", dependency)[0] in install, "docs/install.md explains what each dependency is for"


def test_a_page_of_the_site_loads_nothing_from_the_network(repository):
    hooks = loaded(repository / "docs" / "site_hooks.py")
    page = f'<script src="{hooks.ASKED}"></script><a href="https://ardupilot.org">ArduPilot</a><img src="demo.svg">'
    assert hooks.without_network(page, "page") == page.replace(hooks.ASKED, "search_worker.js")
    assert (repository / "docs" / "search_worker.js").is_file()
    for tag in (
        '<script src="https://x.org/a.js">',
        "<script async src=https://x.org/a.js>",
        '<link rel="stylesheet" href="//x.org/a.css">',
        '<img alt="" src="http://x.org/a.png">',
    ):
        assert hooks.LOADS.search(page.replace(hooks.ASKED, "a.js") + tag)[0] == tag
    assert "docs/site_hooks.py" in yaml.safe_load((repository / "mkdocs.yml").read_text())["hooks"]


def test_the_drawing_of_the_flight_has_every_change(repository):
    figures = loaded(repository / "docs" / "state_figures.py")
    drawn = figures.flight_states()
    boxes = {b.split("</text>")[0].split(">")[-1]: html.unescape(b) for b in drawn.split("<g")[1:]}
    arrows = [html.unescape(text) for text in re.findall(r'class="event"[^>]*>([^<]*)', drawn)]
    for (state, event), following in figures.TABLE.items():
        if state.is_end or following is None or following.state is state:
            continue
        ends = re.sub(r"<[^>]*>", " ", boxes[state.name])
        assert event.name in ends if following.state.is_end else any(event.name in arrow for arrow in arrows)
        assert not following.state.is_end or f"> {following.state.name}" in ends
    with pytest.raises(ValueError, match="no place in the drawing for A"):
        figures.drawing("", {}, {("A", "B"): ("C",)}, "A")


def test_a_wide_table_of_the_site_has_room_and_what_is_folded_is_read(repository):
    hooks = loaded(repository / "docs" / "site_hooks.py")
    narrow, wide = (
        "| a |" + " b |" * n + "\n|---|" + "---|" * n + "\n| c |" + " LINK_LOST, NOT_ARMED |" * n for n in (3, 8)
    )
    assert not hooks.has_wide_table(narrow)
    assert hooks.has_wide_table(wide)
    page = SimpleNamespace(meta={})
    assert hooks.on_page_markdown(f"<details>{wide}", page, None, None).startswith('<details markdown="1">')
    assert page.meta == {"hide": ["toc"]}
    assert "md_in_html" in yaml.safe_load((repository / "mkdocs.yml").read_text())["markdown_extensions"]
    assert hooks.breakable("<td>LINK_LOST</td><p>LINK_LOST</p>") == "<td>LINK_<wbr>LOST</td><p>LINK_LOST</p>"


def test_modules_that_the_docs_name_exist(repository):
    package = repository / "flighttest"
    packages = {folder.name for folder in package.iterdir() if folder.is_dir()}
    pages = [*sorted((repository / "docs").glob("*.md")), *sorted(repository.glob("*.md"))]
    gone = [
        f"{page.name}: {named}"
        for page in pages
        for named in re.findall(r"`(?:flighttest/)?([a-z_]+(?:/[a-z_]+)+)(?:\.py)?`", page.read_text(encoding="utf-8"))
        if named.split("/")[0] in packages and not ((package / named).exists() or (package / f"{named}.py").exists())
    ]
    assert gone == []


def test_lists_within_lists_are_indented_as_the_site_needs_it(repository):
    """Python-Markdown takes fewer than four spaces for the outer list."""
    pages = sorted((repository / "docs").glob("*.md"))
    shallow = [
        f"{page.name}:{number}"
        for page in pages
        for number, line in enumerate(
            re.sub(r"```.*?```", _blank, page.read_text(encoding="utf-8"), flags=re.S).split("\n"), 1
        )
        if re.match(r" {1,3}([-*]|\d+\.) ", line)
    ]
    assert shallow == []


def _blank(match: re.Match[str]) -> str:
    return "\n" * match.group().count("\n")
