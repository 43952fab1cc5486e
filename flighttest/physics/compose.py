"""The ports, evaluated in order: body equations plus every term, on one `Signals`.

The same two functions serve the fit (attitude and translation apart, the translation driven by the measured attitude), the
simulation and the export (chained). They are the only place where contributions are combined.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import casadi as ca

from flighttest.errors import ModelError
from flighttest.physics import body
from flighttest.physics.core import Expr, Port, Signals, Term

ATTITUDE_KEYS = frozenset(
    {"roll_ref", "pitch_ref", "target_roll", "target_pitch", "yaw_rate_ref", "roll", "pitch", "r"}
)
TRANSLATION_KEYS = frozenset({"throttle", "f", "v"})


def symbolic_signals() -> Signals:
    """Signals made of fresh symbols, to ask a term what it contributes and what it depends on."""
    sym = ca.SX.sym
    scalars = {name: sym(name) for name, default in vars(Signals()).items() if isinstance(default, float)}
    vectors = {
        name: sym(name, 3)
        for name in ("rates", "angular_acceleration", "v_world", "v_dot_world", "v_air_body", "v_trimmed", "force")
    }
    base = {p.name: sym(p.name) for p in (*body.ATTITUDE_PARAMS, *body.THRUST_PARAMS)}
    measured = {"f": sym("f", 3), "v": sym("v", 3), "roll": sym("m_roll"), "pitch": sym("m_pitch"), "r": sym("m_r")}
    return Signals(**scalars, **vectors, rotation=sym("R", 3, 3), measured=measured, base=base)


def block_of(term: Term) -> str:
    """'attitude' or 'translation': where the term is evaluated; 'delay' for terms that only shift inputs in time."""
    if term.port is Port.DELAY:
        return "delay"
    if term.port.block != "both":
        return term.port.block
    value = term.build(
        symbolic_signals(),
        {p.name: ca.SX.sym(p.name) for p in term.params},
        {s.name: ca.SX.sym(s.name) for s in term.states},
    ).value
    keys = set(value)
    if keys and keys <= ATTITUDE_KEYS:
        return "attitude"
    if keys and keys <= TRANSLATION_KEYS:
        return "translation"
    raise ModelError(
        f"term {term.id} contributes {sorted(keys)} at {term.port.name}",
        f"name only keys of one block: {sorted(ATTITUDE_KEYS)} or {sorted(TRANSLATION_KEYS)}",
    )


def delays(terms: Iterable[Term], p: Mapping[str, Expr]) -> dict[str, Expr]:
    """Delay of each channel, s, as an expression of the parameters: 'attitude', 'yaw_rate', 'thrust' (those that exist)."""
    found = {
        channel: p["T_d"] if "T_d" in p else p[name]
        for channel, name in body.DELAY_PARAM.items()
        if "T_d" in p or name in p
    }
    for term in terms:
        if term.port is Port.DELAY:
            for channel, extra in term.build(Signals(), _own(term, p), {}).value.items():
                if channel in found:
                    found[channel] = found[channel] + extra
    return found


def attitude(terms: Iterable[Term], s: Signals, p: Mapping[str, Expr], states: Mapping[str, Expr]) -> dict[str, Expr]:
    """Evaluate the attitude block on `s`, in place; returns the rates of the states its terms own.

    Reads references, Euler angles and rates; fills targets, accelerations and the measured roll, pitch and r.
    """
    terms = [t for t in terms if block_of(t) == "attitude"]
    rates: dict[str, Expr] = {}
    s.target_roll, s.target_pitch = s.roll_ref, s.pitch_ref
    for term in _at(terms, Port.REFERENCE):
        for key, value in _build(term, s, p, states, rates).items():
            setattr(s, key, value)
    s.roll_acceleration = body.roll_acceleration(s)
    s.pitch_acceleration = body.pitch_acceleration(s)
    s.yaw_acceleration = body.yaw_acceleration(s)
    for term in _at(terms, Port.ANGULAR):
        extra = _vector(_build(term, s, p, states, rates))
        s.roll_acceleration += extra[0]
        s.pitch_acceleration += extra[1]
        s.yaw_acceleration += extra[2]
    s.measured.update(roll=s.roll, pitch=s.pitch, r=s.yaw_rate)
    for term in _at(terms, Port.MEASUREMENT):
        s.measured.update(_build(term, s, p, states, rates))
    return rates


def translation(
    terms: Iterable[Term], s: Signals, p: Mapping[str, Expr], states: Mapping[str, Expr], disturbance: Expr
) -> dict[str, Expr]:
    """Evaluate the translation block on `s`, in place; returns the rates of the states its terms own.

    Reads attitude, rotation, v_world, a_t, throttle, voltage; `disturbance` is a_d, (3,) world. Fills everything up to v_dot_world and the
    measured specific force and velocity.
    """
    terms = [t for t in terms if block_of(t) == "translation"]
    rates: dict[str, Expr] = {}
    wind = ca.SX.zeros(3)
    for term in _at(terms, Port.WIND):
        wind = wind + _vector(_build(term, s, p, states, rates))
    s.v_air_body = s.rotation.T @ (s.v_world - wind)
    for term in _at(terms, Port.REFERENCE):
        for key, value in _build(term, s, p, states, rates).items():
            setattr(s, key, value)
    s.command = body.thrust_command(s)
    for term in _at(terms, Port.MOTOR_GAIN):
        s.command = s.command * _build(term, s, p, states, rates)
    s.a_t_dot = body.thrust_rate(s)
    for term in _at(terms, Port.THRUST_LAG):
        s.a_t_dot = _build(term, s, p, states, rates)
    s.a_t_total = s.a_t
    for term in _at(terms, Port.AERO_GAIN):
        s.a_t_total = s.a_t_total * _build(term, s, p, states, rates)
    s.force = ca.vertcat(0, 0, s.a_t_total)
    for term in _at(terms, Port.FORCE):
        s.force = s.force + _vector(_build(term, s, p, states, rates))
    s.force = s.force + s.rotation.T @ disturbance
    s.v_dot_world = s.rotation @ s.force - ca.vertcat(0, 0, s.g)
    s.measured.update(f=s.force, v=s.v_world)
    for term in _at(terms, Port.MEASUREMENT):
        s.measured.update(_build(term, s, p, states, rates))
    return rates


def _at(terms: Iterable[Term], port: Port) -> list[Term]:
    return [t for t in terms if t.port is port]


def _own(term: Term, p: Mapping[str, Expr]) -> dict[str, Expr]:
    return {q.name: p[q.name] for q in term.params}


def _build(term: Term, s: Signals, p: Mapping[str, Expr], states: Mapping[str, Expr], rates: dict[str, Expr]) -> Expr:
    made = term.build(s, _own(term, p), {x.name: states[x.name] for x in term.states})
    rates.update(made.state_rates)
    return made.value


def _vector(value: Expr) -> Expr:
    return ca.vertcat(*value) if isinstance(value, tuple | list) else ca.SX(value)
