"""The oracle: the paper's equations fitted apart from the code that is judged, by linear filters and scipy.

How large a hidden effect is (`left`, `size_in_floors`), and what vehicle steered flights are of (`steered_loops`). Must not share a line
with the code it judges.
"""

from flighttest.proof.oracle.blocks import STEP_S, Translation, body_to_world
from flighttest.proof.oracle.innovations import steered_loops
from flighttest.proof.oracle.residuals import (
    CONFUSABLE,
    FIRST,
    FIRST_DISTURBANCE,
    Left,
    OracleNoise,
    cosine,
    force_left,
    left,
    oracle_noise,
    size_in_floors,
)

__all__ = [
    "CONFUSABLE",
    "FIRST",
    "FIRST_DISTURBANCE",
    "STEP_S",
    "Left",
    "OracleNoise",
    "Translation",
    "body_to_world",
    "cosine",
    "force_left",
    "left",
    "oracle_noise",
    "size_in_floors",
    "steered_loops",
]
