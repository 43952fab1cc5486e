"""A small motion planner on an exported model: `python examples/mpc.py EXPORT_DIR` (made by `flighttest export model.yaml --to casadi`).

Plans 10 s ahead, 50 intervals of 0.2 s, to a position, within the tilt and speed the model is valid for: Gauss-Newton sequential quadratic
programming on multiple shooting, each quadratic program solved by HPIPM's structure-exploiting interior point method. In flight there is
one iteration per control step, 50 times a second (real-time iteration), warm started from the last plan moved on by one control step: all
but the quadratic program is done before the state is measured. Timed here: a plan from nothing to convergence, an iteration, and the part
of it between measurement and command. Where a C compiler is found an interval of the model and its slopes are compiled. A plan that does
not converge is said to be none, with exit code 1.

The tube is what the plan is worth with this model: 95 % half widths of position along the plan, from the covariance of the parameters,
with the linear feedback about hover in place of planning again. `--figure FILE.svg` draws it.

The exported functions take delayed inputs. `over_the_delay` rolls the measured state forward over `delays_s` with the inputs already sent;
the plan starts from there.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import casadi as ca
import numpy as np

HORIZON = 50
INTERVAL_S = 0.2
MAX_STEP_S = 0.05  # of the Runge-Kutta steps inside an interval: 25 rad/s loops need no finer for planning
CONTROL_S = 0.02  # 50 Hz
FLOWN_S = 4.0
STABLE = 2.0  # step times the model's fastest pole: Runge-Kutta of fourth order diverges above 2.78
TOLERANCE = 1e-3  # of a departure that matters, and of the cost
ARMIJO, SHORTEST = 1e-4, 1e-3  # share of the promised fall that a step has to keep; of a full step
MOST_ITERATIONS = 50
MOST_INNER = (
    20  # of a quadratic program: what converges takes 3 to 15; more go on at the limit of the numbers' precision
)
NEAR_M = 0.5


class NoPlanError(Exception):
    """There is no plan; the message gives the reason."""


def compiled(*functions: ca.Function) -> list[ca.Function]:
    """The functions in machine code where a C compiler is found, else as they are."""
    compiler = shutil.which("cc")
    if compiler is None:
        return list(functions)
    folder = Path(tempfile.mkdtemp())
    generator = ca.CodeGenerator("model.c")
    for function in functions:
        generator.add(function)
    generator.generate(f"{folder}/")
    library = folder / "model.so"
    words = [compiler, "-O2", "-fPIC", "-shared", "-o", str(library), str(folder / "model.c"), "-lm"]
    if subprocess.run(words, capture_output=True, check=False).returncode != 0:
        return list(functions)
    return [ca.external(f.name(), str(library)) for f in functions]


class Planner:
    """Keeps the last plan: `x_plan` (n_x, HORIZON + 1), `u_plan` (n_u, HORIZON); positions in m, world North-West-Up."""

    def __init__(self, folder: Path) -> None:
        self.described = json.loads((folder / "model.json").read_text())
        self.step, slopes = (ca.Function.load(str(folder / f"{n}.casadi")) for n in ("step", "step_jacobian"))
        self.states = [s["name"] for s in self.described["states"]]
        self.inputs = [s["name"] for s in self.described["inputs"]]
        self.x_hover = np.array(self.described["hover"]["x"])
        self.u_hover = np.array(self.described["hover"]["u"])
        self.n_x, self.n_u = len(self.states), len(self.inputs)
        self.slopes = slopes
        self.steps = self.steps_per_interval(slopes)
        self.interval = compiled(self.one_interval(slopes))[0].map(HORIZON)
        self._cost_and_bounds()
        self._program()
        self.gap = np.inf
        self.x_plan = np.tile(self.x_hover[:, None], HORIZON + 1)
        self.u_plan = np.tile(self.u_hover[:, None], HORIZON)

    def steps_per_interval(self, slopes: ca.Function) -> int:
        """Runge-Kutta steps that an interval needs, by the fastest pole of the model in hover and under tilt references of 0.3 rad."""
        dt = 1e-4
        tilted = self.u_hover + [0.3 if n in ("roll_ref_rad", "pitch_ref_rad") else 0.0 for n in self.inputs]
        found = [np.asarray(slopes(self.x_hover, u, dt)[0]) for u in (self.u_hover, tilted)]
        fastest = max(float(np.abs(np.linalg.eigvals((a - np.eye(self.n_x)) / dt)).max()) for a in found)
        return int(np.ceil(INTERVAL_S / min(MAX_STEP_S, STABLE / fastest)))

    def one_interval(self, slopes: ca.Function) -> ca.Function:
        """interval(x, u) -> the state after it, and its slopes by state and inputs: some Runge-Kutta steps, chained."""
        x, u, h = ca.MX.sym("x", self.n_x), ca.MX.sym("u", self.n_u), INTERVAL_S / self.steps
        after, a, b = x, ca.MX.eye(self.n_x), ca.MX.zeros(self.n_x, self.n_u)
        for _ in range(self.steps):
            by_x, by_u = slopes(after, u, h)
            a, b = by_x @ a, by_x @ b + by_u
            after = self.step(after, u, h)
        return ca.Function("interval", [x, u], [after, ca.densify(a), ca.densify(b)])

    def linearise(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States (n_x, HORIZON) after each interval, and their slopes: (HORIZON, n_x, n_x) by the states, (HORIZON, n_x, n_u) by inputs."""
        after, a, b = (np.asarray(m) for m in self.interval(x, u))
        return after, *(m.reshape(self.n_x, HORIZON, -1).transpose(1, 0, 2) for m in (a, b))

    def _cost_and_bounds(self) -> None:
        """Weights are one over the square of a departure that matters; bounds are the model's valid range."""
        matters = {
            "p_": 1.0,
            "v_": 2.0,
            "roll_rad": 1.0,
            "pitch_rad": 1.0,
            "roll_rate": 6.0,
            "pitch_rate": 6.0,
            "yaw": 0.5,
        }
        size = [next((v for k, v in matters.items() if n.startswith(k)), 10.0) for n in self.states]
        self.size = np.array(size)
        self.q = 1.0 / np.square(size)
        self.r = 1.0 / np.square([{"throttle": 0.2, "yaw_rate_ref_rad_s": 0.5}.get(n, 0.6) for n in self.inputs])
        valid = self.described["valid"]
        tilt, speed = valid.get("tilt_max_rad") or 0.5, valid.get("speed_max_m_s") or 6.0
        low, high = valid.get("throttle") or (0.05, 0.5)
        most = {"roll_ref_rad": 0.7 * tilt, "pitch_ref_rad": 0.7 * tilt, "yaw_rate_ref_rad_s": 1.0}
        self.u_low = np.array([low if n == "throttle" else -most.get(n, 0.0) for n in self.inputs])
        self.u_high = np.array([high if n == "throttle" else most.get(n, 0.0) for n in self.inputs])
        voltage = self.inputs.index("voltage_v")
        self.u_low[voltage] = self.u_high[voltage] = self.u_hover[voltage]
        self.x_high = np.array([speed if n.startswith("v_") else np.inf for n in self.states])

    def _program(self) -> None:
        """Variables x0 u0 x1 u1 ... xN, one block of equations per interval: the structure HPIPM looks for."""
        width = self.n_x + self.n_u
        n = HORIZON * width + self.n_x
        rows = []
        for k in range(HORIZON):
            before, after = k * width, n - k * width - width - self.n_x
            block = ca.horzcat(ca.DM.ones(self.n_x, width), ca.DM.eye(self.n_x))
            rows.append(ca.horzcat(ca.DM(self.n_x, before), block, ca.DM(self.n_x, after)))
        self.pattern = ca.vertcat(*rows).sparsity()
        weights = np.concatenate([np.tile(np.concatenate([self.q, self.r]), HORIZON), 10.0 * self.q])
        self.hessian = ca.diag(ca.DM(weights))
        self.weights = weights
        options = {"hpipm": {"iter_max": MOST_INNER}, "inf": 1e8, "error_on_fail": False}
        self.solver = ca.conic("plan", "hpipm", {"h": self.hessian.sparsity(), "a": self.pattern}, options)
        entries = np.array(self.pattern.get_triplet())
        self.row, self.column = entries[0], entries[1]

    def iterate(self, x_now: np.ndarray, target_m: np.ndarray) -> None:
        """One full Gauss-Newton step towards the plan from x_now (n_x,) to target_m (3,)."""
        self.move(*self.respond(x_now, *self.prepare(target_m))[:2])

    def move(self, x_move: np.ndarray, u_move: np.ndarray, share: float = 1.0) -> None:
        """Change the plan by a share of a step."""
        self.x_plan, self.u_plan = self.x_plan + share * x_move, self.u_plan + share * u_move

    def prepare(self, target_m: np.ndarray) -> tuple[ca.DM, np.ndarray, np.ndarray]:
        """What an iteration needs that the state is not in: the equations' matrix, their right side, the cost's slope. `gap`: how far the
        plan is from what the model does, in departures that matter."""
        after, a, b = self.linearise(self.x_plan[:, :-1], self.u_plan)
        if not np.isfinite(after).all():
            raise NoPlanError("the model's states are not finite along the plan")
        n_x, width = self.n_x, self.n_x + self.n_u
        dense = np.zeros((HORIZON, n_x, width + n_x))
        dense[:, :, :n_x], dense[:, :, n_x:width] = a, b
        dense[:, np.arange(n_x), width + np.arange(n_x)] = -1.0
        block = self.row // n_x
        matrix = ca.DM(self.pattern, dense[block, self.row % n_x, self.column - block * width])
        gap = (self.x_plan[:, 1:] - after).T.ravel()
        self.gap = float(np.abs(gap.reshape(HORIZON, n_x) / self.size).max())

        return matrix, gap, self.weights * self.off(target_m)

    def off(self, target_m: np.ndarray) -> np.ndarray:
        """What the plan departs by from hover at the target, in the order of the program's variables."""
        wanted = self.x_hover.copy()
        wanted[[self.states.index(s) for s in ("p_x_m", "p_y_m", "p_z_m")]] = target_m
        stages = np.concatenate([self.x_plan[:, :-1] - wanted[:, None], self.u_plan - self.u_hover[:, None]])
        return np.concatenate([stages.T.ravel(), self.x_plan[:, -1] - wanted])

    def merit(self, target_m: np.ndarray, price: float) -> float:
        """Cost of the plan, and at a price what it is off the model: the l1 merit function (Nocedal & Wright 2006, 18.3)."""
        after = np.asarray(self.interval(self.x_plan[:, :-1], self.u_plan)[0])
        cost = 0.5 * float(self.weights @ self.off(target_m) ** 2) + price * float(
            np.abs(self.x_plan[:, 1:] - after).sum()
        )
        return cost if np.isfinite(cost) else np.inf

    def respond(
        self, x_now: np.ndarray, matrix: ca.DM, gap: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """The quadratic program from x_now (n_x,): the full step of states and of inputs, and the largest price of an equation."""
        n_x, width = self.n_x, self.n_x + self.n_u
        x_low = np.concatenate(
            [
                -self.x_high[:, None] - self.x_plan,
            ],
            axis=1,
        )
        x_high = self.x_high[:, None] - self.x_plan
        x_low[:, 0] = x_high[:, 0] = x_now - self.x_plan[:, 0]
        low = np.concatenate(
            [np.concatenate([x_low[:, :-1], self.u_low[:, None] - self.u_plan]).T.ravel(), x_low[:, -1]]
        )
        high = np.concatenate(
            [np.concatenate([x_high[:, :-1], self.u_high[:, None] - self.u_plan]).T.ravel(), x_high[:, -1]]
        )
        solved = self.solver(h=self.hessian, g=slope, a=matrix, lba=gap, uba=gap, lbx=low, ubx=high)
        found = np.asarray(solved["x"]).ravel()
        if not np.isfinite(found).all():  # its own limit of iterations may end it earlier: what is left shows in `gap`
            raise NoPlanError("the quadratic program has no solution")
        stages = found[: HORIZON * width].reshape(HORIZON, width).T
        x_move = np.concatenate([stages[:n_x], found[HORIZON * width :, None]], axis=1)
        return x_move, stages[n_x:], float(np.abs(np.asarray(solved["lam_a"])).max())

    def plan(self, x_now: np.ndarray, target_m: np.ndarray) -> int:
        """Iterate until the plan is the model's and nothing lowers its cost any more; returns the iterations. NoPlanError where that does
        not happen.

        Steps are shortened until they lower the merit function by a share of what its slope promises (Armijo): along a bend of the model
        (a limit, a square-root controller) full steps go to and fro.
        """
        price = 0.0
        self.x_plan[:, 0] = x_now
        for iteration in range(1, MOST_ITERATIONS + 1):
            matrix, gap, slope = self.prepare(target_m)
            x_move, u_move, dual = self.respond(x_now, matrix, gap, slope)
            price = max(price, 1.5 * dual)
            stages = np.concatenate([x_move[:, :-1], u_move]).T.ravel()
            fall = price * float(np.abs(gap).sum()) - float(slope @ np.concatenate([stages, x_move[:, -1]]))
            before = self.merit(target_m, price)
            if self.gap <= TOLERANCE and fall <= TOLERANCE * before:
                return iteration
            old, share = (self.x_plan, self.u_plan), 1.0
            self.move(x_move, u_move)
            while self.merit(target_m, price) > before - ARMIJO * share * fall:
                share *= 0.5
                self.x_plan, self.u_plan = old
                if share < SHORTEST:
                    if self.gap <= TOLERANCE:
                        return iteration
                    raise NoPlanError(
                        f"no step brings it nearer to the model, and it is {self.gap:.2g} of what matters off it"
                    )
                self.move(x_move, u_move, share)
        raise NoPlanError(
            f"after {MOST_ITERATIONS} iterations its cost still falls by {100 * fall / before:.2g} %, and it is {self.gap:.2g} of what "
            "matters off the model"
        )

    def shift(self, share: float = 1.0) -> None:
        """The last plan, a share of an interval later."""
        for plan in (self.x_plan, self.u_plan):
            later = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
            plan += share * (later - plan)

    def tube(self, folder: Path) -> np.ndarray | None:
        """95 % half widths of the states along the plan, (n_x, HORIZON + 1), by the errors of the parameters; None where none are known."""
        order = self.described.get("sensitivity_order") or []
        if not order:
            return None
        every, known = (self.described["covariance"][n] for n in ("order", "matrix"))
        pick = [every.index(n) for n in order]
        by_p = ca.Function.load(str(folder / "step_sensitivity.casadi"))
        _, a, b = self.linearise(self.x_plan[:, :-1], self.u_plan)
        _, hover_a, hover_b = self.linearise(
            np.tile(self.x_hover[:, None], HORIZON), np.tile(self.u_hover[:, None], HORIZON)
        )
        gain = feedback(hover_a[0], hover_b[0] * (self.u_high > self.u_low), self.q, self.r)
        spread, half = np.zeros((self.n_x, len(order))), [np.zeros(self.n_x)]
        covariance = np.asarray(known)[np.ix_(pick, pick)]
        # The covariance is of the scatter of responses; a parameter's standard error holds what the equations may err, too.
        stated = np.array([self.described["parameters"][n].get("std") or 0.0 for n in order])
        scatter = np.sqrt(np.diag(covariance))
        scale = np.maximum(np.divide(stated, scatter, out=np.ones_like(stated), where=scatter > 0.0), 1.0)
        covariance = covariance * np.outer(scale, scale)
        h = INTERVAL_S / self.steps
        for k in range(HORIZON):
            x, added = self.x_plan[:, k], np.zeros_like(spread)
            for _ in range(self.steps):
                slope = np.asarray(self.slopes(x, self.u_plan[:, k], h)[0])
                added = slope @ added + np.asarray(by_p(x, self.u_plan[:, k], h))
                x = np.asarray(self.step(x, self.u_plan[:, k], h)).ravel()
            spread = (a[k] - b[k] @ gain) @ spread + added
            half.append(1.96 * np.sqrt(np.einsum("ij,jk,ik->i", spread, covariance, spread).clip(0.0)))
        return np.array(half).T

    def over_the_delay(self, x_measured: np.ndarray, u_sent: np.ndarray) -> np.ndarray:
        """The state once inputs sent now take effect, the mean delay later; u_sent: what is still on its way."""
        return np.asarray(
            self.step(x_measured, u_sent, float(np.mean([v for v in self.described["delays_s"].values() if v])))
        ).ravel()


def feedback(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Gain (n_u, n_x) of the linear-quadratic regulator: the Riccati equation, iterated over as many intervals as settle it."""
    p = np.diag(q)
    for _ in range(500):
        gain = np.linalg.solve(np.diag(r) + b.T @ p @ b, b.T @ p @ a)
        p = np.diag(q) + a.T @ p @ (a - b @ gain)
    return gain


def drawn(planner: Planner, half: np.ndarray) -> str:
    """The plan's position over time with its tube, as SVG."""
    names, width, height = ("p_x_m", "p_y_m", "p_z_m"), 560.0, 130.0
    t = INTERVAL_S * np.arange(HORIZON + 1)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="640" height="{3 * (height + 30):.0f}" font-family="sans-serif" font-size="12">'
    ]
    for row, name in enumerate(names):
        i = planner.states.index(name)
        x, w, top = planner.x_plan[i], half[i], 20.0 + row * (height + 30.0)
        low, high = float((x - w).min()), float((x + w).max())
        across = 60.0 + width * t / t[-1]

        def down(y: np.ndarray, top: float = top, low: float = low, high: float = high) -> np.ndarray:
            return top + height * (high - y) / max(high - low, 1e-6)

        edge = [*zip(across, down(x + w), strict=True), *zip(across[::-1], down(x - w)[::-1], strict=True)]
        line = zip(across, down(x), strict=True)
        parts += [
            f'<polygon fill="#9ecae1" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in edge)}"/>',
            f'<polyline fill="none" stroke="#08519c" stroke-width="1.5" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in line)}"/>',
            f'<text x="4" y="{top + 12:.0f}">{high:.2f}</text><text x="4" y="{top + height:.0f}">{low:.2f}</text>',
            f'<text x="64" y="{top - 4:.0f}">{name}: plan over {t[-1]:.0f} s and 95 % tube of the model</text>',
        ]
    return "\n".join([*parts, "</svg>\n"])


def main() -> None:
    """Time a plan from nothing, show its tube, then fly with one iteration per control step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `flighttest export MODEL --to casadi -o DIR` wrote")
    parser.add_argument("--figure", type=Path, metavar="FILE.svg", help="draw the first plan with its tube")
    words = parser.parse_args()
    planner = Planner(words.folder)
    x, target = planner.x_hover.copy(), np.array([8.0, -4.0, 2.0])
    place = [planner.states.index(s) for s in ("p_x_m", "p_y_m", "p_z_m")]

    began = time.perf_counter()
    try:
        iterations = planner.plan(x, target)
    except NoPlanError as error:
        sys.exit(f"no plan over {HORIZON * INTERVAL_S:.0f} s: {error}")
    cold = time.perf_counter() - began
    print(f"plan over {HORIZON * INTERVAL_S:.0f} s from nothing: {iterations} iterations, {1e3 * cold:.0f} ms")
    half = planner.tube(words.folder)
    if half is None:
        print("tube: the model states no errors")
    else:
        at = {s: half[place, round(s / INTERVAL_S)].max() for s in (1, 3, 10)}
        print(f"tube of the plan: 95 % within {', '.join(f'{w:.3f} m after {s} s' for s, w in at.items())}")
        if words.figure:
            words.figure.write_text(drawn(planner, half))

    whole, answer, spent, missed = [], [], [], 0
    for k in range(round(FLOWN_S / CONTROL_S)):
        try:
            began, used = time.perf_counter(), time.process_time()
            prepared = planner.prepare(target)
            measured = time.perf_counter()
            planner.move(*planner.respond(x, *prepared)[:2])
        except NoPlanError as error:
            sys.exit(f"no plan {k * CONTROL_S:.2f} s into the flight: {error}")
        whole.append(time.perf_counter() - began)
        answer.append(time.perf_counter() - measured)
        spent.append(time.process_time() - used)
        missed += whole[-1] > CONTROL_S
        parts = int(np.ceil(CONTROL_S / (INTERVAL_S / planner.steps)))
        for _ in range(parts):
            x = np.asarray(planner.step(x, planner.u_plan[:, 0], CONTROL_S / parts)).ravel()
        planner.shift(CONTROL_S / INTERVAL_S)
    middle, worst = np.median(whole), np.max(whole)
    print(
        f"warm-started iteration: median {1e3 * middle:.1f} ms, worst {1e3 * worst:.1f} ms, of the processor "
        f"{1e3 * np.median(spent):.1f} ms; from measurement to command {1e3 * np.median(answer):.1f} ms"
    )
    away = float(np.linalg.norm(x[place] - target))
    print(
        f"flown with it: {away:.2f} m from the target after {FLOWN_S:.0f} s{'' if away < NEAR_M else ': NOT REACHED'}"
    )
    rate = 1.0 / CONTROL_S
    print(
        f"{rate:.0f} Hz: {missed} of {len(whole)} control steps took longer than {1e3 * CONTROL_S:.0f} ms on this machine"
    )
    if away >= NEAR_M:
        sys.exit(1)


if __name__ == "__main__":
    main()
