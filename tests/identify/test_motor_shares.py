"""Shares of the motors' commands: one flight of which a propeller is damaged is distinguished from the others."""

import numpy as np
import pytest

from flighttest.identify.motor_shares import MOTORS, REPEATS, least_shift, motor_shares
from flighttest.segments.model import Segment


def windows(run, shares, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 2.0, 0.02)
    found = []
    for k in range(6):
        y = {m: 0.6 * s + 0.01 * rng.standard_normal(t.size) for m, s in zip(MOTORS, shares, strict=True)}
        found.append(Segment(f"free #{k}", run, "free", {}, k, 2.0 * k, t + 2.0 * k, y, {}))
    return found


SOUND = (1.09, 0.87, 1.13, 0.91)


def test_a_motor_that_makes_up_for_its_propeller_is_named():
    flown = [s for k in range(3) for s in windows(f"sound {k}", SOUND, k)]
    found = motor_shares([*flown, *windows("cut", (1.03, 0.83, 1.26, 0.88), 9)])
    assert [(f.flight, f.apart) for f in found] == [("sound 0", ()), ("sound 1", ()), ("sound 2", ()), ("cut", (3,))]
    assert found[0].shares == pytest.approx(SOUND, abs=0.005)


def test_what_undamaged_vehicles_do_is_no_damage():
    flown = [s for k, v in enumerate((1.11, 1.13, 1.145, 1.17)) for s in windows(f"f{k}", (1.08, 0.88, v, 0.91), k)]
    assert not any(f.apart for f in motor_shares(flown))


@pytest.mark.parametrize(("third", "apart"), [(1.5, (3,)), (1.4, (3,)), (1.27, (3,)), (1.22, ())])
def test_of_two_flights_the_motor_that_makes_up_for_its_propeller_is_named(third, apart):
    """Two flights were not compared at all. One motor does more in the second, which the others then do more in the first."""
    rest = (SOUND[2] - third) / 3.0
    damaged = tuple(v + rest if k != 2 else third for k, v in enumerate(SOUND))
    for flights in (("a", "b"), ("b", "a")):
        found = motor_shares([s for f in flights for s in windows(f, SOUND if f == "a" else damaged)])
        assert {f.flight: f.apart for f in found} == {"a": (), "b": apart}


def test_the_fewer_flights_there_are_the_more_a_share_must_differ():
    """The median of the others is known no better than they repeat."""
    assert [round(least_shift(n) / REPEATS, 2) for n in (2, 3, 100)] == [4.24, 3.67, 3.02]
    assert motor_shares(windows("alone", SOUND))[0].apart == ()


def test_without_motor_commands_or_at_rest_nothing_is_said():
    bare = windows("a", SOUND)[0]
    assert motor_shares([Segment(bare.name, "a", "free", {}, 0, 0.0, bare.t_s, {"f_z_m_s2": bare.t_s}, {})]) == ()
    assert motor_shares(windows("rest", (0.0, 0.0, 0.0, 0.01))) == ()
