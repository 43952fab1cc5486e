"""A small motion planner on an exported model: `python examples/mpc.py EXPORT_DIR` (made by `flighttest export model.yaml --to casadi`).

Plans 10 s ahead, 50 intervals of 0.2 s, to a position, within the tilt and speed the model is valid for: Gauss-Newton sequential quadratic
programming on multiple shooting, each quadratic program solved by HPIPM's structure-exploiting interior point method. In flight one
iteration per control step is enough (real-time iteration), warm started from the last plan shifted by one interval. Both are timed here: a
plan from nothing to convergence, and one warm-started iteration; the paper's figure is 20 Hz and more for horizons over 10 s. Where a C
compiler is found the model's step and its slopes are compiled. A plan that does not converge is said to be none, with exit code 1.

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
STABLE = 2.0  # step times the model's fastest pole: Runge-Kutta of fourth order diverges above 2.78
TOLERANCE = 1e-3
MOST_ITERATIONS = 50
NEAR_M = 0.5


class NoPlanError(Exception):
    """There is no plan; the message says why."""


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
    words = [compiler, "-O1", "-fPIC", "-shared", "-o", str(library), str(folder / "model.c"), "-lm"]
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
        self.steps = self.steps_per_interval(slopes)
        self.one, self.slope = (f.map(HORIZON) for f in compiled(self.step, slopes))
        self._cost_and_bounds()
        self._program()
        self.damping, self.gap = 1.0, np.inf
        self.x_plan = np.tile(self.x_hover[:, None], HORIZON + 1)
        self.u_plan = np.tile(self.u_hover[:, None], HORIZON)

    def steps_per_interval(self, slopes: ca.Function) -> int:
        """Runge-Kutta steps that an interval needs, by the fastest pole of the model in hover and under tilt references of 0.3 rad."""
        dt = 1e-4
        tilted = self.u_hover + [0.3 if n in ("roll_ref_rad", "pitch_ref_rad") else 0.0 for n in self.inputs]
        found = [np.asarray(slopes(self.x_hover, u, dt)[0]) for u in (self.u_hover, tilted)]
        fastest = max(float(np.abs(np.linalg.eigvals((a - np.eye(self.n_x)) / dt)).max()) for a in found)
        return int(np.ceil(INTERVAL_S / min(MAX_STEP_S, STABLE / fastest)))

    def linearise(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States (n_x, HORIZON) after each interval, and their slopes: (HORIZON, n_x, n_x) by the states, (HORIZON, n_x, n_u) by inputs."""
        h = INTERVAL_S / self.steps
        a = np.broadcast_to(np.eye(self.n_x), (HORIZON, self.n_x, self.n_x))
        b = np.zeros((HORIZON, self.n_x, self.n_u))
        for _ in range(self.steps):
            by_x, by_u = (np.asarray(m).reshape(self.n_x, HORIZON, -1).transpose(1, 0, 2) for m in self.slope(x, u, h))
            a, b = by_x @ a, by_x @ b + by_u
            x = np.asarray(self.one(x, u, h))
        return x, a, b

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
        options = {"hpipm": {"iter_max": 60}, "inf": 1e8, "error_on_fail": False}
        self.solver = ca.conic("plan", "hpipm", {"h": self.hessian.sparsity(), "a": self.pattern}, options)
        entries = np.array(self.pattern.get_triplet())
        self.row, self.column = entries[0], entries[1]

    def iterate(self, x_now: np.ndarray, target_m: np.ndarray) -> float:
        """One Gauss-Newton step, shortened by `damping`, towards the plan from x_now (n_x,) to target_m (3,); returns its largest change of
        a state, in departures that matter. `gap`: how far the plan was from what the model does before it, likewise."""
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

        wanted = self.x_hover.copy()
        wanted[[self.states.index(s) for s in ("p_x_m", "p_y_m", "p_z_m")]] = target_m
        stages = np.concatenate([self.x_plan[:, :-1] - wanted[:, None], self.u_plan - self.u_hover[:, None]])
        off = np.concatenate([stages.T.ravel(), self.x_plan[:, -1] - wanted])
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
        solved = self.solver(h=self.hessian, g=self.weights * off, a=matrix, lba=gap, uba=gap, lbx=low, ubx=high)
        move = self.damping * np.asarray(solved["x"]).ravel()
        if not np.isfinite(
            move
        ).all():  # its own limit of iterations may end it before its tolerance: what is left shows in `gap`
            raise NoPlanError("the quadratic program has no solution")
        stages = move[: HORIZON * width].reshape(HORIZON, width).T
        moves = np.concatenate([stages[:n_x], move[HORIZON * width :, None]], axis=1)
        self.x_plan, self.u_plan = self.x_plan + moves, self.u_plan + stages[n_x:]
        return float(np.abs(moves / self.size[:, None]).max())

    def plan(self, x_now: np.ndarray, target_m: np.ndarray) -> int:
        """Iterate until nothing changes any more; returns the iterations. NoPlanError where that does not happen.

        A plan along a bend of the model (a limit, a square-root controller) makes full steps go to and fro: they are halved where they do
        not get smaller.
        """
        before, self.damping = np.inf, 1.0
        try:
            for iteration in range(1, MOST_ITERATIONS + 1):
                moved = self.iterate(x_now, target_m)
                if moved <= TOLERANCE and self.gap <= TOLERANCE:
                    return iteration
                if iteration > 5 and moved > 0.7 * before:
                    self.damping = max(0.5 * self.damping, 1.0 / 64.0)
                before = moved
        finally:
            self.damping = 1.0
        raise NoPlanError(
            f"after {MOST_ITERATIONS} iterations it still changes by {moved:.2g} of what matters, and is {self.gap:.2g} off the model"
        )

    def shift(self) -> None:
        """The last plan, one interval later."""
        self.x_plan = np.concatenate([self.x_plan[:, 1:], self.x_plan[:, -1:]], axis=1)
        self.u_plan = np.concatenate([self.u_plan[:, 1:], self.u_plan[:, -1:]], axis=1)

    def over_the_delay(self, x_measured: np.ndarray, u_sent: np.ndarray) -> np.ndarray:
        """The state once inputs sent now take effect, the mean delay later; u_sent: what is still on its way."""
        return np.asarray(
            self.step(x_measured, u_sent, float(np.mean([v for v in self.described["delays_s"].values() if v])))
        ).ravel()


def main() -> None:
    """Time a plan from nothing, then fly 8 s with one iteration per interval."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `flighttest export MODEL --to casadi -o DIR` wrote")
    planner = Planner(parser.parse_args().folder)
    x, target = planner.x_hover.copy(), np.array([8.0, -4.0, 2.0])

    began = time.perf_counter()
    try:
        iterations = planner.plan(x, target)
    except NoPlanError as error:
        sys.exit(f"no plan over {HORIZON * INTERVAL_S:.0f} s: {error}")
    cold = time.perf_counter() - began
    print(f"plan over {HORIZON * INTERVAL_S:.0f} s from nothing: {iterations} iterations, {1e3 * cold:.0f} ms")

    times = []
    for k in range(int(8.0 / INTERVAL_S)):
        began = time.perf_counter()
        try:
            planner.iterate(x, target if k < 20 else np.array([0.0, 0.0, 3.0]))
        except NoPlanError as error:
            sys.exit(f"no plan {k * INTERVAL_S:.1f} s into the flight: {error}")
        times.append(time.perf_counter() - began)
        parts = 4 * planner.steps
        for _ in range(parts):
            x = np.asarray(planner.step(x, planner.u_plan[:, 0], INTERVAL_S / parts)).ravel()
        planner.shift()
        if k == 19:
            reached = x[:3].copy()
    middle, worst = np.median(times), np.max(times)
    print(f"warm-started iteration: median {1e3 * middle:.1f} ms, worst {1e3 * worst:.1f} ms: {1 / middle:.0f} Hz")
    away = float(np.linalg.norm(reached - target))
    print(f"flown with it: {away:.2f} m from the first target after 4 s{'' if away < NEAR_M else ': NOT REACHED'}")
    print(
        f"the paper's 20 Hz is {'met' if worst < 0.05 else 'met in the median only' if middle < 0.05 else 'not met'} on this machine"
    )
    if away >= NEAR_M:
        sys.exit(1)


if __name__ == "__main__":
    main()
