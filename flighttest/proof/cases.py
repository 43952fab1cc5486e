"""Sealed cases: a random vehicle, random conditions and what is hidden, drawn from one seed; the truth is written apart and hashed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count, islice
from types import MappingProxyType
from typing import Literal, Protocol, TypeVar

import numpy as np

from flighttest.sim.plants.plant_motors import NOT_THE_PLANTS
from flighttest.sim.plants.rotor_effects import EFFECTS, effects_on
from flighttest.sim.plants.rotor_vehicle import random_rotor


class _Kinds(Protocol):
    @property
    def kind(self) -> str: ...


C = TypeVar("C", bound=_Kinds)
Generator = Literal["rotor", "sitl", "recorded"]
CaseKind = Literal["clean", "single", "pair", "outside", "natural"]
# Shares of trials: clean, one effect, two effects, physics outside the catalogue.
SHARES = (("clean", 0.34), ("single", 0.42), ("pair", 0.14), ("outside", 0.10))
FACTOR = (0.7, 2.5)  # an effect is its usual size times this, drawn evenly in the logarithm
# Not hidden: linear drag is in the paper's model; delays per channel are in the fit. Moments of the air and the rate feedforward came
# after the trials of the frozen bench were drawn, which one more effect to draw from would change; tests/diagnose conceals them.
NOT_HIDDEN = ("linear_drag", "channel_delay", "airflow_moment", "rate_feedforward")


@dataclass(frozen=True)
class NoiseSource:
    """Real recordings whose noise a simulated flight gets. name: of their set; columns: their column map; data: folder of the files."""

    name: str
    files: tuple[str, ...]
    columns: str | None = None
    data: str = ""


@dataclass(frozen=True)
class Case:
    """One trial's truth. hide: effect to keys and values; conditions: noise factor, gusts m/s, drift as of `sim.SimOptions`.

    generator: 'rotor' is the built-in copter; 'sitl' is ArduCopter's firmware on the same body, rotors and air; 'recorded' is not drawn
    here (`proof.recorded`). noise_from: whose noise and disturbance it has instead of synthetic ones (`proof.transplanted_noise`).
    """

    index: int
    seed: int
    kind: str
    vehicle_seed: int
    flight_seed: int
    hide: Mapping[str, Mapping[str, float]]
    noise: float
    gust_rms_m_s: float
    generator: Generator = "rotor"
    noise_from: NoiseSource | None = None
    drift: float = 0.0

    def truth(self) -> str:
        """As sealed: JSON with sorted keys; of real noise its set and files, wherever their folder is; no word of it or drift without."""
        written = {k: v for k, v in asdict(self).items() if k != "noise_from" and (k != "drift" or v)}
        if self.noise_from is not None:
            written["noise_from"] = {"name": self.noise_from.name, "files": self.noise_from.files}
        return json.dumps(written, sort_keys=True)

    def sha256(self) -> str:
        """Of the truth: printed before the diagnosis starts."""
        return hashlib.sha256(self.truth().encode()).hexdigest()


def cases_of(
    seed: int, trials: int, generator: Generator = "rotor", kind: CaseKind | None = None, clean: int = 0
) -> list[Case]:
    """The first trials of a seed, of every kind or of one, and its next ones with nothing hidden until there are `clean` of these; sensors
    drift, as those of the frozen bench (`draw`) do not."""
    drift = 1.0 if generator == "rotor" else 0.0  # a firmware's own estimators drift
    return first_of((replace(draw(seed, k, generator), drift=drift) for k in count()), trials, kind, clean)


def first_of(drawn: Iterator[C], trials: int, kind: CaseKind | None, clean: int) -> list[C]:
    """The first trials that are drawn, of every kind or of one, and the next ones with nothing hidden until there are `clean` of these."""
    first = list(islice((case for case in drawn if kind in (None, case.kind)), trials))
    lacking = max(clean - sum(case.kind == "clean" for case in first), 0)
    return first + list(islice((case for case in drawn if case.kind == "clean"), lacking))


def draw(seed: int, index: int, generator: Generator = "rotor") -> Case:
    """The case of one trial."""
    rng = np.random.default_rng([seed, index])
    kind = str(rng.choice([k for k, _ in SHARES], p=[share for _, share in SHARES]))
    # A firmware brings loops, estimators and mixer of its own.
    left_out = {*NOT_HIDDEN, *(NOT_THE_PLANTS if generator == "sitl" else ())}
    inside = [k for k, e in EFFECTS.items() if e.known and k not in left_out]
    outside = [k for k, e in EFFECTS.items() if not e.known and k not in left_out]
    number = {"clean": 0, "single": 1, "pair": 2, "outside": 1}[kind]
    chosen = rng.choice(outside if kind == "outside" else inside, size=number, replace=False)
    vehicle_seed = int(rng.integers(1, 2**31))
    hide = sized([str(k) for k in chosen], vehicle_seed, rng)
    return Case(
        index=index,
        seed=seed,
        kind=kind,
        vehicle_seed=vehicle_seed,
        flight_seed=int(rng.integers(1, 2**31)),
        hide=hide,
        noise=float(rng.uniform(0.6, 1.6)),
        gust_rms_m_s=float(rng.choice([0.0, 0.0, 0.2])),
        generator=generator,
    )


# Keys whose size is drawn; the others of an effect (lengths, time constants, widths) keep their usual value.
_SIZED = {
    "slung_payload": ("payload_ratio",), "vortex_ring": ("vortex_depth",), "thrust_fade": ("fade_depth",), "voltage_sag": ("sag_v",),
    "tether": ("stiffness_1_s2",), "updraft": ("speed_m_s",), "gust_front": ("w_north", "w_west"), "resonance": ("gain",),
}  # fmt: skip
# Limits bite the harder the lower they are.
_INVERSE = ("motor_saturation", "rate_limit", "reference_shaping", "yaw_rate_shaping")
# Shares that cannot exceed one.
_WHOLE = ("angle_boost", "rotor_speed_lag")


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn evenly in the logarithm. By `math`: of numpy's exponential the last digit depends on the processor, and with it the seal."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def sized(names: Sequence[str], vehicle_seed: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Effects of a random vehicle, each of a size that is drawn."""
    usual = effects_on({name: {} for name in names}, random_rotor(vehicle_seed))
    return {name: _sized(name, usual[name], rng) for name in names}


def _sized(name: str, usual: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    factor = log_uniform(rng, *FACTOR)
    if name in _WHOLE:
        factor = float(rng.uniform(0.6, 1.0))
    if name in _INVERSE:
        factor = 1.0 / min(factor, 1.4)
    keys = _SIZED.get(name, tuple(k for k in usual if k != "shaping_tc"))
    sign = {k: float(rng.choice([-1.0, 1.0])) for k in keys}
    signed = name in (
        "steady_wind",
        "attitude_offset",
        "accelerometer_bias",
        "imu_lever_arm",
        "roll_pitch_coupling",
        "gust_front",
    )
    return {k: v * factor * (sign[k] if signed else 1.0) if k in keys else v for k, v in usual.items()}


# Cosine above `oracle.CONFUSABLE`, as `python -m benchmarks.aliased` finds it on quiet flights of one vehicle, every effect of usual size.
ALIASED: Mapping[str, tuple[str, ...]] = MappingProxyType({})
