"""The fingerprint of the vehicle behind recordings, as model.yaml carries it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from flighttest.currency.declared import declared_changes
from flighttest.recording import Recording
from flighttest.report.numbers import join
from flighttest.vehicle.fingerprint import fingerprint
from flighttest.vehicle.model import Vehicle


def of_recordings(recordings: Sequence[Recording], vehicle: Vehicle | None) -> dict[str, Any]:
    """From the newest recording that knows each part; the recording's own components before those of the vehicle file, but the nominal
    voltage as the vehicle file has it, since the fit takes it from there."""
    firmware = ""
    parameters: dict[str, float] = {}
    components: dict[str, Any] = {}
    voltage: float | None = None
    mass: float | None = None
    for recording in recordings:
        source = recording.provenance
        firmware = source.firmware or firmware
        parameters = dict(source.parameters) or parameters
        components = dict(source.components) or components
        stored = source.vehicle.get("nominal_voltage_v")
        voltage = float(stored) if isinstance(stored, int | float) else voltage
        weighed = source.vehicle.get("mass_kg")
        mass = float(weighed) if isinstance(weighed, int | float) else mass
    if not components and vehicle is not None:
        components = dict(vehicle.components)
    if vehicle is not None:
        voltage = vehicle.nominal_voltage_v
    if mass is None and vehicle is not None:
        mass = vehicle.mass_kg
    made = fingerprint(None, firmware, parameters)
    return replace(made, components=components, nominal_voltage_v=voltage, mass_kg=mass).as_data()


def conflicts(recordings: Sequence[Recording]) -> str:
    """What says that recordings are not of one vehicle in one state, in one sentence; empty where nothing does."""
    for recording in recordings[1:]:
        said = differences(of_recordings(recordings[:1], None), [recording])
        if said:
            return f"{recordings[0].name} and {recording.name} are not of one vehicle: {said}; one model of both is a compromise"
    return ""


def repeated(recordings: Sequence[Recording]) -> str:
    """Which recording was given twice, in one sentence; empty where none was."""
    seen: dict[str, str] = {}
    for recording in recordings:
        first = seen.setdefault(recording.provenance.sha256 or recording.name, recording.name)
        if first != recording.name:
            return f"{first} and {recording.name} are one recording: it is counted once"
    return ""


def unfiltered(recordings: Sequence[Recording]) -> str:
    """Whose accelerometer may have a filter that nobody stated, in one sentence; empty where none has."""
    names = [r.name for r in recordings if r.has("f_z_m_s2") and "specific_force" not in r.provenance.filters]
    if not names:
        return ""
    return (
        f"the accelerometer's filter is not stated for {join(names)}: none is assumed, and one reads as a slower thrust "
        "(filters_hz: {specific_force: Hz} in a column map)"
    )


def once(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Each recording the first time it was given."""
    first = {r.provenance.sha256 or r.name: r for r in reversed(recordings)}
    return tuple(r for r in recordings if first[r.provenance.sha256 or r.name] is r)


def differences(stored: Mapping[str, Any], recordings: Sequence[Recording]) -> str:
    """What was declared or set otherwise in recordings than for a model: 'MOT_SPIN_MIN 0.15, here 0.1'; empty where nothing was."""
    changes, _ = declared_changes(stored, of_recordings(recordings, None))
    named = [f"{c.name} {c.before}, here {c.after}" for c in changes[:4]]
    return "; ".join(named) + (f" and {len(changes) - 4} more" if len(changes) > 4 else "")


def of_vehicle(vehicle: Vehicle, firmware: str = "", parameters: dict[str, float] | None = None) -> dict[str, Any]:
    """Of a vehicle as declared, and as it reports itself where it was reached."""
    return fingerprint(vehicle, firmware, parameters).as_data()
