"""What cannot be told apart, what could not be seen, and what would have been noticed.

Two candidates are confusable when what is left of them beside the rest of the model points the same way (cosine above 0.95). The smallest
effect that would have been noticed is the larger of two: four standard errors (found four times out of five at the catalogue's false alarm
rate; by the noise, or by how little the responses agree, whichever is larger) and half the power of the noise floor in the place where it
shows most, after the base model has copied what it can.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import PLAIN
from flighttest.diagnose.fitted import LEAST_FLOORS
from flighttest.diagnose.judge import places
from flighttest.diagnose.model import Rival, TermVerdict, Untestable
from flighttest.diagnose.rows import Rows
from flighttest.diagnose.screen import ABSORBED, Variant, orthonormal
from flighttest.diagnose.search import Search
from flighttest.physics.core import Term
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

CONFUSABLE = 0.95
BEYOND_CHANCE = 3.2  # standard errors that exclude chance for the whole catalogue
STANDARD_ERRORS = 4.0  # so many are beyond chance four times out of five
PLAUSIBLE = 2.0  # times the usual size: an effect that shows only above that could not be seen
UNSEEN = "it would not have shown in this flight, or in too few responses"
NEVER = 100.0  # times the usual size: no such thing flies, so that this is no different from seeing nothing


def missing_channels(term: Term, segments: Sequence[Segment]) -> tuple[str, ...]:
    """Of what the term needs, what no segment has."""
    missing = []
    for name in term.needs:
        if name == "time_since_takeoff_s":
            if not any(np.isfinite(s.time_since_takeoff_s) for s in segments):
                missing.append("the time since take-off")
        elif name == "height_m":
            if not any(_has(s, "height_m") or _has(s, "p_z_m") for s in segments):
                missing.append(name)
        elif not any(_has(s, name) or name in s.u for s in segments):
            missing.append(name)
    return tuple(missing)


def _has(segment: Segment, name: str) -> bool:
    return name in segment.y and bool(np.isfinite(segment.y[name]).any())


def rivals_of(search: Search, term: str) -> tuple[Rival, ...]:
    """Candidates that would explain what `term` explains, by the cosine of what is left of both; confusable ones and near ones."""
    assert search.now is not None
    rows = search.now.rows
    own = [n for n in search.now.names if search.now.model.term_of(n) == term]
    rest = [n for n in search.now.names if n not in own]
    basis = orthonormal(rows.columns(rest))
    own_effect = search.judged[term].own
    effect = np.zeros(rows.sample.size)
    effect[: own_effect.size] = own_effect / rows.scale[: own_effect.size]
    effect = effect - basis @ (basis.T @ effect)
    length = float(np.linalg.norm(effect))
    found: dict[str, float] = {}
    for v in search.variants():
        columns = v.columns - basis @ (basis.T @ v.columns)
        if np.linalg.norm(columns) < ABSORBED * np.linalg.norm(v.columns) or length == 0:
            continue
        span = orthonormal(columns)
        cosine = float(np.linalg.norm(span.T @ effect)) / length
        found[v.term.id] = max(found.get(v.term.id, 0.0), cosine)
    by_id = {t.id: t for t in search.pool}
    return tuple(
        Rival(i, TermVerdict.CONFUSABLE if c > CONFUSABLE else TermVerdict.NOT_NEEDED, c, by_id[i].reveals)
        for i, c in sorted(found.items(), key=lambda kv: -kv[1])[:3]
        if c > 0.6
    )


def detectable(search: Search) -> dict[str, tuple[float, str]]:
    """Candidate to (smallest amplitude that would have been noticed, its parameter), infinite where none would."""
    assert search.floor is not None
    assert search.ground is not None
    assert search.now is not None
    ground, rows = search.ground, search.ground.rows
    found: dict[str, tuple[float, str]] = {}
    of_place = places(rows, search.bench.segments)
    base, open_base = rows.columns(search.now.names), rows.open_columns(search.now.names)
    _, which = np.unique(rows.segment, return_inverse=True)
    for v in _usual(search.variants()):
        own = v.columns - ground.basis @ (ground.basis.T @ v.columns)
        for k in range(own.shape[1]):
            others = orthonormal(np.delete(own, k, axis=1)) if own.shape[1] > 1 else np.zeros((own.shape[0], 0))
            alone = own[:, k] - others @ (others.T @ own[:, k])
            information = float((alone**2) @ ground.weight)  # correlated samples of a channel count as fewer
            name = v.names[k] if v.names else ""
            if float(alone @ alone) <= (ABSORBED * float(np.linalg.norm(v.columns[:, k]))) ** 2 or information <= 0:
                level = np.inf
            else:
                without = ground.residual - alone * float(alone @ ground.residual) / float(alone @ alone)
                parts = np.bincount(which, alone * ground.weight * without)
                error = max(float(np.sqrt(1.0 / information)), float(np.sqrt(parts @ parts)) / information)
                level = _asked(rows, alone**2 * ground.weight) * error
                copied = np.linalg.lstsq(base, v.columns[:, k], rcond=1e-10)[0]
                effect = v.open_columns[:, k] - open_base @ copied
                sizes = [
                    float(np.sqrt(np.mean(effect[at] ** 2))) / search.floor.of(c) for (c, _), at in of_place.items()
                ]
                level = max(level, LEAST_FLOORS / max(max(sizes, default=0.0), 1e-12))
            if level < found.get(v.term.id, (np.inf, ""))[0] or v.term.id not in found:
                found[v.term.id] = (level, name)
    return found


def _usual(variants: Sequence[Variant]) -> list[Variant]:
    """Of each candidate the setting of its shapes that is nearest to the usual one: at its most visible it may be what never flies."""
    best: dict[str, tuple[float, Variant]] = {}
    for v in variants:
        usual = {p.name: p.nominal for p in v.term.shapes}
        off = sum(abs(float(np.log(max(abs(v.shapes[n] / usual[n]), 1e-9)))) for n in v.shapes if usual.get(n))
        if v.term.id not in best or off < best[v.term.id][0]:
            best[v.term.id] = off, v
    return [v for _, v in best.values()]


def _asked(rows: Rows, information: FloatArray) -> float:
    """Standard errors that naming takes. Flipping the signs of few responses hardly excludes chance: the fewer carry the information, the
    more, up to what is believed of so few without flips; infinitely many below the fewest that are believed at all. information: (n,)
    per row."""
    _, which = np.unique(rows.segment, return_inverse=True)
    by_response = np.bincount(which, information)
    carriers = float(by_response.sum() ** 2 / max(float(by_response @ by_response), 1e-300))
    falls = [-least for fewest, least in PLAIN if carriers >= fewest]
    found = [float(np.sqrt(fall + np.log(max(rows.residual.size, 2)))) for fall in falls]
    # Flips spread the effect itself, too: of n like responses it stands out by sqrt(n) of that spread at most.
    if carriers > BEYOND_CHANCE**2:
        found.append(STANDARD_ERRORS / float(np.sqrt(1.0 - BEYOND_CHANCE**2 / carriers)))
    return min(found, default=float("inf"))


def untestable(search: Search, levels: dict[str, tuple[float, str]]) -> list[Untestable]:
    """Candidates this data could not have shown."""
    found = []
    for term in search.pool:
        if term.id in search.judged:
            continue
        missing = missing_channels(term, search.bench.segments)
        if missing:
            found.append(Untestable(term.id, f"not recorded: {', '.join(missing)}", term.reveals))
            continue
        level, name = levels.get(term.id, (np.inf, ""))
        usual = next((abs(p.nominal - float(p.off or 0.0)) for p in term.amplitudes if p.name == name), 1.0)
        if not level < NEVER * usual:
            found.append(Untestable(term.id, UNSEEN, term.reveals))
        elif level > PLAUSIBLE * usual:
            unit = next((p.unit if p.unit != "1" else name for p in term.amplitudes if p.name == name), "of itself")
            found.append(
                Untestable(
                    term.id,
                    f"only {level:.2g} {unit} or more would have shown, {level / usual:.1f} times what is usual",
                    term.reveals,
                )
            )
    return found
