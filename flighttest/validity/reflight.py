"""The shortest flight that restores the wanted standard errors: which shipped scripts, and how often each step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flighttest.validity.model import SCRIPTS, SUBSETS

# Relative standard errors (alpha: absolute) an onboard planner is served by; a caller may ask for others.
WANTED: dict[str, float] = {
    "omega_phi": 0.01,
    "omega_theta": 0.01,
    "zeta_phi": 0.02,
    "zeta_theta": 0.02,
    "sigma_r": 0.03,
    "sigma_t": 0.03,
    "K": 0.005,
    "alpha": 0.10,
    "d_x": 0.10,
    "d_y": 0.10,
    "d_z": 0.15,
}
_ABSOLUTE = frozenset({"alpha"})


@dataclass(frozen=True)
class Need:
    """One script of the re-flight. repeats: how often each step; deciding: the parameter that needs the most."""

    script: str
    repeats: int
    usual: int
    deciding: str


def needs(
    scripts: Sequence[str],
    stored: Mapping[str, tuple[float, float]],
    flown_repeats: Mapping[str, int],
    wanted: Mapping[str, float] | None = None,
) -> tuple[Need, ...]:
    """Repeats per script so that every parameter it identifies reaches its wanted standard error.

    stored: parameter to (value, std) of a campaign flown with `flown_repeats` per script; errors shrink with the root of the
    repeats. At least one repeat, at most what was flown times four.
    """
    goals = {**WANTED, **(wanted or {})}
    found = []
    for script in scripts:
        usual = max(flown_repeats.get(script, 1), 1)
        worst, deciding = 0.0, ""
        for subset, names in SUBSETS.items():
            if script not in SCRIPTS[subset]:
                continue
            for name in names:
                if name not in stored or name not in goals:
                    continue
                value, std = stored[name]
                goal = goals[name] * (1.0 if name in _ABSOLUTE else abs(value))
                share = (std / goal) ** 2 if goal > 0 else math.inf
                if share > worst:
                    worst, deciding = share, name
        repeats = usual if not deciding else min(max(math.ceil(usual * worst), 1), 4 * usual)
        found.append(Need(script, repeats, usual, deciding))
    return tuple(found)
