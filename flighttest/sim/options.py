"""What a simulated vehicle is made of: one plain description that crosses process borders as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

from flighttest.errors import InputError
from flighttest.sim.plants.plant import Hidden, IdentifiedVehicle

Airframe = Literal["paper", "rotor"]
AIRFRAMES: tuple[Airframe, ...] = ("paper", "rotor")


@dataclass(frozen=True)
class SimOptions:
    """One simulated vehicle.

    airframe: 'paper' (Eq. 4, Table 2) or 'rotor' (rotor-level first principles). hide: concealed physics, by catalogue id. seed: of
    noise and gusts, and of the random vehicle with vehicle_seed. vehicle: the airframe's own constants by name. noise: factor on all
    sensor noise. drift: factor on the accelerometer's bias (`build.ACCEL_DRIFT_M_S2`). gust_rms_m_s: horizontal gusts.
    speed: vehicle seconds per second when free-running. lockstep: time stands still until the client grants some (see `lockstep`); paced:
    no sooner than `speed` allows. ready_s, gps_s: when it can arm and has a position, s after boot. parameters: autopilot parameters that
    differ from their defaults.
    voltage_v: at which the battery rests; capacity_ah: None keeps the airframe's.
    signing_key: hexadecimal; with it frames are signed, and only signed ones are taken.
    model: an identified model that flies instead of the airframe, as plain data: terms, values (every parameter), constants (further
    arguments of `physics.model.Model`), and optionally battery (cells, resistance_ohm) and noise (fields of `SensorNoise`).
    """

    airframe: Airframe = "paper"
    hide: Hidden = field(default_factory=dict)
    seed: int = 0
    vehicle_seed: int | None = None
    vehicle: Mapping[str, float] = field(default_factory=dict)
    noise: float = 1.0
    drift: float = 0.0
    gust_rms_m_s: float = 0.0
    speed: float = 1.0
    lockstep: bool = False
    paced: bool = False
    ready_s: float = 23.5
    gps_s: float = 41.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    voltage_v: float | None = None
    capacity_ah: float | None = None
    signing_key: str = ""
    model: IdentifiedVehicle | None = None

    def __post_init__(self) -> None:
        if self.airframe not in AIRFRAMES:
            raise InputError(f"no airframe is called {self.airframe!r}", f"there are {' and '.join(AIRFRAMES)}")
        if not self.speed > 0.0:
            raise InputError(f"speed {self.speed} is not above 0")
        if min(self.noise, self.drift, self.gust_rms_m_s) < 0.0:
            raise InputError("noise, drift and gusts cannot be negative")

    def to_json(self) -> str:
        """As one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> SimOptions:
        """The reverse of `to_json`."""
        return cls(**json.loads(text))


def parse_hide(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """`ID`, `ID:key=value` or `ID:key=value,key=value`: effects to conceal; repeated ids are merged.

    InputError where a word cannot be read.
    """
    found: dict[str, dict[str, float]] = {}
    for word in words:
        name, _, rest = word.partition(":")
        if not name:
            raise InputError(f"hide {word!r} names no effect", "write ID:key=value, as ground_effect:R2_m2=0.06")
        values = found.setdefault(name, {})
        for pair in filter(None, rest.split(",")):
            key, equals, text = pair.partition("=")
            try:
                values[key.strip()] = float(text)
            except ValueError:
                equals = ""
            if not equals or not key.strip():
                raise InputError(
                    f"hide {word!r}: {pair!r} is not key=value", "values are numbers in SI units"
                ) from None
    return found
