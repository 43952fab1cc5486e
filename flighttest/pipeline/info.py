"""What the tool offers and what it finds on this machine: the catalogue of terms, and `doctor`."""

from __future__ import annotations

import importlib.metadata
import platform
import shutil
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

from serial.tools import list_ports

from flighttest.documents import nearest
from flighttest.errors import FlighttestError, InputError, LinkError
from flighttest.mavlink.signing import read_key
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Term
from flighttest.pipeline.results import Result, Status
from flighttest.report.document import Cell, Document, Facts, Paragraph, Section, Table
from flighttest.script.shipped import shipped_names
from flighttest.sim.sitl.launcher import find_arducopter
from flighttest.version import __version__

LIBRARIES = (
    "casadi",
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "pymavlink",
    "mavsdk",
    "pyulog",
    "plotly",
    "rich",
    "click",
)


def terms(ids: Sequence[str]) -> Result:
    """The catalogue as a table, or the full page of each named term."""
    known = catalogue()
    for term_id in ids:
        if term_id not in known:
            guess = nearest(term_id, known)
            raise InputError(
                f"there is no term {term_id!r}", f"did you mean {guess}?" if guess else f"known: {', '.join(known)}"
            )
    chosen = [known[i] for i in ids] if ids else list(known.values())
    data = {"terms": [term_data(term) for term in chosen]}
    if ids:
        sections = tuple(_term_section(term) for term in chosen)
        return Result(
            Document(f"{len(chosen)} terms" if len(chosen) > 1 else chosen[0].id, chosen[0].title, sections=sections),
            data,
        )
    rows = tuple(
        (Cell(t.id, "good"), t.family, t.title, ", ".join(f"{p.symbol} {p.unit}" for p in t.params), t.reveals)
        for t in chosen
    )
    table = Table(("id", "family", "what", "parameters", "shown by"), rows, detail=(1, 3))
    verdict = (
        f"{len(chosen)} pieces of physics that a recording can be searched for; `flighttest terms ID` explains one."
    )
    return Result(Document("physics catalogue", verdict, sections=(Section("terms", "", (table,)),)), data)


class ParamData(TypedDict):
    """One parameter of a term; bounds: lower and upper."""

    name: str
    symbol: str
    unit: str
    kind: str
    nominal: float
    bounds: list[float]
    doc: str
    source: str


class TermData(TypedDict):
    """A term of the catalogue as `flighttest terms --json` has it; fields as of `physics.core.Term`."""

    id: str
    title: str
    family: str
    port: str
    equation: str
    plain: str
    source: str
    doubt: str
    hides_in: list[str]
    told_apart_by: str
    reveals: str
    needs: list[str]
    parameters: list[ParamData]


class CheckData(TypedDict):
    """One line of `flighttest doctor`."""

    what: str
    ok: bool
    needed: bool
    found: str
    remedy: str


def term_data(term: Term) -> TermData:
    """A term as plain data."""
    return {
        "id": term.id,
        "title": term.title,
        "family": term.family,
        "port": term.port.name,
        "equation": term.equation,
        "plain": term.plain,
        "source": term.source,
        "doubt": term.doubt,
        "hides_in": list(term.hides_in),
        "told_apart_by": term.told_apart_by,
        "reveals": term.reveals,
        "needs": list(term.needs),
        "parameters": [
            {
                "name": p.name,
                "symbol": p.symbol,
                "unit": p.unit,
                "kind": p.kind,
                "nominal": p.nominal,
                "bounds": [p.lower, p.upper],
                "doc": p.doc,
                "source": p.source,
            }
            for p in term.params
        ],
    }


def _term_section(term: Term) -> Section:
    facts = Facts(
        (
            ("equation", term.equation),
            ("acts at", f"{term.port.name.lower().replace('_', ' ')} ({term.port.unit})"),
            ("hides in", ", ".join(term.hides_in) or "nothing"),
            ("distinguished by", term.told_apart_by),
            ("flown by", term.reveals),
            ("needs", ", ".join(term.needs)),
            ("source", term.source),
            ("doubt", term.doubt),
        )
    )
    rows = tuple((p.name, p.unit, p.kind, f"{p.nominal:g}", f"{p.lower:g} to {p.upper:g}", p.doc) for p in term.params)
    table = Table(
        ("parameter", "unit", "kind", "nominal", "bounds", "meaning"),
        rows,
        align=("left", "left", "left", "right", "left", "left"),
    )
    return Section(term.id, f"{term.id}: {term.title}", (Paragraph(term.plain), facts, table))


def doctor(connect: str | None, signing_key: Path | None = None) -> Result:
    """What is installed and reachable. `connect`: also try this vehicle, with this key."""
    from flighttest.flight.preparation import priority

    key = read_key(signing_key) if signing_key is not None else None
    rows: list[tuple[Cell | str, ...]] = []
    data: list[CheckData] = []

    def note(what: str, found: str, good: bool, remedy: str = "", needed: bool = True) -> None:
        word = "ok" if good else ("missing" if needed else "absent")
        rows.append(
            (what, Cell(word, "good" if good else ("bad" if needed else "warn")), found, remedy if not good else "")
        )
        data.append({"what": what, "ok": good, "needed": needed, "found": found, "remedy": remedy if not good else ""})

    version = platform.python_version_tuple()
    note(
        "Python",
        platform.python_version(),
        (int(version[0]), int(version[1])) >= (3, 11),
        "install Python 3.11 or newer",
    )
    for library in LIBRARIES:
        try:
            note(library, importlib.metadata.version(library), True)
        except importlib.metadata.PackageNotFoundError:
            note(library, "", False, "reinstall: pip install flighttest")
    names = shipped_names()
    note("shipped maneuvers", ", ".join(names), bool(names), "reinstall: the package's maneuvers are missing")
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    note(
        "C compiler",
        compiler or "",
        compiler is not None,
        "estimates take several times as long without one; install gcc or clang",
        needed=False,
    )
    try:
        note("ArduPilot SITL", str(find_arducopter()), True)
    except FlighttestError:
        how = "only for --backend sitl: see sitl/README.md, or fly the built-in vehicle: --connect sim"
        note("ArduPilot SITL", "", False, how, needed=False)
    ports = [f"{p.device} ({p.description})" for p in list_ports.comports()]
    note("serial ports", ", ".join(ports), bool(ports), "none is seen: plug in the vehicle or the radio", needed=False)
    first = priority.granted()
    found = "targets leave on time beside other programs" if first else ""
    late = (
        "targets may leave late beside other programs, and such steps are flown again: allow `rtprio 2` in limits.conf"
    )
    note("real-time priority", found, first, late, needed=False)
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", 0))
            note("local sockets", "127.0.0.1 can be bound", True)
        except OSError as error:
            note("local sockets", str(error), False, "the built-in vehicle needs a TCP port on 127.0.0.1")
    status = Status.DONE
    if connect is not None:
        status = _reach(connect, key, note)
    missing = [d["what"] for d in data if d["needed"] and not d["ok"]]
    verdict = "Everything this tool needs is here." if not missing else f"Missing: {', '.join(missing)}."
    if missing and status is Status.DONE:
        status = Status.BAD_INPUT
    document = Document(
        f"flighttest {__version__}",
        verdict,
        "good" if not missing else "bad",
        (Section("found", "", (Table(("what", "", "found", "what to do"), tuple(rows)),)),),
    )
    return Result(document, {"version": __version__, "checks": data}, status)


def _reach(connect: str, key: bytes | None, note: Any) -> Status:
    from flighttest.pipeline.vehicles.live import hello

    try:
        note("vehicle", hello(connect, key), True)
    except LinkError as error:
        note("vehicle", error.message, False, error.hint)
        return Status.UNUSABLE
    except FlighttestError as error:
        note("vehicle", error.message, False, error.hint)
        return Status.BAD_INPUT
    return Status.DONE
