"""Numbers and lists in sentences."""

from flighttest.report.numbers import interval, join_some


def test_many_words_in_a_sentence_are_counted():
    assert join_some(["a", "b", "c"], 2) == "a, b and c", "one more is said by its name"
    assert join_some(list("abcdefgh")) == "a, b, c, d, e and 3 more"


def test_the_ends_of_an_interval_have_the_decimals_of_its_width():
    """The drop of an error was "-5.81e-05 to 0.230"."""
    assert interval(-5.81e-05, 0.230, 0.06) == "0.000 to 0.230"
    assert interval(6.84e-05, 1.08e-04, 1e-05) == "0.000068 to 0.000108"
