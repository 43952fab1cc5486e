"""A script compiled to a pure function of time, checked against limits and zone before anything flies."""

from flighttest.plan.check import BatteryNeed, CheckResult, EnvelopeRow, TimelineRow, check
from flighttest.plan.compile import compile_plan
from flighttest.plan.model import (
    AttitudeTarget,
    CellPlan,
    Leg,
    Phase,
    Plan,
    Policy,
    PredictedMotion,
    Predictor,
    Snapshot,
)

__all__ = [
    "AttitudeTarget",
    "BatteryNeed",
    "CellPlan",
    "CheckResult",
    "EnvelopeRow",
    "Leg",
    "Phase",
    "Plan",
    "Policy",
    "PredictedMotion",
    "Predictor",
    "Snapshot",
    "TimelineRow",
    "check",
    "compile_plan",
]
