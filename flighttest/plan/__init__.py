"""A script compiled to a pure function of time, checked against limits and zone before anything flies."""

from flighttest.plan.compile import compile_plan
from flighttest.plan.model import AttitudeTarget, CellPlan, Leg, Motion, Phase, Plan, Policy, Predictor, Snapshot

__all__ = [
    "AttitudeTarget",
    "CellPlan",
    "Leg",
    "Motion",
    "Phase",
    "Plan",
    "Policy",
    "Predictor",
    "Snapshot",
    "compile_plan",
]
