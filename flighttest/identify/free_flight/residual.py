"""What one equation leaves over one stretch without gaps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Residual(NamedTuple):
    """channel; residual (n,) measured less modelled; slopes (n, q) derivatives of the modelled by the parameters asked for; state (n, k)
    that the equation may be wrong as a function of (`estimation.equation_error.lack_of_fit`)."""

    channel: str
    residual: FloatArray
    slopes: FloatArray
    state: FloatArray
