"""A model file as a vehicle that flies: its terms, delays, battery and noise behind the built-in autopilot.

The attitude loops of a model are closed loops, autopilot included: they are flown as identified, without rotors below them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from flighttest.errors import ModelError
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import CELL_V
from flighttest.sim import SimOptions
from flighttest.sim.plants.plant import BatteryFields, IdentifiedVehicle

_ACCEL_FILTER_HZ = 20.0  # ArduPilot's default
_BUTTERWORTH_2 = 1.11  # noise bandwidth over cut-off of a second-order Butterworth low-pass
_ACCEL_RATE_HZ = 400.0  # that `SensorNoise.accel_m_s2` and gyro_rad_s are of
_LOOP_RATE_HZ = 200.0  # of the plant
_WHITE_SHARE = 0.25  # of an estimator's error; the rest wanders slowly, as `SensorNoise` has it


def simulator_options(
    stored: ModelFile, hide: Mapping[str, Mapping[str, float]] | None = None, **others: Any
) -> SimOptions:
    """`SimOptions` of the vehicle that a model describes. hide: further terms with their values; others: further fields.

    ModelError where the model has no attitude loops.
    """
    fly_able(stored)
    known = stored.fingerprint.get("shaping_parameters") or {}
    filters = {n: float(known[n]) for n in ("INS_ACCEL_FILTER", "INS_GYRO_FILTER") if _is_number(known.get(n))}
    cutoff = filters.get("INS_ACCEL_FILTER") or _ACCEL_FILTER_HZ
    model = stored.model
    values = dict(stored.values)
    if not stored.valid.get("voltage_v"):
        values["alpha"] = 0.0  # K is the gain at whatever voltage was flown
    described: IdentifiedVehicle = {
        "terms": list(model.terms),
        "values": {n: float(values[n]) for n in model.names},
        "constants": {
            "nominal_voltage_v": model.nominal_voltage_v,
            "g_m_s2": model.g_m_s2,
            "channel_delays": model.channel_delays,
            "rotor_height_m": model.rotor_height_m,
        },
        "battery": simulated_battery(stored),
        "noise": sensor_noise_of(stored, cutoff),
    }
    volts = stored.valid.get("voltage_v")
    start = {"voltage_v": float(volts[1])} if volts else {}
    return SimOptions(model=described, hide=dict(hide or {}), **{"parameters": filters, **start, **others})


def fly_able(stored: ModelFile) -> None:
    """ModelError where the model cannot be flown."""
    if not stored.model.attitude_loops:
        raise ModelError(
            f"{stored.path}: the model has no attitude loops, since its recordings have no attitude references: it cannot be flown",
            "fit recordings with roll, pitch and yaw rate references; `flighttest validate` runs this one on recorded attitudes",
        )


def assumed(stored: ModelFile) -> tuple[str, ...]:
    """Parameters of the model that no flight determined: the twin flies with what was assumed."""
    return tuple(n for n, p in stored.parameters.items() if p.source == "assumed" and n in stored.model.names)


def simulated_battery(stored: ModelFile) -> BatteryFields:
    """Cells by the nominal voltage; the resistance where the model's flights determined it."""
    cells = max(round(stored.model.nominal_voltage_v / CELL_V), 1)
    kept = stored.fit_quality.get("battery")
    determined = kept.get("resistance_ohm") if isinstance(kept, Mapping) else None
    resistance = float(determined) if isinstance(determined, int | float) and determined > 0.0 else 0.001 * cells
    return {"cells": cells, "resistance_ohm": resistance}


def sensor_noise_of(stored: ModelFile, accel_filter_hz: float) -> dict[str, float]:
    """Sensor noise such that the recorded channels come out with the residuals of the fit; other channels stay as they are."""
    std = {c: float(v) for c, v in (stored.noise.get("channels") or {}).items() if _is_number(v)}

    def mean(*names: str) -> float | None:
        known = [std[n] for n in names if n in std]
        return math.sqrt(sum(v * v for v in known) / len(known)) if known else None

    found: dict[str, float] = {}
    force = mean("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
    if force is not None:
        share = min(_BUTTERWORTH_2 * accel_filter_hz / (0.5 * _ACCEL_RATE_HZ), 1.0)
        found["accel_m_s2"] = force / math.sqrt(share)
    rate = mean("r_rad_s")
    if rate is not None:
        found["gyro_rad_s"] = rate * math.sqrt(_ACCEL_RATE_HZ / _LOOP_RATE_HZ)
    for name, total in (
        ("attitude", mean("roll_rad", "pitch_rad")),
        ("velocity", mean("v_x_m_s", "v_y_m_s", "v_z_m_s")),
    ):
        if total is not None:
            unit = {"attitude": "rad", "velocity": "m_s"}[name]
            found[f"{name}_{unit}"] = _WHITE_SHARE * total
            found[f"{name}_wander_{unit}"] = math.sqrt(1.0 - _WHITE_SHARE**2) * total
    return found


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
