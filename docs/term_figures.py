"""Draws what the residual looks like where a term of the catalogue is missing: `python docs/term_figures.py [ID...]`.

For each term the built-in vehicle flies, with the term in it, the maneuver that shows it, each step once. The recording is
fitted twice: by the model without the term and by the model with it. docs/terms/ID.svg shows the response in which the two
fits differ most in noise floors, and both residuals of it: what the fit without the term could not absorb in the parameters
named under "hides in".
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.channels import CHANNELS, WORDS
from flighttest.diagnose.selection.candidates import null_value
from flighttest.flight import fly
from flighttest.identify.fit import Fit, fit
from flighttest.identify.response_analysis.comparison import FittedChannel, fitted_responses
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.plan import compile_plan
from flighttest.proof.flying import ZONE, InProcessTransport
from flighttest.report.document import Figure, Panel, Trace
from flighttest.report.numbers import number, unit
from flighttest.report.render.svg import as_svg
from flighttest.script.load import load_script
from flighttest.script.shipped import resolve
from flighttest.segments import Segment, cut
from flighttest.sim import SimOptions
from flighttest.vehicle.model import DEFAULT_VEHICLE

FOLDER = Path(__file__).resolve().parent / "terms"
SEED = 5
POINTS = 90  # of a drawn line
SHOWS = 0.5  # difference of the residuals, in noise floors, from which on a flight shows the term
# Sizes at which a picture shows the effect, where the nominal one hides in the noise of a single flight.
SIZES: dict[str, dict[str, float]] = {
    "airflow_moment": {"m_u": 6.0, "l_v": 6.0, "m_w": 0.0, "l_w": 0.0, "moment_trim_1_s": 1.0},
    "channel_delay": {"delay_attitude": 0.05, "delay_yaw_rate": 0.05},
    "ground_effect": {"R2_m2": 1.5},
    "motor_saturation": {"T_max": 0.33},
    "quadratic_drag": {"k_x": 0.06, "k_y": 0.06, "k_z": 0.06},
    "rate_feedforward": {"feedforward_s": 0.035},
    "roll_pitch_coupling": {"pitch_to_roll": 0.15, "roll_to_pitch": 0.15},
    "steady_wind": {"w_north": 5.0, "w_west": 3.0, "w_up": 0.0},
    "throttle_offset": {"T_min": 0.06},
    "thrust_fade": {"fade_depth": 0.2, "fade_tau": 60.0},
    "vortex_ring": {"vortex_depth": 0.3, "vortex_centre": 4.0, "vortex_width": 1.5},
}


def flown(term: Term, folder: Path) -> tuple[Segment, ...]:
    """What was cut from one flight of the maneuver that shows the term, each of its steps once, with the term in the vehicle."""
    script = load_script(resolve(term.reveals))
    vehicle = replace(DEFAULT_VEHICLE, zone=ZONE)
    plan = compile_plan(replace(script, repeat=replace(script.repeat, each=1)), vehicle, ModelPredictor(Model(), {}))
    options = SimOptions(hide={term.id: SIZES.get(term.id, {})}, seed=SEED, lockstep=True)
    fly(plan, "sim", folder, transport=InProcessTransport(options))
    return tuple(s for recording in open_recordings([folder]) for s in cut(recording))


def models(term: Term) -> tuple[Model, Model]:
    """The model without the term and the one with it."""
    base = Model()
    if term.id == "channel_delay":
        return replace(base, channel_delays=False), base
    if term.id in base.terms:
        return base.without_terms(term.id), base
    return base, base.with_terms(term.id)


def most_different(without: Fit, with_term: Fit) -> tuple[str, FittedChannel, FittedChannel]:
    """The response and its channel in which the residuals' root mean squares differ most in noise floors."""
    best, found = -np.inf, None
    improved = {r.name: r for r in fitted_responses(with_term)}
    for before in fitted_responses(without):
        after = improved.get(before.name)  # two fits may take different responses, and in another order
        fitted = {} if after is None else {c.channel: c for c in after.channels}
        for channel in before.channels:
            other = fitted.get(channel.channel)
            if other is None or not np.isfinite(other.floor) or other.floor <= 0.0:
                continue
            gain = (_rms(channel) - _rms(other)) / other.floor
            if gain > best:
                best, found = gain, (before.name.split(": ", 1)[-1], channel, other)
    if found is None:
        raise ValueError("the two fits share no channel with a noise floor")
    return found


def _rms(channel: FittedChannel) -> float:
    return float(np.sqrt(np.nanmean((channel.measured - channel.simulated) ** 2)))


def picture(term: Term, response: str, before: FittedChannel, after: FittedChannel) -> Figure:
    """Measured and both models' response, and both residuals between lines at the noise floor."""
    words, symbol = WORDS.get(before.channel, before.channel), unit(CHANNELS[before.channel].unit)
    every = slice(None, None, -(-before.t_s.size // POINTS))
    t = _short(before.t_s[every])
    lines = [("with the term", after, "after"), ("without it", before, "before")]
    measured = Trace(t, _short(before.measured[every]), "measured", "measured")
    shown = [Trace(t, _short(c.simulated[every]), name, role) for name, c, role in lines]  # type: ignore[arg-type]
    left = [Trace(t, _short((c.measured - c.simulated)[every]), name, role) for name, c, role in reversed(lines)]  # type: ignore[arg-type]
    floor = [Trace(t[[0, -1]], np.full(2, s * after.floor), "noise floor", "limit") for s in (1.0, -1.0)]
    label = "time since the step, s"
    sizes = ", ".join(f"{p.name} {SIZES.get(term.id, {}).get(p.name, p.nominal):g}" for p in term.params)
    caption = (
        f"{term.title} ({sizes}), {words} in {response} of {term.reveals}: residual {number(_rms(before), 2)} "
        f"{symbol} (RMS) without the term, {number(_rms(after), 2)} with it, noise floor {number(after.floor, 2)}."
    )
    if _rms(before) - _rms(after) < SHOWS * after.floor:
        caption += " This flight does not show it."
    panels = (
        Panel(response, label, f"{words}, {symbol}", (measured, *shown)),
        Panel("residual: measured minus model", label, f"{words}, {symbol}", (*left, *floor)),
    )
    return Figure(term.id, panels, caption, 2)


def _short(values: np.ndarray) -> np.ndarray:
    """Four significant digits: what a picture shows, and the same on every machine."""
    return np.array([float(f"{v:.4g}") for v in values])


def draw(term: Term) -> str:
    """The picture of one term as SVG."""
    without, with_term = models(term)
    with tempfile.TemporaryDirectory() as folder:
        segments = flown(term, Path(folder) / "run")
    start = {p.name: SIZES.get(term.id, {}).get(p.name, p.nominal) for p in term.params}
    null: dict[str, float] = {}
    if {b.name for b in without.blocks} != {b.name for b in with_term.blocks}:
        # A coupling shows in the axis that was not commanded, which the model of one axis does not predict.
        without, null = with_term, {p.name: null_value(p) for p in term.amplitudes}
    found = fit(segments, without, frozen=null), fit(segments, with_term, start=start)
    return as_svg(picture(term, *most_different(*found)))


def main() -> None:
    """Draw the terms that are named, else all."""
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or catalogue():
        text = draw(catalogue()[name])
        (FOLDER / f"{name}.svg").write_text(text, encoding="utf-8")
        print(text.split("<title>", 1)[1].split("</title>", 1)[0])


if __name__ == "__main__":
    main()
