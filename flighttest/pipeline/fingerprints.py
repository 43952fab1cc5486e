"""The fingerprint of the vehicle behind recordings, as model.yaml carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flighttest.recording import Recording
from flighttest.vehicle.fingerprint import fingerprint
from flighttest.vehicle.model import Vehicle


def of_recordings(recordings: Sequence[Recording], vehicle: Vehicle | None) -> dict[str, Any]:
    """From the newest recording that knows each part; the recording's own components before those of the vehicle file."""
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
    if voltage is None and vehicle is not None:
        voltage = vehicle.nominal_voltage_v
    if mass is None and vehicle is not None:
        mass = vehicle.mass_kg
    made = fingerprint(None, firmware, parameters)
    return replace(made, components=components, nominal_voltage_v=voltage, mass_kg=mass).as_data()


def of_vehicle(vehicle: Vehicle, firmware: str = "", parameters: dict[str, float] | None = None) -> dict[str, Any]:
    """Of a vehicle as declared, and as it reports itself where it was reached."""
    return fingerprint(vehicle, firmware, parameters).as_data()
