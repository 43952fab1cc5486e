"""Writes what can be computed into the docs: `python docs/generate.py` (or `make docs`); `--check` only compares.

docs/cli.md, glossary.md, finding_things.md and flight_states.svg are wholly generated. In the others, the text between
`<!-- generated: NAME -->` and `<!-- end -->` is.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import click

import flighttest as ft
from flighttest.channels import CHANNELS
from flighttest.cli.main import cli
from flighttest.flight.execution.machine import table_as_markdown, words_as_markdown
from flighttest.link.states import link_as_markdown
from flighttest.physics.catalogue import catalogue
from flighttest.script.load import load_script
from flighttest.script.profiles import PROFILES, Duration, Field
from flighttest.script.shipped import resolve, shipped_names

sys.path.insert(0, str(Path(__file__).resolve().parent))
import state_figures
import words

DOCS = Path(__file__).resolve().parent
BLOCK = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def commands() -> str:
    """docs/cli.md: the help page of every command."""
    parts = [
        "# The command line",
        "",
        "Generated from the program's own help by `make docs`; a test keeps it current.",
        "",
    ]
    context = click.Context(cli, info_name="flighttest", terminal_width=84, help_option_names=["-h", "--help"])
    parts += ["```", cli.get_help(context), "```", ""]
    for name, command in cli.commands.items():
        child = click.Context(command, info_name=name, parent=context, terminal_width=84)
        parts += [f"## flighttest {name}", "", "```", command.get_help(child), "```", ""]
    return "\n".join(parts)


def channels() -> str:
    """The table of measured quantities."""
    rows = [f"| `{c.name}` | {c.unit} | {c.frame} | {c.group} | {c.doc} |" for c in CHANNELS.values()]
    return "\n".join(["| name | unit | frame | group | meaning |", "|---|---|---|---|---|", *rows]) + "\n"


def terms() -> str:
    """The catalogue of physics."""
    rows = [
        f"| `{t.id}` | {t.family} | {t.title} | {', '.join(f'{p.name} ({p.unit})' for p in t.params)} "
        f"| {', '.join(t.hides_in) or 'nothing'} | {t.told_apart_by} | {t.reveals} |"
        for t in catalogue().values()
    ]
    head = [
        "| id | family | what | parameters | hides in | distinguished by | shown by |",
        "|---|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *rows]) + "\n"


def term_pages() -> str:
    """Every term in full, by family."""
    parts: list[str] = []
    terms = sorted(catalogue().values(), key=lambda t: (t.family, t.title))
    for family, members in groupby(terms, key=lambda t: t.family):
        parts += [f"## {family.capitalize()}", ""]
        for t in members:
            where = f"{t.port.name.lower().replace('_', ' ')}: {t.port.value[1]}"
            facts = {"acts at": where, "needs": ", ".join(t.needs), "source": t.source, "doubt": t.doubt}
            rows = [
                f"| `{p.name}` | {p.unit} | {p.kind} | {p.nominal:g} | {p.lower:g} to {p.upper:g} | {p.doc} | {p.source} |"
                for p in t.params
            ]
            parts += [
                f"### `{t.id}`: {t.title}", "", f"{t.plain[0].upper()}{t.plain[1:]}.", "", "```text", t.equation, "```", "",
                *(f"- {name}: {text}" for name, text in facts.items() if text), "",
                f"![{figure_caption(t.id)}](terms/{t.id}.svg)", "", figure_caption(t.id), "",
                "| parameter | unit | kind | nominal | bounds | meaning | where the size is from |",
                "|---|---|---|---|---|---|---|", *rows, "",
            ]  # fmt: skip
    return "\n".join(parts)


def figure_caption(term_id: str) -> str:
    """What the figure of a term shows, as docs/term_figures.py wrote it into the figure."""
    return (DOCS / "terms" / f"{term_id}.svg").read_text(encoding="utf-8").split("<title>")[1].split("</title>")[0]


def maneuvers() -> str:
    """The shipped maneuvers."""
    rows = []
    for name in shipped_names():
        script = load_script(resolve(name))
        cells = sum(len(PROFILES[step.profile].cells(step.settings, 1.0)) for step in script.steps)
        rows.append(
            f"| `{name}` | {script.doc} | {cells * script.repeat.each} | {', '.join(script.identifies) or '-'} |"
        )
    return "\n".join(["| name | what | legs | identifies |", "|---|---|---|---|", *rows]) + "\n"


def profiles() -> str:
    """The kinds of step and their settings."""
    parts = []
    for profile in PROFILES.values():
        rows = [f"| `{f.key}` | {f.doc} | {_range(f)} | {_default(f)} |" for f in profile.fields]
        head = ["| setting | what | allowed | default |", "|---|---|---|---|"]
        parts += [f"### {profile.name}", "", profile.doc[0].upper() + profile.doc[1:] + ".", "", *head, *rows, ""]
    return "\n".join(parts)


def _range(field: Field) -> str:
    if field.choices:
        return ", ".join(field.choices)
    if field.throttle:
        return "a throttle, or several" if field.kind == "numbers" else "a throttle"
    words = {"numbers": ", one or several", "duration": ", or {up_to: seconds}", "points": ", each [x, y, z]"}
    return f"{field.low:g} to {field.high:g} {field.unit}".rstrip() + words.get(field.kind, "")


def _default(field: Field) -> str:
    if field.optional:
        return "left out"
    if field.default is None:
        return "must be given"
    if isinstance(field.default, Duration):
        return f"{{up_to: {field.default.seconds:g}}}" if field.default.up_to else f"{field.default.seconds:g}"
    if isinstance(field.default, tuple):
        return ", ".join(f"{value:g}" for value in field.default)
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default)


def interface() -> str:
    """The public names of the package: verbs in full, types and errors by their first sentence."""
    parts: list[str] = []
    rows = []
    for name in ft.__all__:
        found = getattr(ft, name)
        if inspect.isfunction(found):
            text = inspect.getdoc(found) or ""
            parts += [f"### ft.{name}", "", "```text", f"{name}{_signature(found)}", "```", "", text, ""]
        elif name != "__version__":
            doc = inspect.getdoc(found) or ""
            first = " ".join(doc.split("\n\n")[0].split())
            ours = found.__module__.startswith("flighttest.api") or name in ("Model", "Recording", "Simulated")
            members = [m for m in vars(found) if not m.startswith("_")] if ours and isinstance(found, type) else []
            rows.append(f"| `{name}` | {first} | {', '.join(members)} |")
    return "\n".join([*parts, "| name | what it is | members |", "|---|---|---|", *rows]) + "\n"


def _signature(function: Callable[..., object]) -> str:
    """The parameters with their annotations as written, one per line where they do not fit on one."""
    shown = inspect.signature(function)
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    words: list[str] = []
    for p in shown.parameters.values():
        if p.kind is p.KEYWORD_ONLY and not any(word.startswith("*") for word in words):
            words.append("*")
        default = "" if p.default is p.empty else f" = {p.default!r}"
        words.append(f"{stars.get(p.kind, '')}{p.name}: {p.annotation}{default}")
    text = f"({', '.join(words)}) -> {shown.return_annotation}"
    if len(f"{function.__name__}{text}") <= 84:
        return text
    return "(\n" + "".join(f"    {word},\n" for word in words) + f") -> {shown.return_annotation}"


BLOCKS: dict[str, Callable[[], str]] = {
    "channels": channels,
    "interface": interface,
    "terms": terms,
    "term_pages": term_pages,
    "maneuvers": maneuvers,
    "profiles": profiles,
    "flight_words": words_as_markdown,
    "flight_states": lambda: (
        "![States of a flight](flight_states.svg)\n\nIn each box: the events that end the flight in this state, and the end.\n"
        "An end stays, with two exceptions that the table shows: what was under way to the vehicle at a take-over may arrive after it.\n\n"
        + table_as_markdown()
    ),
    "link_states": link_as_markdown,
}


def glossary() -> str:
    """docs/glossary.md: every concept by its one name."""
    rows = [f"| {e.term} | {e.meaning} | `flighttest/{e.where}` | {e.source} |" for e in words.GLOSSARY]
    return "\n".join(
        [
            "# Glossary",
            "",
            "One name per concept, as in the field's textbooks. Generated from `docs/words.py` by `make docs`; tests hold the code to it:",
            "each term stands in the module that is about it, and words that were replaced do not come back.",
            "",
            "| term | what it is | where | source |",
            "|---|---|---|---|",
            *rows,
            "",
            "Words of the textbooks, to be searched for as they are written here, and the module that is about each:",
            "",
            "| word | where |",
            "|---|---|",
            *(f"| {word} | `flighttest/{where}` |" for word, where in words.SEARCHED),
            "",
            "Where a thing stands in the code: [finding_things.md](finding_things.md).",
            "",
        ]
    )


def finding_things() -> str:
    """docs/finding_things.md: questions of a reader who has never seen the code, and both ways to the module that answers."""
    root = Path(ft.__file__).parent
    parts = [
        "# Finding things",
        "",
        "Thirty questions of a reader who has never seen the code, answered by the listing of folders, or by one search. Generated by",
        "`make docs` from the questions in `docs/words.py`: what a listing leads through is the first sentence of each package and",
        "module, and a test keeps each module among the first four files that the search gives.",
        "",
    ]
    for n, (question, word, where) in enumerate(words.QUESTIONS, 1):
        steps = where.split("/")
        said = [root.joinpath(*steps[:k], "__init__.py") for k in range(1, len(steps))] + [root / where]
        listed = [f"    - `{'/'.join(steps[: k + 1])}`: {_first_sentence(path)}" for k, path in enumerate(said)]
        parts += [f"{n}. **{question}** `flighttest/{where}`", "", "    `ls flighttest`, then:", "", *listed, ""]
        parts += [f'    `grep -rci "{word}" flighttest --include=*.py | sort -t: -k2 -rn | head -4`', ""]
    return "\n".join(parts)


def _first_sentence(path: Path) -> str:
    text = path.read_text(encoding="utf-8").split('"""')[1]
    return " ".join(text.split("\n\n")[0].split())


def pages() -> dict[Path, str]:
    """Every page with generated parts, as it should be."""
    wanted = {
        DOCS / "cli.md": commands(),
        DOCS / "glossary.md": glossary(),
        DOCS / "finding_things.md": finding_things(),
        DOCS / "flight_states.svg": state_figures.flight_states(),
    }
    for page in sorted(DOCS.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if BLOCK.search(text):
            wanted[page] = BLOCK.sub(lambda m: m.group(1) + BLOCKS[m.group(2)]() + m.group(3), text)
    return wanted


def stale() -> list[str]:
    """Names of pages that are not as they should be."""
    return [p.name for p, text in sorted(pages().items()) if not p.is_file() or p.read_text(encoding="utf-8") != text]


def main() -> int:
    """Write the pages, or with --check say which are stale."""
    if "--check" in sys.argv[1:]:
        names = stale()
        if names:
            print(f"stale: {', '.join(names)}; run make docs")
        return 1 if names else 0
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
