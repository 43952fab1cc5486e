"""Whether the values of concealed effects are values that a vehicle can have, before anything flies."""

from __future__ import annotations

import math

from flighttest.errors import InputError
from flighttest.sim.plants.plant import Hidden


def check_values(hide: Hidden) -> None:
    """InputError for a value outside what the catalogue states of its parameter, or one that is not a number.

    Ids and keys that do not exist are for the plant to refuse: which there are depends on it.
    """
    if not any(hide.values()):
        return
    from flighttest.physics.catalogue import catalogue  # only where values are given: CasADi takes its time to load

    known = catalogue()
    for name, values in hide.items():
        params = {p.name: p for p in known[name].params} if name in known else {}
        for key, value in values.items():
            if not math.isfinite(value):
                raise InputError(f"hide {name}:{key}={value} is not a finite number", "values are numbers in SI units")
            if (param := params.get(key)) is None:
                continue
            low, high = param.physical
            if not low <= value <= high:
                unit = "" if param.unit == "1" else f" {param.unit}"
                raise InputError(
                    f"hide {name}:{key}={value:g}: {param.doc} cannot be {value:g}{unit}",
                    f"give a value from {low:g} to {high:g}{unit}; usual is {param.nominal:g}",
                )
