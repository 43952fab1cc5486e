"""Synthetic flights, made once."""

import importlib.util
from pathlib import Path

import pytest

from flighttest.cli import main as cli_main

THROTTLE_S = (88.0, 125.0)  # of the synthetic flight


def _module():
    spec = importlib.util.spec_from_file_location("synthetic", Path(__file__).with_name("synthetic.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def synthetic():
    """The module that makes flights."""
    return _module()


@pytest.fixture(scope="session")
def flight_csv(synthetic, tmp_path_factory):
    """A flight of the paper's vehicle as a plain table."""
    return synthetic.write_csv(tmp_path_factory.mktemp("flight") / "flight.csv")


@pytest.fixture(scope="session")
def worn_csv(synthetic, tmp_path_factory):
    """The same vehicle with 6 % less thrust."""
    return synthetic.write_csv(tmp_path_factory.mktemp("worn") / "worn.csv", seed=1, gain=0.94)


@pytest.fixture
def throttle_steps(tmp_path):
    """The throttle steps of a flight as a table of their own."""

    def cut(path):
        lines = path.read_text().splitlines()
        kept = [line for line in lines[1:] if THROTTLE_S[0] < float(line.split(",")[0]) < THROTTLE_S[1]]
        made = tmp_path / path.name
        made.write_text("\n".join([lines[0], *kept]))
        return made

    return cut


@pytest.fixture
def call(capsys):
    """Run a command line: its exit code, standard output and standard error."""

    def run(*argv):
        code = cli_main.call([str(a) for a in argv])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run
