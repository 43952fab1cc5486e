"""The bare client, as a fixture: tests of this folder are no package."""

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def bare():
    """The module `client` beside this file."""
    spec = importlib.util.spec_from_file_location("sim_client", Path(__file__).with_name("client.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
