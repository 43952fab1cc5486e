"""Trials on real recordings, drawn from one seed: which recordings, what is added to them, how large it shall be."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from flighttest.errors import InputError
from flighttest.proof.cases import log_uniform
from flighttest.proof.recorded.sets import RecordedSet
from flighttest.proof.recorded.wind_pairs import Wind

# Shares of trials: nothing added, one effect, two, and pairs of campaigns, or of flights in two winds, whose difference is known.
SHARES = (("clean", 0.35), ("single", 0.40), ("pair", 0.10), ("natural", 0.15))
SIZE = (1.0, 8.0)  # noise floors that an effect shall have, drawn evenly in the logarithm
MOST_FILES = 3
PART_S = 120.0  # of a longer recording so much is taken, from a drawn time on: more different trials of the same data, in less time
ANSWER_1_S = (0.7, 2.0)  # bandwidth of the controller that answers, drawn evenly in the logarithm
_LOADED = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
_ANGLES = ("roll_rad", "pitch_rad")
_TARGETS = ("roll_ref_rad", "pitch_ref_rad")
_FLAT = ("v_x_m_s", "v_y_m_s", "yaw_rad", *_ANGLES)


@dataclass(frozen=True)
class Added:
    """An effect that can be added. usual: its keys at their usual size; scaled: those that a size multiplies (divides, where `inverse`);
    signed: whose sign is drawn; needs: channels without which it shows nowhere."""

    usual: Mapping[str, float]
    scaled: tuple[str, ...]
    needs: tuple[str, ...]
    signed: bool = False
    inverse: bool = False
    most: float = 6.0  # times its usual size


# Usual sizes as the hidden ones of the rotor vehicle (`sim.plants.rotor_effects`).
ADDED: Mapping[str, Added] = MappingProxyType(
    {
        "quadratic_drag": Added({"k_x": 0.030, "k_y": 0.036, "k_z": 0.050}, ("k_x", "k_y", "k_z"), _FLAT),
        "thrust_scaled_drag": Added({"c_h": 0.025}, ("c_h",), _FLAT),
        "translational_lift": Added({"k_lift": 0.005}, ("k_lift",), _FLAT),
        "axial_inflow": Added({"k_inflow": 0.035}, ("k_inflow",), ("v_z_m_s", "throttle")),
        "ground_effect": Added({"R2_m2": 0.05}, ("R2_m2",), ("height_m", "throttle")),
        "thrust_fade": Added({"fade_depth": 0.10, "fade_tau": 60.0}, ("fade_depth",), ("throttle",), most=4.0),
        "thrust_extra_lag": Added({"thrust_extra_tau": 0.035}, ("thrust_extra_tau",), ("throttle",)),
        "thrust_asymmetry": Added({"ln_sigma_ratio": 0.6}, ("ln_sigma_ratio",), ("throttle",), most=2.5),
        "throttle_curve": Added({"curvature": 0.15}, ("curvature",), ("throttle",), most=4.0),
        "throttle_offset": Added({"T_min": 0.03}, ("T_min",), ("throttle",), most=5.0),  # the catalogue ends at 0.15
        "slung_payload": Added(
            {"payload_ratio": 0.12, "cable_m": 0.8, "swing_damping": 0.05}, ("payload_ratio",), (*_FLAT, "throttle"), most=2.5
        ),
        "accelerometer_bias": Added(
            {"bias_x": 0.25, "bias_y": -0.2, "bias_z": 0.3}, ("bias_x", "bias_y", "bias_z"), (*_LOADED, *_FLAT), signed=True
        ),
        "imu_lever_arm": Added(
            {"arm_x": 0.06, "arm_y": -0.04, "arm_z": 0.05}, ("arm_x", "arm_y", "arm_z"),
            (*_LOADED, "p_rad_s", "q_rad_s", "r_rad_s", *_ANGLES), signed=True,
        ),
        "velocity_latency": Added({"velocity_latency": 0.12}, ("velocity_latency",), ("f_z_m_s2", "v_z_m_s"), most=3.0),
        "rate_limit": Added({"rate_max": 1.6}, ("rate_max",), (*_ANGLES, *_TARGETS), inverse=True),
        "reference_shaping": Added(
            {"shaping_accel": 9.0, "shaping_tc": 0.15}, ("shaping_accel",), (*_ANGLES, *_TARGETS), inverse=True
        ),
        "yaw_rate_shaping": Added(
            {"shaping_yaw_accel": 4.7}, ("shaping_yaw_accel",), ("r_rad_s", "yaw_rate_ref_rad_s"), inverse=True
        ),
        "attitude_extra_pole": Added({"attitude_pole_tau": 0.025}, ("attitude_pole_tau",), (*_ANGLES, *_TARGETS)),
        "roll_pitch_coupling": Added(
            {"pitch_to_roll": 0.10, "roll_to_pitch": 0.10}, ("pitch_to_roll", "roll_to_pitch"), (*_ANGLES, *_TARGETS), signed=True, most=4.0
        ),
    }
)  # fmt: skip


@dataclass(frozen=True)
class RecordedCase:
    """One trial's truth. files: of the recordings diagnosed; earlier: of those that a `natural` pair compares them with, whose state
    `differs` or not; winds: of `files`, (north, west), m/s, where their difference is asked for; order: in which effects are tried, until
    one (two in a pair) can be made large enough in these flights; sizes: noise floors they shall have; signs: of signed effects;
    answer_1_s: as `side_by_side.Vehicle`; begin: where in a recording longer than `PART_S` the part that is taken begins, as a share of
    what is left of it; data: folder that files are relative to."""

    index: int
    seed: int
    kind: str
    name: str
    files: tuple[str, ...]
    columns: str | None
    own: tuple[str, ...]
    order: tuple[str, ...] = ()
    sizes: tuple[float, ...] = ()
    signs: tuple[float, ...] = ()
    answer_1_s: float = 1.0
    begin: float = 0.0
    earlier: tuple[str, ...] = ()
    differs: bool = False
    winds: tuple[Wind, ...] = ()
    data: str = ""

    def truth(self) -> str:
        """As sealed: JSON with sorted keys. What is added follows from it and the recordings, wherever their folder is."""
        left_out = (
            "data",
            "columns",
            *(() if self.winds else ("winds",)),
        )  # trials that are no pair of winds keep their hash
        return json.dumps({k: v for k, v in asdict(self).items() if k not in left_out}, sort_keys=True)

    def sha256(self) -> str:
        """Of the truth: printed before the diagnosis starts."""
        return hashlib.sha256(self.truth().encode()).hexdigest()


def drawn_cases(seed: int, sets: Sequence[RecordedSet], data: Path) -> Iterator[RecordedCase]:
    """Cases without end. InputError where none of the recordings are here."""
    here = {one: [str(f.relative_to(data)) for f in found] for one in sets if (found := one.found(data))}
    if not here:
        raise InputError(
            f"{data}: none of the recordings that are listed are here", "name their folder with --data DIR"
        )
    index = 0
    while True:
        yield replace(_draw(seed, index, here), data=str(data))
        index += 1


def _draw(seed: int, index: int, here: Mapping[RecordedSet, Sequence[str]]) -> RecordedCase:
    rng = np.random.default_rng([seed, index])
    known = _pairs(here)
    shares = dict(SHARES) if known else {k: s for k, s in SHARES if k != "natural"}
    kind = str(rng.choice(list(shares), p=np.array(list(shares.values())) / sum(shares.values())))
    if kind == "natural":
        return _natural(seed, index, here, known, rng)
    sources = sorted({one.source for one in here})
    source = str(rng.choice(sources))
    one = _one_of([s for s in here if s.source == source], rng)
    number = {"clean": 0, "single": 1, "pair": 2}[kind]
    order = [str(e) for e in rng.permutation(sorted(set(ADDED) - set(one.own)))]
    return RecordedCase(
        index=index,
        seed=seed,
        kind=kind,
        name=one.name,
        files=_some(here[one], rng),
        columns=str(one.columns) if one.columns else None,
        own=one.own,
        order=tuple(order) if number else (),
        sizes=tuple(log_uniform(rng, *SIZE) for _ in range(number)),
        signs=tuple(float(rng.choice([-1.0, 1.0])) for _ in range(3)),
        answer_1_s=log_uniform(rng, *ANSWER_1_S),
        begin=float(rng.random()),
    )


def _natural(
    seed: int,
    index: int,
    here: Mapping[RecordedSet, Sequence[str]],
    known: Sequence[RecordedSet],
    rng: np.random.Generator,
) -> RecordedCase:
    """Two campaigns of one vehicle without a common flight: in one state, or in two."""
    source = str(rng.choice(sorted({s.source for s in known})))
    first = _one_of([s for s in known if s.source == source], rng)
    if first.wind_m_s is not None:
        return _in_two_winds(seed, index, here, first, rng)
    others = [s for s in here if s.vehicle == first.vehicle and s.state != first.state]
    differs = bool(others) and bool(rng.random() < 0.5)
    if differs:
        earlier, later = _some(here[first], rng), _some(here[second := _one_of(others, rng)], rng)
        name = f"{first.name} -> {second.name}"
    else:
        shuffled = [str(f) for f in rng.permutation(here[first])]
        half = min(len(shuffled) // 2, MOST_FILES)
        earlier, later, name = tuple(sorted(shuffled[:half])), tuple(sorted(shuffled[half : 2 * half])), first.name
    columns = str(first.columns) if first.columns else None
    return RecordedCase(index, seed, "natural", name, later, columns, first.own, earlier=earlier, differs=differs)


def _in_two_winds(
    seed: int, index: int, here: Mapping[RecordedSet, Sequence[str]], first: RecordedSet, rng: np.random.Generator
) -> RecordedCase:
    """Two flights of one vehicle, in one wind or in two, in an order that is drawn."""
    others = [
        s
        for s in here
        if s.wind_m_s not in (None, first.wind_m_s) and (s.vehicle, s.state) == (first.vehicle, first.state)
    ]
    differs = bool(others) and bool(rng.random() < 0.5)
    if differs:
        flown = [(s, str(rng.choice(here[s]))) for s in (first, _one_of(others, rng))]
    else:
        flown = [(first, str(f)) for f in rng.choice(here[first], size=2, replace=False)]
    return RecordedCase(
        index, seed, "natural", " -> ".join(dict.fromkeys(s.name for s, _ in flown)), tuple(f for _, f in flown),
        str(first.columns) if first.columns else None, first.own, differs=differs,
        winds=tuple(s.wind_m_s for s, _ in flown if s.wind_m_s is not None),
    )  # fmt: skip


def _pairs(here: Mapping[RecordedSet, Sequence[str]]) -> list[RecordedSet]:
    """Sets in a known state or wind that have enough flights to be divided."""
    return [s for s, files in here.items() if s.vehicle and (s.state or s.wind_m_s is not None) and len(files) >= 2]


def _one_of(sets: Sequence[RecordedSet], rng: np.random.Generator) -> RecordedSet:
    return sets[int(rng.integers(len(sets)))]


def _some(files: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    count = min(int(rng.integers(1, MOST_FILES + 1)), len(files))
    return tuple(sorted(str(f) for f in rng.permutation(files)[:count]))
