"""What every test may ask for: the real recordings beside the repository, and a real ArduPilot SITL. Both skip with a reason."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from flighttest.cli import durations
from flighttest.errors import FlighttestError
from flighttest.pipeline.results import Result
from flighttest.sim.sitl.launcher import find_arducopter
from tests.widths import troubles

REPOSITORY = Path(__file__).resolve().parents[1]

# Where an environment forbids bytecode, every worker compiles all modules and tests anew, and so does every program that a test starts.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_sessionstart() -> None:
    """Ctrl-C and a closed terminal are tested: where a shell runs the suite in its background, or `nohup` does, their signals are
    ignored by it and all it starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def find_shared_data() -> Path | None:
    """The folder of real recordings: FLIGHTTEST_DATA, or ../shared/data beside the repository."""
    for candidate in (os.environ.get("FLIGHTTEST_DATA"), REPOSITORY.parent / "shared" / "data"):
        if candidate and Path(candidate).is_dir():
            return Path(candidate)
    return None


def sitl_binary() -> str | None:
    """An `arducopter` binary, found as the launcher finds it."""
    try:
        return str(find_arducopter())
    except FlighttestError:
        return None


@pytest.fixture(autouse=True, scope="session")
def every_answer_fits_a_terminal() -> Iterator[None]:
    """The document of every result that any test makes is drawn at 80 and 120 columns: no heading cut, no line too long."""
    made = Result.__init__

    def checked(self: Result, *args: object, **options: object) -> None:
        made(self, *args, **options)
        found = [words for width in (80, 120) for words in troubles(self.document, width)]
        assert not found, found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Result, "__init__", checked)
        yield


@pytest.fixture(autouse=True, scope="session")
def nothing_is_kept_in_the_users_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """How long stages take is remembered in a folder of the session."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(durations, "default_path", lambda: folder / "durations.json")
        patch.setattr("flighttest.cli.live.default_path", lambda: folder / "durations.json")
        yield


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the source tree."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real recordings that may not be copied into the repository."""
    folder = find_shared_data()
    if folder is None:
        pytest.skip("real recordings are not here: set FLIGHTTEST_DATA or place them in ../shared/data")
    return folder


@pytest.fixture(scope="session")
def arducopter() -> str:
    """Path of a real ArduCopter SITL binary."""
    binary = sitl_binary()
    if binary is None:
        pytest.skip("no arducopter found: set ARDUCOPTER or put it on PATH (see sitl/README.md)")
    return binary


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked `sitl` are skipped with a reason where no arducopter is found."""
    if not any(item.get_closest_marker("sitl") for item in items) or sitl_binary() is not None:
        return
    skip = pytest.mark.skip(reason="no arducopter found: set ARDUCOPTER or put it on PATH (see sitl/README.md)")
    for item in items:
        if item.get_closest_marker("sitl"):
            item.add_marker(skip)
