"""Moments of the air on a small vehicle: at an optimum of the loops without them they are not to be reached, and their derivatives are
known only together with the loops that they act against."""

from functools import cache

import numpy as np
import pytest

from flighttest.diagnose.free_flight import estimates
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.identify.free_flight import stretches
from flighttest.identify.free_flight.estimate import covariance_at, estimate_beside
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

POOL = tuple(catalogue()[t] for t in ("airflow_moment", "attitude_extra_pole", "rate_feedforward", "rate_limit"))
OMEGA_RAD_S, ZETA, MOMENT = 40.0, 2.5, 30.0  # as of a Crazyflie: an attitude loop of 8 1/s about a rate loop of 200 1/s
DT, EVERY = 0.002, 10


def position_loop(t, p, v):
    """Roll and pitch, rad, that follow a figure of eight, and make up for what tilts the vehicle."""
    goal = np.array([np.sin(0.9 * t), 0.6 * np.sin(1.8 * t)])
    moving = np.array([0.9 * np.cos(0.9 * t), 1.08 * np.cos(1.8 * t)])
    wanted = 4.0 * (goal - p) + 3.0 * (moving - v)
    return np.clip(np.array([-wanted[1], wanted[0]]) / 9.81, -0.5, 0.5)


def figure_of_eight(seed, moment, run):
    """Windows of 13 s of free flight, rad, m, s: loops of second order, a position loop that follows a figure of eight at 50 Hz, and a
    moment of the air, rad/(s m)."""
    rng = np.random.default_rng(seed)
    n = int(13.0 / DT)
    out = np.empty((n, 8))
    p, v, angle, rate, air = (np.zeros(2) for _ in range(5))
    for k in range(n):
        if k % EVERY == 0:
            asked = position_loop(k * DT, p, v)
        out[k] = [*angle, *asked, *v, *p]
        tilting = moment * np.array([v[1], -v[0]])
        rate = rate + DT * (OMEGA_RAD_S**2 * (asked - angle) - 2.0 * ZETA * OMEGA_RAD_S * rate + tilting)
        angle = angle + DT * rate
        air = air - DT * air + 0.05 * np.sqrt(2.0 * DT) * rng.standard_normal(2)
        p, v = p + DT * v, v + DT * (9.81 * np.array([angle[1], -angle[0]]) - 0.3 * v + air)
    some, t = out[::EVERY], np.arange(n)[::EVERY] * DT
    found = []
    for first in range(0, t.size - 150, 150):
        at, reach = slice(first, first + 150), slice(max(first - 50, 0), first + 150)
        y = {"roll_rad": some[at, 0], "pitch_rad": some[at, 1]}
        y = {name: x + 0.002 * rng.standard_normal(x.size) for name, x in y.items()} | {"yaw_rad": np.zeros(t[at].size)}
        y |= {"v_x_m_s": some[at, 4], "v_y_m_s": some[at, 5], "v_z_m_s": np.zeros(t[at].size)}
        u = {"roll_ref_rad": (t[reach], some[reach, 2]), "pitch_ref_rad": (t[reach], some[reach, 3])}
        u["throttle"] = t[reach], np.full(t[reach].size, 0.4)
        found.append(Segment(f"free #{first}", run, "free", {}, first, float(t[at][0]), t[at], y, u))
    return found


@cache
def flown(moment):
    return stretches([w for k in range(4) for w in figure_of_eight(k, moment, f"flight {k}")], "roll_pitch")


@cache
def searched(moment):
    return find_terms(flown(moment), Model(), POOL, part="roll_pitch")


@pytest.mark.slow
def test_a_moment_is_named_from_an_optimum_of_the_loops_without_it():
    """There the frequency of the roll loop is not known, and what a moment has to be is not known either."""
    found = searched(MOMENT)
    assert found.base.std["omega_phi"] > found.base.values["omega_phi"]
    assert "airflow_moment" in found.named
    for moment, omega in (("l_v", "omega_phi"), ("m_u", "omega_theta")):
        assert found.final.values[moment] / found.final.values[omega] ** 2 == pytest.approx(
            MOMENT / OMEGA_RAD_S**2, rel=0.15
        )


@pytest.mark.slow
def test_whether_a_moment_is_there_does_not_depend_on_how_well_the_loop_is_known():
    """A moment acts as M / omega^2: each is known only with the other, and that there is one is sure."""
    final = searched(MOMENT).final
    null = dict.fromkeys(("m_u", "l_v", "m_w", "l_w"), 0.0)
    there, moment = covariance_at(flown(MOMENT), final, null), final.names.index("l_v")
    assert final.values["l_v"] < 10.0 * final.std["l_v"]
    assert final.values["l_v"] > 20.0 * np.sqrt(there[moment, moment])


@pytest.mark.slow
def test_a_term_is_estimated_from_usual_loops_too(monkeypatch):
    """Six flights of a Crazyflie with a load had loops without a moment of the air from where none was found."""
    tried = []

    def estimated(smaller, flown, model, starts, **asked):
        tried.extend((model.terms, dict(one)) for one in starts)
        return estimate_beside(smaller, flown, model, starts, **asked)

    monkeypatch.setattr(estimates, "estimate_beside", estimated)
    base = find_terms(flown(MOMENT), Model(), (catalogue()["airflow_moment"],), part="roll_pitch").base
    of_moments = [start for terms, start in tried if "airflow_moment" in terms][:2]
    usual = Model().param["omega_phi"].nominal
    assert [start["omega_phi"] for start in of_moments] == [base.values["omega_phi"], usual]
    assert {start["moment_trim_1_s"] for start in of_moments} == {0.0, 1.0}


def test_without_a_moment_none_is_named():
    assert "airflow_moment" not in searched(0.0).named


def test_the_prior_of_a_moment_holds_what_vehicles_of_34_g_and_of_2_kg_have():
    """g R / (k^2 Omega R): radius and tip speed of the rotors, radius of gyration, m and m/s."""
    crazyflie, large = (9.81 * r / (k**2 * tip) for r, tip, k in ((0.023, 48.0, 0.021), (0.12, 70.0, 0.14)))
    for name in ("m_u", "l_v", "m_w", "l_w"):
        p = Model(("airflow_moment",)).param[name]
        assert crazyflie / 2.0 < p.prior_std < crazyflie
        assert p.nominal == pytest.approx(large, rel=0.5)
        assert p.upper == -p.lower > 4.0 * crazyflie
