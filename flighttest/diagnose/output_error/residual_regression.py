"""Physics without a name: where it acts and what shape it has, by a small sparse regression on physical state functions.

What stays of the specific force (or of the attitude loops' angles) is regressed on functions of the vehicle's state, forward, one
function at a time, as many as improve the prediction of groups not used by 5 % each, and never more than four. The formula describes; it
is not a name, and holds only inside the range of the data it came from.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.model import short
from flighttest.diagnose.records import Description
from flighttest.diagnose.residuals.locate import VARIABLES, sampled
from flighttest.diagnose.selection.held_out import folds_of
from flighttest.diagnose.selection.search import Search
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

MOST_FUNCTIONS = 4
LEAST_GAIN = 0.05
KNOTS = (0.2, 0.4, 0.6, 0.8)  # quantiles of a variable at which a slope may change

SYMBOLS = {
    "speed_forward_m_s": "u", "speed_left_m_s": "v", "speed_up_m_s": "w", "tilt_rad": "tilt", "heading_rad": "psi",
    "p_rad_s": "p", "q_rad_s": "q", "r_rad_s": "r", "height_m": "h", "throttle": "T", "throttle_rate_1_s": "dT/dt", "voltage_v": "U",
    "time_since_takeoff_s": "t", "time_since_command_s": "t_c",
}  # fmt: skip


def candidate_functions(variables: dict[str, FloatArray]) -> dict[str, tuple[FloatArray, tuple[str, ...]]]:
    """Formula to (values, variables in it): powers, changes of slope, products with speed, periodic in heading."""
    found: dict[str, tuple[FloatArray, tuple[str, ...]]] = {}
    for name, x in variables.items():
        s = SYMBOLS[name]
        if name == "heading_rad":
            own = {"cos(psi)": np.cos(x), "sin(psi)": np.sin(x)}
        else:
            own = {s: x, f"{s}^2": x**2}
            for knot in sorted({float(f"{k:.2g}") for k in np.quantile(x, KNOTS)}):
                own[f"max({s} {'-' if knot >= 0 else '+'} {abs(knot):g}, 0)"] = np.maximum(x - knot, 0.0)
        if name.startswith("speed"):
            own[f"|{s}| {s}"] = np.abs(x) * x
        if name == "height_m":
            own["1/(h + 0.2)^2"] = 1 / (np.maximum(x, 0.0) + 0.2) ** 2
        if name in ("time_since_command_s", "time_since_takeoff_s"):
            own[f"exp(-{s}/0.5 s)"] = np.exp(-np.maximum(x, 0.0) / 0.5)
        found |= {formula: (values, (name,)) for formula, values in own.items()}
    for a in ("speed_forward_m_s", "speed_left_m_s", "speed_up_m_s"):
        for b in ("throttle", "height_m", "tilt_rad"):
            if a in variables and b in variables:
                found[f"{SYMBOLS[a]} {SYMBOLS[b]}"] = variables[a] * variables[b], (a, b)
    return found


def describe(
    search: Search, segments: Sequence[Segment], groups: IntArray, channels: Collection[str]
) -> list[Description]:
    """Formulas for channels (short names) where a mismatch stays; forces and angles, not velocities (which follow from forces)."""
    assert search.now is not None
    rows = search.now.rows
    variables = sampled(rows, segments)
    found: list[Description] = []
    for c, name in enumerate(rows.channels):
        if name.startswith("v_") or short(name) not in channels:
            continue
        at = np.flatnonzero(rows.channel == c)
        good = at[np.all([np.isfinite(x[at]) for x in variables.values()], axis=0)] if variables else at
        r = rows.unprofiled_residual[good]
        if good.size < 200:
            continue
        functions = candidate_functions({k: x[good] for k, x in variables.items() if k != name})
        table = {k: v for k, (v, _) in functions.items() if np.ptp(v) > 1e-9}
        fold = folds_of(groups)[rows.segment[good]]
        chosen, left = sparse_choice(r, table, fold)
        if not chosen:
            continue
        columns = np.stack([np.ones(r.size), *(table[k] for k in chosen)], axis=1)
        weights = np.linalg.lstsq(columns, r, rcond=None)[0]
        formula = f"{weights[0]:+.3g} " + " ".join(f"{w:+.3g} {k}" for w, k in zip(weights[1:], chosen, strict=True))
        used = [n for n in SYMBOLS if any(n in functions[k][1] for k in chosen)]
        found.append(
            {
                "channel": short(name),
                "port": "specific force" if name.startswith(("f_", "a_")) else "attitude loop",
                "formula": f"{short(name)} residual = {formula}",
                "sentence": f"{short(name)}: this formula describes {100 * (1.0 - left):.0f} % of the residual inside the range flown; "
                "it is a description, not a named effect",
                "functions": chosen,
                "coefficients": weights.tolist(),
                "heldout_share": left,
                "valid": {n: [float(variables[n][good].min()), float(variables[n][good].max())] for n in used},
                "symbols": {SYMBOLS[n]: VARIABLES[n][0] for n in used},
            }
        )
    return found


def sparse_choice(r: FloatArray, table: dict[str, FloatArray], fold: IntArray) -> tuple[list[str], float]:
    """Forward choice by grouped held-out error; (functions, share of the held-out mean square they leave)."""
    names = list(table)
    if not names:
        return [], 1.0
    scale = {k: float(np.std(v)) or 1.0 for k, v in table.items()}
    every = np.stack([np.ones(r.size), *(table[k] / scale[k] for k in names)], axis=1)
    folds = np.unique(fold)
    if folds.size < 2:
        return [], 1.0
    grams = [
        (every[fold == f].T @ every[fold == f], every[fold == f].T @ r[fold == f], float(r[fold == f] @ r[fold == f]))
        for f in folds
    ]
    gram, moment = sum(g[0] for g in grams), sum(g[1] for g in grams)
    total = sum(g[2] for g in grams)

    def held(columns: list[int]) -> float:
        error = 0.0
        for own_gram, own_moment, own_power in grams:
            h = (gram - own_gram)[np.ix_(columns, columns)] + 1e-9 * r.size * np.eye(len(columns))
            w = np.linalg.solve(h, (moment - own_moment)[columns])
            error += own_power - 2 * w @ own_moment[columns] + w @ own_gram[np.ix_(columns, columns)] @ w
        return float(error) / total

    chosen, left = [0], [held([0])]
    while len(chosen) <= min(MOST_FUNCTIONS, len(names)):
        value, k = min((held([*chosen, k]), k) for k in range(1, len(names) + 1) if k not in chosen)
        chosen.append(k)
        left.append(value)
    # As many as pay for themselves, together: a bend needs two before either shows. What they made needless goes again.
    best = min(range(len(left)), key=lambda n: left[n] / (1.0 - LEAST_GAIN) ** n)
    chosen, share = chosen[: best + 1], left[best]
    while len(chosen) > 1:
        value, k = min((held([c for c in chosen if c != k]), k) for k in chosen[1:])
        if value * (1.0 - LEAST_GAIN) > share:
            break
        chosen, share = [c for c in chosen if c != k], value
    # Better than the mean is not enough: a mean that holds for some groups only is worse than nothing for the others.
    if len(chosen) == 1 or share > 1.0 - LEAST_GAIN:
        return [], 1.0
    return [names[k - 1] for k in chosen[1:]], share
