"""Planning a script again in flight, for the hover throttle and the age of thrust that were seen: `flight.execution.response.Replanner`."""

from __future__ import annotations

import numpy as np

from flighttest.flight.execution.response import Learnt
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.plan import Plan
from flighttest.plan.compile import compile_plan

# Below these, start heights and durations change by less than the gate's slack.
HOVER_CHANGE = 0.04
AGE_CHANGE_S = 0.03


class ScriptReplanner:
    """Keeps the prior that the present plan rests on, and corrects it. The script's throttles stay what they are."""

    def __init__(self, plan: Plan, prior: ModelPredictor) -> None:
        self._plan = plan
        self._prior = prior

    def due(self, learnt: Learnt) -> bool:
        """Whether hover throttle or age differ from the prior's by more than the plan can bear."""
        expected = float(self._prior.hover_throttle(np.array([learnt.voltage_v]))[0])
        if abs(learnt.hover_throttle / expected - 1.0) > HOVER_CHANGE:
            return True
        return learnt.thrust_age_s is not None and abs(learnt.thrust_age_s - self._prior.thrust_age_s) > AGE_CHANGE_S

    def plan(self, learnt: Learnt) -> Plan:
        """The script compiled with the corrected prior, which becomes the one that is compared with."""
        self._prior = self._prior.corrected(learnt.hover_throttle, learnt.voltage_v, learnt.thrust_age_s)
        return compile_plan(self._plan.script, self._plan.vehicle, self._prior)
