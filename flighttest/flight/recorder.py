"""The recorder: raw.tlog with every frame of both directions, events.jsonl, manifest, script and plan, as the flight goes on.

What the program has seen is handed to the operating system at least every 0.2 s, so that killing the program loses at most 0.5 s.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import errno
import hashlib
import json
import os
import struct
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, TypedDict, cast

from flighttest.errors import RecordingError
from flighttest.link.session import Session
from flighttest.mavlink.dialect import Message
from flighttest.mavlink.tlog_frames import decoder_of, split
from flighttest.plan import Plan
from flighttest.recording import Marker, Provenance, Recording
from flighttest.recording.manifest import EventData, Manifest, ZoneData
from flighttest.recording.store import (
    EVENTS_NAME,
    RAW_NAME,
    events_header,
    write_manifest,
    write_recording,
)
from flighttest.version import __version__

FLUSH_EVERY_S = 0.2
RESERVE_BYTES = 16 << 20  # landing for minutes (1 MB each), then the channels of half an hour
_STAMP = struct.Struct(">Q")


class _Reserve:
    """Space on the run folder's disk that is kept for the end of a flight: given back when the disk is full, or with the program."""

    def __init__(self, folder: Path) -> None:
        self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # has no name: a killed program leaves nothing
        with contextlib.suppress(OSError):  # a disk with less space than that is flown as far as it goes
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._file.fileno(), 0, RESERVE_BYTES)

    def give_back(self) -> bool:
        """Free the space; False where that was done before."""
        if self._file is None:
            return False
        self._file.close()
        self._file = None
        return True


class LineFile:
    """A file that is only added to. What could not be written yet waits, whole: a full disk may have space again."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self.waiting = bytearray()

    def add(self, data: bytes) -> None:
        """Write this next."""
        self.waiting += data

    def flush(self) -> None:
        """Hand everything to the operating system; OSError where it does not take it."""
        while self.waiting:
            taken = self._file.write(self.waiting)
            if not taken:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            del self.waiting[:taken]

    def close(self) -> None:
        """Flush for the last time; harmless when done twice."""
        if not self._file.closed:
            try:
                self.flush()
            finally:
                self._file.close()


class Recorder:
    """Writes one run folder. ground_s: the ground's clock for the stamps of raw.tlog, s since 1970. host_s: for flushing.

    failure: why something could not be written (a full disk), empty while all is well; then the space that was kept back is used to end
    the flight and its record. Nothing here raises for it: in flight the vehicle comes first, and the flight looks at `failure`.
    incomplete: what the record lacks in the end.
    """

    def __init__(
        self,
        run_dir: Path,
        ground_s: Callable[[], float],
        manifest: Manifest,
        plan: Plan,
        host_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.run_dir = run_dir
        self.failure = ""
        self.incomplete = ""
        run_dir.mkdir(parents=True, exist_ok=True)
        self._ground_s = ground_s
        self._host_s = host_s
        self.reserve = _Reserve(run_dir)
        self._tlog = LineFile(run_dir / RAW_NAME)
        self._events = LineFile(run_dir / EVENTS_NAME)
        self._flushed_s = host_s()
        self._last_us = 0
        self.markers: list[Marker] = []
        self.manifest: Manifest = manifest.copy()
        self._events.add(events_header())
        self._written(self._events.flush)
        self._written(lambda: (run_dir / "script.yaml").write_text(plan.script.text, encoding="utf-8"))
        self.save_plan(plan)
        self.save_manifest()

    def _written(self, write: Callable[[], object]) -> bool:
        """Write, a second time with the space that was kept back; whether it was written at last."""
        try:
            write()
        except OSError as error:
            self.failure = self.failure or error.strerror or str(error)
            if not self.reserve.give_back():
                return False
            return self._written(write)
        return True

    def save_plan(self, plan: Plan) -> None:
        """What is going to be flown; again when it was planned again in flight."""
        text = json.dumps(plan_as_data(plan), indent=1)
        self._written(lambda: (self.run_dir / "plan.json").write_text(text, encoding="utf-8"))

    def use_clock(self, ground_s: Callable[[], float]) -> None:
        """Stamp by another ground clock from now on (lock-step has begun)."""
        self._ground_s = ground_s

    def tap(self, frame: bytes, _message: Message, ago_s: float = 0.0) -> None:
        """Write one frame; given to `Port.tap`. Nothing of it stays in memory: the channels are read from raw.tlog in the end."""
        us = max(
            int((self._ground_s() - ago_s) * 1e6), self._last_us
        )  # a record whose time goes back cannot be read by other tools
        self._last_us = us
        self._tlog.add(_STAMP.pack(us) + frame)
        if self._host_s() - self._flushed_s >= FLUSH_EVERY_S:
            self.flush(force=True)

    def event(self, kind: str, label: str, t_s: float, data: EventData | None = None) -> None:
        """Write one event; its kinds are those of `Marker`."""
        marker = Marker(t_s, kind, label, data.copy() if data else EventData())
        self.markers.append(marker)
        line = {"t_s": round(t_s, 6), "kind": kind, "label": label, **({"data": marker.data} if marker.data else {})}
        self._events.add((json.dumps(line, default=str) + "\n").encode())
        self._written(self._events.flush)

    def flush(self, *, force: bool = False) -> None:
        """Hand what is buffered to the operating system, if it is time."""
        now = self._host_s()
        if force or now - self._flushed_s >= FLUSH_EVERY_S:
            self._flushed_s = now
            self._written(self._tlog.flush)

    def save_manifest(self) -> None:
        """Write the manifest as it stands."""
        self._written(lambda: write_manifest(self.run_dir, self.manifest))

    def close(self) -> None:
        """Close the files and give back the space that was kept; harmless when done twice."""
        self.reserve.give_back()
        for name, file in ((RAW_NAME, self._tlog), (EVENTS_NAME, self._events)):
            if not self._written(file.close):
                self._lacks(f"the last {len(file.waiting)} bytes of {name}")

    def finish(self, session: Session, plan: Plan) -> Recording | None:
        """Close the files and write the channels; None when too little was recorded to decode."""
        self.close()
        recording = self._recording(session, plan)
        if recording is not None and not self._written(lambda: write_recording(self.run_dir, recording)):
            self._lacks("the channels")
            self.save_manifest()
        return recording

    def _lacks(self, what: str) -> None:
        self.incomplete = (
            f"{self.incomplete + '; ' if self.incomplete else ''}{what} could not be written ({self.failure})"
        )
        self.manifest["losses"] = [self.incomplete]

    def _recording(self, session: Session, plan: Plan) -> Recording | None:
        raw = self.run_dir / RAW_NAME
        # A device in its place may never end.
        on_disk = raw.read_bytes() if raw.is_file() else b""
        try:
            decoded = decoder_of(split(on_disk + bytes(self._tlog.waiting))).result(session.vehicle_system or None)
        except RecordingError as error:
            self.manifest["losses"] = [*self.manifest.get("losses", []), error.message]
            self.save_manifest()
            return None
        self.manifest["clock"] = {
            "offset_s": decoded.clock.offset_s,
            "error_s": decoded.clock.error_s,
            "method": "lock-step" if session.lock_step else decoded.clock.method,
        }
        self.save_manifest()
        notes = tuple(m for m in decoded.markers if m.kind == "note" and m.data.get("from_vehicle"))
        return Recording(
            name=self.run_dir.name,
            series=decoded.series,
            markers=tuple(sorted((*self.markers, *notes), key=lambda m: m.t_s)),
            provenance=Provenance(
                source=str(raw),
                importer="flight",
                sha256=hashlib.sha256(on_disk).hexdigest(),
                firmware=str(self.manifest.get("firmware", "")),
                parameters=self.manifest.get("parameters", {}),
                components=plan.vehicle.components,
                vehicle=self.manifest.get("vehicle", {}),
                clock=self.manifest["clock"],
                losses=(*self.manifest.get("losses", []), *decoded.losses),
                filters=filters_of_parameters(self.manifest.get("parameters", {})),
                derived=decoded.derived,
                reference_clock=decoded.reference_clock,
                autopilot=str(self.manifest.get("autopilot", "")),
            ),
        )


def first_manifest(plan: Plan, url: str, weather: str, resume: Path | None) -> Manifest:
    """The manifest of a flight before it begins; its outcome is the one that stays where the program is killed."""
    vehicle = plan.vehicle
    return {
        "name": plan.script.name,
        "started": dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        "versions": {"flighttest": __version__},
        "script": {"name": plan.script.name, "sha256": plan.script.sha256, "path": plan.script.path},
        "connect": url,
        "vehicle": {
            "name": vehicle.name,
            "firmware": vehicle.firmware,
            "nominal_voltage_v": vehicle.nominal_voltage_v,
            "hover_throttle": vehicle.hover_throttle,
            "mass_kg": vehicle.mass_kg,
            "rotor_height_m": vehicle.rotor_height_m,
            "zone": cast(ZoneData, asdict(vehicle.zone)),
        },
        "components": {name: dict(fields) for name, fields in vehicle.components.items()},
        "parameters": {},
        "firmware": "",
        "clock": {},
        "weather": weather,
        "outcome": "the program ended before the flight did",
        **({"resumes": str(resume)} if resume is not None else {}),
    }


def filters_of_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Measurement filters that the vehicle's parameters name: channel group to cut-off, Hz."""
    cutoff = float(parameters.get("INS_ACCEL_FILTER", 0.0))
    return {"specific_force": cutoff} if cutoff > 0 else {}


class PhaseData(TypedDict):
    """A phase of a leg; record: whether it is cut from the recording."""

    name: str
    start_s: float
    end_s: float
    record: bool


class LegPlan(TypedDict):
    """A `Leg` as plan.json has it; mark: its id as it fits into a mark."""

    id: str
    mark: str
    maneuver: str
    kind: str
    cell: dict[str, float]
    repeat: int
    start_m: list[float]
    heading_rad: float
    duration_s: float
    t_step_s: float
    phases: list[PhaseData]
    voltage_v: float | None
    motors_off: bool


class PlanData(TypedDict):
    """plan.json (format plan/1)."""

    format: str
    script: str
    script_sha256: str
    rate_hz: float
    legs: list[LegPlan]
    refusals: list[list[str]]
    notes: list[str]


def plan_as_data(plan: Plan) -> PlanData:
    """The plan as plain JSON types: what was going to be flown, leg by leg."""
    return {
        "format": "plan/1",
        "script": plan.script.name,
        "script_sha256": plan.script.sha256,
        "rate_hz": plan.rate_hz,
        "legs": [
            {
                "id": leg.id,
                "mark": mark_id(leg.id),
                "maneuver": leg.maneuver,
                "kind": leg.kind,
                "cell": dict(leg.cell),
                "repeat": leg.repeat,
                "start_m": list(leg.start_m),
                "heading_rad": leg.heading_rad,
                "duration_s": leg.duration_s,
                "t_step_s": leg.t_step_s,
                "phases": [
                    {"name": p.name, "start_s": p.start_s, "end_s": p.end_s, "record": p.record} for p in leg.phases
                ],
                "voltage_v": leg.voltage_v,
                "motors_off": leg.motors_off,
            }
            for leg in plan.legs
        ],
        "refusals": [list(r) for r in plan.refusals],
        "notes": list(plan.notes),
    }


def mark_id(leg_id: str) -> str:
    """The leg's id as it fits into a mark: no spaces, at most 32 bytes, the end kept (it separates repeats)."""
    word = "_".join(leg_id.split())
    return word if len(word.encode()) <= 32 else word.encode()[-32:].decode(errors="ignore")
