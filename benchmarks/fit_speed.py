"""How fast the joint fit is, against two usual ways to write it, in one run: `python -m benchmarks.fit_speed [--quick]`.

(a) the same thrust-and-drag problem as one single-shooting sum of squares for IPOPT, as in CasADi's own system identification example;
(b) scipy's least_squares with finite differences over solve_ivp, on a smaller problem (vertical motion, thrust steps, no disturbances).
Then the cost against the number of responses, and two fits in two processes against one after the other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from flighttest.estimation.likelihood_weights import start_noise
from flighttest.estimation.problem import Problem, prior_std
from flighttest.estimation.responses import Stacked, zero_order_hold
from flighttest.estimation.solver import Start, solve
from flighttest.frames import G_M_S2
from flighttest.identify.fit import fit
from flighttest.identify.selection import problem_of
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.physics.simulate import rk4_stages
from flighttest.segments.model import Segment
from tests.identify.campaign import campaign


def timed(action: Callable[[], object]) -> tuple[float, object]:
    began = time.perf_counter()
    result = action()
    return time.perf_counter() - began, result


def single_shooting(block: Block, outputs: tuple[str, ...], k: int) -> ca.Function:
    """Outputs (n, k) after each of k pieces, of parameters, locals (initial states, disturbances) and nodes: one long expression."""
    x, p, d = (
        ca.SX.sym("x", len(block.states)),
        ca.SX.sym("p", len(block.params)),
        ca.SX.sym("d", len(block.disturbances)),
    )
    n_u, n_e = len(block.inputs), len(block.exogenous)
    node = ca.SX.sym("node", 1 + n_u + 2 * n_e)
    h, u, e0, e1 = node[0], node[1 : 1 + n_u], node[1 + n_u : 1 + n_u + n_e], node[1 + n_u + n_e :]
    after, _, _ = rk4_stages(lambda x, e: block.function(x, p, u, e, d)[0], x, h, (e0, 0.5 * (e0 + e1), e1))
    y = block.function(after, p, u, e1, d)[1][[block.outputs.index(n) for n in outputs]]
    step = ca.Function("step", [x, p, d, node], ca.cse([after, y]))
    p, local, nodes = (
        ca.MX.sym("p", p.numel()),
        ca.MX.sym("l", x.numel() + d.numel()),
        ca.MX.sym("nodes", node.numel(), k),
    )
    state, rows = local[: x.numel()], []
    for column in ca.horzsplit(nodes):
        state, made = step(state, p, local[x.numel() :], column)
        rows.append(made)
    return ca.Function("single_shooting", [p, local, nodes], [ca.horzcat(*rows)])


def ipopt_single_shooting(problem: Problem, limit_s: float) -> tuple[float, bool, dict[str, float]]:
    """Translation only, T_d held: every response simulated by one mapped chain, all unknowns in one NLP, exact Hessian."""
    part = next(p for p in problem.parts if p.block.name == "translation")
    began = time.perf_counter()
    delay = problem.values["T_d_thrust"]
    made = [Stacked.of([r]).nodes(delay) for r in part.responses]
    rows = [(one.rows, one.sample) for one in made]
    k = max(len(r[0]) for r in rows)
    m = len(rows)
    chain = single_shooting(part.block, part.outputs, k)
    nodes = np.zeros((m, k, chain.size1_in(2)))
    for j, (node, _) in enumerate(rows):
        nodes[j, : len(node)] = node
        nodes[j, len(node) :] = node[-1]
        nodes[j, len(node) :, 0] = 0.0
    free = [n for n in part.block.params if not n.startswith("T_d")]
    p, local = ca.MX.sym("p", len(free)), ca.MX.sym("l", len(part.locals), m)
    p_full = ca.vertcat(*(p[free.index(n)] if n in free else problem.values[n] for n in part.block.params))
    y = chain.map(m, "thread", 2)(ca.repmat(p_full, 1, m), local, ca.DM(nodes.reshape(m * k, -1).T))
    noise = start_noise(problem)
    std = np.array([noise.channel[c] for c in part.outputs])
    cost = ca.sumsqr((local - ca.DM(part.start_local().T)) / ca.DM(prior_std(part, noise).T))
    for j, (_, sample) in enumerate(rows):
        mask = part.mask[j, : sample.size]
        off = (y[:, (j * k + sample).tolist()] - ca.DM(np.where(mask, part.y[j, : sample.size], 0.0).T)) * ca.DM(
            (mask / std).T
        )
        cost = cost + ca.sumsqr(off)
    scale = ca.DM([problem.model.param[n].scale for n in free])
    variables = ca.vertcat(p / scale, ca.vec(local))
    w = ca.MX.sym("w", variables.shape[0])
    at_w = {"p": w[: len(free)] * scale, "l": ca.reshape(w[len(free) :], len(part.locals), m)}
    objective = ca.graph_substitute(cost, [p, local], [at_w["p"], at_w["l"]])
    options = {"ipopt": {"print_level": 0, "max_wall_time": limit_s, "sb": "yes", "tol": 1e-6}, "print_time": False}
    solver = ca.nlpsol("solver", "ipopt", {"x": w, "f": objective}, options)
    start = np.concatenate([[problem.values[n] for n in free] / np.asarray(scale).ravel(), part.start_local().ravel()])
    result = np.asarray(solver(x0=start)["x"]).ravel()
    found = dict(zip(free, result[: len(free)] * np.asarray(scale).ravel(), strict=True))
    return time.perf_counter() - began, bool(solver.stats()["success"]), found


def scipy_finite_differences(problem: Problem) -> tuple[float, dict[str, float]]:
    """sigma_t, K, alpha, d_z on the throttle steps: a_z of each by solve_ivp, Jacobian by differences."""
    part = next(p for p in problem.parts if p.block.name == "translation")
    delay = problem.values["T_d_thrust"]
    steps = [problem.segments[r.index] for r in part.responses if problem.segments[r.index].kind == "throttle_step"]

    def residuals(theta: np.ndarray) -> np.ndarray:
        sigma, gain, alpha, drag = theta
        rows = []
        for s in steps:
            voltage = float(np.mean(s.y["voltage_v"]))
            full = gain * (voltage / 22.2) ** alpha

            def rate(t: float, x: np.ndarray, s=s, full=full) -> list[float]:
                throttle = float(zero_order_hold(s.u["throttle"], np.array([t - delay]))[0])
                return [x[1] - drag * x[0] - G_M_S2, sigma * (full * throttle - x[1])]

            start = [float(s.y["v_z_m_s"][0]), float(np.mean(s.y["f_z_m_s2"][:4]))]
            made = solve_ivp(rate, (s.t_s[0], s.t_s[-1]), start, t_eval=s.t_s, rtol=1e-4, atol=1e-4, max_step=0.05)
            rows.append(made.y[1] - drag * made.y[0] - s.y["f_z_m_s2"])
        return np.concatenate(rows)

    begin = np.array([problem.values[n] for n in ("sigma_t", "K", "alpha", "d_z")])
    seconds, result = timed(lambda: least_squares(residuals, begin, x_scale=[5.0, 10.0, 0.5, 0.2], diff_step=1e-4))
    return seconds, dict(zip(("sigma_t", "K", "alpha", "d_z"), result.x, strict=True))


@cache
def flown() -> list[Segment]:
    return campaign(0)


def fit_one(_: int) -> float:
    return fit(flown(), Model()).values["K"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="stop IPOPT after 20 s and skip 1000 responses")
    quick = parser.parse_args().quick
    segments = campaign(0)
    model = Model()
    cold, _ = timed(lambda: fit(segments, model))
    warm, found = timed(lambda: fit(segments, model))
    print(
        f"full campaign, {len(segments)} responses, joint, delays and covariance: {cold:.2f} s first, {warm:.2f} s again"
    )

    begin = {**found.values, "sigma_t": 30.0, "K": 50.0, "alpha": 1.0, "d_x": 0.2, "d_y": 0.2, "d_z": 0.2}
    translation = problem_of(segments, model, values=begin, fixed=("T_d_thrust",))
    parts = [p for p in translation.parts if p.block.name == "translation"]
    translation.parts = tuple(parts)
    free = [n for n in parts[0].block.params if n != "T_d_thrust"]
    begun = Start(noise=start_noise(translation))
    solve(translation, begun, free=free, estimate_noise=False, robust=False)
    ours, solved = timed(lambda: solve(translation, begun, free=free, estimate_noise=False, robust=False))
    print(f"thrust and drag alone, {len(parts[0].responses)} responses, same objective as IPOPT below: {ours:.2f} s")
    limit = 20.0 if quick else 300.0
    seconds, good, values = ipopt_single_shooting(translation, limit)
    word = "" if good else f" (stopped after {limit:.0f} s, not converged)"
    print(f"(a) IPOPT, single shooting: {seconds:.1f} s{word}: {seconds / ours:.0f} times as long")
    print(
        "    largest difference of a parameter:",
        max(abs(values[n] / solved.values[n] - 1) for n in free) if good else "-",
    )
    seconds, values = scipy_finite_differences(translation)
    print(f"(b) scipy, finite differences, four parameters only: {seconds:.1f} s: {seconds / ours:.0f} times as long")

    for count in (1, 10, 100) if quick else (1, 10, 100, 1000):
        steps = [s for s in segments if s.kind == "throttle_step"]
        many = (steps * (-(-count // len(steps))))[:count]
        problem = problem_of(many, model, values=found.values)
        problem.evaluate(problem.values, None, problem.names)
        seconds = min(timed(lambda p=problem: p.evaluate(p.values, None, p.names))[0] for _ in range(3))
        print(
            f"residuals and Jacobian of {count:4d} responses: {1e3 * seconds:7.1f} ms, {1e3 * seconds / count:.2f} ms each"
        )
    for workers in (1, 2):
        with ProcessPoolExecutor(workers) as pool:
            list(pool.map(fit_one, range(8)))
            seconds, _ = timed(lambda pool=pool: list(pool.map(fit_one, range(4))))
        print(f"four campaigns on {workers} core(s), as `--workers {workers}` has them: {seconds:.2f} s")


if __name__ == "__main__":
    main()
