"""Many vehicles stepped through time at once, by the shortest way that gives the same: RK4 steps of `System`, inputs held.

What has only been asked to go up and down stays level, and most of the equations vanish; where what is left is linear, a step is a product
with a constant matrix.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.physics.simulate import RungeKuttaStep
from flighttest.physics.system import System

FloatArray = NDArray[np.float64]

# States and inputs that stay zero in a flight straight up and down.
SIDEWAYS = (
    *("roll_rad", "pitch_rad", "roll_rate_rad_s", "pitch_rate_rad_s", "r_rad_s", "v_x_m_s", "v_y_m_s"),
    *("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s"),
)
# RK4 follows a mode to a few percent of it up to here (mode times step), and runs away beyond 2.8.
RESOLVED = 1.5
_PARTS_MAX = 20


class Forms:
    """The rate of change of a system's states at parameters p, in every form a flight may use; compiled when first asked for."""

    def __init__(self, system: System, p: FloatArray) -> None:
        self.system, self.p = system, p

    @cached_property
    def full(self) -> RungeKuttaStep:
        """Of states (k, n) and inputs (m, n)."""
        return RungeKuttaStep(self._function(straight=False))

    @cached_property
    def level(self) -> RungeKuttaStep | None:
        """The same while nothing moves sideways, a quarter of the work; None where that does not last (wind, an askew rotor)."""
        function = self._function(straight=True)
        rates = function(*(ca.SX.sym("z", *function.size_in(i)) for i in range(2)))
        still = all(rates[i].is_zero() for i, n in enumerate(self.system.states) if n in SIDEWAYS)
        return RungeKuttaStep(function) if still else None

    @cached_property
    def matrix(self) -> FloatArray | None:
        """d rate / d states (k, k) where the level form is affine in them and in the throttle; None where it is not."""
        function = self._function(straight=True)
        x, u = ca.SX.sym("x", *function.size_in(0)), ca.SX.sym("u", *function.size_in(1))
        rate, throttle = function(x, u), u[list(self.system.inputs).index("throttle")]
        by_x, by_throttle = ca.jacobian(rate, x), ca.jacobian(rate, throttle)
        timed = "time_s" in self.system.inputs
        if timed or ca.depends_on(by_x, ca.vertcat(x, u)) or ca.depends_on(by_throttle, ca.vertcat(x, throttle)):
            return None
        return np.asarray(ca.evalf(ca.densify(by_x)), dtype=float)

    def parts(self, u: FloatArray, dt_s: float) -> int:
        """Into how many a step of dt_s has to fall for the fastest mode about level flight with inputs u (m, 1): 1 for usual vehicles."""
        begun = {"a_t_m_s2": G_M_S2, "p_z_m": 5.0, **self.system.initial}
        x = np.array([[begun.get(n, 0.0)] for n in self.system.states])
        slope = np.nan_to_num(np.asarray(self._slope(x, u)), posinf=0.0, neginf=0.0)
        fastest = float(np.abs(np.linalg.eigvals(slope)).max())
        return min(max(math.ceil(dt_s * fastest / RESOLVED), 1), _PARTS_MAX)

    @cached_property
    def _slope(self) -> ca.Function:
        """d rate / d states (k, k)."""
        function = self._function(straight=False)
        x, u = ca.SX.sym("x", *function.size_in(0)), ca.SX.sym("u", *function.size_in(1))
        return ca.Function("slope", [x, u], [ca.densify(ca.jacobian(function(x, u), x))])

    def _function(self, straight: bool) -> ca.Function:
        x, u = ca.SX.sym("x", len(self.system.states)), ca.SX.sym("u", len(self.system.inputs))
        at = [
            ca.vertcat(*(0.0 if straight and n in SIDEWAYS else of[i] for i, n in enumerate(names)))
            for of, names in ((x, self.system.states), (u, self.system.inputs))
        ]
        rate = ca.cse(ca.simplify(self.system.function(*at, self.p)[0]))
        return ca.Function("rate", [x, u], [ca.densify(rate)])


class Stepping:
    """x_next = stepping(x, u) for states (k, n) and inputs (m, n). straight: nothing has moved sideways nor been asked to."""

    def __init__(self, forms: Forms, u: FloatArray, dt_s: float, straight: bool = False) -> None:
        self.forms, self._parts = forms, forms.parts(u[:, :1], dt_s)
        self.dt_s = dt_s / self._parts
        self.straight = straight and forms.level is not None
        self._moving = np.zeros(0, dtype=np.intp)
        self._linear: tuple[FloatArray, FloatArray, FloatArray] | None = None
        if self.straight and forms.matrix is not None:
            self._linear = self._affine(forms.matrix, u)
        self._throttle = list(forms.system.inputs).index("throttle")

    def keep(self, n: int) -> None:
        """Only the first n vehicles fly on."""
        if self._linear is not None:
            power, free, forced = self._linear
            self._linear = power, free[:, :n], forced[:, :n]

    def __call__(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """One step."""
        if self._linear is not None:
            power, free, forced = self._linear
            after = x.copy()
            after[self._moving] = power @ x[self._moving] + free + forced * u[self._throttle]
            return after
        step = (self.forms.level if self.straight else None) or self.forms.full
        for _ in range(self._parts):
            x = step(x, u, self.dt_s)
        return x

    def _affine(self, matrix: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """RK4's own step of x_dot = A x + a + b throttle: x_next = P x + Q a + Q b throttle, P and Q its polynomials in A."""
        assert self.forms.level is not None
        z = self.dt_s * matrix
        one = np.eye(len(z))
        q = one + z @ (one / 2.0 + z @ (one / 6.0 + z / 24.0))
        row = list(self.forms.system.inputs).index("throttle")
        at_rest = np.zeros((len(z), u.shape[1]))
        pushed: list[Any] = []
        for throttle in (0.0, 1.0):
            asked = u.copy()
            asked[row] = throttle
            pushed.append(self.forms.level.rate(at_rest, asked))
        part, free, forced = one + z @ q, self.dt_s * q @ pushed[0], self.dt_s * q @ (pushed[1] - pushed[0])
        power = np.linalg.matrix_power(part, self._parts)
        repeated = sum((np.linalg.matrix_power(part, k) for k in range(self._parts)), np.zeros_like(one))
        free, forced = repeated @ free, repeated @ forced
        # What neither changes nor is changed need not be carried along.
        alive = z.any(axis=0) | z.any(axis=1) | free.any(axis=1) | forced.any(axis=1)
        self._moving = np.flatnonzero(alive)
        return power[np.ix_(alive, alive)], free[alive], forced[alive]
