"""How the load is shared by the motors in each flight, as a section of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from flighttest.identify.motor_shares import FEWEST, REPEATS, SHOWS, motor_shares
from flighttest.report.document import Cell, Paragraph, Section, Table
from flighttest.report.numbers import join
from flighttest.segments import Segment


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
        lead = f"More than in the other flights is asked of {join(apart)}: look at its propeller and motor, or for a load near it."
    elif len(found) < FEWEST:
        lead = f"Commands over their mean; {FEWEST} flights or more are compared with each other."
    else:
        lead = "No motor of a flight works harder than in the others."
    least = f"A share {SHOWS * REPEATS:.3f} above the other flights' median shows; undamaged vehicles repeat theirs to {REPEATS:g}."
    data: list[MotorRow] = [
        {"flight": f.flight, "shares": f.shares.tolist(), "std": f.std.tolist(), "apart": list(f.apart)} for f in found
    ]
    return Section("motors", "Load of the motors", (table, Paragraph(least, "quiet")), lead), {"motors": data}
