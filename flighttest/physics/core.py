"""The declarations physics is made of: `Param`, `State`, `Port`, `Signals`, `Term`.

A term plugs into one port. Ports are evaluated in the order of `Port`, so a term sees what the ports before its own
have made of the signals (the wind-relative velocity, the boosted throttle, the sagged voltage, ...): composition is acyclic.
CasADi expressions are not Python numbers: no `if`, `max`, `and` or `==` on them; use `casadi.if_else`, `fmax`, smooth forms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal

from flighttest.frames import G_M_S2

Expr = Any  # casadi.SX or float; casadi carries no types
Values = Mapping[str, Expr]  # of parameters or states, by name

Family = Literal["body", "aerodynamics", "propulsion", "payload", "autopilot", "sensor", "link"]
ParamKind = Literal["base", "amplitude", "shape"]


class Port(Enum):
    """Where a term acts: (unit, how contributions combine, block). Declared in evaluation order.

    block 'attitude': roll, pitch and yaw rate loops; 'translation': thrust, forces, velocity and what is measured of them.
    """

    WIND = ("m/s", "sum of (3,) world vectors; air-relative velocity is v minus it", "translation")
    DELAY = ("s", "sum per channel: attitude, yaw_rate, thrust", "both")
    REFERENCE = ("1", "composition: maps the attitude, yaw rate or throttle reference", "both")
    MOTOR_GAIN = ("1", "product on the commanded thrust, before the lag", "translation")
    THRUST_LAG = ("m/s^3", "composition: maps the rate of a_t", "translation")
    AERO_GAIN = ("1", "product on a_t, after the lag", "translation")
    FORCE = ("m/s^2", "sum of (3,) specific forces in body axes", "translation")
    ANGULAR = ("rad/s^2", "sum on roll, pitch and yaw acceleration, or a map of the rates", "attitude")
    MEASUREMENT = ("as measured", "maps specific force, velocity or attitude as the sensors report them", "both")

    @property
    def unit(self) -> str:
        """Unit of what a term contributes here."""
        return str(self.value[0])

    @property
    def block(self) -> str:
        """'attitude', 'translation' or 'both'."""
        return str(self.value[2])


# Prior standard deviation of a linear coefficient, in nominal sizes: effects of a tenth to three sizes fly.
PRIOR_SIZES = 3.0


@dataclass(frozen=True)
class Param:
    """One parameter of a term.

    kind: 'base' (always estimated), 'amplitude' (vanishes exactly at `off`, with a slope there that is not zero) or 'shape' (a
    limit, pole, width, length: without meaning at off; screened on `screen`, three to five declared values). scale: a
    typical size, used to normalise. one_sided: physics allows only the side of `off` on which `nominal` lies (a drag cannot push): an
    estimate well on the other side is another effect in disguise. alone: whether it can be all there is of its term (a wind that only
    rises cannot: what does that is thrust). limits: what it is a limit of, 'throttle' or 'tilt_rate' (what the angle loops ask for): a
    limit that was not reached cannot be known. natural_bound: the bound at which the term is still itself, in its limit (a time
    constant too short, or too long, to be seen); at any other its estimate is not what its name means. drift: standard deviation of what
    instruments have of it in any flight, which no recording distinguishes from more of the same. spread: standard deviation of the prior of
    a coefficient that vehicles differ in by more than `PRIOR_SIZES` nominal sizes.
    """

    name: str
    symbol: str
    unit: str
    nominal: float
    lower: float
    upper: float
    scale: float
    doc: str
    source: str
    kind: ParamKind = "amplitude"
    off: float | None = 0.0
    screen: tuple[float, ...] = ()
    one_sided: bool = False
    alone: bool = True
    limits: Literal["", "throttle", "tilt_rate"] = ""
    natural_bound: Literal["", "lower", "upper"] = ""
    drift: float = 0.0
    spread: float = 0.0

    @property
    def prior_std(self) -> float:
        """Of the normal prior of a linear coefficient about `off`."""
        return self.spread or PRIOR_SIZES * max(abs(self.nominal - (self.off or 0.0)), 1e-12)

    @property
    def physical(self) -> tuple[float, float]:
        """Smallest and largest value that physics allows: the bounds, of a one-sided parameter from `off` on."""
        if not self.one_sided or self.off is None:
            return self.lower, self.upper
        return (self.off, self.upper) if self.nominal > self.off else (self.lower, self.off)


@dataclass(frozen=True)
class State:
    """A state a term owns: name, unit, doc, and whether its initial value is free (estimated per segment, with the prior standard
    deviation `spread` about `initial`) or `initial`. settles: to `initial`, where nothing moves the vehicle."""

    name: str
    unit: str
    doc: str
    free: bool = False
    initial: float = 0.0
    spread: float = 1.0
    settles: bool = False


@dataclass
class Signals:
    """What a term may read, as CasADi expressions; `physics.model` fills it port by port.

    References are the delayed ones. v_air_body: (3,) air-relative velocity in body axes; relative_thrust: over that of hover;
    v_trimmed: (3,) that velocity, times the root of that thrust, at which the autopilot has trimmed the moments of the air away; rates,
    angular_acceleration: (3,) body; rotation: (3, 3) body to world; height_m: of the feet above ground; rotor_height: of the rotors above
    the feet, m; time_s: since take-off; a_t: thrust acceleration after the lag (before aero gain), a_t_total after it; command: commanded
    thrust acceleration K (U/U_n)^alpha T times motor gains; a_t_dot: rate of a_t so far (what THRUST_LAG maps); force: (3,)
    specific force so far; measured_force: (3,) all of it as measured, world, None where it is not; v_dot_world: (3,) once all forces
    are known (MEASUREMENT only); target_roll/target_pitch: the attitude target (shaped where recorded, else the reference).
    roll_acceleration, pitch_acceleration, yaw_acceleration: second Euler derivatives and r_dot so far (what ANGULAR adds to).
    measured: what the sensors report so far, keys 'f' (3,) 'v' (3,) 'roll' 'pitch' 'r'. base: the body's own parameters by name.
    """

    roll_ref: Expr = 0.0
    pitch_ref: Expr = 0.0
    yaw_rate_ref: Expr = 0.0
    throttle: Expr = 0.0
    target_roll: Expr = 0.0
    target_pitch: Expr = 0.0
    voltage: Expr = 0.0
    nominal_voltage: Expr = 1.0
    roll: Expr = 0.0
    pitch: Expr = 0.0
    yaw: Expr = 0.0
    roll_rate: Expr = 0.0
    pitch_rate: Expr = 0.0
    yaw_rate: Expr = 0.0
    rates: Expr = None
    angular_acceleration: Expr = None
    rotation: Expr = None
    v_world: Expr = None
    v_dot_world: Expr = None
    v_air_body: Expr = None
    v_trimmed: Expr = None
    height_m: Expr = 0.0
    rotor_height: Expr = 0.0
    relative_thrust: Expr = 1.0
    time_s: Expr = 0.0
    a_t: Expr = 0.0
    a_t_total: Expr = 0.0
    command: Expr = 0.0
    sigma_t: Expr = 0.0
    a_t_dot: Expr = 0.0
    roll_acceleration: Expr = 0.0
    pitch_acceleration: Expr = 0.0
    yaw_acceleration: Expr = 0.0
    force: Expr = None
    measured_force: Expr = None
    g: Expr = G_M_S2
    measured: dict[str, Expr] = field(default_factory=dict)
    base: Mapping[str, Expr] = field(default_factory=dict)


@dataclass(frozen=True)
class Contribution:
    """What a term adds at its port, and the rates of the states it owns.

    value by port: WIND (3,) world m/s; DELAY a mapping of 'attitude', 'yaw_rate', 'thrust' to added seconds; REFERENCE a mapping
    of 'roll_ref', 'pitch_ref', 'target_roll', 'target_pitch', 'yaw_rate_ref', 'throttle' to their new expression (name only what changes;
    all of one block; the target is the attitude asked for, the reference what the loop is given, which may run ahead of it);
    VOLTAGE added volts; MOTOR_GAIN and AERO_GAIN a factor; THRUST_LAG the new a_t_dot; FORCE (3,) m/s^2 in body axes; ANGULAR (3,)
    added roll, pitch and yaw acceleration; MEASUREMENT a mapping of keys of `Signals.measured` to their new expression.
    """

    value: Any
    state_rates: Mapping[str, Expr] = field(default_factory=dict)


@dataclass(frozen=True)
class Term:
    """One piece of physics.

    id: as in the catalogue; equation: one line of plain text; plain: the sentence an operator reads; hides_in: base parameters
    that absorb it; told_apart_by: what separates it from rivals; reveals: the shipped maneuver script that shows it; needs:
    channels without which it cannot be seen; build(signals, params, states) gives its contribution.
    """

    id: str
    title: str
    family: Family
    port: Port
    params: tuple[Param, ...]
    build: Callable[[Signals, Mapping[str, Expr], Mapping[str, Expr]], Contribution]
    equation: str
    plain: str
    source: str
    doubt: str
    hides_in: tuple[str, ...]
    told_apart_by: str
    reveals: str
    needs: tuple[str, ...]
    states: tuple[State, ...] = ()

    def __repr__(self) -> str:
        return f"<Term {self.id}: {self.equation}>"

    @property
    def amplitudes(self) -> tuple[Param, ...]:
        """Parameters with an off value."""
        return tuple(p for p in self.params if p.kind == "amplitude")

    @property
    def shapes(self) -> tuple[Param, ...]:
        """Parameters without meaning at off."""
        return tuple(p for p in self.params if p.kind == "shape")
