"""The oracle's fit of loops that were steered, against a position loop that answers gusts of known size."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.proof import oracle
from flighttest.segments import Segment

OMEGA, ZETA, DELAY_S = (12.0, 9.0), (0.6, 0.8), 0.07
PERIOD_S, FINER, WINDOW_S = 0.02, 4, 2.5


def held_position(seed: int, gust_rad: float, seconds: float = 120.0) -> list[Segment]:
    """Free flight of a position loop of 1.5 rad/s that gusts tilt; references are held for a period, attitudes sampled without noise."""
    rng = np.random.default_rng(seed)
    n, h = round(seconds / PERIOD_S), PERIOD_S / FINER
    late = round(DELAY_S / h)
    angle, rate, v, p, gust = (np.zeros(2) for _ in range(5))
    asked = np.zeros((n, 2))
    seen = np.zeros((n, 2))
    line = [np.zeros(2)] * late
    goal = np.zeros(2)
    for k in range(n):
        if k % 150 == 0:
            goal = 2.0 * rng.standard_normal(2)
        asked[k] = np.clip((1.5**2 * (goal - p) - 2 * 0.9 * 1.5 * v) / 9.8, -0.4, 0.4)
        seen[k] = angle
        for _ in range(FINER):
            line.append(asked[k])
            gust = gust * (1 - h / 0.3) + gust_rad * np.sqrt(2 * h / 0.3) * rng.standard_normal(2)
            push = np.array(OMEGA) ** 2 * (line.pop(0) + gust - angle) - 2 * np.array(ZETA) * np.array(OMEGA) * rate
            rate = rate + h * push
            angle = angle + h * rate
            v = v + h * 9.8 * angle
            p = p + h * v
    t, many = PERIOD_S * np.arange(n), round(WINDOW_S / PERIOD_S)
    return [
        Segment(
            f"free{a}", "run", "free", {}, 1, float(t[a]), t[a : a + many],
            {name: seen[a : a + many, i] for i, name in enumerate(("roll_rad", "pitch_rad"))},
            {name: (t[a : a + many], asked[a : a + many, i]) for i, name in enumerate(("roll_ref_rad", "pitch_ref_rad"))},
        )
        for a in range(0, n - many + 1, many)
    ]  # fmt: skip


def frequencies(theta: np.ndarray) -> list[float]:
    return [float(theta[0]), float(theta[2])]


@pytest.mark.slow
@pytest.mark.parametrize("gust_rad", [0.02, 0.1])
def test_answers_to_gusts_are_not_taken_for_their_causes(gust_rad):
    found = oracle.steered_loops(held_position(1, gust_rad))["roll_pitch"]
    assert frequencies(found) == pytest.approx(OMEGA, rel=0.06)
    assert [found[1], found[3]] == pytest.approx(ZETA, rel=0.12)
    assert found[4] == pytest.approx(DELAY_S, abs=0.006)


@pytest.mark.slow
def test_a_fit_of_what_the_loops_leave_takes_them_so():
    """What the innovations are for: the same flight fitted by what the loops leave has slow ones."""
    left = oracle.left(
        held_position(1, 0.1), oracle.OracleNoise(oracle.FIRST, oracle.FIRST_DISTURBANCE), 22.2, free=True
    )
    assert all(
        found < 0.85 * true for found, true in zip(frequencies(left.parameters["roll_pitch"]), OMEGA, strict=True)
    )


@pytest.mark.slow
def test_loops_of_another_form_and_short_flights_are_left_out():
    """Attitudes that are their references at once end at a bound; a single window has too few samples for the regression."""
    flown = held_position(2, 0.02)
    asked = [{n.replace("_ref", ""): x for n, (_, x) in s.u.items()} for s in flown]
    at_once = [replace(s, y=y) for s, y in zip(flown, asked, strict=True)]
    assert not oracle.steered_loops(at_once)
    assert not oracle.steered_loops(flown[:1])
