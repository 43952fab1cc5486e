"""The transcripts of docs/look.md are what the program prints: exactly where that is cheap, in their stable parts where it is a flight."""

import importlib.util
import re

import pytest

from flighttest.physics.model import Model
from flighttest.pipeline import demo
from flighttest.pipeline.flights import run as flying
from flighttest.sim import parse_hide


@pytest.fixture(scope="module")
def transcript(repository):
    spec = importlib.util.spec_from_file_location("docs_transcript", repository / "docs" / "transcript.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def text(repository):
    return (repository / "docs" / "look.md").read_text(encoding="utf-8")


def test_the_check_transcript_is_what_check_prints(transcript, text, tmp_path):
    (command,) = [c for c in transcript.commands_in(text) if " check " in c]
    printed = transcript.outputs_of([command], tmp_path)[command]
    assert transcript.shown(text, command) == printed, "run: python docs/transcript.py check"


def test_the_flight_transcript_is_current_in_its_stable_parts(transcript, text):
    (command,) = [c for c in transcript.commands_in(text) if " run " in c]
    shown = transcript.shown(text, command).splitlines()
    scripts = command.split()[2:]
    assert shown[0] == flying.announce(flying.FlightRequest(tuple(scripts)))
    flown = [line for line in shown if re.search(r"\d+ of \d+ steps flown", line)]
    assert [line.split()[2].rstrip(":") for line in flown] == scripts
    table = shown[shown.index("Parameters") + 2 :]
    names = [*Model().names, "T_d"]
    assert [line.split()[0] for line in table[: len(names)]] == names
    assert all(line.rstrip().endswith("known") for line in table[: len(names)])


def test_the_demo_transcript_shows_what_the_demo_hides_and_its_picture_is_small(transcript, text, repository):
    (command,) = [c for c in transcript.commands_in(text) if " demo " in c]
    lines = transcript.shown(text, command).splitlines()
    assert len(lines) == int(command.split()[-1])
    for term, values in parse_hide(demo.HIDE).items():
        for name, truth in values.items():
            (row,) = [line for line in lines if line.startswith(f"{term} {name}")]
            low, high = re.search(r"(\S+) to (\S+)", row).groups()
            assert float(row.split()[2]) == truth
            assert float(low) <= truth <= float(high)
    run = re.search(r"accept (\S+)", "\n".join(lines))[1]
    assert run.endswith(demo.CAMPAIGN[-1])
    assert 1_000 < (repository / "docs" / "demo.svg").stat().st_size < 100_000


def test_the_readme_is_short_and_its_links_and_files_exist(repository):
    text = (repository / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 110
    for target in [*re.findall(r"\]\(([^)#]+)\)", text), *re.findall(r"(?:examples|tests)/[\w./]+", text)]:
        assert (repository / target).exists(), target
