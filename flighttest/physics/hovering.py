"""At rest in the air: the throttle and the states in which a composed model neither rises nor sinks."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.system import LOOPS, POSITION, VELOCITY, System

FloatArray = NDArray[np.float64]

ITERATIONS = 20
CLOSE = 1e-10  # of a step of Newton's method, in the unit of what it moves
HIGH_M = 1e3  # above ground, where the ground changes nothing


@dataclass(frozen=True)
class Hover:
    """throttle (n,); states (k, n): of the system, level at height 0, world velocity 0."""

    throttle: FloatArray
    states: FloatArray


class Hovering:
    """Newton's method for a system's rest: the throttle, the thrust and the states of terms in which vertical velocity, thrust and these
    states do not change. What pulls sideways, as wind does, is left out."""

    def __init__(self, system: System) -> None:
        self._system, self._states, self._inputs = system, list(system.states), list(system.inputs)
        fixed = {*POSITION, *VELOCITY, *LOOPS}
        self._own = [i for i, n in enumerate(self._states) if n not in fixed]
        still = [self._states.index("v_z_m_s"), *self._own]
        x, u = (ca.SX.sym("z", *system.function.size_in(i)) for i in range(2))
        p = ca.SX.sym("p", *system.function.size_in(2))
        rates = system.function(x, u, p)[0][still]
        sought = ca.vertcat(u[self._inputs.index("throttle")], x[self._own])
        self._newton = ca.Function("hovering", [x, u, p], [rates, ca.jacobian(rates, sought)])

    def at(self, p: FloatArray, voltage_v: FloatArray, guess: FloatArray, a_t_m_s2: float) -> Hover:
        """Voltages (n,), V; guess (n,): throttles near by; a_t_m_s2: thrust near by."""
        found = np.array(guess, dtype=float)
        states = np.zeros((len(self._states), found.size))
        for name, value in self._system.initial.items():
            states[self._states.index(name)] = value
        states[self._states.index("a_t_m_s2")] = a_t_m_s2
        for k, volts in enumerate(voltage_v):
            x, u = states[:, k].copy(), np.zeros(len(self._inputs))
            x[self._states.index("p_z_m")] = HIGH_M
            u[self._inputs.index("voltage_v")], u[self._inputs.index("throttle")] = volts, found[k]
            for _ in range(ITERATIONS):
                rates, slope = (np.asarray(one, dtype=float) for one in self._newton(x, u, p))
                # The least step: of a state that nothing here moves, none.
                step = np.linalg.lstsq(slope, -rates.ravel(), rcond=1e-9)[0]
                u[self._inputs.index("throttle")] += step[0]
                x[self._own] += step[1:]
                if np.abs(step).max() < CLOSE:
                    break
            found[k], x[self._states.index("p_z_m")] = u[self._inputs.index("throttle")], 0.0
            states[:, k] = x
        return Hover(found, states)
