"""Did the mass change? A change of mass lies in the span of K and D, so it is no term but a test against a previous model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats

# All forces per mass: one ratio moves them together when the mass has changed. The thrust alone moves only K.
FORCES = ("K", "d_x", "d_y", "d_z")
DRAG_KNOWN = 0.02  # relative standard error below which drag can tell mass from thrust
SIGNIFICANT = 0.01


def mass_test(
    previous: Mapping[str, tuple[float, float | None]], after: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Against the previous parameters: ratio of K, one common ratio of all forces and whether it fits; {} where nothing can be compared."""
    logs, variances, names = [], [], []
    for name in FORCES:
        if name not in previous or name not in after:
            continue
        old, old_std = previous[name]
        new, new_std = float(after[name]["value"]), float(after[name]["std"])
        if old <= 0 or new <= 0:
            continue
        logs.append(float(np.log(new / old)))
        variances.append(max((new_std / new) ** 2 + ((old_std or 0.0) / old) ** 2, 1e-10))
        names.append(name)
    if "K" not in names:
        return {}
    y, w = np.array(logs), 1.0 / np.array(variances)
    common, std = float(np.sum(w * y) / np.sum(w)), float(1.0 / np.sqrt(np.sum(w)))
    thrust, thrust_std = float(y[names.index("K")]), float(np.sqrt(variances[names.index("K")]))
    drag = [k for k, n in enumerate(names) if n != "K"]
    found: dict[str, Any] = {
        "thrust_ratio": float(np.exp(thrust)),
        "thrust_changed": bool(2 * stats.norm.sf(abs(thrust) / thrust_std) < SIGNIFICANT),
        "common_ratio": float(np.exp(common)),
        "common_ratio_std": std * float(np.exp(common)),
    }
    if not found["thrust_changed"]:
        return found | {"sentence": "thrust per mass is what it was"}
    percent = 100 * (float(np.exp(thrust)) - 1)
    if not drag or min(np.sqrt(variances[k]) for k in drag) > DRAG_KNOWN:
        return found | {
            "answer": "thrust or mass",
            "sentence": f"thrust per mass changed by {percent:+.1f} %: thrust or mass, drag is not known well enough to tell",
        }
    same = float(stats.chi2.sf(float(np.sum(w * (y - common) ** 2)), len(names) - 1))
    still = float(stats.chi2.sf(float(sum(w[k] * y[k] ** 2 for k in drag)), len(drag)))
    if same > SIGNIFICANT > still:
        answer = "mass"
        words = (
            f"all forces per mass changed by one ratio: the mass changed by {100 * (float(np.exp(-common)) - 1):+.1f} %"
        )
    elif still > SIGNIFICANT > same:
        answer, words = "thrust", f"thrust changed by {percent:+.1f} % and drag did not: propulsion, not mass"
    else:
        answer, words = "thrust or mass", f"thrust per mass changed by {percent:+.1f} %: thrust or mass"
    return found | {"answer": answer, "same_ratio_p": same, "drag_unchanged_p": still, "sentence": words}
