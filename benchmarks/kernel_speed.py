"""The compiled kernel against the same in numpy, in one run: `python -m benchmarks.kernel_speed`.

Processor time of residuals, and of residuals with their Jacobian, of a campaign of 116 responses: of the paper's model, of coupled attitude
loops, and of the whole catalogue; and the largest difference between both.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from unittest.mock import patch

import numpy as np

from flighttest.estimation.integration import kernel
from flighttest.estimation.integration.native import library
from flighttest.estimation.problem import PartEvaluation, Problem
from flighttest.identify.selection import problem_of
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from tests.identify.campaign import campaign

REPEATS = 3


def cpu_s(action: Callable[[], object]) -> float:
    """Least processor time of a few; what it compiles once is not counted."""
    action()
    taken = []
    for _ in range(REPEATS):
        began = time.process_time()
        action()
        taken.append(time.process_time() - began)
    return min(taken)


def evaluated(problem: Problem, shift: list[float], jacobian: bool) -> list[PartEvaluation]:
    """At values that differ from call to call, as a solver's do: nothing is kept of an earlier one."""
    shift[0] += 1e-9
    values = {n: v * (1.0 + shift[0]) for n, v in problem.values.items() if not n.startswith("T_d")}
    return problem.evaluate(values, None, problem.names if jacobian else None)


def main() -> None:
    if library() is None:
        raise SystemExit("no C compiler: there is nothing to compare")
    segments = campaign(0)
    models = {
        "the paper's model": Model(),
        "coupled attitude": Model().with_terms("roll_pitch_coupling", "turn_axes"),
        "the whole catalogue": Model().with_terms(*catalogue()),
    }
    print(f"{len(segments)} responses, {sum(s.t_s.size for s in segments)} samples; ms of processor time")
    print(f"{'':22}{'':14}{'compiled':>10}{'numpy':>10}{'ratio':>8}{'difference':>14}")
    for name, model in models.items():
        problem = problem_of(segments, model, select="all")
        for jacobian in (False, True):
            fast = cpu_s(lambda p=problem, j=jacobian: evaluated(p, [0.0], j))
            made = evaluated(problem, [0.0], jacobian)
            with patch.object(kernel, "library", lambda: None):
                shift = [0.0]
                slow = cpu_s(lambda p=problem, j=jacobian, s=shift: evaluated(p, s, j))
                other = evaluated(problem, [0.0], jacobian)
            what = "Jacobian" if jacobian else "residuals"
            print(
                f"{name:22}{what:14}{1e3 * fast:10.1f}{1e3 * slow:10.1f}{slow / fast:8.1f}{apart(made, other, jacobian):14.1e}"
            )


def apart(one: list[PartEvaluation], other: list[PartEvaluation], jacobian: bool) -> float:
    """Largest difference, relative to the largest of its kind."""
    found = 0.0
    for a, b in zip(one, other, strict=True):
        for x, y in ((a.jacobian, b.jacobian),) if jacobian else ((a.residual, b.residual),):
            size = np.abs(y).max(axis=(0, 1)) + 1e-12
            found = max(found, float((np.abs(x - y).max(axis=(0, 1)) / size).max()))
    return found


if __name__ == "__main__":
    main()
