"""An identified vehicle without its attitude loops, for an autopilot that brings its own: motor commands in, motion out.

Rotation is a frame's: each moment of the motors is an angular acceleration with a first-order lag; moments of the air are the identified
model's. Translation is the identified model's, driven by the attitude that comes of it; the mean motor command is its throttle. Moments of
the motors are made by the rotors that make the thrust: what the air and the battery do to one, they do to the other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import cos, exp, sin

import casadi as ca

from flighttest.frames import G_M_S2
from flighttest.physics.body import rotation
from flighttest.physics.core import Port, Signals
from flighttest.physics.model import Model
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import IdentifiedVehicle
from flighttest.sim.plants.plant_terms import TermsPlant, of_description
from flighttest.sim.plants.weather import Air

# Signs of roll, pitch (FLU) and yaw of a quadrotor X in ArduCopter's motor order: front right, rear left, front left, rear right.
_ROLL, _PITCH, _YAW = (-1.0, 1.0, 1.0, -1.0), (-1.0, 1.0, -1.0, 1.0), (-1.0, -1.0, 1.0, 1.0)
AXES = ("roll", "pitch", "yaw")
_UP = "f_z_m_s2"


class FramePlant(TermsPlant):
    """Driven motor by motor, a command 0..1 being static thrust at constant voltage (a `json_backend.MotorDriven`).

    described: `SimOptions.model` without attitude loops, and its `frame`: gain_* (angular acceleration of a full output of the autopilot,
    rad/s^2), lag_* (s) of roll, pitch and yaw, thrust_delay (s).
    """

    motors = 4

    def __init__(self, described: IdentifiedVehicle, battery: Battery | None = None, air: Air | None = None) -> None:
        model, values = of_description(described)
        super().__init__(model, values, battery, air)
        self._of_the_air, self._in_air = moments_of_the_air(model, values), thrust_in_air(model, values)
        frame = described["frame"]
        self._gains = [float(frame[f"gain_{n}"]) for n in AXES]
        self._lags = [float(frame[f"lag_{n}"]) for n in AXES]
        self._late_s = float(frame["thrust_delay"])
        self._given: deque[tuple[float, float]] = deque()
        self._throttle = 0.0
        self._turning = [0.0, 0.0, 0.0]  # angular acceleration by the motors, rad/s^2
        self.rates_rad_s = [0.0, 0.0, 0.0]
        self._angles = [0.0, 0.0, 0.0]  # roll, pitch, yaw
        self.time_s = 0.0

    def step(self, motor_commands: Sequence[float], dt_s: float) -> None:
        """Move on by dt_s, s, under constant motor commands 0..1."""
        m = self.motion
        self.time_s += dt_s
        if m.on_ground:
            self.rates_rad_s, self._turning = [0.0] * 3, [0.0] * 3
        else:
            self._turn(motor_commands, dt_s)
        roll, pitch, yaw = self._angles
        p, q, r = self.rates_rad_s
        p_dot, q_dot, r_dot = self._turning if not m.on_ground else (0.0, 0.0, 0.0)
        given = {
            "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw, "p_rad_s": p, "q_rad_s": q, "r_rad_s": r,
            "p_dot_rad_s2": p_dot, "q_dot_rad_s2": q_dot, "r_dot_rad_s2": r_dot,
            "throttle": self._delayed(sum(motor_commands) / self.motors),
        }  # fmt: skip
        self._translate(dt_s, given, spinning=sum(motor_commands) > 0.0)

    def _turn(self, commands: Sequence[float], h: float) -> None:
        """Moments to angular accelerations, rates and angles."""
        gain = self.voltage_gain * self._in_air(self._x, self._u[:-1])
        wanted = [
            0.5 * g * gain * sum(s * c for s, c in zip(signs, commands, strict=False))
            for g, signs in zip(self._gains, (_ROLL, _PITCH, _YAW), strict=True)
        ]
        turning = [w + (a - w) * exp(-h / lag) for w, a, lag in zip(wanted, self._turning, self._lags, strict=True)]
        pushed = turning
        if self._of_the_air is not None:
            added = self._of_the_air(
                self._angles, self._through_the_air(), float(self._x[self._index["a_t_m_s2"]]) / G_M_S2
            )
            pushed = [a + b for a, b in zip(turning, added.full().ravel().tolist(), strict=True)]
        p, q, r = (v + 0.5 * h * a for v, a in zip(self.rates_rad_s, pushed, strict=True))
        self._turning, self.rates_rad_s = turning, [v + h * a for v, a in zip(self.rates_rad_s, pushed, strict=True)]
        roll, pitch, yaw = self._angles
        around = sin(roll) * q + cos(roll) * r
        self._angles = [
            roll + h * (p + sin(pitch) / cos(pitch) * around),
            pitch + h * (cos(roll) * q - sin(roll) * r),
            yaw + h * around / cos(pitch),
        ]

    def _through_the_air(self) -> list[float]:
        """World velocity less that of a gust, m/s."""
        gust = (self._air.x, self._air.y, self._air.z) if self._air is not None else (0.0, 0.0, 0.0)
        flown = self._x[self._vz - 2 : self._vz + 1].tolist()
        return [v - w for v, w in zip(flown, gust, strict=True)]

    def _delayed(self, throttle: float) -> float:
        given = self._given
        if not given or given[-1][1] != throttle:
            given.append((self.time_s, throttle))
        while given and given[0][0] <= self.time_s - self._late_s:
            self._throttle = given.popleft()[1]
        return self._throttle

    def _touch_down(self) -> None:
        """The ground stops the rotation, too; a vehicle that fell lies as it fell."""
        yaw = self._angles[2]
        super()._touch_down()
        self._angles = [self.motion.roll, self.motion.pitch, yaw]
        self.motion.yaw = yaw


def moments_of_the_air(model: Model, values: Mapping[str, float]) -> ca.Function | None:
    """(roll, pitch, yaw in rad, velocity through the air in m/s, world; thrust over that of hover) to the angular acceleration (3,),
    rad/s^2, by the model's aerodynamic moments, of which the autopilot has trimmed nothing: that is what flies it. None where it has
    none."""
    every = replace(model, attitude_loops=True).built_terms
    terms = [t for t in every if t.port is Port.ANGULAR and t.family == "aerodynamics"]
    if not terms:
        return None
    angles, velocity, thrust = ca.SX.sym("angles", 3), ca.SX.sym("v", 3), ca.SX.sym("thrust")
    s = Signals(
        v_world=velocity, v_trimmed=ca.SX.zeros(3), rotation=rotation(*ca.vertsplit(angles)), relative_thrust=thrust
    )
    total = ca.SX.zeros(3)
    for t in terms:
        total += t.build(s, {p.name: values[p.name] for p in t.params}, {x.name: 0.0 for x in t.states}).value
    return ca.Function("moments", [angles, velocity, thrust], [total])


def thrust_in_air(model: Model, values: Mapping[str, float]) -> Callable[..., float]:
    """Of states and inputs of a model: its thrust as a multiple of that without the terms of the air (`Port.AERO_GAIN`), by the specific
    force along the body's up axis with and without them."""
    gains = [t.id for t in model.built_terms if t.port is Port.AERO_GAIN]
    bare = model.without_terms(*gains)
    if not gains or tuple(bare.system.states) != tuple(model.system.states):
        return lambda _states, _inputs: 1.0
    x, u = ca.SX.sym("x", len(model.system.states)), ca.SX.sym("u", len(model.system.inputs))
    at = list(model.system.outputs).index(_UP)
    force, without = (m.system.function(x, u, [values[n] for n in m.names])[1][at] for m in (model, bare))
    thrust = ca.fmax(x[list(model.system.states).index("a_t_m_s2")], 0.1 * G_M_S2)
    made = ca.Function("in_air", [x, u], [1.0 + (force - without) / thrust])
    return lambda states, inputs: float(made(states, inputs))
