"""Clocks that follow a vehicle, and round trips that bound their error, on links that delay and stand still."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from flighttest.link.clock import FollowedClock, GrantedClock, TimeSync
from tests.link.host import Host


def test_the_followed_clock_goes_by_the_least_delayed_stamp_and_never_back() -> None:
    host = Host()
    clock = FollowedClock(host, host)
    for k in range(200):
        t = 50.0 + 0.02 * k - (0.3 if k % 5 else 0.0)
        host.now = 1000.0 + 0.02 * k
        before = clock.now_s()
        clock.heard(t)
        assert clock.now_s() >= before or k == 0
    host.now = 1004.0
    assert clock.now_s() == pytest.approx(54.0, abs=0.01)
    clock.answered(clock.now_s() + 0.05, 0.02)
    assert clock.pace == 1.0
    host.now += 3.0
    assert clock.now_s() == pytest.approx(57.06, abs=0.02)


def test_silence_is_measured_and_a_fast_simulator_keeps_its_pace() -> None:
    host = Host()
    clock = FollowedClock(host, host)
    for k in range(400):
        host.now = 1000.0 + 0.01 * k
        clock.heard(0.1 * k)
    assert clock.pace == pytest.approx(10.0, rel=0.05)
    host.now += 1.0
    assert clock.now_s() == pytest.approx(50.0, rel=0.05)


@pytest.mark.parametrize("pace", [1.0, 4.0])
@pytest.mark.parametrize("paused_s", [0.6, 3.0, 65.0])
@pytest.mark.parametrize("drained_s", [0.0, 0.4, 4.0])
def test_stamps_that_a_pause_of_the_host_held_up_are_no_pace(pace: float, paused_s: float, drained_s: float) -> None:
    """A simulator's go on meanwhile, and come in a burst that takes the program some time to read."""
    host = Host()
    clock = FollowedClock(host, host)
    before = -math.inf
    for k in range(8000):  # one stamp each 20 ms of the host
        t = 0.02 * k
        if 500 <= k < 500 + round(50 * paused_s):
            continue
        host.now = 1000.0 + t
        since = 0.02 * (k - 500 - round(50 * paused_s))
        behind_s = paused_s * max(1.0 - since / drained_s, 0.0) if since >= 0.0 and drained_s else 0.0
        if since == 0.0 and not drained_s:
            for stamp in range(round(50 * paused_s)):
                clock.heard(pace * (10.0 + 0.02 * stamp))
        clock.heard(pace * (t - behind_s))
        shown = clock.now_s()
        assert shown >= before
        before = shown
        if t > 2.5:
            assert shown < pace * t + 0.1 * pace, f"{shown / pace - t:.1f} s ahead at {t:.2f} s"
            assert clock.pace == pytest.approx(pace, rel=0.06)
    assert shown == pytest.approx(pace * t, abs=0.01 * pace)


@pytest.mark.parametrize(("paused_s", "after"), [(65.0, 4.0), (5.0, 0.5)])
def test_after_a_pause_of_the_host_a_simulator_is_followed_at_its_pace(paused_s: float, after: float) -> None:
    """It stood still meanwhile; what comes then is its pace, the old one or another."""
    host = Host()
    clock = FollowedClock(host, host)
    for k in range(1000):
        t = 0.02 * k
        host.now = 1000.0 + t + (paused_s if t >= 10.0 else 0.0)
        clock.heard(4.0 * min(t, 10.0) + after * max(t - 10.0, 0.0))
        if t > 2.5 and (t < 10.0 or after == 4.0):
            assert clock.pace == pytest.approx(4.0, rel=0.06)
    assert clock.pace == pytest.approx(after, rel=0.06)


def test_stamps_that_stand_still_stop_no_wait() -> None:
    """A simulator that waits for our clock answers again and again with one time."""
    host = Host()
    clock = FollowedClock(host, host)
    for k in range(300):
        host.now = 1000.0 + 0.01 * k
        clock.heard(7.0)
    before = clock.now_s()
    host.now += 5.0
    assert clock.now_s() == pytest.approx(before + 5.0)


def test_the_clock_of_a_real_vehicle_stands_still_for_no_link() -> None:
    host = Host()
    clock = FollowedClock(host, host)
    clock.keep_real_time()
    rng = random.Random(3)
    shown, queue = [], []
    for k in range(12000):  # two minutes; from the middle on a quarter of a second slower, and stalls all along
        t = 0.01 * k
        queue.append((t + 0.02 + rng.random() * 0.1 + (0.25 if t > 60.0 else 0.0), 50.0 + t))
        host.now = 1000.0 + t
        if not 0.0 <= t % 2.7 < 0.25:
            for _, stamp in sorted(q for q in queue if q[0] <= t):
                clock.heard(stamp)
            queue = [q for q in queue if q[0] > t]
        shown.append(clock.now_s())
    steps = [b - a for a, b in pairwise(shown[500:])]
    assert clock.pace == 1.0
    assert 0.0099 < min(steps) <= max(steps) < 0.012
    assert shown[-1] == pytest.approx(50.0 + 119.99, abs=0.05)
    clock.heard(1.0)  # booted anew
    assert clock.now_s() == pytest.approx(1.0)


def test_a_granted_clock_stands_still() -> None:
    clock = GrantedClock(lambda: 1234.5)
    clock.reach(10.0)
    assert (clock.now_s(), clock.ground_s()) == (10.0, 1234.0)
    clock.reach(9.0)
    assert clock.now_s() == 10.0
    clock.reach(12.5)
    assert clock.ground_s() == 1236.5


def test_the_quickest_round_trip_counts() -> None:
    sync = TimeSync()
    for sent, trip, vehicle in ((100.0, 0.4, 10.3), (101.0, 0.02, 11.01), (102.0, 0.3, 12.02)):
        ts1 = sync.ask(sent)
        assert sync.answer(int(vehicle * 1e9), ts1, sent + trip) == pytest.approx(trip, abs=1e-6)
    assert sync.answer(5, 12345, 0.0) is None
    offset = sync.offset()
    assert offset is not None
    assert offset.offset_s == pytest.approx(90.0, abs=1e-6)
    assert offset.error_s == pytest.approx(0.01, abs=1e-6)
