"""The prior model as `plan` takes it: many vehicles flown at once through targets that may depend on where they are.

The equations are those of `physics.model`; nothing is written twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.flight.execution.response import Learnt, ThrottleTrace
from flighttest.frames import G_M_S2
from flighttest.physics.model import Model
from flighttest.physics.stepping import SIDEWAYS, Forms, Stepping
from flighttest.plan import AttitudeTarget, Plan
from flighttest.plan.compile import compile_plan
from flighttest.plan.model import Policy, PredictedMotion, Snapshot, Trail

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# What the coarse steps of a rehearsal can follow.
SHORTEST_LAG_S = 0.025

# The step on which a prior's own curvature is looked at: of the hover throttle, halves of the time, s.
_SEEN_AT, _SEEN_FOR_S, _SEEN_DT_S = (0.6, 1.7), 1.0, 0.01

_POSITION = ("p_x_m", "p_y_m", "p_z_m")
_VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")
_CHANNEL = {
    "roll_ref_rad": "attitude",
    "pitch_ref_rad": "attitude",
    "yaw_rate_ref_rad_s": "yaw_rate",
    "throttle": "thrust",
}


class ModelPredictor:
    """`plan.Predictor` over a fitted or nominal `Model`. values: parameters by name; the rest at the model's start values."""

    def __init__(self, model: Model | None = None, values: Mapping[str, float] | None = None) -> None:
        self.model = model or Model()
        self.values = self.model.start(values)
        self._p = np.array([self.values[n] for n in self.model.system.params])
        delays = np.asarray(self.model.system.delays_s(self._p)).ravel()
        self._delays_s = dict(zip(self.model.system.delay_channels, delays.tolist(), strict=True))

    @property
    def delay_s(self) -> float:
        """From sending a target to the first effect: the longest of the channels, s."""
        return max(self._delays_s.values(), default=0.0)

    @property
    def attitude_lag_s(self) -> float:
        """Mean age of the attitude behind its delayed reference, s."""
        loops = [("zeta_phi", "omega_phi"), ("zeta_theta", "omega_theta")]
        return max((2.0 * self.values[z] / self.values[w] for z, w in loops if w in self.values), default=0.0)

    @property
    def thrust_lag_s(self) -> float:
        """Mean age of the thrust behind its delayed command, s."""
        return 1.0 / self.values["sigma_t"]

    def hover_throttle(self, voltage_v: FloatArray) -> FloatArray:
        """Throttle (n,) that holds height at these voltages (n,)."""
        return self.model.hover_throttle(self.values, voltage_v)

    @property
    def thrust_age_s(self) -> float:
        """From sending a throttle to its mean effect, s."""
        return float(self._delays_s.get("thrust", self.delay_s)) + self.thrust_lag_s

    def curvature(self, voltage_v: float) -> float:
        """Of thrust over throttle, as `ThrottleTrace` would see it on this vehicle: from a sinking step to a climbing one."""
        hover = float(self.hover_throttle(np.array([voltage_v]))[0])
        trace, (low, high) = ThrottleTrace(hover), _SEEN_AT

        def throttle(t_s: float) -> float:
            return hover * (low if t_s < _SEEN_FOR_S / 2 else high)

        flown = self.fly(
            np.array([[0.0, 0.0, 20.0]]), np.zeros(1), np.array([voltage_v]),
            lambda now: np.array([[0.0, 0.0, 0.0, throttle(now.t_s)]]), _SEEN_FOR_S, _SEEN_DT_S,
        )  # fmt: skip
        for t_s, place, speed in zip(flown.t_s, flown.p_m[0], flown.v_m_s[0], strict=True):
            trace.sent(float(t_s), AttitudeTarget(float(t_s), 0.0, 0.0, 0.0, throttle(float(t_s))))
            trace.seen(float(t_s), float(speed[2]), float(place[2]))
        seen = trace.thrust()
        return seen.curvature if seen is not None else 0.0

    def corrected(
        self, hover_throttle: float, voltage_v: float, thrust_age_s: float | None = None, curved: float = 0.0
    ) -> ModelPredictor:
        """The same vehicle with the hover throttle seen at a voltage, V, the mean age of its thrust, s (None: as it was), and so much more
        curvature of thrust over throttle.

        What the age leaves beside the lag is delay, of every channel: they come over one link.
        """
        now = float(self.hover_throttle(np.array([voltage_v]))[0])
        values = {**self.values, "K": self.values["K"] * now / hover_throttle}
        if thrust_age_s is not None:
            lag = min(self.thrust_lag_s, max(thrust_age_s, SHORTEST_LAG_S))
            delay = max(thrust_age_s - lag, 0.0)
            values |= {"sigma_t": 1.0 / lag, **{name: delay for name in values if name.startswith("T_d")}}
        model = self.model
        if curved:
            model = model if "curvature" in values else model.with_terms("throttle_curve")
            # The term counts r = T K / g from the hover at nominal voltage: r (1 + c (r - 1)) v is the thrust in weights, v what the
            # voltage makes of it. What is seen counts from the hover at this voltage, r = s: the curvature there is c s^2 v.
            c, s = values.get("curvature", 0.0), now * self.values["K"] / G_M_S2
            v = 1.0 / (s * (1.0 + c * (s - 1.0)))
            bounds, seen = model.param["curvature"], c * s * s * v + curved
            s = (1.0 - seen + math.sqrt((1.0 - seen) ** 2 + 4.0 * v * seen)) / (2.0 * v)
            values["curvature"] = float(np.clip(seen / (s * s * v), bounds.lower, bounds.upper))
            values["K"] = s * G_M_S2 / hover_throttle
        return ModelPredictor(model, values)

    def fly(
        self,
        start_m: FloatArray,
        yaw_rad: FloatArray,
        voltage_v: FloatArray,
        policy: Policy,
        duration_s: float,
        dt_s: float,
    ) -> PredictedMotion:
        """Fly n vehicles from rest at start_m (n, 3), yaw_rad (n,), voltage_v (n,), hovering until now, for duration_s."""
        steps = np.full(len(np.atleast_2d(start_m)), max(round(duration_s / dt_s), 1))
        return self.fly_each(start_m, yaw_rad, voltage_v, policy, steps, dt_s).motion

    def fly_each(
        self,
        start_m: FloatArray,
        yaw_rad: FloatArray,
        voltage_v: FloatArray,
        policy: Policy,
        steps: IntArray,
        dt_s: float,
    ) -> Trail:
        """The same, each for its own number of steps, (n,), falling."""
        start, yaw, volts = np.atleast_2d(start_m), np.atleast_1d(yaw_rad), np.atleast_1d(voltage_v)
        at_rest = self.model.hover(self.values, volts)
        x = at_rest.states
        x[self._at(_POSITION)] = start.T
        x[self._states.index("yaw_rad")] = yaw
        hover = np.zeros((4, len(start)))
        hover[3] = at_rest.throttle
        return self._fly(x, [hover] * self._memory(dt_s), volts, np.zeros(len(start)), policy, steps, dt_s)

    def branch(self, trail: Trail, of: IntArray, at: IntArray, policy: Policy, steps: IntArray, dt_s: float) -> Trail:
        """Fly on n vehicles, the k-th from what vehicle of[k] of an earlier flight was at step at[k]; targets under way arrive."""
        hover = np.zeros((4, of.size))
        hover[3] = self.hover_throttle(trail.voltage_v[of])
        past = [
            np.where(at > back, trail.asked[np.maximum(at - 1 - back, 0), :, of].T, hover)
            for back in reversed(range(self._memory(dt_s)))
        ]
        return self._fly(
            trail.states[at, :, of].T, past, trail.voltage_v[of], trail.clock_s[of] + at * dt_s, policy, steps, dt_s
        )

    def _fly(
        self,
        x: FloatArray,
        past: list[FloatArray],
        volts: FloatArray,
        clock_s: FloatArray,
        policy: Policy,
        steps: IntArray,
        dt_s: float,
    ) -> Trail:
        """Fly on from states x (n_states, n), with the targets sent until now, (4, n) each, the last one last."""
        system, inputs, (total, n) = self.model.system, self._inputs, (int(steps[0]), x.shape[1])
        place, speed, angle = self._at(_POSITION), self._at(_VELOCITY), self._at(_ATTITUDE)
        # A delay between two steps is the mean of both, weighted: what is held is then delayed by it on the mean.
        lag = [divmod(self._delays_s[_CHANNEL[t]] / dt_s + 1e-9, 1.0) for t in INPUTS]
        u = np.zeros((len(inputs), n))
        u[inputs.index("voltage_v")] = volts
        rows = [inputs.index(t) for t in INPUTS]
        record, asked = np.empty((total + 1, len(system.states), n)), np.zeros((total, 4, n))
        record[0] = x
        history = list(past)
        step = self._stepper(x, u, dt_s)
        flying = n
        for k in range(total):
            if steps[flying - 1] <= k:
                ended, flying = flying, int(np.searchsorted(-steps, -k, side="left"))
                record[k + 1 :, :, flying:ended] = x[:, flying:]
                x, u, history = x[:, :flying], u[:, :flying], [h[:, :flying] for h in history]
                step.keep(flying)
            targets = np.asarray(policy(Snapshot(k * dt_s, x[place].T, x[speed].T, x[angle].T)), dtype=float)
            asked[k, :, :flying] = targets.T
            history.append(asked[k, :, :flying])
            if step.straight and asked[k, :3].any():
                step = Stepping(self.forms, u, dt_s)
            for column in (3,) if step.straight else range(4):
                row, (whole, part) = rows[column], lag[column]
                late = history[-1 - int(whole)][column]
                u[row] = late
                if part > 1e-6:
                    u[row] += part * (history[-2 - int(whole)][column] - late)
            if "time_s" in inputs:
                u[inputs.index("time_s")] = clock_s[:flying] + k * dt_s
            x = step(x, u)
            record[k + 1, :, :flying] = x
        t_s = np.arange(total + 1, dtype=float) * dt_s
        # Each coordinate of each vehicle in one piece of memory: they are searched for extremes. Attitudes are not.
        p, v = (np.ascontiguousarray(record[:, i].transpose(2, 1, 0)).transpose(0, 2, 1) for i in (place, speed))
        rpy = record[:, angle].transpose(2, 0, 1)
        return Trail(PredictedMotion(t_s, p, v, rpy), record, asked, volts, clock_s)

    def _memory(self, dt_s: float) -> int:
        """How many targets are on their way at most."""
        return int(max(self._delays_s.values(), default=0.0) / dt_s + 1e-9) + 2

    @property
    def _states(self) -> list[str]:
        return list(self.model.system.states)

    @property
    def _inputs(self) -> list[str]:
        return list(self.model.system.inputs)

    def _at(self, names: Sequence[str]) -> slice | list[int]:
        """Where these states are; a slice, which copies nothing, where they follow each other."""
        found = [self._states.index(n) for n in names]
        return slice(found[0], found[-1] + 1) if found == list(range(found[0], found[-1] + 1)) else found

    @cached_property
    def forms(self) -> Forms:
        """The system's functions in the shortest form that gives the same."""
        return Forms(self.model.system, self._p)

    def _stepper(self, x: FloatArray, u: FloatArray, dt_s: float) -> Stepping:
        """The shortest way to fly on from these states."""
        sideways = [i for i, n in enumerate(self._states) if n in SIDEWAYS]
        return Stepping(self.forms, u, dt_s, straight=not x[sideways].any())


# Below these, start heights and durations change by less than the gate's slack.
HOVER_CHANGE = 0.04
AGE_CHANGE_S = 0.03
# Of 26 throttle steps of two scripts at 25 V, planned for straight thrust, none is refused at a curvature of 0.03, four are at 0.04.
CURVATURE_CHANGE = 0.03


class ScriptReplanner:
    """Keeps the prior that the present plan rests on, and corrects it. The script's throttles stay what they are."""

    def __init__(self, plan: Plan, prior: ModelPredictor) -> None:
        self._plan = plan
        self._prior = prior
        self._curvature = prior.curvature(plan.vehicle.nominal_voltage_v)

    def due(self, learnt: Learnt) -> bool:
        """Whether hover throttle, age or curvature differ from the prior's by more than the plan can bear."""
        expected = float(self._prior.hover_throttle(np.array([learnt.voltage_v]))[0])
        if abs(learnt.hover_throttle / expected - 1.0) > HOVER_CHANGE:
            return True
        return self._late(learnt) is not None or bool(self._curved(learnt))

    def plan(self, learnt: Learnt) -> Plan:
        """The script compiled with the corrected prior, which becomes the one that is compared with."""
        curved = self._curved(learnt)
        # Seen in few legs it is sure to no more than that; and more of it makes climbs and descents both stronger, which is the safe side.
        planned = curved + CURVATURE_CHANGE if curved else 0.0
        self._prior = self._prior.corrected(learnt.hover_throttle, learnt.voltage_v, self._late(learnt), planned)
        self._curvature += curved
        return compile_plan(self._plan.script, self._plan.vehicle, self._prior)

    def _late(self, learnt: Learnt) -> float | None:
        """The age of the thrust that was seen, None where the plan can bear how it differs: by as much an age is seen too low."""
        seen = learnt.thrust_age_s
        return seen if seen is not None and abs(seen - self._prior.thrust_age_s) > AGE_CHANGE_S else None

    def _curved(self, learnt: Learnt) -> float:
        """By how much the thrust was seen to be more curved than the prior's; 0 where the plan can bear it."""
        if learnt.curvature is None:
            return 0.0
        change = learnt.curvature - self._curvature
        return change if abs(change) > CURVATURE_CHANGE else 0.0
