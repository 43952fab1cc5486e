"""A composed model in motion: the paper's vehicle with concealed physics from the catalogue, or an identified model.

Each term is evaluated by `physics`, the one place where it is written; keys are the terms' parameter names. For data whose physics the
catalogue has never seen, use the rotor vehicle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from difflib import get_close_matches
from math import cos, sin, sqrt
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.errors import InputError
from flighttest.frames import G_M_S2
from flighttest.physics.model import Model
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import Command, Delays, Hidden, IdentifiedVehicle, Motion
from flighttest.sim.plants.plant_paper import HARD_LANDING_M_S, HOVER_CURRENT_A, TICK_S, PaperParameters
from flighttest.sim.plants.weather import Air

FloatArray = NDArray[np.float64]

_BASE = ("body", "linear_drag")


def of_paper(parameters: PaperParameters) -> tuple[Model, dict[str, float]]:
    """The paper's model and its values."""
    model = Model(_BASE, nominal_voltage_v=parameters.nominal_voltage_v)
    own = asdict(parameters)
    delays = {p.name: parameters.T_d for p in model.params if p.name.startswith("T_d")}
    return model, {p.name: own.get(p.name, p.nominal) for p in model.params} | delays


def of_description(described: IdentifiedVehicle) -> tuple[Model, dict[str, float]]:
    """The model of `SimOptions.model`, and its values."""
    return Model(tuple(described["terms"]), **described["constants"]), dict(described["values"])


def concealing(model: Model, values: Mapping[str, float], hide: Hidden) -> tuple[Model, dict[str, float]]:
    """A model with hidden terms: their values as given or nominal."""
    made = model.with_terms(*hide)
    found = {p.name: values.get(p.name, p.nominal) for p in made.params}
    terms = {t.id: t for t in made.built_terms}
    for name, given in hide.items():
        own = [p.name for p in terms[name].params]
        for key, value in given.items():
            if key not in own:
                near = get_close_matches(key, own, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(own)}"
                raise InputError(f"term {name} has no parameter {key!r}", hint)
            found[key] = float(value)
    return made, found


class TermsPlant:
    """The composed model in motion (a `Plant`)."""

    tick_s = TICK_S

    def __init__(
        self, model: Model, values: Mapping[str, float], battery: Battery | None = None, air: Air | None = None
    ) -> None:
        self.battery, self._air = battery or Battery(), air
        self.motion = Motion(voltage=self.battery.voltage)
        p = [values[name] for name in model.names]
        system = model.system
        delays = dict(zip(system.delay_channels, np.asarray(system.delays_s(p)).ravel().tolist(), strict=True))
        self.delays = Delays(*(max(delays.get(c, 0.0), 0.0) for c in ("attitude", "yaw_rate", "thrust")))
        # Of the body alone: the vehicle's parameters show it, and nothing of what is concealed.
        self.hover_throttle = float(model.hover_throttle_of_body(values, self.battery.voltage))
        self._index = {name: i for i, name in enumerate(system.states)}
        self._inputs = tuple(system.inputs)
        self._start = np.array([system.initial.get(name, 0.0) for name in system.states])
        self._x = self._start.copy()
        self._u = np.zeros(len(self._inputs) + 1)
        self._next, self._y = np.zeros_like(self._x), np.zeros(len(system.outputs))
        self._run = self._compile(system.function, np.array(p))
        self._alpha, self._nominal_v = values["alpha"], model.nominal_voltage_v
        self._vz, self._pz = self._index["v_z_m_s"], self._index["p_z_m"]
        self._flown_s = 0.0
        self._frozen = False

    def _compile(self, function: ca.Function, p: FloatArray) -> Callable[[], None]:
        """One Runge-Kutta step as one call: (x, u with dt last) to the next x and what is measured there."""
        x, u = ca.SX.sym("x", self._x.size), ca.SX.sym("u", self._u.size)
        v, h = u[:-1], u[-1]
        k1 = function(x, v, p)[0]
        k2 = function(x + 0.5 * h * k1, v, p)[0]
        k3 = function(x + 0.5 * h * k2, v, p)[0]
        k4 = function(x + h * k3, v, p)[0]
        new = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        step = ca.Function("step", [x, u], [new, function(new, v, p)[1]])
        buffer: Any
        buffer, run = step.buffer()
        for i, array in enumerate((self._x, self._u)):
            buffer.set_arg(i, array.data)
        for i, array in enumerate((self._next, self._y)):
            buffer.set_res(i, array.data)
        self._buffer = buffer  # keeps the memory that `run` works on
        run_now: Callable[[], None] = run
        return run_now

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V."""
        self.battery.replace(voltage_v)

    def advance(self, dt_s: float, command: Command) -> None:
        """Move on by dt_s, s, under a constant command."""
        steps = int(dt_s / TICK_S - 1e-9) + 1
        h = dt_s / steps
        for _ in range(steps):
            self._step(h, command)

    def _step(self, h: float, command: Command) -> None:
        m = self.motion
        flying = 0.0 if m.on_ground else 1.0  # on the ground nothing turns
        given = {
            "roll_ref_rad": command.roll * flying,
            "pitch_ref_rad": command.pitch * flying,
            "yaw_rate_ref_rad_s": command.yaw_rate * flying,
            "throttle": command.throttle if command.spinning else 0.0,
        }
        self._translate(h, given, command.spinning)
        m.shaped_roll, m.shaped_pitch, m.shaped_yaw_rate = command.roll, command.pitch, command.yaw_rate

    def _translate(self, h: float, given: Mapping[str, float], spinning: bool) -> None:
        """One step of the model under constant inputs, and of the battery that feeds it."""
        m, battery = self.motion, self.battery
        own = {"voltage_v": battery.voltage_ahead(0.5 * h), "time_s": self._flown_s}
        for i, name in enumerate(self._inputs):
            self._u[i] = given[name] if name in given else own[name]
        self._u[-1] = h
        self._integrate(h)
        if m.on_ground:
            self._stand()
        else:
            self._flown_s += h
            self._fly()
        thrust = max(float(self._x[self._index["a_t_m_s2"]]), 0.0) / G_M_S2
        battery.draw((0.4 if spinning else 0.2) + HOVER_CURRENT_A * thrust * sqrt(thrust), h)
        m.voltage, m.current = battery.voltage, battery.current

    @property
    def states(self) -> dict[str, float]:
        """The model's states by name, as they are now, SI."""
        return dict(zip(self._index, self._x.tolist(), strict=True))

    @property
    def voltage_gain(self) -> float:
        """Static thrust at the battery's voltage, as a multiple of that at nominal voltage."""
        gain: float = (self.battery.voltage / self._nominal_v) ** self._alpha
        return gain

    def _integrate(self, h: float) -> None:
        """One step in air that moves: velocities relative to the gust, position with it."""
        air = self._air
        if air is None:
            self._run()
            return
        air.advance(h)
        v = slice(self._vz - 2, self._vz + 1)
        w = np.array([air.x, air.y, air.z])
        self._x[v] -= w
        self._run()
        self._next[v] += w
        self._next[self._pz - 2 : self._pz + 1] += h * w
        self._y[3:6] += w
        self._x[v] += w

    def _stand(self) -> None:
        """On the ground: the thrust grows until it lifts, nothing else moves."""
        m, x, i = self.motion, self._x, self._index
        lifts = self._next[self._vz] > 0.0 and not self._frozen
        if lifts:
            m.on_ground = False
            x[:] = self._next
            self._fly()
            return
        x[i["a_t_m_s2"]] = self._next[i["a_t_m_s2"]]
        m.vx = m.vy = m.vz = m.p = m.q = m.r = 0.0

    def _fly(self) -> None:
        m, x = self.motion, self._x
        if self._next[self._pz] <= 0.0 and self._next[self._vz] < 0.0:
            self._touch_down()
            return
        x[:] = self._next
        (
            m.px, m.py, m.pz, m.vx, m.vy, m.vz, m.roll, m.pitch, m.yaw, m.p, m.q, m.r, m.fx, m.fy, m.fz, *_
        ) = self._y.tolist()  # fmt: skip

    def _touch_down(self) -> None:
        m, i, new = self.motion, self._index, self._next
        m.impact_m_s = -float(new[self._vz])
        loops = "roll_rad" in i  # else the attitude is somebody else's
        roll, pitch = (float(new[i["roll_rad"]]), float(new[i["pitch_rad"]])) if loops else (m.roll, m.pitch)
        self._frozen = m.impact_m_s > HARD_LANDING_M_S or cos(roll) * cos(pitch) < 0.7
        if not self._frozen:
            roll = pitch = 0.0
        x = self._start.copy()
        for name in {"p_x_m", "p_y_m", "yaw_rad", "a_t_m_s2"} & i.keys():
            x[i[name]] = new[i[name]]
        if loops:
            x[i["roll_rad"]], x[i["pitch_rad"]] = roll, pitch
            m.yaw = float(x[i["yaw_rad"]])
        self._x[:] = x
        m.px, m.py, m.pz = float(x[i["p_x_m"]]), float(x[i["p_y_m"]]), 0.0
        m.roll, m.pitch = roll, pitch
        m.vx = m.vy = m.vz = m.p = m.q = m.r = 0.0
        m.fx, m.fy, m.fz = -sin(pitch) * G_M_S2, cos(pitch) * sin(roll) * G_M_S2, cos(roll) * cos(pitch) * G_M_S2
        m.on_ground = True
