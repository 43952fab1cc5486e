"""`System`: the whole model chained, for simulation, validation and export."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics import body
from flighttest.physics.compose import attitude, block_of, delays, translation
from flighttest.physics.core import Param, Signals, Term

FloatArray = NDArray[np.float64]

ITERATIONS = 20
CLOSE = 1e-10  # of a step of Newton's method, in the unit of what it moves
HIGH_M = 1e3  # above ground, where the ground changes nothing

POSITION = ("p_x_m", "p_y_m", "p_z_m")
VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
LOOPS = ("roll_rad", "roll_rate_rad_s", "pitch_rad", "pitch_rate_rad_s", "r_rad_s", "yaw_rad")
RATES = ("p_rad_s", "q_rad_s", "r_rad_s")
ACCELERATIONS = ("p_dot_rad_s2", "q_dot_rad_s2", "r_dot_rad_s2")
OUTPUTS = (
    *POSITION, *VELOCITY, "roll_rad", "pitch_rad", "yaw_rad", *RATES,
    "f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "a_x_m_s2", "a_y_m_s2", "a_z_m_s2",
)  # fmt: skip


@dataclass(frozen=True)
class System:
    """x_dot, y = function(x, u, p), delays left out: inputs are the delayed ones.

    states, inputs: name to unit, in order; outputs: channel names, as measured but before known filters; params: names. initial: of term
    states (others start where the caller puts them). input_delay: input to its delay channel ('' where it has none);
    delays_s(p): s, one per entry of `delay_channels`. Height above ground is p_z_m. time_s, and without attitude loops angular
    accelerations, are inputs where a term asks for them.
    """

    states: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: tuple[str, ...]
    params: tuple[str, ...]
    initial: Mapping[str, float]
    input_delay: Mapping[str, str]
    delay_channels: tuple[str, ...]
    function: ca.Function
    delays_s: ca.Function


def build_system(
    terms: Sequence[Term], params: Sequence[Param], constants: Mapping[str, float], attitude_loops: bool
) -> System:
    """Chain the attitude loops (or attitude inputs) into thrust, forces, velocity and position."""
    p = {q.name: ca.SX.sym(q.name) for q in params}
    own = [s for t in terms if block_of(t) in ("attitude", "translation") for s in t.states]
    state_units = dict.fromkeys(POSITION, "m") | dict.fromkeys(VELOCITY, "m/s")
    if attitude_loops:
        state_units |= dict(zip(LOOPS, ("rad", "rad/s", "rad", "rad/s", "rad/s", "rad"), strict=True))
    state_units |= {"a_t_m_s2": "m/s^2"} | {s.name: s.unit for s in own}
    x = {n: ca.SX.sym(n) for n in state_units}
    if attitude_loops:
        input_units = {"roll_ref_rad": "rad", "pitch_ref_rad": "rad", "yaw_rate_ref_rad_s": "rad/s"}
    else:
        input_units = dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), "rad") | dict.fromkeys(RATES, "rad/s")
    asked_for = {"time_s": "s"} | ({} if attitude_loops else dict.fromkeys(ACCELERATIONS, "rad/s^2"))
    input_units |= {"throttle": "1", "voltage_v": "V"} | asked_for
    u = {n: ca.SX.sym(n) for n in input_units}

    s = Signals(
        throttle=u["throttle"], voltage=u["voltage_v"], time_s=u["time_s"], height_m=x["p_z_m"], a_t=x["a_t_m_s2"],
        relative_thrust=x["a_t_m_s2"] / constants["g"],
        nominal_voltage=constants["nominal_voltage_v"], rotor_height=constants["rotor_height_m"],
        g=constants["g"], base=p, sigma_t=p["sigma_t"],
    )  # fmt: skip
    s.v_world, s.v_trimmed = ca.vertcat(*(x[n] for n in VELOCITY)), ca.SX.zeros(3)
    term_states = {n.name: x[n.name] for n in own}
    rates: dict[str, Any] = {}
    if attitude_loops:
        s.roll, s.roll_rate, s.pitch, s.pitch_rate, s.yaw_rate, s.yaw = (x[n] for n in LOOPS)
        s.roll_ref, s.pitch_ref, s.yaw_rate_ref = u["roll_ref_rad"], u["pitch_ref_rad"], u["yaw_rate_ref_rad_s"]
        s.rotation = body.rotation(s.roll, s.pitch, s.yaw)
        yaw_dot = body.yaw_kinematics(s)
        s.rates = body.body_rates(s, yaw_dot)
        rates |= attitude(terms, s, p, term_states)
        loops = (s.roll_rate, s.roll_acceleration, s.pitch_rate, s.pitch_acceleration, s.yaw_acceleration, yaw_dot)
        s.angular_acceleration = ca.jtimes(s.rates, ca.vertcat(*(x[n] for n in LOOPS)), ca.vertcat(*loops))
        rates |= dict(zip(LOOPS, loops, strict=True))
    else:
        s.roll, s.pitch, s.yaw = u["roll_rad"], u["pitch_rad"], u["yaw_rad"]
        s.target_roll, s.target_pitch = s.roll, s.pitch
        s.rotation = body.rotation(s.roll, s.pitch, s.yaw)
        s.rates = ca.vertcat(*(u[n] for n in RATES))
        s.yaw_rate = s.rates[2]
        s.roll_rate, s.pitch_rate = body.euler_rates(s.roll, s.pitch, s.rates)
        s.angular_acceleration = ca.vertcat(*(u[n] for n in ACCELERATIONS))
        s.measured.update(roll=s.roll, pitch=s.pitch, r=s.yaw_rate)
    rates |= translation(terms, s, p, term_states, ca.SX.zeros(3))
    rates |= dict(zip(POSITION, (x[n] for n in VELOCITY), strict=True))
    rates |= dict(zip(VELOCITY, ca.vertsplit(s.v_dot_world), strict=True))
    rates["a_t_m_s2"] = s.a_t_dot

    x_dot = ca.vertcat(*(rates[n] for n in state_units))
    f = s.measured["f"]
    y = ca.vertcat(
        *(x[n] for n in POSITION), s.measured["v"], s.measured["roll"], s.measured["pitch"], s.yaw, s.rates[:2],
        s.measured["r"], f, s.rotation @ f - ca.vertcat(0, 0, s.g),
    )  # fmt: skip
    for name in asked_for:
        if not ca.depends_on(ca.vertcat(x_dot, y), u[name]):
            del input_units[name]
    channels = delays(terms, p)
    by_input = {
        "throttle": "thrust",
        "roll_ref_rad": "attitude",
        "pitch_ref_rad": "attitude",
        "yaw_rate_ref_rad_s": "yaw_rate",
    }
    arguments = [ca.vertcat(*x.values()), ca.vertcat(*(u[n] for n in input_units)), ca.vertcat(*p.values())]
    return System(
        states=state_units,
        inputs=input_units,
        outputs=OUTPUTS,
        params=tuple(p),
        initial={n.name: n.initial for n in own},
        input_delay={n: by_input.get(n, "") for n in input_units},
        delay_channels=tuple(channels),
        function=ca.Function("dynamics", arguments, [x_dot, y], ["x", "u", "p"], ["x_dot", "y"]),
        delays_s=ca.Function("delays", [arguments[2]], [ca.vertcat(*channels.values())]),
    )


@dataclass(frozen=True)
class AtRest:
    """throttle (n,); states (k, n): of the system, level at height 0, world velocity 0."""

    throttle: FloatArray
    states: FloatArray


class RestSolver:
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
        self._newton = ca.Function("at_rest", [x, u, p], [rates, ca.jacobian(rates, sought)])

    def at(self, p: FloatArray, voltage_v: FloatArray, guess: FloatArray, a_t_m_s2: float) -> AtRest:
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
                if not (np.isfinite(rates).all() and np.isfinite(slope).all()):
                    break  # absurd values have no rest: the throttle near by stays
                # The least step: of a state that nothing here moves, none.
                step = np.linalg.lstsq(slope, -rates.ravel(), rcond=1e-9)[0]
                u[self._inputs.index("throttle")] += step[0]
                x[self._own] += step[1:]
                if np.abs(step).max() < CLOSE:
                    break
            found[k], x[self._states.index("p_z_m")] = u[self._inputs.index("throttle")], 0.0
            states[:, k] = x
        return AtRest(found, states)
