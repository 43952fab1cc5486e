"""The campaign and its fit that the tests of `identify` share."""

from tests.identify.conftest import flown, found

__all__ = ["flown", "found"]
