"""Work in two processes: the same results in the same order, and what fails there fails here with its own words."""

import os

import pytest

from flighttest.errors import FitError
from flighttest.pipeline.parallel import in_halves

HERE = os.getpid()


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel._second_core", lambda: True)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_are_those_of_the_items_in_order(two_cores, count):
    done = in_halves(lambda some: [(10 * i, os.getpid()) for i in some], range(count), [1] * count)
    assert [value for value, _ in done] == [10 * i for i in range(count)]
    assert len({pid for _, pid in done}) == min(count, 2), "one alone is not worth a second process"


def test_the_halves_are_of_like_size(two_cores):
    sizes = [5, 1, 1, 1, 1, 1]
    done = in_halves(lambda some: [os.getpid() for _ in some], range(6), sizes)
    assert [pid == done[0] for pid in done] == [True, False, False, False, False, False]


def test_without_a_second_core_nothing_is_begun(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel._second_core", lambda: False)
    assert set(in_halves(lambda some: [os.getpid() for _ in some], range(4), [1] * 4)) == {HERE}


def test_what_dies_there_is_done_here(two_cores):
    def work(some):
        if os.getpid() != HERE:
            os._exit(1)
        return [i * i for i in some]

    assert in_halves(work, range(5), [1] * 5) == [0, 1, 4, 9, 16]


def test_what_fails_fails_with_its_own_words(two_cores, capfd):
    def work(some):
        if 3 in some:
            raise FitError("step 3 does not fit", "make it shorter")
        return list(some)

    with pytest.raises(FitError, match="step 3 does not fit"):
        in_halves(work, range(5), [1] * 5)
    assert capfd.readouterr() == ("", "")


def test_no_process_is_left_behind(two_cores, monkeypatch):
    begun, fork = [], os.fork
    monkeypatch.setattr(os, "fork", lambda: begun.append(fork()) or begun[-1])

    def work(some):
        if os.getpid() == HERE:
            raise FitError("here", "")
        return list(some)

    with pytest.raises(FitError):
        in_halves(work, range(5), [1] * 5)
    with pytest.raises(ProcessLookupError):
        os.kill(begun[0], 0)


@pytest.fixture
def interrupted_while_waiting(monkeypatch):
    """Ctrl-C while the copy is waited for. It is not sent: where tests run in a second thread it would hit the first."""
    pending, read = [KeyboardInterrupt], os.read

    def interrupted(pipe, size):
        if pending:
            raise pending.pop()
        return read(pipe, size)

    monkeypatch.setattr(os, "read", interrupted)


def test_an_interrupt_while_waiting_takes_what_the_copy_still_tells(two_cores, interrupted_while_waiting):
    assert in_halves(lambda some: [-i for i in some], [1, 2], [1, 1]) == [-1, -2]


def test_an_interrupt_that_ends_the_copy_ends_all(two_cores, interrupted_while_waiting):
    def work(some):
        if os.getpid() != HERE:
            raise KeyboardInterrupt
        return list(some)

    with pytest.raises(KeyboardInterrupt):
        in_halves(work, [1, 2], [1, 1])
