"""How moments of the air go with the thrust: `python -m benchmarks.thrust_of_moments WIND_TUNNEL_FOLDER`, for `physics.terms.moments`.

The term has velocity through the air times the root of the thrust. Here the velocity of every flight is multiplied by the thrust over that
of hover to a power less a half, so that the moment goes with the thrust to that power. Per wind, three flights together: by how much the
likelihood of their attitudes rises with the term, nats, and by how much more with a shaping of the references beside it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.estimation.responses import relative_thrust
from flighttest.identify.fit import default_model
from flighttest.identify.free_flight import estimate, stretches
from flighttest.identify.free_flight.priors import determined
from flighttest.identify.free_flight.winds import WIND_TERM, in_still_air
from flighttest.physics.blocks import VELOCITY
from flighttest.physics.catalogue import catalogue
from flighttest.physics.terms.moments import LEAST_THRUST
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.segments import Segment, cut

POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)
WINDS = ("nowind", "35wind", "70wind")
COLUMNS = Path(__file__).parents[1] / "examples" / "columns" / "neural_fly.yaml"
TRIMS_1_S = (0.0, 0.1, 1.0)  # local optima begin there
MOMENTS, SHAPING = "airflow_moment", "reference_shaping"


def through_the_air(files: list[Path]) -> tuple[Segment, ...]:
    """Segments of the flights in the frame of their air."""
    flown = tuple(s for r in open_recordings(files, Reading(COLUMNS)) for s in cut(r) if s.usable)
    model = replace(default_model(flown), attitude_loops=False)
    terms = [catalogue()[t] for t in (WIND_TERM, "attitude_offset", "thrust_scaled_drag")]
    return in_still_air(flown, find_terms(stretches(flown), model, terms).winds)


def with_power(segments: tuple[Segment, ...], power: float) -> tuple[Segment, ...]:
    """The same with velocities that give moments by that power of the thrust."""
    made = []
    for s in segments:
        factor = np.maximum(relative_thrust(s), LEAST_THRUST) ** (power - 0.5)
        made.append(replace(s, y={**s.y, **{n: s.y[n] * factor for n in VELOCITY}}))
    return in_still_air(made, ())  # what is trimmed, anew


def gains(segments: tuple[Segment, ...]) -> tuple[float, float]:
    """Nats by the moments, and by a shaping beside them."""
    flown, model = stretches(segments, "roll_pitch"), default_model(segments)

    def likelihood(*terms: str) -> float:
        tried = model.with_terms(*terms)
        starts = [{"moment_trim_1_s": t} for t in TRIMS_1_S] if MOMENTS in terms else [{}]
        base = estimate(flown, model, part="roll_pitch", free=determined(flown, model)).values
        free = determined(flown, tried)
        start = [{**base, **one} for one in starts]
        return estimate(flown, tried, part="roll_pitch", start=start, free=free).log_likelihood

    none, moments, both = likelihood(), likelihood(MOMENTS), likelihood(MOMENTS, SHAPING)
    return moments - none, both - moments


def main(folder: Path) -> None:
    """Print a row per wind."""
    print("| wind |", " | ".join(f"{p:g}: moments, shaping" for p in POWERS), "|")
    print("|---" * (len(POWERS) + 1) + "|")
    for wind in WINDS:
        flown = through_the_air(sorted(folder.glob(f"*_{wind}.csv*")))
        row = [f"{first:.0f}, {second:.0f}" for first, second in (gains(with_power(flown, p)) for p in POWERS)]
        print(f"| {wind} |", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
