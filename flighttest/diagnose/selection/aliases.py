"""Which other candidate would do in place of a named term: one whose effect points the same way, refitted there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, floor_of
from flighttest.diagnose.selection.comparison import inadmissible, log_evidence
from flighttest.diagnose.selection.search import Search
from flighttest.diagnose.selection.subsets import Scored
from flighttest.estimation.linearisation import orthonormal

ALIASED = 0.9  # cosine of two effects beside the rest of the model above which the other is refitted in its place
CHANCE_NATS = 3.0  # a rival this near is within chance of the best (odds of 20 to 1)


@dataclass(frozen=True)
class Alias:
    """A candidate in place of a named term. cosine: of their effects beside the rest of the model; nats: evidence of the named term's model
    over the model with this one in its place."""

    term: str
    cosine: float
    nats: float

    @property
    def confusable(self) -> bool:
        """Whether both models are in the confidence set."""
        return self.nats < CHANCE_NATS


def aliases_of(search: Search, term: str) -> tuple[Alias, ...]:
    """Candidates whose effect beside the rest of the present model points as a named term's does, refitted in its place."""
    now, without = search.now, search.evidence[term].without
    assert now is not None
    basis = orthonormal(now.rows.columns([n for n in now.names if now.model.term_of(n) != term]))
    effect = np.zeros(now.rows.residual.size)
    own = search.evidence[term].profiled
    effect[: own.size] = own / now.rows.scale[: own.size]
    effect -= basis @ (basis.T @ effect)
    length = float(np.linalg.norm(effect))
    near: dict[str, tuple[float, int]] = {}
    for j, c in enumerate(search.candidates):
        span = orthonormal(c.columns - basis @ (basis.T @ c.columns))
        cosine = float(np.linalg.norm(span.T @ effect)) / max(length, 1e-300)
        near[c.term.id] = max(near.get(c.term.id, (0.0, j)), (cosine, j))
    found = []
    for name, (cosine, j) in sorted(near.items(), key=lambda kv: -kv[1][0])[:2]:
        nats = np.inf
        if cosine > ALIASED and name not in search.rejected:
            search.progress(f"trying {name} in place of {term}")
            scored = Scored((j,), 0.0, np.zeros(search.candidates[j].columns.shape[1]))
            other = search.models.with_candidates(without, [search.candidates[j]], scored)
            if other.finite and not inadmissible(
                search.terms[name], other, search.estimator.segments, len(search.pool)
            ):
                floor = floor_of(now.rows, search.estimator.segments, RESOLUTION)
                nats = sum(log_evidence(now, other, search.estimator, search.groups, floor).values())
        if cosine > 0.6:
            found.append(Alias(name, cosine, nats))
    return tuple(found)
