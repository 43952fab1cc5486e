"""Rows and sentences of a diagnosis of free flight: parameters, winds, noise floor, pairs of flights that would decide more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flighttest.diagnose.free_flight.equation_search import OFFSET_TERM, EquationSearch
from flighttest.diagnose.records import ParameterRow
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.estimation.linearisation import Linearisation
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.free_flight.winds import CHANCE, WIND_TERM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.model import Segment


def pairs_of_flights(found: EquationSearch) -> list[str]:
    """Pairs of flights that would part what these could not."""
    said = []
    if found.winds and not found.turned and not found.declared:
        said.append(
            "a wind and an attitude offset tilt the vehicle alike at one heading: a second flight at another heading, or one in still air "
            "(--weather FLIGHT=still), diagnosed together with this one separates them"
        )
    offered = {*found.offered} - {*found.named}
    if "ground_effect" in offered and not any(s.term == "ground_effect" and s.p_value < CHANCE for s in found.screened):
        said.append(
            "ground effect shows between a low and a high flight: hover below one rotor diameter and above three, diagnosed together"
        )
    if len(found.final.flights) == 1:
        said.append(
            "a payload shows as K of a loaded over K of an unloaded flight of the same battery: diagnose the one with the other's --model"
        )
    return said


def table_of(found: FreeFlight, model: Model | None) -> dict[str, ParameterRow]:
    """Estimated parameters as rows; `model` None: those of single flights, too."""
    rows: dict[str, ParameterRow] = {}
    factor = found.factor()
    for n, std in found.std.items():
        if model is not None and n not in model.names:
            continue
        value, p = found.values[n], found.model.param[n.split("@")[0]]
        if np.isfinite(std):
            rows[n] = {
                "value": value, "std": std, "unit": p.unit, "interval_95": [value - factor * std, value + factor * std],
                "scatter": std,
            }  # fmt: skip
    return rows


def what_separates(rival: str, term: str) -> str:
    """The flight that separates two terms."""
    if {rival, term} == {WIND_TERM, OFFSET_TERM}:
        return "fly a second heading, or declare a flight in still air"
    return f"fly {catalogue()[rival].reveals}"


def free_flight_floor(rows: Linearisation, segments: Sequence[Segment]) -> NoiseFloor:
    """The floor of free flight: what the final model leaves of each channel is its noise, whatever its spectrum.

    What a variable orders in it is no noise, and is still found by `locate`. Never below what sensors resolve.
    """
    least = floor_of(rows, segments, RESOLUTION)
    left = {
        name: float(np.sqrt(np.mean(rows.unprofiled_residual[rows.channel == c] ** 2)))
        for c, name in enumerate(rows.channels)
    }
    return NoiseFloor({c: max(v, left.get(c, 0.0)) for c, v in least.std.items()}, frozenset(), {})
