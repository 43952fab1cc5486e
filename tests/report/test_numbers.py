"""Numbers and lists in sentences."""

from flighttest.report.numbers import join_some


def test_many_words_in_a_sentence_are_counted():
    assert join_some(["a", "b", "c"], 2) == "a, b and c", "one more is said by its name"
    assert join_some(list("abcdefgh")) == "a, b, c, d, e and 3 more"
