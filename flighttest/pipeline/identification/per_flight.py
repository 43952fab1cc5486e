"""What differs from flight to flight, as sections of a fit: the wind (drag shared by all flights, declared still air as a prior) and the
load of each motor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypedDict

from flighttest.errors import FlighttestError, InputError
from flighttest.identify.free_flight.winds import STILL_STD_M_S, Winds, wind_rows, winds
from flighttest.identify.models.model_blocks import FlightWindRow
from flighttest.identify.motor_shares import FEWEST, REPEATS, least_shift, motor_shares
from flighttest.physics.model import Model
from flighttest.recording import Recording
from flighttest.report.document import Cell, Paragraph, Section, Table
from flighttest.report.numbers import join, number
from flighttest.report.render.plain import plain
from flighttest.report.sections.diagnosis import winds_table
from flighttest.segments import Segment
from flighttest.vehicle.load import WEATHERS
from flighttest.vehicle.model import Vehicle


class DragRow(TypedDict):
    """A drag coefficient shared by all flights, 1/s."""

    value: float
    std: float
    between_flights: float


class WindsData(TypedDict, total=False):
    """The wind of each flight; empty where no free flight shows it."""

    winds: list[FlightWindRow]
    winds_drag: dict[str, DragRow]


def weather_of(
    declared: Mapping[str, str], recordings: Sequence[Recording], vehicle: Vehicle | None = None
) -> dict[str, str]:
    """Flight to 'still' or 'unknown'. declared: part of a flight's name ('' is in every name) to its weather; of several that fit a flight
    the last counts, else vehicle.yaml's. InputError for another weather, and for a part that is in no flight's name."""
    found = dict.fromkeys((r.name for r in recordings), "unknown" if vehicle is None else vehicle.weather)
    for part, weather in declared.items():
        if weather not in WEATHERS:
            raise InputError(f"weather {weather!r} is not known", f"the known ones are {' and '.join(WEATHERS)}")
        named = [name for name in found if part in name]
        if not named:
            raise InputError(
                f"weather of {part!r}: no flight has this in its name", f"the flights are {join(list(found))}"
            )
        found |= dict.fromkeys(named, weather)
    return found


def wind_section(
    segments: Sequence[Segment], model: Model, weather: Mapping[str, str]
) -> tuple[Section | None, WindsData]:
    """Table of the wind in every flight and the same as data; neither where no free flight determines it."""
    if not any(s.usable and s.kind == "free" for s in segments):
        return None, {}
    try:
        found = winds(segments, model, weather)
    except FlighttestError:
        return None, {}  # the fit reports what was not recorded
    return (None, {}) if found is None else (_section(found), _data(found))


def _section(found: Winds) -> Section:
    fit = found.fit
    drag = [
        f"{n} {number(fit.values[n], 3)} ± {number(1.96 * fit.std[n], 2)} 1/s"
        + (f" (flights differ by {fit.spread[n]:.2f})" if n in fit.spread else "")
        for n in ("d_x", "d_y", "d_z")
        if n in fit.std
    ]
    words = f"Estimated beside one drag for all flights, as an equation of motion of the free flight: {join(drag)}."
    notes = [f"{words} Intervals of 95 % hold what flights differ by."]
    if not found.turned:
        known = (
            f"flights declared still (within {STILL_STD_M_S:g} m/s) distinguish them"
            if found.declared
            else "declare flights in still air with --weather FLIGHT=still, or fly two headings"
        )
        notes.append(f"At a single heading a wind and an attitude offset tilt the vehicle alike: {known}.")
    section = winds_table(wind_rows(found.flights, found.declared))
    assert section is not None
    return replace(section, blocks=(*section.blocks, *(Paragraph(n, "quiet") for n in notes)))


def _data(found: Winds) -> WindsData:
    fit = found.fit
    return {
        "winds": wind_rows(found.flights, found.declared),
        "winds_drag": plain(
            {
                n: {"value": fit.values[n], "std": fit.std[n], "between_flights": fit.spread.get(n, 0.0)}
                for n in ("d_x", "d_y", "d_z")
                if n in fit.std
            }
        ),
    }


class MotorRow(TypedDict):
    """Share of each motor in one flight, and its standard error; apart: numbers of motors that work harder than in the other flights."""

    flight: str
    shares: list[float]
    std: list[float]
    apart: list[int]


class MotorsData(TypedDict, total=False):
    """How the load is shared; empty where the commands were not recorded."""

    motors: list[MotorRow]


def motor_section(segments: Sequence[Segment]) -> tuple[Section | None, MotorsData]:
    """Table of every motor's share in every flight and the same as data; neither where the commands were not recorded."""
    found = motor_shares(segments)
    if not found:
        return None, {}
    rows: tuple[tuple[Cell | str, ...], ...] = tuple(
        (f.flight, *(Cell(f"{v:.3f}", "warn" if k in f.apart else "plain") for k, v in enumerate(f.shares, 1)))
        for f in found
    )
    columns = ("flight", *(f"motor {k}" for k in range(1, 5)))
    table = Table(columns, rows, ("left", "right", "right", "right", "right"))
    apart = [f"motor {k} in {f.flight}" for f in found for k in f.apart]
    if apart:
        which = "other flight" if len(found) == FEWEST else "other flights"
        lead = f"More than in the {which} is asked of {join(apart)}: look at its propeller and motor, or for a load near it."
    elif len(found) < FEWEST:
        lead = "Commands over their mean; two flights or more are compared with each other."
    else:
        lead = "No motor of a flight works harder than in the others."
    least = f"Undamaged vehicles repeat their shares to {REPEATS:g}"
    if len(found) >= FEWEST:
        least = f"A share {least_shift(len(found)):.3f} above the other flights' median shows; {least[0].lower()}{least[1:]}"
    data: list[MotorRow] = [
        {"flight": f.flight, "shares": f.shares.tolist(), "std": f.std.tolist(), "apart": list(f.apart)} for f in found
    ]
    return Section("motors", "Load of the motors", (table, Paragraph(f"{least}.", "quiet")), lead), {"motors": data}
