"""Linearised rows with columns and residuals of one's own making, the responses they are of, and evidence of a term."""

import numpy as np

from flighttest.diagnose.selection.comparison import Evidence
from flighttest.estimation.linearisation import Linearisation, Projection
from flighttest.segments.model import Segment


def rows_of(residual, columns, segments=20, channel=None, names=None):
    """Whitened rows without nuisance parameters: each of the responses has as many samples."""
    n = residual.size
    each = n // segments
    nothing = np.zeros((segments, each, 0))
    return Linearisation(
        residual=residual, jacobian=columns, unprofiled_residual=residual, scale=np.ones(n),
        derivatives=(columns[: segments * each].reshape(segments, each, -1),),
        segment=np.repeat(np.arange(segments), each), sample=np.tile(np.arange(each), segments),
        stratum=np.zeros(n, dtype=int) if channel is None else channel, channels=("f_z_m_s2", "v_z_m_s"), disturbances=(),
        projections=(Projection(nothing, nothing, np.ones(each), np.ones((segments, each), dtype=bool)),),
        names=names or tuple(f"p{k}" for k in range(columns.shape[1])),
    )  # fmt: skip


def responses(segments=20, each=50, repeats=1, step_s=0.02):
    """Roll steps, the repeats of a cell one after the other."""
    t = np.arange(each) * step_s
    return tuple(
        Segment(f"s{i}", "flight", "roll_step", {"amplitude_rad": i // repeats}, i % repeats, 0.0, t, {}, {})
        for i in range(segments)
    )


def autoregressive(rng, shape, rho):
    """(m, n) stationary first-order processes of variance one, along the last axis."""
    x = np.empty(shape)
    x[:, 0] = rng.normal(size=shape[0])
    for k in range(1, shape[1]):
        x[:, k] = rho * x[:, k - 1] + np.sqrt(1 - rho**2) * rng.normal(size=shape[0])
    return x


def evidence(term, nats=100.0, inadmissible="", floors=5.0, without=None, nothing=""):
    """Of a term that is needed, or why its estimates cannot be."""
    none, place = np.zeros(0), ("f_z_m_s2", "roll_step")
    return Evidence(
        term, nats, float(nats > 10.0), floors, place, none, none, inadmissible, without, ("f_z_m_s2",), nothing=nothing
    )
