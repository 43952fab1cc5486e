"""What could not be seen, and the smallest effect that would have been: minimum detectable effect of every candidate beside the model.

    MDE = max( (sqrt(2 t) + z_0.8) se,  size at which the effect has `LEAST_FLOORS` noise floors )

se: standard error of the coefficient beside the model, in the weights of its discrepancy; t: log odds that naming takes, prior odds
included; z_0.8: normal quantile, found four times out of five.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flighttest.diagnose.model import Untestable, brief
from flighttest.diagnose.selection.candidates import Candidate, usual_size
from flighttest.diagnose.selection.comparison import LEAST_FLOORS, log_odds_asked, weights_of
from flighttest.diagnose.selection.search import Search
from flighttest.diagnose.selection.subsets import ABSORBED
from flighttest.estimation.linearisation import orthonormal
from flighttest.estimation.responses import HORIZONTAL, attitude_is_known
from flighttest.physics.core import Term
from flighttest.segments.model import Segment

POWER = 0.8416  # normal quantile of 0.8
PLAUSIBLE = 2.0  # times the usual size: an effect that shows only above that could not be seen
UNSEEN = "it would not have shown in this flight"
NEVER = 100.0  # times the usual size: as good as never


def missing_channels(term: Term, segments: Sequence[Segment]) -> tuple[str, ...]:
    """Of what the term needs, what no segment has. Of horizontal motion nothing is compared where roll or pitch was not measured."""
    missing = []
    level = not any(attitude_is_known(s) for s in segments)
    for name in term.needs:
        if name == "time_since_takeoff_s":
            if not any(np.isfinite(s.time_since_takeoff_s) for s in segments):
                missing.append("the time since take-off")
        elif name == "height_m":
            if not any(_has(s, "height_m") or _has(s, "p_z_m") for s in segments):
                missing.append(name)
        elif not any(_has(s, name) or name in s.u for s in segments):
            missing.append(name)
        elif level and name in HORIZONTAL:
            missing += [a for a in ("roll_rad", "pitch_rad") if not any(_has(s, a) for s in segments)]
    return tuple(missing)


def _has(segment: Segment, name: str) -> bool:
    return name in segment.y and bool(np.isfinite(segment.y[name]).any())


def detectable(search: Search) -> dict[str, tuple[float, str]]:
    """Candidate to (smallest coefficient that would have been named, its parameter), infinite where none would."""
    now, sizes = search.now, search.sizes
    assert now is not None
    if sizes is None:
        return {}
    root = np.sqrt(weights_of(now, search.estimator.segments)(now.rows))[:, None]
    basis = orthonormal(now.rows.columns(now.names) * root)
    asked = math.sqrt(2.0 * log_odds_asked(len(search.pool))) + POWER
    found: dict[str, tuple[float, str]] = {}
    for c in usual_settings(search.candidates):
        whitened = c.columns * root
        own = whitened - basis @ (basis.T @ whitened)
        for k in range(own.shape[1]):
            others = orthonormal(np.delete(own, k, axis=1))
            alone = own[:, k] - others @ (others.T @ own[:, k])
            length = float(np.linalg.norm(alone))
            level = np.inf
            if length > ABSORBED * float(np.linalg.norm(whitened[:, k])):
                level = max(asked / length, LEAST_FLOORS / max(float(sizes.of_units(c)[k]), 1e-12))
            if level < found.get(c.term.id, (np.inf, ""))[0] or c.term.id not in found:
                found[c.term.id] = (level, c.names[k] if c.names else "")
    return found


def usual_settings(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Of each term the grid value that is nearest to the usual one: at its most visible it may be what never flies."""
    best: dict[str, tuple[float, Candidate]] = {}
    for c in candidates:
        usual = {p.name: p.nominal for p in c.term.shapes}
        off = sum(abs(math.log(max(abs(c.shape[n] / usual[n]), 1e-9))) for n in c.shape if usual.get(n))
        if c.term.id not in best or off < best[c.term.id][0]:
            best[c.term.id] = off, c
    return [c for _, c in best.values()]


def untestable(search: Search, levels: dict[str, tuple[float, str]]) -> list[Untestable]:
    """Candidates this data could not have shown."""
    found = []
    for term in search.pool:
        if term.id in search.members:
            continue
        level, name = levels.get(term.id, (np.inf, ""))
        if why := why_unseen(term, level, name):
            found.append(Untestable(term.id, why, term.reveals))
    return found


def why_unseen(term: Term, level: float, name: str) -> str:
    """Why a term could not have been seen at its usual size, '' where it could. level: smallest size of coefficient `name` that would have
    been named."""
    usual = next((abs(usual_size(p)) for p in term.amplitudes if p.name == name), 1.0)
    if not level < NEVER * usual:
        return UNSEEN
    if level <= PLAUSIBLE * usual:
        return ""
    unit = next((p.unit if p.unit != "1" else name for p in term.amplitudes if p.name == name), "times itself")
    return f"would be detected from {brief(level)}{f' {unit}' if unit else ''} on, {level / usual:.1f} times its usual size"
