"""What is assumed of a parameter before a free flight shows it, and which parameters free flight may show at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flighttest.identify.diagnostics.identifiability import drag_without_velocity, voltage_varies
from flighttest.physics.core import Param
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

ALPHA_STD = 0.5  # motors on a battery have 1 to 2
DRAG = ("d_x", "d_y", "d_z")


def prior_of(p: Param) -> tuple[float, float]:
    """Mean and standard deviation of a parameter's prior where none is given: usual sizes of linear coefficients, else none."""
    if p.name == "alpha":
        return p.nominal, ALPHA_STD
    if p.kind == "amplitude" and p.off is not None and p.name not in DRAG:
        return p.off, p.prior_std
    return p.nominal, np.inf


def determined(flown: Sequence[Segment], model: Model) -> list[str]:
    """Parameters that free flight may determine: not the exponent of a voltage that stays what it is, nor an upward wind, which is a
    thrust, nor drag at a velocity that nothing measured."""
    held = {"w_up", *drag_without_velocity(flown)} | (
        set() if voltage_varies(flown, model.nominal_voltage_v) else {"alpha"}
    )
    return [n for n in model.names if n not in held]
