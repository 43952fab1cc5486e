"""Words of the command line to values."""

import pytest

from flighttest.cli.words import seconds
from flighttest.errors import InputError


def test_seconds_are_sorted_and_given_once():
    assert seconds("1,0.01,0.5,1") == (0.01, 0.5, 1.0)
    assert seconds(None) == ()


@pytest.mark.parametrize("word", ["", "0,1", "fast", "1,,2", "1e9", "nan"])
def test_what_is_no_time_is_refused(word):
    with pytest.raises(InputError, match="horizons"):
        seconds(word)
