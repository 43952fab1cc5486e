"""Changes to an identified vehicle, typed as NAME=VALUE: another battery, payload, propeller, wind, parameter or autopilot setting."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import InputError
from flighttest.identify.mass import FORCES
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

PARTS = ("payload", "battery", "propeller")
_PER_MASS = (*FORCES, *(p.name for p in catalogue()["quadratic_drag"].params))  # forces whose parameter holds the mass
_AUTOPILOT = re.compile(r"[A-Z][A-Z0-9_]+_[A-Z0-9_]+")


@dataclass(frozen=True)
class WhatIf:
    """A changed vehicle. values, base: every parameter of `model`, changed and as identified; held_v, shift_v: what the battery's voltage
    is held at and shifted by, V; given, factors: values and factors of the changed parameters; sentences: what was changed, and how."""

    model: Model
    values: dict[str, float]
    base: dict[str, float]
    held_v: float | None = None
    shift_v: float = 0.0
    sentences: tuple[str, ...] = ()
    given: dict[str, float] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)

    def drawn(self, p: FloatArray, names: Sequence[str]) -> FloatArray:
        """Draws of parameters (k, n), changed alike: those given a value have it in every draw."""
        out = np.array(p)
        for i, name in enumerate(names):
            out[:, i] = self.given[name] if name in self.given else out[:, i] * self.factors.get(name, 1.0)
        return out

    def voltage(self, segment: Segment) -> Segment:
        """A segment with the battery's voltage as asked for."""
        volts = segment.y.get("voltage_v")
        if self.held_v is not None:
            return _with_voltage(segment, np.full(segment.t_s.size, self.held_v))
        if self.shift_v and volts is None:
            raise InputError(
                "the recording has no battery voltage to shift", "give the voltage itself, as battery=22.2"
            )
        return (
            _with_voltage(segment, np.asarray(volts) + self.shift_v) if self.shift_v and volts is not None else segment
        )


def _with_voltage(segment: Segment, volts: FloatArray) -> Segment:
    context = replace(segment.context, voltage_samples=None)
    return replace(segment, y={**segment.y, "voltage_v": volts}, context=context)


def what_if(stored: ModelFile, words: Sequence[str]) -> WhatIf:
    """The vehicle of a model with changes. InputError where one cannot be read, or the model cannot answer it."""
    found = WhatIf(stored.model, dict(stored.values), dict(stored.values))
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name or not text:
            raise InputError(f"set {word!r} is not NAME=VALUE", "as in payload=0.3 or K=+10%")
        found = _changed(found, stored, name, text, word)
    return found


def _changed(now: WhatIf, stored: ModelFile, name: str, text: str, word: str) -> WhatIf:
    if name == "payload":
        added = _number(text, word)
        mass = stored.fingerprint.get("mass_kg")
        if not isinstance(mass, int | float):
            raise InputError(
                f"set {word}: the model does not hold the mass of its vehicle",
                "write mass_kg into vehicle.yaml and fit again with --vehicle, or change the forces with K=-10%",
            )
        if mass + added <= 0.0:
            raise InputError(
                f"set {word}: the mass of {mass:g} kg would not stay above zero", "give what is added, in kg"
            )
        ratio = mass / (mass + added)
        sentence = f"payload {added:+g} kg on {mass:g} kg: thrust and drag per mass x {ratio:.3f}; the attitude loops are as identified"
        return _scaled(now, [n for n in _PER_MASS if n in now.values], ratio, sentence)
    if name == "propeller":
        ratio = 1.0 + _percent(text, word) if text.endswith("%") else _number(text, word)
        if not ratio > 0.0:
            raise InputError(
                f"set {word}: the ratio of thrust has to be above zero", "give the ratio of thrust, as propeller=1.1"
            )
        sentence = (
            f"propeller: thrust at equal throttle x {ratio:.3f}; its lag and the attitude loops are kept as identified"
        )
        return _scaled(now, ["K"], ratio, sentence)
    if name == "battery":
        volts = _number(text.removesuffix("V"), word)
        if text[0] in "+-":
            return replace(now, shift_v=volts, sentences=(*now.sentences, f"battery: voltage {volts:+g} V"))
        if not 1.0 <= volts <= 100.0:
            raise InputError(
                f"set {word}: {volts:g} V is not the voltage of a multirotor's battery",
                "give V under load, or +V and -V to shift it",
            )
        return replace(now, held_v=volts, sentences=(*now.sentences, f"battery: {volts:g} V under load"))
    if _AUTOPILOT.fullmatch(name):
        if name != "ATC_ANGLE_BOOST":
            raise InputError(
                f"set {word}: the model holds the closed attitude loops and the throttle path with this setting in them, and cannot "
                "take it out",
                "ATC_ANGLE_BOOST=0 or 1 can be asked; others need a flight, or a simulator that runs the autopilot itself",
            )
        boost = _number(text, word)
        return _set(now, "boost", boost, f"ATC_ANGLE_BOOST {boost:g}")
    owner = next((t for t in catalogue().values() if any(p.name == name for p in t.params)), None)
    if name not in now.model.names and owner is None:
        known = [*PARTS, *now.model.names, *(p.name for t in catalogue().values() for p in t.params)]
        near = get_close_matches(name, known, 1)
        raise InputError(
            f"set {word}: there is no change or parameter {name}",
            f"did you mean {near[0]}?"
            if near
            else f"there are {', '.join(PARTS)}, and every parameter of `flighttest terms`",
        )
    if text.endswith("%"):
        if name not in now.model.names:
            raise InputError(f"set {word}: the model has no {name} that could change by a share", "give its value")
        share = _percent(text, word)
        return _scaled(now, [name], 1.0 + share, f"{name} {100 * share:+g} %")
    value = _number(text, word)
    return _set(now, name, value, f"{name} {value:g}")


def _set(now: WhatIf, name: str, value: float, sentence: str) -> WhatIf:
    """A parameter at a value; its term joins where the model has it not, its other parameters at their null value."""
    model = now.model
    if name not in model.names:
        term = next(t for t in catalogue().values() if any(p.name == name for p in t.params))
        model = model.with_terms(term.id)
    start: dict[str, Any] = model.start(now.values)
    param = model.param[name]
    if not param.lower <= value <= param.upper:
        raise InputError(
            f"{name} {value:g} is outside {param.lower:g} to {param.upper:g} {param.unit}", "see `flighttest terms`"
        )
    base = model.start(now.base)
    return replace(
        now,
        model=model,
        values=start | {name: value},
        base=base,
        given={**now.given, name: value},
        sentences=(*now.sentences, sentence),
    )


def _scaled(now: WhatIf, names: Sequence[str], ratio: float, sentence: str) -> WhatIf:
    values = now.values | {n: now.values[n] * ratio for n in names}
    factors = now.factors | {n: now.factors.get(n, 1.0) * ratio for n in names}
    given = now.given | {n: now.given[n] * ratio for n in names if n in now.given}
    return replace(now, values=values, factors=factors, given=given, sentences=(*now.sentences, sentence))


def _number(text: str, word: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"set {word}: {text!r} is not a number", "numbers are in SI units, as payload=0.3 (kg)")
    return value


def _percent(text: str, word: str) -> float:
    return _number(text.removesuffix("%"), word) / 100.0


def outside(stored: ModelFile, change: WhatIf) -> str:
    """What of a change lies outside of what the model's flights have seen; empty where nothing does."""
    volts = stored.valid.get("voltage_v")
    if change.held_v is not None and volts and not volts[0] <= change.held_v <= volts[1]:
        return f"{change.held_v:g} V is outside of {volts[0]:.1f} to {volts[1]:.1f} V, where the model's flights were"
    return ""
