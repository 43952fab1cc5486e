"""Free flight by equation error: vehicles made without our equations, flown by a position loop in gusts."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flighttest.errors import FitError
from flighttest.estimation.drift import LEVEL
from flighttest.estimation.gauss_newton import minimise
from flighttest.frames import rotation_from_euler
from flighttest.identify.diagnostics.identifiability import allowance
from flighttest.identify.fit import fit
from flighttest.identify.free_flight import estimate, stretches
from flighttest.identify.free_flight.chunks import Chunks
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.estimate import estimate_beside
from flighttest.identify.free_flight.estimated import mixture
from flighttest.identify.free_flight.priors import prior_of
from flighttest.identify.free_flight.translation import predicted
from flighttest.identify.free_flight.winds import FlightWind, WindVerdict, any_wind, headings_of, winds, winds_of
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import fit_segments
from flighttest.segments.model import Segment
from flighttest.sim.plants.slung import SlungLoad

GAIN, SIGMA, DELAY_S, DRAG = 50.0, 18.0, 0.06, np.array([0.4, 0.3, 0.5])
DT, RATE_HZ = 0.01, 50


def flight(
    seconds,
    seed,
    wind=(0.0, 0.0),
    gust=0.4,
    run="run",
    offset=0.0,
    accelerometer=True,
    climb=0.5,
    quadratic=(0.0, 0.0, 0.0),
    drag=DRAG,
    load=None,
):
    """Windows of free flight under a position loop that answers gusts; m, s. Euler attitude with a lag of 60 ms, gusts of 1 s.
    quadratic, drag: force over mass by the square of the airspeed along each axis, 1/m, and by the airspeed, 1/s; load: on a cable."""
    rng = np.random.default_rng(seed)
    n = int(seconds / DT)
    p, v, angles, w = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(3)
    a_t, late = 9.81, [9.81 / GAIN] * round(DELAY_S / DT)
    asked, goal, throttle = np.zeros(2), np.zeros(3), 9.81 / GAIN
    out = np.empty((n, 14))
    push = gust * np.sqrt(2 * DT) * rng.standard_normal((n, 3))
    air, quadratic, drag = np.array([*wind, 0.0]), np.array(quadratic), np.array(drag)
    for k in range(n):
        if k % 300 == 0:
            goal = rng.uniform(-4.0, 4.0, 3) * [1.0, 1.0, climb]
        if k % 2 == 0:
            pull = np.clip(0.8 * (goal - p), -2.5, 2.5) - v
            wanted = np.clip(1.6 * pull, -4.0, 4.0)
            asked = np.array([-wanted[1], wanted[0]]) / 9.81
            throttle = (9.81 + wanted[2]) / GAIN / float(np.cos(angles[0]) * np.cos(angles[1]))
        late.append(throttle)
        cr, sr, cp, sp = np.cos(angles[0]), np.sin(angles[0]), np.cos(angles[1]), np.sin(angles[1])
        rotation = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
        along = rotation.T @ (v - air)
        force = np.array([offset * a_t, 0.0, a_t]) - (drag + quadratic * np.abs(along)) * along + rotation.T @ w
        if load is not None:
            force = rotation.T @ load.pull(DT, tuple(rotation @ force))
        out[k] = [k * DT, *angles, *force, *v, *p, throttle, a_t]
        a_t += (GAIN * late.pop(0) - a_t) * (1.0 - np.exp(-SIGMA * DT))
        angles = angles + (asked - angles) * DT / 0.06
        w = w - w * DT + push[k]
        p = p + DT * v
        v = v + DT * (rotation @ force - [0.0, 0.0, 9.81])
    some = out[:: round(1 / DT / RATE_HZ)]
    t = some[:, 0]

    def noisy(column, std):
        return some[:, column] + std * rng.standard_normal(t.size)

    found = []
    length = 125
    for k in range(1, t.size // length):
        at = slice(length * k, length * (k + 1))
        reach = slice(length * k - 50, length * (k + 1))
        y = {"roll_rad": noisy(1, 0.001)[at], "pitch_rad": noisy(2, 0.001)[at], "yaw_rad": np.zeros(length)}
        y |= {name: noisy(6 + i, 0.03)[at] for i, name in enumerate(("v_x_m_s", "v_y_m_s", "v_z_m_s"))}
        if accelerometer:
            y |= {name: noisy(3 + i, 0.1)[at] for i, name in enumerate(("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"))}
        u = {"throttle": (t[reach], some[reach, 12])}
        found.append(Segment(f"free #{k}", run, "free", {}, k, float(t[at][0]), t[at], y, u))
    return found


@cache
def flown(seed=1):
    return tuple(flight(80.0, seed))


NAMES = ("K", "sigma_t", "T_d_thrust", "d_x", "d_y", "d_z")
TRUTH = dict(zip(NAMES, (GAIN, SIGMA, DELAY_S, *DRAG), strict=True))


def test_adjoining_windows_are_one_stretch():
    windows = flown()
    whole = stretches(windows)
    assert len(whole) == 1
    assert whole[0].t_s.size == sum(w.t_s.size for w in windows)
    assert len(stretches([w for k, w in enumerate(windows) if k != 20])) == 2


@pytest.mark.slow
@pytest.mark.parametrize("accelerometer", [True, False])
def test_a_load_that_swings_as_stretches_begin_is_found_as_it_is(accelerometer):
    """With a load at rest as each stretch begins its cable was 0.69 m, damped by 0.06; with small motion about rest the mass 0.10."""
    load = SlungLoad(1.0, {"payload_ratio": 0.15, "cable_m": 0.8, "swing_damping": 0.02})
    windows = flight(90.0, 7, accelerometer=accelerometer, load=load)
    parted = stretches([w for k, w in enumerate(windows) if k % 5])
    assert len(parted) == 7
    model = Model(("body", "linear_drag", "slung_payload"), attitude_loops=False)
    found = estimate(parted, model, start={"cable_m": 1.0})
    assert found.values["payload_ratio"] == pytest.approx(0.15, abs=0.015)
    assert found.values["cable_m"] == pytest.approx(0.8, abs=0.02)
    assert found.values["swing_damping"] == pytest.approx(0.02, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("accelerometer", [True, False])
def test_a_position_loop_in_gusts_does_not_bias_the_estimates(accelerometer):
    segments = flown() if accelerometer else flight(120.0, 2, accelerometer=False)
    found = estimate(stretches(segments), Model(attitude_loops=False), free=NAMES)
    assert found.converged
    for name, truth in TRUTH.items():
        assert abs(found.values[name] - truth) < 3.0 * found.std[name], name
    assert found.std["K"] < 0.02 * GAIN
    assert found.std["d_x"] < 0.15


def test_ten_seconds_in_gusts_show_the_gain_that_carries_the_vehicle():
    """By output error they show 42.1 and 41.1 m/s^2: what a slow lag keeps, and a constant force, carry a sixth of the vehicle."""
    for seed in (21, 24):
        made = fit_segments(flight(10.0, seed, gust=0.5), [])
        assert abs(made.values["K"] - GAIN) < 0.06 * GAIN


def test_what_few_blocks_show_is_known_by_its_interval():
    """Of one degree of freedom a small standard error has a wide interval: drag of 0.4 +- 0.5 1/s was known."""
    made = fit_segments(flight(7.5, 21, gust=0.1), [])
    widths = {
        n: np.ptp(e.interval_95) / 2 for n, e in made.estimates.items() if n in TRUTH and e.interval_95 is not None
    }
    known = [n for n, half in widths.items() if half < 1.96 * allowance(made.model.param[n], made.values[n])]
    assert "K" in known
    assert "d_x" in widths.keys() - {*known}
    assert [n for n in widths if made.estimates[n].identifiable] == known


def test_of_output_error_too_the_interval_decides_what_is_known():
    """0.26 +- 0.15 1/s at 3 degrees of freedom: its standard error of 0.046 is below what drag may have, and its interval is not."""
    drag = fit(flight(15.0, 22, gust=0.1), Model(attitude_loops=False)).estimates["d_y"]
    assert drag.std < allowance(Model().param["d_y"], drag.value) < np.ptp(drag.interval_95) / (2.0 * 1.96)
    assert not drag.identifiable
    assert "95 % interval" in drag.why


@pytest.mark.slow
def test_an_estimate_does_not_depend_on_where_it_began():
    """Steps cut to what one lag may move left winds between 4 and 8 m/s for one flight, by their start."""
    some, none = stretches(flown()), {"sigma_t": 60.0, "T_d_thrust": 0.02, "K": 40.0, "d_x": 1.0}
    first, second = (estimate(some, Model(attitude_loops=False), free=NAMES, start=start) for start in ({}, none))
    assert second.converged
    for name in NAMES:
        assert abs(first.values[name] - second.values[name]) < 0.2 * first.std[name], name


@pytest.mark.parametrize("order", [1, -1])
def test_of_several_starts_the_best_optimum_is_found_and_what_leads_to_less_is_given_up(order, monkeypatch):
    """A slow motor after a long delay is an optimum of its own, 632 nats below."""
    limits = []

    def noted(*asked, tolerances=None, **others):
        if not others:  # else from where the first ended
            limits.append(tolerances)
        return minimise(*asked, tolerances=tolerances, **others)

    monkeypatch.setitem(estimate.__globals__, "minimise", noted)
    good, poor = {"sigma_t": 60.0, "T_d_thrust": 0.02}, {"sigma_t": 15.0, "T_d_thrust": 0.28}
    some, model = stretches(flown()), Model(attitude_loops=False)
    alone = estimate(some, model, free=NAMES, start=good)
    limits.clear()
    found = estimate(some, model, free=NAMES, start=[good, poor][::order])
    for name in NAMES:
        assert abs(found.values[name] - alone.values[name]) < 0.1 * alone.std[name], name
        assert found.std[name] == pytest.approx(alone.std[name], rel=0.05)
    reached = [None if one is None else one.compared_with for one in limits]
    assert [one is None for one in reached] == [True, False]


def test_a_larger_model_that_predicts_no_better_is_given_up_on_the_way(monkeypatch):
    """One that does has the same values. A load that is not there took 25 iterations on nine flights, each with a lead of 20 s."""
    given_up = []

    def noted(objective, *asked, tolerances=None, **others):
        found = minimise(objective, *asked, tolerances=tolerances, **others)
        given_up.append(
            (tolerances and tolerances.compared_with, objective.log_likelihood(objective.cost(found.point)))
        )
        return found

    some, model = stretches(flown()), Model(attitude_loops=False)
    held = ("K", "sigma_t", "T_d_thrust")
    smaller = estimate(some, model, free=held, start={"d_x": 0.01, "d_y": 0.01, "d_z": 0.01})
    alone = estimate(some, model, free=NAMES, start=smaller.values)
    monkeypatch.setitem(estimate.__globals__, "minimise", noted)
    there = estimate_beside(smaller, some, model, [smaller.values], free=NAMES)
    (least, first), _ = given_up
    assert least == pytest.approx(smaller.log_likelihood + smaller.inflation * 1.5 * math.log(smaller.blocks))
    assert first > least
    for name in NAMES:
        assert abs(there.values[name] - alone.values[name]) < 0.1 * alone.std[name], name
    given_up.clear()
    bent = model.with_terms("throttle_curve")
    absent = estimate_beside(alone, some, bent, [alone.values | {"curvature": 0.0}], free=(*NAMES, "curvature"))
    assert len(given_up) == 1  # not from where the first ended
    assert absent.log_likelihood < given_up[0][0]


def test_the_level_of_an_accelerometer_is_not_divided_by_what_log_likelihoods_are():
    """In the scale of the innovations it is smaller by the root of the inflation; undivided, biases had taken the place of offsets."""
    found = estimate(stretches(flight(40.0, 108, gust=0.1)), Model(attitude_loops=False), free=NAMES)
    assert found.inflation > 1.2
    for channel, std in LEVEL.items():
        assert found.noise[channel].level * np.sqrt(found.inflation) == pytest.approx(std, rel=0.03)
    alone = estimate(stretches(flight(40.0, 108, accelerometer=False)), Model(attitude_loops=False), free=NAMES)
    assert not any(one.level for one in alone.noise.values())


@pytest.mark.parametrize("seed", [3, 4, 6])
def test_a_prior_weighs_as_much_as_a_flight_of_the_same_standard_error(seed):
    """Its mean is three standard errors off, its standard deviation one of them: the estimate goes half the way, with an error smaller by
    the root of two. Log likelihoods count information that robust errors do not confirm; beside them it went 0.33 to 0.40 of the way."""
    flown = stretches(flight(40, seed, gust=0.4, accelerometer=False))
    shown = estimate(flown, Model(attitude_loops=False), free=NAMES)
    assert shown.inflation > 1.3
    std = shown.std["K"]
    prior = {"K": (shown.values["K"] + 3.0 * std, std)}
    both = estimate(flown, Model(attitude_loops=False), free=NAMES, priors=prior)
    assert (both.values["K"] - shown.values["K"]) / (3.0 * std) == pytest.approx(0.5, abs=0.05)
    assert both.std["K"] / std == pytest.approx(math.sqrt(0.5), rel=0.05)


def test_pieces_that_are_integrated_side_by_side_are_one_flight(monkeypatch):
    """The start of each is forgotten in its lead; no sample is lost or counted twice."""
    some = stretches(flown())
    values = Model(attitude_loops=False).start() | TRUTH
    found = []
    for lanes in (16, 1):
        monkeypatch.setitem(Chunks.__init__.__globals__, "LANES", lanes)
        found.append(Equations(Model(attitude_loops=False), some).streams(values, NAMES)[0])
    for many, few in zip(*found, strict=True):
        assert many.residual.size == few.residual.size > 0.98 * sum(s.t_s.size for s in some)
        assert np.abs(many.residual - few.residual).max() < 1e-3
        assert np.abs(many.columns - few.columns).max() < 1e-3 * np.abs(few.columns).max()


def test_flights_that_are_integrated_together_are_what_each_is_by_itself():
    """With a wind and filters of its own each, whether an accelerometer was recorded or not; a delay cannot be a flight's own."""
    model = Model(attitude_loops=False) + "steady_wind"
    some = [
        *stretches(flight(40.0, 1, run="a")),
        *stretches(flight(30.0, 2, run="b", accelerometer=False)),
        *stretches(flight(50.0, 3, run="c")),
        *stretches(flight(30.0, 4, run="d")),
    ]
    some[-1] = replace(some[-1], context=replace(some[-1].context, filters={"specific_force": 5.0}))
    winds = {f"w_north@{run}": wind for run, wind in (("a", 2.0), ("b", -1.0), ("c", -3.0), ("d", 1.0))}
    values = {**model.start(), **TRUTH, "w_west": 0.5, **winds}
    names = (*NAMES, "w_north", "w_west")
    together, columns = Equations(model, some).streams(values, names, ("w_north",))
    for g, run in enumerate("abcd"):
        alone, own = Equations(model, [s for s in some if s.run == run]).streams(values, names, ("w_north",))
        mine = [s for s in together if s.group == g]
        assert [s.channel for s in mine] == [s.channel for s in alone]
        for one, other in zip(mine, alone, strict=True):
            assert np.abs(one.residual - other.residual).max() < 1e-3
            shared = one.columns[:, [columns.index(n) for n in own]]
            assert np.abs(shared - other.columns).max() < 1e-3 * np.abs(other.columns).max()
            assert not one.columns[:, [c.startswith("w_north@") and c not in own for c in columns]].any()
    with pytest.raises(ValueError, match="have the same delays"):
        Equations(model, some).streams(values | {"T_d_thrust@a": 0.1}, names, ("T_d_thrust",))


def test_a_stretch_with_a_hole_is_estimated_from_what_is_beside_it():
    """Of sixteen pieces one or two lie in a hole of 9 s."""
    (whole,) = stretches(flown())
    kept = (whole.t_s < 30.0) | (whole.t_s > 39.0)
    holed = replace(whole, t_s=whole.t_s[kept], y={n: v[kept] for n, v in whole.y.items()})
    found = estimate([holed], Model(attitude_loops=False), free=NAMES, start=TRUTH)
    assert found.converged
    assert abs(found.values["K"] - GAIN) < 3.0 * found.std["K"]


def test_an_accelerometer_that_was_logged_less_often_than_attitudes_is_used_at_its_own_samples():
    """Attitudes at 400 Hz beside an accelerometer at 25 Hz, as ArduCopter logs them where attitudes are fast: no sample had a neighbour,
    and a flight of 140 s was refused."""
    (whole,) = stretches(flight(40, 3, gust=0.2))
    seldom = np.arange(whole.t_s.size) % 3 == 0
    y = {n: np.where(seldom, v, np.nan) if n.startswith("f_") else v for n, v in whole.y.items()}
    found = estimate([replace(whole, y=y)], Model(attitude_loops=False), free=NAMES)
    assert found.period_s == pytest.approx(3.0 * float(np.median(np.diff(whole.t_s))))
    assert found.values["K"] == pytest.approx(TRUTH["K"], rel=0.03)
    assert found.values["d_x"] == pytest.approx(TRUTH["d_x"], rel=0.25)


def test_few_blocks_do_not_divide_log_likelihoods_by_more_than_their_noise_asks_for():
    """Where the equations are right. By variances without each block it was 1.86 in the mean of these flights, and names were lost."""
    flights = [stretches(flight(15.0, seed)) for seed in (212, 213, 214, 215)]
    found = [estimate(one, Model(attitude_loops=False), free=NAMES).inflation for one in flights]
    assert np.mean(found) < 1.6


@pytest.mark.slow
def test_equations_of_the_wrong_form_widen_intervals():
    """A force by the square of the speed, fitted by a line: the square recurs with the state."""
    some = stretches(flown())
    right = estimate(some, Model(attitude_loops=False), free=NAMES)
    bent = [replace(s, y=s.y | {"f_x_m_s2": s.y["f_x_m_s2"] - 0.3 * s.y["v_x_m_s"] ** 2}) for s in some]
    wrong = estimate(bent, Model(attitude_loops=False), free=NAMES)
    assert wrong.std["d_x"] > 1.5 * right.std["d_x"]
    assert wrong.inflation > 1.5  # by the scatter between blocks alone it is 1


def test_local_optima_that_serve_as_well_are_in_the_covariance():
    found = estimate(stretches(flown()), Model(attitude_loops=False), free=NAMES)
    at = found.names.index("d_x")
    other = replace(found, values=dict(found.values) | {"d_x": found.values["d_x"] + 1.0})
    same = mixture([found, other]).covariance[at, at] - found.covariance[at, at]
    worse = replace(other, log_likelihood=found.log_likelihood - 10.0 * found.inflation)
    assert same == pytest.approx(0.5)  # half the weight, 1 away
    assert mixture([worse, found]).covariance[at, at] - found.covariance[at, at] < 1e-4
    diverged = replace(other, log_likelihood=-np.inf)
    assert np.array_equal(mixture([diverged, found]).covariance, found.covariance)
    assert mixture([diverged]) is diverged


def test_a_parameter_without_effect_is_unknown_and_spoils_no_other():
    """Without sideways velocity nothing depends on its drag."""
    some = stretches(flight(60.0, 2, accelerometer=False))
    straight = [replace(s, y=s.y | {n: np.zeros(s.t_s.size) for n in ("v_y_m_s", "roll_rad")}) for s in some]
    found = estimate(straight, Model(attitude_loops=False), free=NAMES)
    assert not np.isfinite(found.std["d_y"])
    assert found.std["K"] < 0.02 * GAIN


def test_the_noise_of_the_recording_is_reported():
    found = estimate(stretches(flown()), Model(attitude_loops=False), free=NAMES)
    quick, slow = found.noise["f_x_m_s2"].spectrum(np.array([20.0, 0.1]), 1.0 / RATE_HZ)
    assert quick == pytest.approx(2 * 0.1**2 / RATE_HZ, rel=0.5)  # the accelerometer's white noise
    assert slow > 20.0 * quick  # gusts


def test_a_velocity_is_predicted_from_the_past_alone():
    t = np.arange(200) / 50.0
    v = np.sin(t)
    changed = v.copy()
    changed[100:] += 5.0
    for slope in (None, np.cos(t)):
        before, after = predicted(t, v, slope), predicted(t, changed, slope)
        assert np.array_equal(before[:101], after[:101])
        assert np.abs(before - v)[20:].max() < 0.01


@pytest.mark.slow
def test_each_flight_has_its_own_wind_and_drag_is_shared():
    segments = flight(60.0, 3, (0.0, 0.0), run="calm", offset=0.03) + flight(
        60.0, 4, (-4.0, 2.0), run="windy", offset=0.03
    )
    found = winds(segments, Model(), {"calm": "still"})
    calm, windy = found.flights
    assert (calm.verdict, windy.verdict) == (WindVerdict.STILL, WindVerdict.WIND)
    assert abs(windy.north + 4.0) < 3.0 * windy.north_std < 4.0
    assert abs(windy.west - 2.0) < 3.0 * windy.west_std < 4.0
    assert windy.from_deg == pytest.approx(27.0, abs=25.0)
    assert not found.turned


def test_of_an_offset_as_much_is_expected_as_level_calibrations_leave():
    for offset in catalogue()["attitude_offset"].params:
        mean, std = prior_of(offset)
        assert mean == 0.0
        assert 2.0 * std == pytest.approx(np.radians(3.0))


def test_nothing_to_fly_from_is_said():
    with pytest.raises(FitError, match="no free flight"):
        estimate(stretches([]), Model())
    assert winds([], Model()) is None


def test_rotation_of_this_test_is_that_of_the_package():
    cr, sr, cp, sp = np.cos(0.1), np.sin(0.1), np.cos(0.2), np.sin(0.2)
    own = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    assert rotation_from_euler(np.array([0.1, 0.2, 0.0])) == pytest.approx(own)


@pytest.mark.parametrize(
    ("verdicts", "found"), [(("none seen",), True), (("none seen", "none seen"), False), (("none seen", "wind"), True)]
)
def test_of_several_flights_one_must_have_a_wind_by_its_own_interval(verdicts, found):
    flown = [FlightWind(f"f{k}", 0.7, 0.1, 1.0, 0.5, 0.5, WindVerdict(v), 2.0) for k, v in enumerate(verdicts)]
    assert any_wind(flown) is found


@pytest.mark.parametrize(
    ("drag_std", "yaw", "found"),
    [
        (0.02, 0.0, "wind"),  # a drag of 0.1 1/s is seen
        (0.05, 0.0, "none seen"),  # it may be none: what pushes along this axis says nothing of a wind
        (0.05, np.pi / 2, "wind"),  # the axis that the wind blows along is then the one whose drag is seen
        (0.05, None, "wind"),  # every axis of the body has met it
    ],
)
def test_a_wind_is_seen_along_an_axis_whose_drag_is(drag_std, yaw, found):
    names = ("d_x", "d_y", "w_north@a", "w_west@a")
    values = dict(zip(names, (0.3, 0.1, 0.0, -16.0), strict=True))
    covariance = np.diag(np.square([0.02, drag_std, 0.7, 4.0]))
    made = replace(
        estimate(flight(20.0, 1), Model(attitude_loops=False)),
        names=names,
        values=values,
        covariance=covariance,
        flights=("a",),
        blocks=40,
    )
    (wind,) = winds_of(made, {} if yaw is None else {"a": yaw})
    assert wind.verdict.value == found


@pytest.mark.parametrize(("k_std", "found"), [(0.002, "wind"), (0.02, "none seen")])
def test_a_quadratic_drag_counts_at_the_speed_of_the_wind(k_std, found):
    """0.02 1/m is a drag of 0.32 1/s at 16 m/s, whose error is 0.04 beside one of 0.05 of the linear drag, or 0.32."""
    names = ("d_x", "d_y", "k_y", "w_north@a", "w_west@a")
    values = dict(zip(names, (0.3, 0.0, 0.02, 0.0, -16.0), strict=True))
    covariance = np.diag(np.square([0.02, 0.05, k_std, 0.7, 4.0]))
    flown = estimate(flight(20.0, 1), Model(attitude_loops=False))
    made = replace(flown, names=names, values=values, covariance=covariance, flights=("a",), blocks=40)
    (wind,) = winds_of(made, {"a": 0.0})
    assert wind.verdict.value == found


@pytest.mark.parametrize(("swing", "kept"), [(0.1, True), (1.5, False)])
def test_a_flight_keeps_its_heading_where_it_hardly_turns(swing, kept):
    (segment,) = flight(30.0, 2, run="one")[:1]
    t = segment.t_s - segment.t_s[0]
    weaving = replace(segment, y=segment.y | {"yaw_rad": 0.7 + swing * np.sin(6.0 * t)})
    assert ("one" in headings_of([weaving])) is kept
    if kept:
        assert headings_of([weaving])["one"] == pytest.approx(0.7, abs=0.05)
