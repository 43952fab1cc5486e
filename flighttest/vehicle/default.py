"""The vehicle that is flown when nobody names one: the paper's, in the paper's flight zone."""

from __future__ import annotations

from flighttest.vehicle.model import Vehicle, Zone

# Paper Table 2 at nominal voltage: 9.81 / 54.55 = 0.18. Zone of 30 x 15 x 10 m: paper section 3. Firmware: paper footnote 1.
DEFAULT_VEHICLE = Vehicle(
    name="paper",
    connect="sim",
    firmware="ardupilot",
    nominal_voltage_v=22.2,
    hover_throttle=0.18,
    zone=Zone(),
    mass_kg=2.9,
    components={
        "battery": {"id": "sim", "model": "6S 10 Ah"},
        "propellers": {"id": "sim"},
        "motors": {"id": "sim"},
        "payload": {"id": "none"},
    },
)
