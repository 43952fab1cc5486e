"""Predictions of a model with all parameters held, and the noise floors that their errors are counted in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flighttest.diagnose.model import Diagnosis, Verdict, short
from flighttest.diagnose.records import FROM_REPEATS
from flighttest.estimation.problem import Noise
from flighttest.estimation.solver import Start, finite_or_error, solve
from flighttest.identify.diagnostics.quality import ChannelQuality, channel_quality
from flighttest.identify.fit import Fit
from flighttest.identify.selection import problem_of
from flighttest.physics.model import Model
from flighttest.segments.model import Segment


def prediction_quality(
    segments: Sequence[Segment], model: Model, values: Mapping[str, float], noise: Noise, free: Sequence[str] = ()
) -> dict[str, ChannelQuality]:
    """Residuals of responses whose parameters are held: only initial states and each response's disturbance are estimated, and the
    parameters that are free. Samples count alike: how a flight began is seen in each of them."""
    problem = problem_of(segments, model, select="all", values=values)
    alike = Noise(noise.channel, noise.disturbance)
    solution = solve(problem, Start(noise=alike), free=tuple(free), robust=False, estimate_noise=False)
    return channel_quality(problem, finite_or_error(solution))


def floors_of(found: Fit, diagnosis: Diagnosis) -> dict[str, float]:
    """Noise floor of each channel, in its unit: what the repeats differ by, as the diagnosis has it.

    Where nothing was repeated the diagnosis has the residual's fast part, which lacks the noise that lasts for several samples. Where it
    finds nothing missing, all that the fit leaves is noise, and its RMS is the floor if it is larger.
    """
    whole = diagnosis.verdict in (Verdict.NOTHING_MISSING, Verdict.EXPLAINED)
    floors = {}
    for channel, quality in found.quality.items():
        row = diagnosis.noise_floor.get(short(channel))
        floor = (row["value"] if row is not None else 0.0) or quality.floor
        lower_bound = whole and row is not None and row["from"] != FROM_REPEATS
        floors[channel] = max(floor, quality.rmse) if lower_bound else floor
    return floors
