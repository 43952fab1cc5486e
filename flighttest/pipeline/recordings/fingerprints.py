"""The fingerprint of the vehicle behind recordings, as model.yaml carries it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from flighttest.recording import Recording
from flighttest.recording.manifest import Components, Manifest
from flighttest.validity.declared import declared_changes
from flighttest.vehicle.fingerprint import FingerprintData, fingerprint
from flighttest.vehicle.model import Vehicle


def of_recordings(recordings: Sequence[Recording], vehicle: Vehicle | None) -> FingerprintData:
    """From the newest recording that has each part; the recording's own components before those of the vehicle file, but the nominal
    voltage as the vehicle file has it, since the fit takes it from there."""
    firmware = ""
    parameters: dict[str, float] = {}
    components: Components = {}
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


def fingerprint_of_run(manifest: Manifest) -> FingerprintData:
    """Of a run, by its manifest alone."""
    vehicle = manifest.get("vehicle") or {}
    made = fingerprint(None, str(manifest.get("firmware") or ""), manifest.get("parameters") or {})
    block = vehicle if isinstance(vehicle, Mapping) else {}
    components = manifest.get("components") or {}
    volts, mass = block.get("nominal_voltage_v"), block.get("mass_kg")
    return replace(made, components=components, nominal_voltage_v=volts, mass_kg=mass).as_data()


def differences(stored: FingerprintData, recordings: Sequence[Recording]) -> str:
    """What was declared or set otherwise in recordings than for a model: 'MOT_SPIN_MIN 0.15, here 0.1'; empty where nothing was."""
    changes, _ = declared_changes(stored, of_recordings(recordings, None))
    named = [f"{c.name} {c.before}, here {c.after}" for c in changes[:4]]
    return "; ".join(named) + (f" and {len(changes) - 4} more" if len(changes) > 4 else "")


def of_vehicle(vehicle: Vehicle, firmware: str = "", parameters: dict[str, float] | None = None) -> FingerprintData:
    """Of a vehicle as declared, and as it reports itself where it was reached."""
    return fingerprint(vehicle, firmware, parameters).as_data()
