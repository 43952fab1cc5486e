"""`Block`: an independent part of the model, as the fit integrates it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from flighttest.physics import body
from flighttest.physics.compose import attitude, block_of, delays, translation
from flighttest.physics.core import Expr, Param, Signals, Term

# Signals a block may take as measured, sampled at the segment's times; a block lists those it depends on.
EXOGENOUS = (
    "roll_rad", "pitch_rad", "yaw_rad", "p_rad_s", "q_rad_s", "r_rad_s", "p_dot_rad_s2", "q_dot_rad_s2", "r_dot_rad_s2",
    "target_roll_rad", "target_pitch_rad", "voltage_v", "height_m", "time_s", "relative_thrust",
)  # fmt: skip
AXES = (("roll", ("roll_rad", "roll_rate_rad_s")), ("pitch", ("pitch_rad", "pitch_rate_rad_s")), ("yaw", ("r_rad_s",)))
_REFERENCES = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s")
FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
MEASURED_FORCE = ("measured_f_x_m_s2", "measured_f_y_m_s2", "measured_f_z_m_s2")  # specific force, world
TRIMMED = ("trimmed_u_m_s", "trimmed_v_m_s", "trimmed_w_m_s")  # `SegmentContext.trimmed_m_s`
ACCELERATION = ("a_x_m_s2", "a_y_m_s2", "a_z_m_s2")
TRANSLATION_OUTPUTS = (*FORCE, *VELOCITY, *ACCELERATION)


@dataclass(frozen=True)
class Block:
    """x_dot, y = function(x, p, u, e, d).

    x: `states`; p: `params` (values); u: `inputs`, the delayed references (held between edges); e: `exogenous` measured signals;
    d: `disturbances`, constant over a segment: a_d_x/y/z_m_s2 (world) or an offset of the reference (roll_d_rad, ...); y:
    `outputs` (channel names), as measured but before known filters. free_states: initial value estimated per segment, with the prior
    standard deviation `spread` where a term owns the state; the others start at `initial`. delay: channel name; delay_s(p) its value, s.
    made: what has been compiled of it, shared by all who integrate it.
    """

    name: str
    states: tuple[str, ...]
    free_states: tuple[str, ...]
    initial: Mapping[str, float]
    spread: Mapping[str, float]
    params: tuple[str, ...]
    inputs: tuple[str, ...]
    exogenous: tuple[str, ...]
    disturbances: tuple[str, ...]
    outputs: tuple[str, ...]
    delay: str
    function: ca.Function
    delay_s: ca.Function
    made: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False, init=False)

    def __getstate__(self) -> dict[str, Any]:
        """What has been compiled stays behind when a block goes to another process."""
        return {**self.__dict__, "made": {}}


class BlockStore:
    """Blocks of models derived from one another: equal ones are one object, with all that was compiled of it, and made once. Of more than
    `KEPT`, the one not asked for longest is dropped. It goes empty to another process."""

    KEPT = 128  # attitude axes and translations: a diagnosis tries about so many

    def __init__(self) -> None:
        self._known: dict[Hashable, tuple[Block, ...]] = {}

    def of(self, key: Hashable, make: Callable[[], tuple[Block, ...]]) -> tuple[Block, ...]:
        """The blocks under a key, made where they are not there yet."""
        found = self._known.pop(key, None)
        if found is None:
            found = make()
        self._known[key] = found
        while len(self._known) > self.KEPT:
            del self._known[next(iter(self._known))]
        return found

    def __getstate__(self) -> dict[str, Any]:
        """Nothing: CasADi's functions are cheaper made than carried."""
        return {"_known": {}}


@dataclass(frozen=True)
class _Draft:
    """A block as expressions by name, as `Block` names its parts; delay: channel, delay_s: its value in p."""

    name: str
    delay: str
    delay_s: Expr
    x: Mapping[str, Expr]
    x_dot: Mapping[str, Expr]
    p: Mapping[str, Expr]
    u: Mapping[str, Expr]
    e: Mapping[str, Expr]
    d: Mapping[str, Expr]
    y: Mapping[str, Expr]
    initial: Mapping[str, float]
    spread: Mapping[str, float]

    def block(self) -> Block:
        """Drop what the block does not depend on and build its functions."""
        out = ca.vertcat(*self.x_dot.values(), *self.y.values())
        p = {k: v for k, v in self.p.items() if ca.depends_on(ca.vertcat(out, self.delay_s), v)}
        e = {k: v for k, v in self.e.items() if ca.depends_on(out, v)}
        u = {k: v for k, v in self.u.items() if ca.depends_on(out, v)}
        args = [ca.vertcat(*group.values()) if group else ca.SX(0, 1) for group in (self.x, p, u, e, self.d)]
        results = [ca.vertcat(*self.x_dot.values()), ca.vertcat(*self.y.values())]
        return Block(
            name=self.name,
            states=tuple(self.x),
            free_states=tuple(k for k in self.x if k not in self.initial),
            initial=dict(self.initial),
            spread={k: v for k, v in self.spread.items() if k in self.x},
            params=tuple(p),
            inputs=tuple(u),
            exogenous=tuple(e),
            disturbances=tuple(self.d),
            outputs=tuple(self.y),
            delay=self.delay,
            function=ca.Function(self.name, args, results, ["x", "p", "u", "e", "d"], ["x_dot", "y"]),
            delay_s=ca.Function(f"{self.name}_delay", [args[1]], [self.delay_s]),
        )


def _symbols(names: Sequence[str]) -> dict[str, Expr]:
    return {n: ca.SX.sym(n) for n in names}


def _term_states(terms: Sequence[Term], block: str) -> tuple[dict[str, Expr], dict[str, float], dict[str, float]]:
    """Symbols, initial values of those that are not free, prior standard deviations of those that are."""
    states = [s for t in terms if block_of(t) == block for s in t.states]
    return (
        _symbols([s.name for s in states]),
        {s.name: s.initial for s in states if not s.free},
        {s.name: s.spread for s in states if s.free},
    )


def measured_signals(e: Mapping[str, Expr], p: Mapping[str, Expr], constants: Mapping[str, float]) -> Signals:
    """Signals whose attitude, rates, height, voltage and time are the measured ones."""
    s = Signals(
        roll=e["roll_rad"], pitch=e["pitch_rad"], yaw=e["yaw_rad"],
        target_roll=e["target_roll_rad"], target_pitch=e["target_pitch_rad"],
        voltage=e["voltage_v"], height_m=e["height_m"], time_s=e["time_s"], relative_thrust=e["relative_thrust"],
        nominal_voltage=constants["nominal_voltage_v"], rotor_height=constants["rotor_height_m"], g=constants["g"], base=dict(p),
    )  # fmt: skip
    s.rates = ca.vertcat(e["p_rad_s"], e["q_rad_s"], e["r_rad_s"])
    s.angular_acceleration = ca.vertcat(e["p_dot_rad_s2"], e["q_dot_rad_s2"], e["r_dot_rad_s2"])
    s.rotation = body.rotation(s.roll, s.pitch, s.yaw)
    s.roll_rate, s.pitch_rate = body.euler_rates(s.roll, s.pitch, s.rates)
    s.yaw_rate = s.rates[2]
    return s


def translation_block(terms: Sequence[Term], params: Sequence[Param], constants: Mapping[str, float]) -> Block:
    """Velocity (world) and a_t, driven by throttle and the measured attitude."""
    p, e = _symbols([q.name for q in params]), _symbols(EXOGENOUS)
    own, initial, spread = _term_states(terms, "translation")
    x = _symbols(["v_x_m_s", "v_y_m_s", "v_z_m_s", "a_t_m_s2"]) | own
    u = _symbols(["throttle"])
    d = _symbols(["a_d_x_m_s2", "a_d_y_m_s2", "a_d_z_m_s2"])
    s = measured_signals(e, p, constants)
    s.v_world = ca.vertcat(x["v_x_m_s"], x["v_y_m_s"], x["v_z_m_s"])
    s.a_t, s.throttle = x["a_t_m_s2"], u["throttle"]
    s.sigma_t = p["sigma_t"]
    rates = translation(terms, s, p, own, ca.vertcat(*d.values()))
    x_dot = dict(zip(x, [*ca.vertsplit(s.v_dot_world), s.a_t_dot, *(rates[n] for n in own)], strict=True))
    f, v = s.measured["f"], s.measured["v"]
    a = s.rotation @ f - ca.vertcat(0, 0, s.g)
    y = dict(zip(TRANSLATION_OUTPUTS, [*ca.vertsplit(f), *ca.vertsplit(v), *ca.vertsplit(a)], strict=True))
    delay = delays(terms, p)["thrust"]
    return _Draft("translation", "thrust", delay, x, x_dot, p, u, e, d, y, initial, spread).block()


def measured_velocity_block(terms: Sequence[Term], params: Sequence[Param], constants: Mapping[str, float]) -> Block:
    """Specific force and world acceleration at the measured velocity and attitude: the equations of motion, not integrated.

    Its states are a_t and those of terms; velocity and acceleration are exogenous signals, so that nothing but the lags and what the
    acceleration swings has a memory.
    """
    p, e = _symbols([q.name for q in params]), _symbols([*EXOGENOUS, *VELOCITY, *MEASURED_FORCE])
    own, initial, spread = _term_states(terms, "translation")
    x = _symbols(["a_t_m_s2"]) | own
    u = _symbols(["throttle"])
    s = measured_signals(e, p, constants)
    s.v_world, s.measured_force = (ca.vertcat(*(e[name] for name in names)) for names in (VELOCITY, MEASURED_FORCE))
    s.a_t, s.throttle = x["a_t_m_s2"], u["throttle"]
    s.sigma_t = p["sigma_t"]
    rates = translation(terms, s, p, own, ca.SX.zeros(3))
    x_dot = dict(zip(x, [s.a_t_dot, *(rates[n] for n in own)], strict=True))
    values = [*ca.vertsplit(s.measured["f"]), *ca.vertsplit(s.v_dot_world)]
    y = dict(zip((*FORCE, *ACCELERATION), values, strict=True))
    return _Draft(
        "translation", "thrust", delays(terms, p)["thrust"], x, x_dot, p, u, e, {}, y, initial, spread
    ).block()


def attitude_blocks(
    terms: Sequence[Term], params: Sequence[Param], constants: Mapping[str, float]
) -> tuple[Block, ...]:
    """Roll, pitch and yaw rate loops; axes that a term couples come as one block."""
    p, e = _symbols([q.name for q in params]), _symbols([*EXOGENOUS, *VELOCITY, *TRIMMED])
    own, initial, spread = _term_states(terms, "attitude")
    x = _symbols([n for _, names in AXES for n in names]) | own
    u = _symbols(_REFERENCES)
    d = _symbols(["roll_d_rad", "pitch_d_rad", "yaw_rate_d_rad_s"])
    s = measured_signals(e, p, constants)
    s.v_world, s.v_trimmed = (ca.vertcat(*(e[name] for name in names)) for names in (VELOCITY, TRIMMED))
    s.roll_ref = u["roll_ref_rad"] + d["roll_d_rad"]
    s.pitch_ref = u["pitch_ref_rad"] + d["pitch_d_rad"]
    s.yaw_rate_ref = u["yaw_rate_ref_rad_s"] + d["yaw_rate_d_rad_s"]
    s.roll, s.pitch, s.yaw_rate = x["roll_rad"], x["pitch_rad"], x["r_rad_s"]
    s.roll_rate, s.pitch_rate = x["roll_rate_rad_s"], x["pitch_rate_rad_s"]
    rates = attitude(terms, s, p, own)
    x_dot = {
        "roll_rad": s.roll_rate,
        "roll_rate_rad_s": s.roll_acceleration,
        "pitch_rad": s.pitch_rate,
        "pitch_rate_rad_s": s.pitch_acceleration,
        "r_rad_s": s.yaw_acceleration,
        **{n: rates[n] for n in own},
    }
    y = {"roll_rad": s.measured["roll"], "pitch_rad": s.measured["pitch"], "r_rad_s": s.measured["r"]}
    channel_delay = delays(terms, p)

    found = []
    for states in _components(x, x_dot, u, y):
        axes = [name for name, names in AXES if names[0] in states]
        channel = "yaw_rate" if axes == ["yaw"] else "attitude"
        found.append(
            _Draft(
                "_".join(axes) or "_".join(states),
                channel,
                channel_delay[channel],
                {k: v for k, v in x.items() if k in states},
                {k: v for k, v in x_dot.items() if k in states},
                p,
                u,
                e,
                {k: v for k, v in d.items() if k.split("_d_")[0] in {a.replace("yaw", "yaw_rate") for a in axes}},
                {k: v for k, v in y.items() if k in states},
                {k: v for k, v in initial.items() if k in states},
                spread,
            ).block()
        )
    return tuple(b for b in found if b.outputs)


def _components(
    x: Mapping[str, Expr], x_dot: Mapping[str, Expr], u: Mapping[str, Expr], y: Mapping[str, Expr]
) -> list[tuple[str, ...]]:
    """Groups of states that depend on each other or share an input, in the order of `x`."""
    leader = {name: name for name in [*x, *(f"u:{k}" for k in u)]}

    def find(name: str) -> str:
        while leader[name] != name:
            name = leader[name]
        return name

    for target, expr in [*x_dot.items(), *y.items()]:
        for name, symbol in [*x.items(), *((f"u:{k}", v) for k, v in u.items())]:
            if ca.depends_on(expr, symbol):
                leader[find(name)] = find(target)
    groups: dict[str, list[str]] = {}
    for name in x:
        groups.setdefault(find(name), []).append(name)
    return [tuple(g) for g in groups.values()]
