"""The one estimator: its derivatives, what it profiles out, where its fits end, and what it takes for a disturbance."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from flighttest.estimation.estimator import COMPARED, Estimator
from flighttest.estimation.gauss_newton import Tolerances
from flighttest.estimation.likelihood_weights import LikelihoodWeights, State, start_noise, variance_between_repeats
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise, prior_std
from flighttest.estimation.solver import solve
from flighttest.identify.fit import default_model
from flighttest.identify.selection import able
from tests.diagnose.flight import TRUE, Step, campaign, fly

FREE = ("sigma_t", "K", "d_z", "T_d_thrust")
# By a delay the derivative is that of the continuous solution, which RK4 steps of 25 ms follow to a thousandth.
SHARP = {"sigma_t": 1e-5, "K": 1e-5, "d_z": 1e-5, "T_d_thrust": 3e-3}


@pytest.fixture(scope="module")
def throttled():
    """Six throttle steps and their estimator."""
    segments = tuple(fly(campaign(1, tilts=False, yaws=False)))[:6]
    return Estimator(segments, "translation", able), default_model(segments)


@pytest.fixture(scope="module")
def point(throttled):
    """Anywhere: parameters, initial states and disturbances off their optimum."""
    estimator, model = throttled
    problem = estimator.problem(model)
    values = problem.full_values({"sigma_t": 24.0, "K": 52.0, "T_d_thrust": 0.1043})
    rng = np.random.default_rng(0)
    nuisance = {n: np.full(len(estimator.segments), np.nan) for part in problem.parts for n in part.locals}
    noise = start_noise(problem)
    for part in problem.parts:
        moved = part.start_local() + 0.5 * rng.normal(size=(*part.start.shape[:1], 1)) * prior_std(part, noise)
        for k, name in enumerate(part.locals):
            nuisance[name][[r.index for r in part.responses]] = moved[:, k]
    return Optimum(values, nuisance, noise, np.inf)


def raw(estimator, model, at, nuisance=None):
    """Residuals and prior residuals of every response, whitened, one array per response, straight from the definition."""
    problem = estimator.problem(model)
    local = nuisance if nuisance is not None else problem.placed(at.nuisance)
    found = []
    for part, made, l_i in zip(problem.parts, problem.evaluate(at.values, local), local, strict=True):
        std = np.array([at.noise.channel[c] for c in part.outputs])
        prior = (part.start_local() - l_i) / prior_std(part, at.noise)
        found += [np.concatenate([(r / std).ravel(), p]) for r, p in zip(made.residual, prior, strict=True)]
    return found


def differences(estimator, model, at, names):
    """Per response (n, p) and (n, n_l): minus the derivatives of its rows, by central differences."""
    by_parameter = []
    for name in names:
        h = 1e-5 * model.param[name].scale
        up, down = (
            raw(estimator, model, replace(at, values=at.values | {name: at.values[name] + s * h})) for s in (1, -1)
        )
        by_parameter.append([-(u - d) / (2 * h) for u, d in zip(up, down, strict=True)])
    problem = estimator.problem(model)
    local = problem.placed(at.nuisance)
    by_local = []
    for k in range(local[0].shape[1]):
        moved = []
        for s in (1, -1):
            there = [x.copy() for x in local]
            for x in there:
                x[:, k] += s * 1e-5
            moved.append(raw(estimator, model, at, there))
        by_local.append([-(u - d) / 2e-5 for u, d in zip(*moved, strict=True)])
    responses = range(len(by_parameter[0]))
    return [
        (np.stack([c[i] for c in by_parameter], axis=1), np.stack([c[i] for c in by_local], axis=1)) for i in responses
    ]


def test_the_jacobian_is_that_of_finite_differences(throttled, point):
    estimator, model = throttled
    rows = estimator.linearise(model, point, FREE)
    for k, name in enumerate(FREE):
        h = 1e-4 * model.param[name].scale
        ends = [estimator.moved(model, point, {name: point.values[name] + s * h}) for s in (-0.5, 0.5)]
        change = next(estimator.differences(model, ends[0], [(model, ends[1].values)]))
        profiled, unprofiled = rows.profiled(change), rows.unprofiled(change)
        size = float(np.max(np.abs(rows.jacobian[:, k])))
        np.testing.assert_allclose(profiled[:, 0] / h, rows.jacobian[:, k], atol=SHARP[name] * size)
        size = float(np.max(np.abs(rows.unprofiled_jacobian[:, k])))
        np.testing.assert_allclose(unprofiled[:, 0] / h, rows.unprofiled_jacobian[:, k], atol=SHARP[name] * size)


def test_inner_products_are_the_schur_complement(throttled, point):
    estimator, model = throttled
    rows = estimator.linearise(model, point, FREE)
    gram, moment, square = np.zeros((len(FREE), len(FREE))), np.zeros(len(FREE)), 0.0
    for (a, b), r in zip(differences(estimator, model, point, FREE), raw(estimator, model, point), strict=True):
        h_ll, h_pl = b.T @ b, a.T @ b  # the priors are rows of b
        gram += a.T @ a - h_pl @ np.linalg.solve(h_ll, h_pl.T)
        moment += a.T @ r - h_pl @ np.linalg.solve(h_ll, b.T @ r)
        square += r @ r - (b.T @ r) @ np.linalg.solve(h_ll, b.T @ r)
    length, sharp = np.sqrt(np.diag(gram)), np.array([SHARP[n] for n in FREE])
    wrong = (rows.jacobian.T @ rows.jacobian - gram) / np.outer(length, length)
    assert np.all(np.abs(wrong) < np.maximum.outer(sharp, sharp))
    assert np.all(np.abs(rows.jacobian.T @ rows.residual - moment) / (length * np.sqrt(square)) < sharp)
    assert rows.residual @ rows.residual == pytest.approx(square, rel=1e-6)


def test_a_fit_ends_where_scipys_does(throttled):
    estimator, model = throttled
    names = ("sigma_t", "K", "d_z")
    start = estimator.start(model, {"K": 50.0, "sigma_t": 25.0, "T_d_thrust": 0.1003})
    found = estimator.fit(model, start, names, noise=False)
    problem = estimator.problem(model)
    local = problem.placed(start.nuisance)
    spread = [prior_std(p, start.noise).ravel() for p in problem.parts]
    scale = np.concatenate([[model.param[n].scale for n in names], *spread])

    def residuals(x):
        x = x * scale
        values = start.values | dict(zip(names, x, strict=False))
        there, at = [], len(names)
        for one in local:
            there.append(x[at : at + one.size].reshape(one.shape))
            at += one.size
        return np.concatenate(raw(estimator, model, replace(start, values=values), there))

    begun = np.concatenate([[start.values[n] for n in names], *(x.ravel() for x in local)]) / scale
    best = least_squares(residuals, begun)
    assert found.objective == pytest.approx(2 * best.cost, rel=1e-4)
    error = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))[: len(names)] * scale[: len(names)]
    for name, value, std in zip(names, best.x * scale, error, strict=False):
        assert found.values[name] == pytest.approx(value, abs=0.1 * std), name


def test_what_repeats_have_in_common_is_no_disturbance():
    steps = campaign(3, tilts=False, yaws=False)
    cells = {str(s.cell): k % 2 for k, s in enumerate(campaign(1, tilts=False, yaws=False))}
    pushed = [k for k, s in enumerate(steps) if cells[str(s.cell)]]
    segments = tuple(fly(steps, gust=(pushed, 1.0)))
    estimator, model = Estimator(segments, "translation", able), default_model(segments)
    found = estimator.fit(model, estimator.start(model, {"T_d_thrust": 0.1003}), FREE)
    # Half the cells are pushed by 1 m/s^2, and repeats differ by 0.05 m/s^2.
    assert found.noise.disturbance["a_d_x_m_s2"] == pytest.approx(0.05, abs=0.025)
    rows = estimator.linearise(model, found, FREE)
    push = rows.residual[rows.stratum == rows.strata.index("a_d_x_m_s2")]
    assert np.sqrt(np.mean(push**2)) > 3.0


def test_what_windows_of_free_flight_have_in_common_is_no_disturbance():
    """Hops of a small vehicle were fitted with a gain 17 % above the one that held it in the air, and 1.6 m/s^2 of disturbance in every
    window: a curved throttle bends all of them alike."""
    hover = TRUE["g"] / TRUE["K"]
    throttles = [(hover * (1 - x), hover * (1 + x)) for x in (0.1, -0.1, 0.15, -0.15)] * 4
    steps = [Step("throttle_step", {}, 2.2, throttle=pair, voltage=TRUE["U_n"]) for pair in throttles]
    segments = tuple(replace(s, kind="free") for s in fly(steps, curve=0.3))
    estimator, model = Estimator(segments, "translation", able), default_model(segments)
    found = estimator.fit(model, estimator.start(model, {"T_d_thrust": 0.1003}), FREE)
    # Windows differ by 0.05 m/s^2, and the accelerometer's noise is 0.1 m/s^2: what the curve does stays in the residual.
    assert found.noise.disturbance["a_d_z_m_s2"] < 0.2
    assert found.noise.channel["f_z_m_s2"] > 0.13
    assert found.values["K"] == pytest.approx(1.1 * TRUE["K"], rel=0.04)


def test_the_variance_between_repeats_is_that_of_a_one_way_analysis():
    rng = np.random.default_rng(1)
    cells = np.repeat(np.arange(12), 3)
    values = rng.normal(0, 5.0, 12)[cells] + rng.normal(0, 0.3, 36)
    within = sum(np.sum((values[cells == c] - values[cells == c].mean()) ** 2) for c in range(12)) / 24
    assert variance_between_repeats(values, np.ones(36), cells, 99.0) == pytest.approx(within)


@pytest.mark.parametrize(("repeats", "known"), [(7, False), (8, True)])
def test_of_few_repeats_no_variance_is_taken(repeats, known):
    cells = np.r_[np.zeros(repeats + 1, dtype=int), 1, 2]
    values = np.r_[np.tile([0.1, -0.1], repeats)[: repeats + 1], 5.0, -5.0]
    assert (variance_between_repeats(values, np.ones(values.size), cells, 99.0) < 1.0) is known


@pytest.mark.parametrize(("power", "held"), [(0.6, True), (1.6, False)])
def test_a_parameter_whose_usual_change_is_below_one_samples_noise_is_held(throttled, power, held):
    estimator, model = throttled
    at = estimator.start(model)
    total = sum(
        float(np.sum((one[..., 0] / np.tile([at.noise.channel[c] for c in part.outputs], part.y.shape[1])) ** 2))
        for part, one in zip(estimator.problem(model).parts, estimator.derivatives(model, at, ["alpha"]), strict=True)
    )
    louder = np.sqrt(total * model.param["alpha"].scale ** 2 / power)
    noise = replace(at.noise, channel={c: v * louder for c, v in at.noise.channel.items()})
    assert ("alpha" in estimator.insensitive(model, replace(at, noise=noise))) is held


def test_from_where_the_simulation_is_not_finite_nothing_is_tried():
    segments = tuple(fly(campaign(1, yaws=False)))
    estimator, model = Estimator(segments, "translation", able), default_model(segments)
    far = estimator.start(model, {"K": 1e200})
    assert not np.isfinite(far.objective)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert estimator.fit(model, far, ("K", "sigma_t")) is far
    near = estimator.fit(model, estimator.start(model, {"K": 40.0}), ("K", "sigma_t"))
    assert np.isfinite(near.objective)
    assert near.values["K"] > 45.0


def test_an_estimator_distinguishes_models_by_all_that_they_are(throttled):
    estimator, model = throttled
    assert estimator.problem(model) is estimator.problem(replace(model))
    others = [
        replace(model, nominal_voltage_v=11.1),
        replace(model, rotor_height_m=0.5),
        model.with_terms("ground_effect"),
    ]
    assert len({id(estimator.problem(m)) for m in (model, *others)}) == 4


def test_variances_and_disturbances_are_found_together(throttled):
    estimator, model = throttled
    problem = estimator.problem(model)
    found = solve(problem, robust=False)
    state = State(np.zeros(0), list(found.local), problem.evaluate(found.values, found.local, FREE))
    loud = Noise({c: 4.0 * std for c, std in found.noise.channel.items()}, dict(found.noise.disturbance))
    once = LikelihoodWeights.even(problem, loud, robust=False).with_noise_of(state, FREE)
    twice = once.with_noise_of(state, FREE)
    assert once.noise.channel["f_z_m_s2"] < 0.3 * loud.channel["f_z_m_s2"]
    assert twice.noise.channel == pytest.approx(once.noise.channel, rel=0.01)
    assert twice.noise.disturbance == pytest.approx(once.noise.disturbance, rel=0.02)


def test_between_two_steps_a_channels_noise_falls_to_half_of_its_residual_at_most(throttled, monkeypatch):
    estimator, model = throttled
    problem = estimator.problem(model)
    found = solve(problem, robust=False)
    # A gain half as large again, which disturbances without bounds would explain nearly whole.
    local = [part.start_local() for part in problem.parts]
    state = State(np.zeros(0), local, problem.evaluate({**found.values, "K": 1.5 * found.values["K"]}, local, FREE))
    wide = Noise(dict(found.noise.channel), dict.fromkeys(found.noise.disturbance, 50.0))

    def learned():
        return np.array(
            list(LikelihoodWeights.even(problem, wide, robust=False).with_noise_of(state, FREE).noise.channel.values())
        )

    half = learned()
    monkeypatch.setattr("flighttest.estimation.likelihood_weights.LEAST_LEFT", 1.0)
    assert (half / learned()).min() == pytest.approx(0.5)


def test_models_are_compared_at_optima_that_are_known_to_a_fraction_of_a_nat(throttled, monkeypatch):
    estimator, model = throttled
    start = estimator.start(model, {"K": 70.0, "sigma_t": 8.0, "T_d_thrust": 0.02, "d_z": 0.1})
    noise = estimator.fit(model, start, estimator.problem(model).names).noise
    begun = replace(start, noise=noise)

    def likelihood(tolerances):
        monkeypatch.setattr("flighttest.estimation.estimator.COMPARED", tolerances)
        return estimator.fit(model, begun, estimator.problem(model).names, noise=False).log_likelihood

    sharp = likelihood(Tolerances(step=1e-3, decrease=1e-6))
    assert sharp - likelihood(COMPARED) < 0.3
    for loose in (
        replace(COMPARED, step=30.0),
        replace(COMPARED, decrease=1e5),
    ):  # a step of Gauss-Newton forgives less
        assert sharp - likelihood(loose) > 0.3


def test_the_step_of_integration_resolves_the_lag_that_a_fit_has_arrived_at(throttled):
    """It was that of the start values: at 50 Hz, a lag that a fit took to 150 1/s was integrated by steps of 20 ms, which diverge."""
    estimator, model = throttled
    fast = {"sigma_t": 150.0}
    begun = estimator.problem(model)
    for one, other in zip(begun.evaluate(fast), replace(begun, values=begun.values | fast).evaluate(fast), strict=True):
        assert np.array_equal(one.residual, other.residual)
