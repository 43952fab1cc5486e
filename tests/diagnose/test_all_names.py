"""All that was named, against the base, in what was not used."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import evidence, rows_of

from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.diagnose.selection.comparison import Fitted
from flighttest.diagnose.selection.fitted_models import FittedModels
from flighttest.diagnose.selection.search import Search
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise


@pytest.fixture
def judged(monkeypatch):
    """A search with one name, judged. before, after: residuals (1000,) of the base and of the model with it, of twenty responses."""
    monkeypatch.setattr(Search, "linearise", lambda _self: None)

    def judge(before, after, floors, groups=20, channel=None):
        base, now = (
            Fitted(
                SimpleNamespace(terms=()),
                (),
                Optimum({}, {}, Noise({"f_z_m_s2": 1.0}, {}), 1.0),
                rows_of(one, np.zeros((1000, 0)), channel=channel),
            )
            for one in (before, after)
        )
        floor = NoiseFloor(dict(zip(base.rows.channels, floors, strict=True)), frozenset(), {})
        models = FittedModels(SimpleNamespace(segments=()), (SimpleNamespace(id="a"),), base=base)
        search = Search(models, np.arange(20) % groups, now=now, floor=floor)
        search.evidence = {"a": evidence("a")}
        search.judge_as_a_whole()
        assert search.now is (now if search.evidence else base)
        return search

    return judge


@pytest.mark.parametrize(
    ("after", "groups", "named"),
    [
        (0.5, 20, {"a"}),
        (1.0, 20, set()),
        (2.0, 20, set()),
        (2.0, 5, {"a"}),
        # A limit that a few stretches of a log reached took 45 % of the error, all of it in these.
        (np.repeat(np.where(np.arange(20) < 3, 0.3, 1.00001), 50), 20, {"a"}),
        (np.repeat(np.where(np.arange(20) < 6, 0.3, 1.9), 50), 20, set()),
        # Smaller in the mean by 5 %, which groups that differ as much could make by chance.
        (np.repeat(np.where(np.arange(20) % 2, 0.5, 1.25), 50), 20, set()),
    ],
)
def test_names_that_predict_what_was_not_used_no_better_are_withdrawn(judged, rng, after, groups, named):
    """A crashed flight had a wind and unequal spin-up named, each needed beside the other, with which lateral speed was off eleven times
    as far; on hops with a cut propeller a vortex ring, with which no channel was surely better."""
    noise = rng.normal(size=1000)
    search = judged(noise, noise * after, (0.1, 0.1), groups)
    assert set(search.evidence) == named
    assert ("a" in search.rejected) is not bool(named)
    assert all("predicted better" in e.why_not for e in search.rejected.values())


@pytest.mark.parametrize(("floor", "named"), [(0.1, set()), (3.0, {"a"})])
def test_a_channel_below_its_noise_floor_withdraws_no_name(judged, rng, floor, named):
    """A latency of 0.36 s (24 noise floors; velocity off by 0.025 and 0.031 for 0.125 and 0.26 m/s) was withdrawn on a simulator's log,
    since two specific forces were off by 0.027 and 0.057 for 0.021 and 0.032 m/s^2, where 0.05 is noise."""
    channel, noise = np.arange(1000) % 2, rng.normal(size=1000)
    search = judged(noise, noise * np.where(channel == 0, 0.5, 2.5), (0.1, floor), channel=channel)
    assert set(search.evidence) == named


@pytest.mark.parametrize(("floor", "named"), [(0.9, {"a"}), (0.3, set())])
def test_a_channel_that_the_names_hardly_move_says_nothing_of_them(judged, rng, floor, named):
    """Of an axial inflow of 0.95 noise floors with 186 nats f_z was off by 0.82 to 0.95 times as much, v_y, which it does not move, by 0.99
    to 1.05 times. (Leaving velocities beside forces out instead withdrew a wind with which they were off by a fiftieth.)"""
    channel, noise = np.arange(1000) % 2, rng.normal(size=1000)
    search = judged(noise, noise * np.where(channel == 0, 0.8, 1.3), (0.1, floor), channel=channel)
    assert set(search.evidence) == named
