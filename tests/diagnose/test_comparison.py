"""The evidence for a term, and what an estimate must be like to be what its name means."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import autoregressive, responses, rows_of
from scipy.stats import multivariate_normal

from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor, floor_of
from flighttest.diagnose.selection.admissible import EstimatedModel, outside_prior
from flighttest.diagnose.selection.candidates import redundant
from flighttest.diagnose.selection.comparison import (
    Evidence,
    Fitted,
    change_by_stratum,
    evidence_of,
    held_out_errors,
    inadmissible,
    log_evidence,
    log_odds_asked,
    probability_of,
    standard_errors,
    visible,
)
from flighttest.diagnose.selection.held_out import (
    CrossValidation,
    ParameterPrior,
    cross_validated,
    share_left,
    stratum_gains,
)
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise
from flighttest.estimation.uncertainty.covariance import Covariance
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

SEGMENTS, EACH, REPEATS = 40, 50, 4
GROUPS = np.arange(SEGMENTS) // REPEATS
NOISE = Noise({"f_z_m_s2": 1.0}, {})


def fitted(y, columns, names, model=None, values=None):
    """A linear model at its least squares optimum, far from all bounds where no model is given."""
    anywhere = {
        n: SimpleNamespace(name=n, lower=-np.inf, upper=np.inf, nominal=1e3, off=None, prior_std=3e3) for n in names
    }
    model = model or SimpleNamespace(param=anywhere)
    step = np.linalg.lstsq(columns, y, rcond=None)[0]
    rows = rows_of(y - columns @ step, columns, SEGMENTS, names=names)
    at = Optimum(values or dict(zip(names, step.tolist(), strict=True)), {}, NOISE, 0.0)
    return Fitted(model, names, at, rows)


def evidence(y, columns):
    """Log evidence of the last column."""
    segments = responses(SEGMENTS, EACH, REPEATS)
    names = tuple(f"p{k}" for k in range(columns.shape[1]))
    larger, smaller = fitted(y, columns, names), fitted(y, columns[:, :-1], names[:-1])
    floor = floor_of(larger.rows, segments, {})
    return sum(log_evidence(larger, smaller, SimpleNamespace(segments=segments), GROUPS, floor).values())


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_what_is_not_needed_has_no_evidence_on_the_average_and_is_not_named(rng, rho):
    found = []
    for _ in range(150):
        e, x = (autoregressive(rng, (SEGMENTS, EACH), rho).ravel() for _ in range(2))
        found.append(evidence(e, np.stack([np.ones(e.size), x], axis=1)))
    # A parameter that is not there costs about half a nat of prediction.
    assert -1.1 < np.mean(found) < -0.2
    assert np.std(found) < 1.6
    assert max(found) < log_odds_asked(1)


@pytest.mark.parametrize("rho", [0.0, 0.8])
@pytest.mark.parametrize("size", [6.0, 12.0])
def test_what_is_there_has_half_its_chi_square(rng, rho, size):
    """size: of the coefficient, in standard errors."""
    found, chi = [], []
    for _ in range(30):
        e = autoregressive(rng, (SEGMENTS, EACH), rho).ravel()
        x = rng.normal(size=SEGMENTS).repeat(EACH)
        lag = np.arange(1, EACH)
        tau = 1.0 + 2.0 * float(np.sum((1.0 - lag / EACH) * rho**lag))  # of the mean of one response
        columns = np.stack([np.ones(e.size), x], axis=1)
        error = np.sqrt(tau * np.linalg.inv(columns.T @ columns)[1, 1])
        y = e + size * error * x
        found.append(evidence(y, columns))
        chi.append((np.linalg.lstsq(columns, y, rcond=None)[0][1] / error) ** 2)
    assert np.mean(found) == pytest.approx(0.5 * np.mean(chi), rel=0.2)


RECORDED = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "v_x_m_s", "v_y_m_s", "v_z_m_s", "a_d_x_m_s2")


@pytest.mark.parametrize(
    ("term", "missing", "aside"),
    [
        ("quadratic_drag", (), {"v_x_m_s", "v_y_m_s", "v_z_m_s"}),
        ("quadratic_drag", ("f_x_m_s2",), {"v_z_m_s"}),  # body axes turn: one axis does not show a side
        ("quadratic_drag", ("f_z_m_s2",), {"v_x_m_s", "v_y_m_s"}),
        ("quadratic_drag", ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"), set()),
        # States that are free in every response take up its disturbance.
        ("slung_payload", (), {"v_x_m_s", "v_y_m_s", "v_z_m_s", "a_d_x_m_s2"}),
        ("slung_payload", ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"), {"a_d_x_m_s2"}),
        ("velocity_latency", (), {"a_d_x_m_s2"}),
        ("accelerometer_bias", (), set()),
        ("channel_delay", (), set()),
    ],
)
def test_what_is_no_evidence_of_a_term(term, missing, aside):
    assert redundant(catalogue()[term], [s for s in RECORDED if s not in missing]) == aside


@pytest.mark.parametrize(("term", "named"), [("axial_inflow", False), ("velocity_latency", True)])
def test_what_only_the_velocity_shows_beside_a_recorded_specific_force_is_an_instrument(rng, term, named):
    """500 nats of the velocity in half of the responses, whose other half is specific force."""
    column = np.repeat([0.0, 1.0], SEGMENTS // 2 * EACH)[:, None] * rng.normal(size=(SEGMENTS * EACH, 1))
    y = column[:, 0] + rng.normal(size=column.shape[0])
    names = tuple(p.name for p in catalogue()[term].params)
    channel = np.repeat([0, 1], SEGMENTS // 2 * EACH)
    larger, smaller = fitted(y, column, names, Model((term,))), fitted(y, column[:, :0], (), Model(()))
    larger, smaller = (replace(m, rows=replace(m.rows, stratum=channel)) for m in (larger, smaller))
    segments = responses(SEGMENTS, EACH, REPEATS)
    estimator = SimpleNamespace(
        segments=segments, covariance=lambda *_: Covariance((), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    )
    floor = floor_of(smaller.rows, segments, {})
    e = evidence_of(catalogue()[term], larger, smaller, estimator, GROUPS, floor, 30)
    assert (e.nats > 100.0) is named
    assert (e.probability > 0.99) is named


@pytest.mark.parametrize(
    ("lost", "along", "counts"),
    [(0.9, 0.0, False), (4.0, 0.0, False), (8.0, 0.0, True), (300.0, 0.0, True), (0.0, 0.03, False), (0.0, 0.1, True)],
)
def test_a_channel_is_worse_where_its_own_loss_can_be_seen_and_would_decide_by_itself(rng, lost, along, counts):
    """A lag of the rotors' speed with 6438 nats was refused, and an asymmetry of 1886 nats named in its place: four channels were worse by
    less than half a nat each. Arms of 609 nats were refused for five channels worse by 0.8 to 9.6 nats, three of them below log 99."""
    noise, half = rng.normal(size=SEGMENTS * EACH), SEGMENTS // 2 * EACH
    shown = np.append(rng.normal(size=half), np.zeros(half))
    # Of every response, orthogonal to its noise: what it costs is half of its square.
    apart = rng.normal(size=(SEGMENTS, EACH))
    own = noise.reshape(SEGMENTS, EACH)
    apart -= np.sum(apart * own, axis=1, keepdims=True) / np.sum(own**2, axis=1, keepdims=True) * own
    apart *= np.sqrt(2.0 * lost / (SEGMENTS // 2)) / np.linalg.norm(apart, axis=1, keepdims=True)
    column = np.where(np.arange(2 * half) < half, shown, apart.ravel() - along * noise)[:, None]
    channel = np.repeat([0, 1], half)
    larger = fitted(noise + shown, column, ("velocity_latency",), Model(("velocity_latency",)))
    smaller = fitted(noise + shown, column[:, :0], (), Model(()))
    larger, smaller = (replace(m, rows=replace(m.rows, stratum=channel)) for m in (larger, smaller))
    segments = responses(SEGMENTS, EACH, REPEATS)
    estimator = SimpleNamespace(
        segments=segments, covariance=lambda *_: Covariance((), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    )
    floor = floor_of(smaller.rows, segments, {})
    e = evidence_of(catalogue()["velocity_latency"], larger, smaller, estimator, GROUPS, floor, 30)
    assert e.improved == ("f_z_m_s2",)
    assert e.worsened == (("v_z_m_s",) if counts else ())


def test_models_are_compared_in_the_noise_of_the_larger(rng):
    """The smaller model is linearised anew where its own noise was another."""
    names, y = ("p0",), rng.normal(size=SEGMENTS * EACH)
    larger = fitted(y, np.ones((y.size, 1)), names)
    smaller = replace(larger, at=replace(larger.at, noise=Noise({"f_z_m_s2": 2.0}, {})))
    asked = []
    estimator = SimpleNamespace(
        segments=responses(SEGMENTS, EACH), linearise=lambda _m, at, _n: asked.append(at.noise) or larger.rows
    )
    found = log_evidence(larger, smaller, estimator, GROUPS, floor_of(larger.rows, estimator.segments, {}))
    assert set(found.values()) == {0.0}
    assert asked == [NOISE]


def predictions(rng, factors):
    """Squares of both channels of ten groups, and the same times factors (2, 10): channel, group."""
    channel = np.tile([0, 1], 500)
    rows = rows_of(np.zeros(1000), np.zeros((1000, 0)), 20, channel=channel)
    group = (np.arange(20) // 2)[rows.segment] % 10
    squares = rng.normal(size=1000) ** 2
    return (
        CrossValidation(rows, squares),
        CrossValidation(rows, squares * np.asarray(factors)[channel, group]),
        np.arange(20) // 2,
    )


def test_a_stratum_is_predicted_better_where_groups_agree_on_it(rng):
    """A channel in every group, half of the sum of squares; another in five of ten groups, and as much worse in the others."""
    mixed = np.where(np.arange(10) < 5, 0.5, 1.5)
    before, after, groups = predictions(rng, [np.full(10, 0.5), mixed])
    found = stratum_gains(before, after, groups)
    low, high = found["f_z_m_s2"]
    whole = 0.25 * float(before.deviance[before.rows.stratum == 0].sum())
    assert 0.5 * whole < low < whole < high < 1.5 * whole
    assert found["v_z_m_s"][0] < 0.0
    assert stratum_gains(after, before, groups)["f_z_m_s2"][1] < 0.0


def test_a_stratum_without_measurements_has_no_interval(rng):
    rows = rows_of(np.zeros(1000), np.zeros((1000, 0)), 20)
    one = CrossValidation(rows, rng.normal(size=1000) ** 2)
    assert list(stratum_gains(one, one, np.arange(20) // 2)) == ["f_z_m_s2"]


def test_the_predictive_density_is_that_of_what_the_other_folds_say(rng):
    """Against the normal density of each fold with the parameters integrated over their posterior by the others and the prior."""
    columns, y = rng.normal(size=(200, 2)), rng.normal(size=200)
    groups, weights = np.arange(20) // 4, rng.uniform(0.5, 2.0, 200)
    rows = rows_of(y, columns, segments=20)
    alone = (groups % 5)[rows.segment] == 0
    columns[~alone, 1] = 0.0
    rows, std = rows_of(y, columns, segments=20), np.array([2.0, 3.0])
    found = cross_validated(
        rows, ("p0", "p1"), groups, weights, ParameterPrior(np.full(2, -np.inf), np.full(2, np.inf), std)
    )
    root = np.sqrt(weights)
    a, r = columns * root[:, None], y * root
    for fold in range(5):
        inside = (groups % 5)[rows.segment] == fold
        known = np.linalg.inv(a[~inside].T @ a[~inside] + np.diag(std**-2.0))
        expected = multivariate_normal(
            a[inside] @ known @ a[~inside].T @ r[~inside], np.eye(inside.sum()) + a[inside] @ known @ a[inside].T
        ).logpdf(r[inside])
        assert -0.5 * found[inside].sum() - 0.5 * inside.sum() * np.log(2.0 * np.pi) == pytest.approx(expected)


def test_a_fold_that_alone_determines_a_parameter_does_not_decide_on_another(rng):
    """On a log with few steps one stretch determined the drag along the vertical: the others foresaw it by 100 standard deviations, a
    little worse beside any further term, and a lever arm of the right size had -6880 nats."""
    n = SEGMENTS * EACH
    alone = GROUPS[np.repeat(np.arange(SEGMENTS), EACH)] == 0
    for _ in range(10):
        x, hidden = rng.normal(size=n), np.where(alone, 300.0, 1e-2) * rng.normal(size=n)
        y = 5.0 * hidden + 0.4 * x + rng.normal(size=n)
        assert 20.0 < evidence(y, np.stack([np.ones(n), hidden, x], axis=1)) < 0.1 * n


def test_standard_errors_are_those_of_generalised_least_squares(rng):
    rho, spread = 0.8, []
    x = rng.normal(size=SEGMENTS).repeat(EACH)
    columns = np.stack([np.ones(x.size), x], axis=1)
    reported = []
    for _ in range(40):
        e = autoregressive(rng, (SEGMENTS, EACH), rho).ravel()
        found = fitted(e, columns, ("p0", "p1"))
        reported.append(standard_errors(found, responses(SEGMENTS, EACH, REPEATS))["p1"])
        spread.append(found.at.values["p1"])
    assert np.mean(reported) == pytest.approx(np.std(spread), rel=0.3)


def test_the_probability_of_a_term_has_the_catalogue_in_its_prior():
    assert probability_of(0.0, 1) == 0.5
    assert probability_of(np.log(30.0), 30) == pytest.approx(0.5)
    assert probability_of(np.log(99.0) + np.log(30.0), 30) == pytest.approx(0.99)
    assert probability_of(log_odds_asked(30), 30) == pytest.approx(0.99)
    assert probability_of(-1e9, 30) == pytest.approx(0.0)
    assert probability_of(1e9, 30) == 1.0


def found(probability=0.999, floors=5.0, inadmissible=""):
    nothing = np.zeros(0)
    return Evidence(
        "t", 9.0, probability, floors, ("f_z_m_s2", "roll_step"), nothing, nothing, inadmissible, None, ("f_z_m_s2",)
    )


@pytest.mark.parametrize(("probability", "named"), [(0.98, False), (0.985, False), (0.992, True)])
def test_a_name_is_given_where_it_is_wrong_once_in_a_hundred(probability, named):
    assert (found(probability=probability).why_not == "") is named


@pytest.mark.parametrize(("floors", "named"), [(0.4, False), (0.6, False), (0.75, True), (1.3, True)])
def test_a_name_is_given_to_half_the_power_of_the_floor_and_no_less(floors, named):
    assert (found(floors=floors).why_not == "") is named


@pytest.mark.parametrize("what", ["probability", "floors"])
def test_what_is_not_a_number_is_no_evidence(what):
    assert found(**{what: np.nan}).why_not != ""


def test_what_cannot_be_is_not_named_however_probable():
    assert found(probability=1.0, floors=100.0, inadmissible="k is at its bound").why_not == "k is at its bound"


def judged(term, model, values, columns=None, rng=None, segments=(), repeated=False):
    names = tuple(p.name for p in catalogue()[term].params if p.name in values)
    rows = None
    if columns is not None:
        rows = rows_of(rng.normal(size=columns.shape[0]), columns, SEGMENTS, names=names)
        segments = responses(SEGMENTS, columns.shape[0] // SEGMENTS)
    at = Optimum(values, {}, NOISE, 0.0)
    return inadmissible(catalogue()[term], Fitted(model, names, at, rows), segments, 30, repeated=repeated)


def test_a_pure_pole_is_at_its_usual_value_and_not_at_a_bound(rng):
    model, values = (
        Model(("linear_drag", "attitude_extra_pole")),
        {"attitude_pole_share": 1.0, "attitude_pole_tau": 0.05},
    )
    assert judged("attitude_extra_pole", model, values) == ""
    columns = rng.normal(size=(SEGMENTS * EACH, 2))  # standard errors of 0.022
    assert "bound" in judged("attitude_extra_pole", model, values | {"attitude_pole_share": -2.0}, columns, rng)


def test_a_pole_that_would_lead_is_none():
    """On a pilot's log it went to -2, its bound then, for a rate feedforward, which was refused beside it."""
    model = Model(("linear_drag", "attitude_extra_pole"))
    values = {"attitude_pole_share": -0.08, "attitude_pole_tau": 0.05}
    assert "physics does not allow" in judged("attitude_extra_pole", model, values)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_share_may_be_nothing_and_all(share):
    """Of a log of ArduPilot's own simulator the share of the lean angle went to -1, its bound, then, and the boost was refused with 154
    nats, and with it quadratic drag and axial inflow, which only show beside it."""
    model = Model(("linear_drag", "angle_boost"))
    assert judged("angle_boost", model, {"boost": 1.0, "boost_actual": share}) == ""
    assert (model.param["boost_actual"].lower, model.param["boost_actual"].upper) == (0.0, 1.0)


def test_a_coefficient_at_its_bound_is_refused_where_data_tell_it_from_its_usual_value(rng):
    model, values = Model(("vortex_ring",)), {"vortex_depth": 0.7, "vortex_centre": 5.0}
    columns = rng.normal(size=(SEGMENTS * EACH, 2))
    assert "bound" in judged("vortex_ring", model, values, columns, rng)  # 0.7 +- 0.022, usually 0.15
    # Along a ridge, centre and depth take each other's place.
    alike = columns[:, :1] + 0.05 * columns
    assert judged("vortex_ring", model, values, alike, rng) == ""


def test_a_load_of_negative_mass_and_a_length_at_its_bound_are_refused(rng):
    model = Model(("linear_drag", "slung_payload", "quadratic_drag"))
    load, drag = {"payload_ratio": 0.1, "cable_m": 1.0}, {"k_x": 0.02, "k_y": 0.02, "k_z": -0.005}
    poor = 2.0 * rng.normal(size=(SEGMENTS * EACH, 3))  # standard errors of 0.011
    assert judged("slung_payload", model, load) == ""
    assert judged("quadratic_drag", model, drag, poor, rng) == ""  # one of three, by chance
    assert "does not allow" in judged("slung_payload", model, load | {"payload_ratio": -0.03})
    assert "bound" in judged("slung_payload", model, load | {"cable_m": 15.0})
    assert "does not allow" in judged("quadratic_drag", model, drag | {"k_z": -0.1}, poor, rng)


def test_a_wind_that_only_rises_is_refused(rng):
    model, columns = Model(("steady_wind",)), rng.normal(size=(SEGMENTS * EACH, 2))  # standard errors of 0.022
    assert "without the rest" in judged("steady_wind", model, {"w_north": 0.04, "w_up": 0.5}, columns, rng)
    assert judged("steady_wind", model, {"w_north": 1.0, "w_up": 0.5}, columns, rng) == ""


@pytest.mark.parametrize(
    ("term", "limit", "error", "reached"),
    [
        ("motor_saturation", {"T_max": 0.45}, 0.02, True),
        (
            "motor_saturation",
            {"T_max": 0.45},
            0.03,
            False,
        ),  # or none: in ArduPilot's simulator 0.574 +- 0.06, and 0.6 was flown
        ("motor_saturation", {"T_max": 0.55}, 0.02, False),
        ("motor_saturation", {"T_max": 0.25}, 0.02, False),  # half of what was flown is above it, as on one pilot's log
        ("motor_saturation", {"T_max": 0.35}, 0.02, True),
        # A step of 0.4 rad asks for 20 / (2 0.5) 0.4 = 8 rad/s.
        ("rate_limit", {"rate_max": 7.0}, 0.4, True),
        ("rate_limit", {"rate_max": 7.0}, 0.6, False),
        ("rate_limit", {"rate_max": 9.0}, 0.4, False),
        ("reference_shaping", {}, 0.0, True),
    ],
)
def test_a_limit_that_nothing_or_nearly_everything_went_beyond_is_none(term, limit, error, reached):
    t = np.linspace(0.0, 1.0, 21)
    roll = np.where(t < 0.5, 0.0, 0.4 * (1 - np.exp(-(t - 0.5) / 0.1)))
    throttle = (np.array([0.0, 0.3, 0.8]), np.array([0.2, 0.3, 0.5]))  # 30 % at 0.2, half at 0.3
    references = {"roll_ref_rad": (np.array([0.0, 0.5]), np.array([0.0, 0.4])), "throttle": throttle}
    step = SimpleNamespace(t_s=t, y={"roll_rad": roll}, u=references)
    values = {"omega_phi": 20.0, "zeta_phi": 0.5, **limit}
    found = EstimatedModel(tuple(limit), values, lambda: dict.fromkeys(limit, error), [step])
    assert (outside_prior(catalogue()[term], found, 3.0) == "") is reached


@pytest.mark.parametrize(("trim", "refused"), [(0.0, False), (1.33, False), (2.1, True), (5.8, True)])
def test_moments_that_are_gone_faster_than_an_integrator_trims_them_are_dynamics_of_the_loop(trim, refused):
    """Under the real firmware, without any moments of the air, they were named in three of six flights (193 to 291 nats, trimmed at 3.7 to
    5.8 1/s). Integral gains are at most 1.33 times the proportional ones (PX4)."""
    model = Model(("linear_drag", "airflow_moment"))
    param = model.param["moment_trim_1_s"]
    values = {"m_u": 3.0, "l_v": 3.0, "m_w": 0.1, "l_w": 0.1, param.name: min(trim, param.upper)}
    assert ("bound" in judged("airflow_moment", model, values, repeated=True)) is refused


def test_a_time_constant_too_short_to_be_seen_leaves_shaping_what_it_is():
    """With 19,700 nats reference shaping was refused on a part of a firmware's log for 0.02 s, and a rate limit of 276 nats named."""
    model = Model(("linear_drag", "reference_shaping"))
    values = {"shaping_accel": 70.0, "shaping_tc": 0.02, "shaping_ff": 0.13}
    assert judged("reference_shaping", model, values, repeated=True) == ""
    assert "bound" in judged("reference_shaping", model, values)
    assert "bound" in judged("reference_shaping", model, values | {"shaping_tc": 0.6}, repeated=True)
    assert "bound" in judged("reference_shaping", model, values | {"shaping_accel": 400.0}, repeated=True)


def test_a_time_constant_that_is_not_distinguished_from_none_is_refused_where_nothing_was_repeated(rng):
    """In eight of 24 flights of a laboratory whose autopilot shapes nothing, shaping was named with 0.02 to 0.036 +- 0.04 to 0.16 s: only
    its feedforward was determined."""
    model, values = Model(("linear_drag", "reference_shaping")), {"shaping_accel": 20.0, "shaping_ff": 1.0}
    columns = rng.normal(size=(SEGMENTS * EACH, 3))  # standard errors of 0.022
    order = {name: values.get(name, 0.06) for name in ("shaping_accel", "shaping_tc", "shaping_ff")}
    assert "may be its bound" in judged("reference_shaping", model, order, columns, rng)
    assert judged("reference_shaping", model, order | {"shaping_tc": 0.07}, columns, rng) == ""
    assert judged("reference_shaping", model, order, columns, rng, repeated=True) == ""


def test_what_improves_no_prediction_of_unused_steps_is_not_named():
    assert found().why_not == ""
    assert "not used" in replace(found(), improved=()).why_not
    assert replace(found(), worsened=("f_x_m_s2",)).why_not == ""
    assert "worse" in replace(found(), worsened=("f_x_m_s2", "v_x_m_s")).why_not


@pytest.mark.parametrize(("second", "share"), [(3.0, 0.6), (1.2, 0.2), (0.9, 0.2)])
def test_what_stays_is_counted_where_it_was_as_large_as_the_floor(second, share):
    """Of one channel a fifth of the excess over the floor stays, of the other all of it."""
    channel, floor = np.tile([0, 1], 500), NoiseFloor({"f_z_m_s2": 1.0, "v_z_m_s": 1.0}, frozenset(), {})
    before, after = (
        rows_of(np.where(channel == 0, of_first, second), np.zeros((1000, 0)), 20, channel=channel)
        for of_first in (np.sqrt(6.0), np.sqrt(2.0))
    )
    assert share_left(before, after, floor) == pytest.approx(share)
    assert share_left(after, after, NoiseFloor({"f_z_m_s2": 5.0, "v_z_m_s": 5.0}, frozenset(), {})) == 0.0


def test_of_few_groups_all_but_any_one_have_to_be_predicted_better(rng):
    """No sign test of five groups reaches 2.5 %. Of three flights one had a ground effect of 137 nats, the others -2 and -5."""
    rows = rows_of(np.zeros(1000), np.zeros((1000, 0)), 20)
    group = np.arange(20) % 3

    def gains(*nats):
        per_row = np.asarray(nats)[group[rows.segment]] / np.bincount(group[rows.segment])[group[rows.segment]]
        return stratum_gains(CrossValidation(rows, 2.0 * per_row), CrossValidation(rows, np.zeros(1000)), group)

    assert gains(137.0, -2.0, -5.0)["f_z_m_s2"] == pytest.approx((-7.0, 135.0))
    assert gains(137.0, -2.0, 5.0)["f_z_m_s2"] == pytest.approx((3.0, 142.0))
    assert gains(-137.0, 2.0, 5.0)["f_z_m_s2"][1] == pytest.approx(-130.0 + 137.0)
    one, other = (CrossValidation(rows, f * rng.normal(size=1000) ** 2) for f in (1.0, 0.1))
    assert stratum_gains(one, other, np.zeros(20, dtype=np.intp)) == {}
    fifth, all_five = 0.5 * (one.deviance - other.deviance), np.arange(20)[rows.segment] % 5
    each = np.bincount(all_five[rows.stratum == 0], fifth[rows.stratum == 0])
    assert stratum_gains(one, other, np.arange(20) % 5)["f_z_m_s2"] == pytest.approx(
        (each.sum() - each.max(), each.sum() - each.min())
    )
    sixth = stratum_gains(one, other, np.arange(20) % 6)["f_z_m_s2"]
    assert 0.0 < sixth[0] < sixth[1]


def test_what_was_not_used_is_predicted_by_both_models_in_the_noise_of_the_larger(rng):
    """By its own noise each of two models has other initial states: a sideward velocity, which a lag of the thrust cannot touch, was 28 %
    worse with it."""
    x = rng.normal(size=(1000, 2))
    larger, smaller = fitted(x[:, 0], x, ("p0", "p1")), fitted(x[:, 0], x[:, :1], ("p0",))
    own = replace(smaller, at=replace(smaller.at, noise=replace(NOISE, channel={"f_z_m_s2": 3.0})))
    asked = []

    def linearise(_model, at, _names):
        asked.append(at.noise)
        return smaller.rows

    before, after = held_out_errors(own, larger, SimpleNamespace(linearise=linearise), GROUPS)
    assert asked == [larger.at.noise]
    assert (before.rows, after.rows) == (smaller.rows, larger.rows)


def test_an_estimate_that_may_be_nothing_is_not_named():
    assert replace(found(), nothing="k is 0.1 +- 0.2 1, which may be nothing").why_not.endswith("may be nothing")


def test_better_predictions_count_where_a_term_acts(rng):
    """Thrust fade was named for horizontal disturbances, which it does not touch."""
    rows = rows_of(rng.normal(size=1000), np.zeros((1000, 0)), channel=np.arange(1000) % 2)
    little, much = 0.08 * (rows.stratum == 0), 0.09 * (rows.stratum == 0)  # squares of 500 samples: 3.2 and 4.05
    for added, shown in ((little, False), (much, True)):
        change = change_by_stratum(replace(rows, residual=rows.residual + added), rows)
        assert [visible(change.get(channel)) for channel in rows.channels] == [shown, False]
