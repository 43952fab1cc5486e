"""Linearised rows with columns and residuals of one's own making."""

import numpy as np
from flighttest.diagnose.rows import Rows


def rows_of(residual, columns, segments=20, channel=None):
    n = residual.size
    each = n // segments
    return Rows(
        residual=residual, jacobian=columns, open_residual=residual, open_jacobian=columns, scale=np.ones(n),
        segment=np.repeat(np.arange(segments), each), sample=np.tile(np.arange(each), segments),
        channel=np.zeros(n, dtype=int) if channel is None else channel, channels=("f_z_m_s2", "v_z_m_s"),
        names=tuple(f"p{k}" for k in range(columns.shape[1])),
    )  # fmt: skip
