"""How far a vehicle's parameters differ between the conditions of one campaign, beyond their stated errors.

A model is not its vehicle: other headings, voltages, amplitudes or runs move the best-fitting parameters by more than noise does, and
so will the next campaign. Every partition of a campaign's responses by such a condition gives groups, and each group, to first
order, an estimate of its own: the influence of its responses over its share of the information (Quenouille's random groups).
What the groups scatter beyond the error each of them has by the scatter within it is the discrepancy (method of moments, as
DerSimonian and Laird 1986), pulled towards a stated prior by as much as the groups leave it undetermined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.likelihood_weights import Normal
from flighttest.segments import Segment
from flighttest.validity.model import FloatArray

# What one flight after another differs by where nothing has been measured, relative, as one standard deviation: the stated fallback.
PRIOR: dict[str, float] = {
    "K": 0.008,
    "alpha": 0.06,
    "sigma_t": 0.03,
    "omega_phi": 0.02,
    "omega_theta": 0.02,
    "zeta_phi": 0.04,
    "zeta_theta": 0.04,
    "sigma_r": 0.03,
    "d_x": 0.10,
    "d_y": 0.10,
    "d_z": 0.10,
}
DEFAULT_PRIOR = 0.05
# Delays, s: a command stream of 50 Hz meets the autopilot's own loop at any phase, 20 ms / sqrt(12).
DELAY_STD_S = 0.006
PRIOR_WEIGHT = 2.0  # groups that the prior counts as
MIN_GROUP = 3  # responses; of fewer the scatter is not known
MIN_SHARE = 0.1  # of a group in what is known of a parameter

Condition = Callable[[Segment], float | str]


def prior(name: str) -> float:
    """The stated relative discrepancy of a parameter."""
    return PRIOR.get(name, DEFAULT_PRIOR)


def measured(
    normal: Normal, names: Sequence[str], values: Mapping[str, float], segments: Sequence[Segment]
) -> dict[str, float]:
    """Relative discrepancy, one standard deviation, of each of `names` (those that were estimated) that the responses show; of one that
    free flight alone determined, by equations of its own, no response says how far it moves, and its prior stays.

    normal: normal equations per segment at the solution, as `segments`; values: of the parameters.
    """
    names = [n for n in names if n in normal.names]
    pick = [normal.names.index(n) for n in names]
    if not pick:
        return {}
    hessian, score = normal.hessian[:, pick][:, :, pick], normal.score[:, pick]
    total = hessian.sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    inverse = np.linalg.pinv(total * np.outer(scale, scale), rcond=1e-10, hermitian=True) * np.outer(scale, scale)
    influence = score @ inverse  # (segments, parameters): what each response adds to the estimate
    share = np.einsum("ij,sjk,ki->si", inverse, hessian, inverse) / np.diag(inverse)
    found = {}
    for i, name in enumerate(names):
        size = abs(values[name])
        if size > 0.0 and not name.startswith("T_d"):
            variance = _variance(influence[:, i] / size, share[:, i], segments, prior(name) ** 2)
            found[name] = float(np.sqrt(variance))
    return found


def _variance(influence: FloatArray, share: FloatArray, segments: Sequence[Segment], stated: float) -> float:
    """Squared relative discrepancy of one parameter; influence and share: (segments,)."""
    telling = share > 1e-6
    top, weights = PRIOR_WEIGHT * stated, PRIOR_WEIGHT
    for condition in CONDITIONS:
        labels = condition_labels(condition, segments, telling)
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels[labels >= 0])]
        groups = [g for g in groups if g.size >= MIN_GROUP and float(share[g].sum()) >= MIN_SHARE]
        if len(groups) < 2:
            continue
        for group in groups:
            part = float(share[group].sum())
            shift = float(influence[group].sum()) / part
            rest = influence[group] - share[group] * shift
            own = float(rest @ rest) / part**2 * group.size / (group.size - 1)
            weight = (stated / (stated + own)) ** 2
            top += weight * (shift**2 * len(groups) / (len(groups) - 1) - own)
            weights += weight
    return max(top / weights, stated / 16.0)


def condition_labels(condition: Condition, segments: Sequence[Segment], telling: NDArray[np.bool_]) -> FloatArray:
    """Group number per segment, -1 for none. Numbers are parted at their median within each kind of step."""
    labels = np.full(len(segments), -1.0)
    raw = [condition(s) if t else float("nan") for s, t in zip(segments, telling, strict=True)]
    words = sorted({r for r in raw if isinstance(r, str)})
    for kind in {s.kind for s in segments}:
        mine = [i for i, s in enumerate(segments) if s.kind == kind]
        numbers = [r for i in mine if isinstance(r := raw[i], float) and np.isfinite(r)]
        middle = float(np.median(numbers)) if numbers else 0.0
        for i in mine:
            value = raw[i]
            if isinstance(value, str):
                labels[i] = words.index(value)
            elif np.isfinite(value):
                labels[i] = float(value > middle)
    return labels


def _voltage(s: Segment) -> float:
    volts = s.y.get("voltage_v")
    return float(np.nanmean(volts)) if volts is not None and bool(np.isfinite(volts).any()) else float("nan")


def _heading(s: Segment) -> str | float:
    return f"{round(s.heading_rad / (np.pi / 2)) % 4}" if np.isfinite(s.heading_rad) else float("nan")


def _size(s: Segment) -> float:
    for key in ("amplitude_rad", "rate_rad_s"):
        if key in s.cell:
            return abs(float(s.cell[key]))
    if "throttle_0" in s.cell and "throttle_1" in s.cell:
        return float(s.cell["throttle_1"])
    return float("nan")


def _sign(s: Segment) -> str | float:
    for key in ("amplitude_rad", "rate_rad_s"):
        if key in s.cell:
            return "left" if s.cell[key] > 0 else "right"
    return float("nan")


def _time(s: Segment) -> float:
    return s.time_since_takeoff_s


def _run(s: Segment) -> str:
    return s.run


CONDITIONS: tuple[Condition, ...] = (_run, _time, _voltage, _heading, _size, _sign)
