"""The integrator of the fit: against closed forms, its derivatives against differences, its filter against scipy's."""

import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lsim

from flighttest.estimation.integration.filters import forced_response, free_response
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.interpolation import between_samples
from flighttest.estimation.responses import MAX_STEP_S, Response, Stacked
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.physics.simulate import rk4_stages
from tests.identify.campaign import TRUTH, first_order, second_order

BLOCKS = {b.name: b for b in Model().blocks}


def nodes_of(response, delay_s, step_s=MAX_STEP_S):
    """Nodes (k, n_data) of one response for a delay, and the node of each sample (n,)."""
    found = Stacked.of([response]).nodes(delay_s, step_s)
    return found.rows, found.sample


def response(t, edges, values, e=None, n_states=4):
    exogenous = np.zeros((t.size, 0)) if e is None else e
    start = np.zeros(n_states)
    return Response(
        0, t, np.zeros((t.size, 1)), np.array(edges), np.array(values)[:, None], exogenous, start, start + 1
    )


def parameters(block, delay):
    values = {**Model().start(), "T_d_attitude": delay, "T_d_yaw_rate": delay, "T_d_thrust": delay}
    return np.array([values[n] for n in block.params])


def irregular(rng, n=120):
    return np.cumsum(rng.uniform(0.005, 0.035, n))


def test_roll_step_with_an_edge_between_irregular_samples_is_the_closed_form():
    block, delay = BLOCKS["roll"], 0.0837
    t = irregular(np.random.default_rng(1))
    r = response(t, [-9.0, 0.3011, 1.2], [0.0, 0.3, -0.1])
    kernel = Kernel(block, block.outputs, ())
    nodes, sample = nodes_of(r, delay, 0.01)
    y, _ = kernel.run(parameters(block, delay), np.zeros((1, 3)), nodes[None], False)
    exact = second_order(
        t, [(-9, 0.0), (0.3011 + delay, 0.3), (1.2 + delay, -0.1)], TRUTH["omega_phi"], TRUTH["zeta_phi"]
    )
    assert np.allclose(y[0, sample, 0], exact, atol=3e-5)


def test_an_edge_exactly_on_a_sample_parts_old_from_new():
    block = BLOCKS["yaw"]
    t = np.arange(50) * 0.02
    r = response(t, [-9.0, 0.1], [0.0, 1.0])
    kernel = Kernel(block, block.outputs, ("T_d_yaw_rate",))
    nodes, sample = nodes_of(r, 0.1, 0.01)
    y, dy = kernel.run(parameters(block, 0.1), np.zeros((1, 2)), nodes[None], True)
    assert np.allclose(y[0, sample, 0], first_order(t, [(-9, 0.0), (0.2, 1.0)], TRUTH["sigma_r"]), atol=1e-4)
    after = t > 0.2 + 1e-9
    slope = -TRUTH["sigma_r"] * np.exp(-TRUTH["sigma_r"] * (t[after] - 0.2))
    assert np.allclose(dy[0, sample, 0, 0][after], slope, rtol=5e-3, atol=1e-4)


@pytest.mark.parametrize("filtered", [False, True])
def test_sensitivities_are_those_of_differences(filtered):
    block = BLOCKS["translation"]
    rng = np.random.default_rng(3)
    t = np.arange(60) * 0.02
    signals = {
        "roll_rad": 0.3 * np.sin(5 * t),
        "pitch_rad": 0.2 * np.cos(4 * t),
        "yaw_rad": t,
        "voltage_v": 23 + 0.1 * t,
    }
    e = np.stack([signals[n] for n in block.exogenous], axis=1)
    r = response(t, [-9.0, 0.2213, 0.7131], [0.15, 0.35, 0.1], e)
    outputs = block.outputs[:6]
    cutoffs = dict.fromkeys(outputs[:3], 20.0) if filtered else {}
    kernel = Kernel(block, outputs, block.params, cutoffs)
    delay, local = 0.0937, np.concatenate([[1.0, -2.0, 0.5, 9.0], 0.2 * rng.standard_normal(3)])[None]
    p = parameters(block, delay)

    def run(p, local):
        nodes, sample = nodes_of(r, p[block.params.index("T_d_thrust")])
        y, dy = kernel.run(p, local, nodes[None], True)
        return y[0, sample], dy[0, sample]

    _, slopes = run(p, local)
    for k, name in enumerate((*kernel.free, *kernel.locals)):
        step = 1e-5
        p_up, p_down, l_up, l_down = p.copy(), p.copy(), local.copy(), local.copy()
        if k < len(kernel.free):
            at = block.params.index(name)
            p_up[at] += step
            p_down[at] -= step
        else:
            l_up[0, k - len(kernel.free)] += step
            l_down[0, k - len(kernel.free)] -= step
        difference = (run(p_up, l_up)[0] - run(p_down, l_down)[0]) / (2 * step)
        # Of the delay the derivative is that of the continuous solution, of the others that of the RK4 steps.
        tolerance = 0.002 * np.abs(difference).max() if name == "T_d_thrust" else 1e-6 * (1 + np.abs(difference).max())
        assert np.allclose(slopes[..., k], difference, atol=tolerance), name


def test_known_filter_is_the_butterworth_of_scipy():
    block = BLOCKS["translation"]
    p = parameters(block, 0.05)
    local = np.array([[0.0, 0.0, 0.0, Model().start()["K"] * 0.1, 0.0, 0.0, 0.0]])

    def run(t, cutoffs):
        e = np.tile([0.0 if n != "voltage_v" else 22.2 for n in block.exogenous], (t.size, 1))
        nodes, sample = nodes_of(response(t, [-9.0, 0.2043], [0.1, 0.4], e), 0.05)
        return Kernel(block, ("f_z_m_s2",), (), cutoffs).run(p, local, nodes[None], False)[0][0, sample, 0]

    t, fine = np.arange(50) * 0.02, np.arange(0.0, 0.99, 1e-3)
    ours, raw, unfiltered = run(t, {"f_z_m_s2": 20.0}), run(fine, {}), run(t, {})
    w = 2 * np.pi * 20.0
    _, y, _ = lsim(([w * w], [1, np.sqrt(2) * w, w * w]), raw - raw[0], fine)
    assert np.abs(ours - unfiltered).max() > 0.5
    assert np.allclose(ours, np.interp(t, fine, y) + raw[0], atol=0.01)


def test_results_do_not_depend_on_who_else_is_in_the_batch():
    block = BLOCKS["roll"]
    t = np.arange(70) * 0.02
    nodes = [nodes_of(response(t, [-9.0, 0.1 + 0.01 * k], [0.0, 0.3]), 0.1)[0] for k in range(7)]
    kernel = Kernel(block, block.outputs, block.params)
    p = parameters(block, 0.1)
    together = kernel.run(p, np.zeros((7, 3)), np.stack(nodes), True)[1]
    alone = [kernel.run(p, np.zeros((1, 3)), n[None], True)[1][0] for n in nodes]
    assert np.array_equal(together, np.stack(alone))


def stepped_load(t):
    return np.where(t < 1.03, 5.0, 5.0 + 11.0 * (1 - np.exp(-20 * np.clip(t - 1.03, 0, None))))


@pytest.mark.parametrize("phase", [0.0, 0.03, 0.06])
def test_a_slow_voltage_follows_the_load_between_its_samples(phase):
    rng = np.random.default_rng(4)
    t = np.arange(100) * 0.02
    true = 23.5 - 0.012 * stepped_load(t) ** 1.5
    slow = np.arange(phase - 0.5, 2.5, 0.1)
    samples = slow, 23.5 - 0.012 * stepped_load(slow) ** 1.5 + 0.01 * rng.standard_normal(slow.size)
    chord = np.interp(t, *samples)
    force = stepped_load(t - 0.01) + 0.1 * rng.standard_normal(t.size)
    found = between_samples(t, chord, samples, force, 0.01)
    assert np.abs(chord - true).max() > 0.08
    assert np.abs(found - true).max() < 0.04
    assert abs(np.mean(found - true)) < 0.006
    here = (slow >= t[0]) & (slow <= t[-1])
    at_samples = between_samples(slow[here], samples[1][here], samples, np.interp(slow[here], t, force), 0.01)
    np.testing.assert_allclose(at_samples, samples[1][here], atol=1e-9)  # what was measured stands


def test_the_voltage_of_a_fast_monitor_and_of_few_samples_is_taken_as_it_is():
    t = np.arange(100) * 0.02
    chord = 23.0 + 0.1 * np.sin(9 * t)
    force = stepped_load(t)
    for samples in ((t, chord), (t[:60:15], chord[:60:15])):
        assert between_samples(t, chord, samples, force, 0.01) is chord


def whole_chain(kernel, n_nodes, delay_s):
    """The same as one long expression, which CasADi differentiates as a whole. delay_s: of the inputs that the nodes were made for; what a
    later edge adds to the state is added where they change, and is nothing at this delay."""
    block = kernel.block
    x0, p, d = (
        ca.SX.sym(n, len(g)) for n, g in zip("xpd", (block.states, block.params, block.disturbances), strict=True)
    )
    n_u, n_e = len(block.inputs), len(block.exogenous)
    nodes = ca.SX.sym("nodes", 1 + n_u + 2 * n_e, n_nodes)
    x, rows, z, later = x0, [], None, block.delay_s(p) - delay_s
    for k in range(n_nodes):
        node = nodes[:, k]
        h, u, e0, e1 = node[0], node[1 : 1 + n_u], node[1 + n_u : 1 + n_u + n_e], node[1 + n_u + n_e :]
        if k:
            kept, new = (block.function(x, p, inputs, e0, d)[0] for inputs in (nodes[1 : 1 + n_u, k - 1], u))
            x = x + later * (kept - new)
        ends = (e0, 0.5 * (e0 + e1), e1)
        after, k1, k4 = rk4_stages(lambda at, e, u=u: block.function(at, p, u, e, d)[0], x, h, ends)
        middle = 0.5 * (x + after) + h / 8 * (k1 - k4)
        y0, ym, y1 = (block.function(at, p, u, e, d)[1] for at, e in zip((x, middle, after), ends, strict=True))
        y = ca.SX(y1[[block.outputs.index(n) for n in kernel.outputs]])
        z = z or {n: (y0[block.outputs.index(n)], ca.SX(0)) for n in kernel.filters_hz}
        for n, hz in kernel.filters_hz.items():
            i, w, (now, rate) = block.outputs.index(n), 2 * np.pi * hz, z[n]
            free, forced = free_response(ca, w, h), forced_response(w, (y0[i], ym[i], y1[i]), h, ca)
            z[n] = forced[0] + free[0] * now + free[1] * rate, forced[1] + free[2] * now + free[3] * rate
            y[kernel.outputs.index(n)] = z[n][0]
        rows.append(y)
        x = after
    free_x = [block.states.index(n) for n in block.free_states]
    columns = ca.vertcat(*(p[block.params.index(n)] for n in kernel.free), *(x0[i] for i in free_x), d)
    every = ca.vertcat(*rows)
    return ca.Function("whole", [x0, p, d, nodes], [every, ca.densify(ca.jacobian(every, columns))])


@pytest.mark.parametrize("term", ["", *sorted(catalogue())])
def test_states_and_slopes_are_those_of_one_long_expression_differentiated_as_a_whole(term):
    model = Model().with_terms(term) if term else Model()
    rng = np.random.default_rng(5)
    values = model.start()
    values |= {p.name: values[p.name] + 0.05 * p.scale for p in model.params if model.term_of(p.name) == term}
    for block in model.blocks:
        outputs = block.outputs[:6]
        kernel = Kernel(block, outputs, block.params, {n: 20.0 for n in outputs if n.startswith("f_")})
        m, k = 2, 6
        p = np.array([values[n] for n in block.params])
        local = rng.normal(0.0, 0.3, (m, len(kernel.locals)))
        signals = {"voltage_v": 23.0, "height_m": 1.3, "time_s": 20.0}
        e = np.array([signals.get(n, 0.2) for n in block.exogenous]) + rng.normal(
            0.0, 0.05, (m, k + 1, len(block.exogenous))
        )
        u = rng.uniform(0.15, 0.3, (m, k, len(block.inputs)))
        u[:, 3] = u[:, 2]  # no edge between these
        nodes = np.concatenate([rng.uniform(0.01, 0.02, (m, k, 1)), u, e[:, :-1], e[:, 1:]], axis=2)
        y, dy = kernel.run(p, local, nodes, True)
        assert np.array_equal(y, kernel.run(p, local, nodes, False)[0])
        whole = whole_chain(kernel, k, float(block.delay_s(p)))
        for j in range(m):
            start = np.array([block.initial.get(n, 0.0) for n in block.states])
            start[[block.states.index(n) for n in block.free_states]] = local[j, : len(block.free_states)]
            exact, slopes = whole(start, p, local[j, len(block.free_states) :], nodes[j].T)
            np.testing.assert_allclose(y[j].ravel(), np.asarray(exact).ravel(), rtol=1e-9, atol=1e-9)
            slopes = np.asarray(slopes).reshape(k * len(outputs), -1)
            size = np.abs(slopes).max(axis=0) + 1e-9
            np.testing.assert_allclose(dy[j].reshape(slopes.shape) / size, slopes / size, atol=1e-9)


def test_what_was_compiled_of_a_block_does_not_follow_it_elsewhere():
    block = BLOCKS["yaw"]
    nodes = nodes_of(response(np.arange(40) * 0.02, [-9.0, 0.1], [0.0, 1.0]), 0.1)[0][None]
    here = Kernel(block, block.outputs, block.params).run(parameters(block, 0.1), np.zeros((1, 2)), nodes, True)
    assert block.made
    sent, other = pickle.loads(pickle.dumps(block)), replace(block, initial={**block.initial})
    assert not sent.made
    assert not other.made
    there = Kernel(sent, sent.outputs, sent.params).run(parameters(sent, 0.1), np.zeros((1, 2)), nodes, True)
    assert np.array_equal(here[1], there[1])
