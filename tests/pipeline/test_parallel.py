"""Work in several processes: the same results in the same order, and what fails there fails here with its own words."""

import os
import time
from concurrent.futures import Future

import pytest

from flighttest.errors import FitError
from flighttest.pipeline.parallel import in_parallel

HERE = os.getpid()


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel.usable_processes", lambda: 2)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_are_those_of_the_items_in_order(two_cores, count):
    done = in_parallel(lambda some: [(10 * i, os.getpid()) for i in some], range(count), [1] * count)
    assert [value for value, _ in done] == [10 * i for i in range(count)]
    assert len({pid for _, pid in done}) == min(count, 2), "one alone is not worth a second process"


def test_the_parts_are_of_like_size(two_cores):
    sizes = [5, 1, 1, 1, 1, 1]
    done = in_parallel(lambda some: [os.getpid() for _ in some], range(6), sizes)
    assert [pid == done[0] for pid in done] == [True, False, False, False, False, False]


def test_every_core_gets_a_part(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel.usable_processes", lambda: 3)

    def work(some):
        time.sleep(0.3)
        return [os.getpid() for _ in some]

    done = in_parallel(work, range(3), [1, 1, 1])
    assert HERE in done
    assert len(set(done)) == 3


def test_without_a_second_core_nothing_is_begun(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel.usable_processes", lambda: 1)
    assert set(in_parallel(lambda some: [os.getpid() for _ in some], range(4), [1] * 4)) == {HERE}


def test_what_dies_there_is_done_here(two_cores):
    def work(some):
        if os.getpid() != HERE:
            os._exit(1)
        return [i * i for i in some]

    assert in_parallel(work, range(5), [1] * 5) == [0, 1, 4, 9, 16]


def test_what_fails_fails_with_its_own_words(two_cores, capfd):
    def work(some):
        if 3 in some:
            raise FitError("step 3 does not fit", "make it shorter")
        return list(some)

    with pytest.raises(FitError, match="step 3 does not fit"):
        in_parallel(work, range(5), [1] * 5)
    assert capfd.readouterr() == ("", "")


def test_no_process_is_left_behind(two_cores, tmp_path):
    def work(some):
        if os.getpid() == HERE:
            raise FitError("here", "")
        (tmp_path / "pid").write_text(str(os.getpid()))
        return list(some)

    with pytest.raises(FitError):
        in_parallel(work, range(5), [1] * 5)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_where_no_process_can_be_copied_the_work_is_done_here(monkeypatch):
    monkeypatch.setattr("flighttest.pipeline.parallel.get_all_start_methods", lambda: ["spawn"])
    assert set(in_parallel(lambda some: [os.getpid() for _ in some], range(4), [1] * 4)) == {HERE}


@pytest.fixture
def interrupted_while_waiting(monkeypatch):
    """Ctrl-C while a copy is waited for. It is not sent: where tests run in a second thread it would hit the first."""
    pending, result = [KeyboardInterrupt], Future.result

    def interrupted(future, timeout=None):
        if pending:
            raise pending.pop()
        return result(future, timeout)

    monkeypatch.setattr(Future, "result", interrupted)


def test_an_interrupt_while_waiting_takes_what_the_copy_still_shows(two_cores, interrupted_while_waiting):
    assert in_parallel(lambda some: [-i for i in some], [1, 2], [1, 1]) == [-1, -2]


def test_an_interrupt_after_the_copy_has_ended_takes_what_it_has_shown(two_cores, interrupted_while_waiting):
    """It lost all of it, where the copy was the faster one."""

    def work(some):
        time.sleep(0.5 if os.getpid() == HERE else 0.0)
        return [-i for i in some]

    assert in_parallel(work, [1, 2], [1, 1]) == [-1, -2]


def test_an_interrupt_that_ends_the_copy_ends_all(two_cores, interrupted_while_waiting):
    def work(some):
        if os.getpid() != HERE:
            time.sleep(0.2)
            raise KeyboardInterrupt
        return list(some)

    with pytest.raises(KeyboardInterrupt):
        in_parallel(work, [1, 2], [1, 1])
