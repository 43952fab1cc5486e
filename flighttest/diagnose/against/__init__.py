"""A simulator's recordings against real ones: what differs, and how well each model predicts."""

from flighttest.diagnose.against.two_sides import (
    Against,
    Difference,
    Kind,
    Side,
    compare_sides,
    differences_of,
    errors_of,
    hidden_notes,
    mass_notes,
    notes_of,
    shared_limits,
    side_of,
    stamp_variance,
    step_by_step,
)

__all__ = [
    "Against",
    "Difference",
    "Kind",
    "Side",
    "compare_sides",
    "differences_of",
    "errors_of",
    "hidden_notes",
    "mass_notes",
    "notes_of",
    "shared_limits",
    "side_of",
    "stamp_variance",
    "step_by_step",
]
