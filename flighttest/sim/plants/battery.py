"""A lithium pack: open-circuit voltage over charge, internal resistance, drain."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

# Open-circuit volts per cell over state of charge: near linear in use, a knee when empty, as published discharge curves of
# lithium-polymer cells show.
_CHARGE = (0.0, 0.04, 0.1, 0.3, 0.5, 0.8, 1.0)
_CELL_V = (3.00, 3.40, 3.58, 3.72, 3.82, 4.02, 4.20)

_SHORTEST_S = 1e-4  # pieces of a step between two edges may be of next to no length


def cell_voltage(charge: float) -> float:
    """Open-circuit V of a cell at a state of charge 0..1."""
    c = min(max(charge, 0.0), 1.0)
    i = min(max(bisect_right(_CHARGE, c) - 1, 0), len(_CHARGE) - 2)
    share = (c - _CHARGE[i]) / (_CHARGE[i + 1] - _CHARGE[i])
    return _CELL_V[i] + share * (_CELL_V[i + 1] - _CELL_V[i])


def charge_at(cell_v: float) -> float:
    """State of charge at an open-circuit cell voltage, V."""
    v = min(max(cell_v, _CELL_V[0]), _CELL_V[-1])
    i = min(max(bisect_right(_CELL_V, v) - 1, 0), len(_CELL_V) - 2)
    share = (v - _CELL_V[i]) / (_CELL_V[i + 1] - _CELL_V[i])
    return _CHARGE[i] + share * (_CHARGE[i + 1] - _CHARGE[i])


@dataclass(slots=True)
class Battery:
    """State of one pack. capacity_ah A h, resistance_ohm of the whole pack with its leads up to the sensor, charge 0..1."""

    cells: int = 6
    capacity_ah: float = 5.0
    resistance_ohm: float = 0.006
    charge: float = 1.0
    current: float = 0.0
    voltage: float = 25.2
    used_ah: float = 0.0
    _change_v_s: float = 0.0

    def __post_init__(self) -> None:
        self.draw(0.0, 0.0)

    def draw(self, current_a: float, dt_s: float) -> None:
        """Deliver a current, A, for dt_s, s."""
        used = current_a * dt_s / 3600.0
        self.used_ah += used
        self.charge = max(self.charge - used / self.capacity_ah, 0.0)
        self.current = current_a
        before = self.voltage
        self.voltage = self.cells * cell_voltage(self.charge) - self.resistance_ohm * current_a
        if dt_s > _SHORTEST_S:
            self._change_v_s = (self.voltage - before) / dt_s

    def replace(self, voltage_v: float | None = None) -> None:
        """A full pack, or one that rests at a voltage, V."""
        self.charge = 1.0 if voltage_v is None else charge_at(voltage_v / self.cells)
        self.used_ah = 0.0
        self.draw(0.0, 0.0)
        self._change_v_s = 0.0

    def voltage_ahead(self, dt_s: float) -> float:
        """Voltage dt_s, s, from now at its present rate of change: a plant's step takes that of its middle, that of its beginning
        would be half a step late."""
        return self.voltage + dt_s * self._change_v_s

    @property
    def remaining(self) -> float:
        """What is left by count of charge, 0..1."""
        return max(0.0, 1.0 - self.used_ah / self.capacity_ah)
