"""What flights do not determine, from the model that they were compared with: a short flight must not discard what a campaign
determined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.linalg import block_diag

from flighttest.identify.fit import Fit
from flighttest.identify.models.model_blocks import ModelData
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.body import DELAY_PARAM
from flighttest.segments.model import Segment

MEAN_DELAY = "T_d"


def fitted_to(base: ModelFile, segments: Iterable[Segment]) -> bool:
    """Whether a model was fitted to recordings of these segments alone, so that it holds nothing more than they do."""
    return bool(base.runs) and {*map(str, base.runs)} <= {s.run for s in segments}


def known_before(found: Fit, base: ModelFile | None) -> dict[str, float]:
    """Parameters that this fit does not determine and the earlier model does, with the earlier model's values.

    None where that was fitted to these very flights, of which it holds nothing more; and none that absorbs a term which only this model
    has (`Term.hides_in`): there its value was another one. A d_z of 0.65 1/s, held beside an axial inflow and a quadratic drag, took both
    away again (0.02 1/s with them), and velocities after 1 s erred by 0.28 m/s for 0.04.
    """
    if base is None or fitted_to(base, found.problem.segments):
        return {}
    absorb = {n for t in found.model.built_terms if t.id not in base.model.terms for n in t.hides_in}
    return {
        name: base.parameters[name].value
        for name in found.model.names
        if name not in absorb
        and name in base.parameters
        and base.parameters[name].identifiable
        and not found.estimates[name].identifiable
    }


def carry_over(data: ModelData, base: ModelFile, names: Sequence[str]) -> ModelData:
    """The data of model.yaml (see `model_file.as_data`) with these parameters as the earlier model has them: value, error and covariance
    among themselves."""
    parameters = {k: v.copy() for k, v in data["parameters"].items()}
    order = [n for n in data["covariance"]["order"] if n not in (*names, MEAN_DELAY)]
    at = [data["covariance"]["order"].index(n) for n in order]
    old = [n for n in names if n in base.order]
    own = [base.order.index(n) for n in old]
    here = np.array(data["covariance"]["matrix"], dtype=float)
    matrix = block_diag(here[np.ix_(at, at)], base.covariance[np.ix_(own, own)])
    order += old
    for name in names:
        stored = base.parameters[name]
        parameters[name] |= {
            "value": stored.value, "std": stored.std, "source": stored.source, "identifiable": True,
            "interval_95": None if stored.interval_95 is None else list(stored.interval_95),
            "why": "as the base model has it: these flights do not determine it",
        }  # fmt: skip
        parameters[name].pop("fly", None)
    delays = [n for n in DELAY_PARAM.values() if n in order]
    if delays and MEAN_DELAY in parameters:
        weight = np.array([1.0 / len(delays) if n in delays else 0.0 for n in order])
        row = weight @ matrix
        std = float(np.sqrt(row @ weight))
        mean = float(np.mean([parameters[n]["value"] for n in delays]))
        # Carried over or fitted to many responses: either way hardly anything but the normal quantile is left of Student's.
        low, mean, high = (float(f"{v:.7g}") for v in (mean - 1.96 * std, mean, mean + 1.96 * std))
        parameters[MEAN_DELAY] |= {"value": mean, "std": float(f"{std:.7g}"), "interval_95": [low, high]}
        matrix = np.block([[matrix, row[:, None]], [row[None, :], np.array([[std**2]])]])
        order = [*order, MEAN_DELAY]
    words = f"as the base model has them, since these flights do not determine them: {', '.join(names)}"
    return {
        **data,
        "parameters": parameters,
        "delays": data["delays"] | {
            channel: {"value": parameters[n]["value"], "unit": "s", "std": parameters[n]["std"]}
            for channel, n in DELAY_PARAM.items()
            if n in names
        },
        "covariance": {"order": order, "matrix": matrix.tolist()},
        "notes": [*data["notes"], words],
    }  # fmt: skip
