"""A recording of a real autopilot and its fit, made once."""

import pytest

import flighttest as ft


@pytest.fixture(scope="session")
def log_file(repository):
    return repository / "tests" / "data" / "sitl_roll_pitch.tlog.xz"


@pytest.fixture(scope="session")
def log(log_file):
    return ft.read(log_file)


@pytest.fixture(scope="session")
def fitted(log):
    return ft.fit(log)
