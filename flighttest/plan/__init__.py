"""A script compiled to a pure function of time, checked against limits and zone before anything flies."""

from flighttest.plan.check import Battery, CheckResult, EnvelopeRow, TimelineRow, check
from flighttest.plan.compile import compile_plan
from flighttest.plan.model import AttitudeTarget, CellPlan, Leg, Motion, Phase, Plan, Policy, Predictor, Snapshot

__all__ = [
    "AttitudeTarget",
    "Battery",
    "CellPlan",
    "CheckResult",
    "EnvelopeRow",
    "Leg",
    "Motion",
    "Phase",
    "Plan",
    "Policy",
    "Predictor",
    "Snapshot",
    "TimelineRow",
    "check",
    "compile_plan",
]
