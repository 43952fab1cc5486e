"""Terms that mend another term's equation: no equation of the catalogue is exact, and what it leaves over is no physics of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flighttest.diagnose.fitted import Judged
from flighttest.diagnose.judge import places
from flighttest.diagnose.search import Search

REMAINDER = 0.05  # of what another term does at the same place: an equation's own error may be as large


def drop_remainders(search: Search) -> None:
    """Take out, the smallest first, what is dwarfed by another accepted term at the place where it shows most."""
    while len(search.judged) > 1 and search.now is not None:
        shares = {term: _share_of_another(search, judged) for term, judged in search.judged.items()}
        term = min(shares, key=lambda t: shares[t][0])
        share, another = shares[term]
        if share >= REMAINDER:
            break
        reason = f"it does {100 * share:.1f} % of what {another} does there, and no equation is known that well"
        now = search.without(term)
        search.refused[term] = replace(search.judged.pop(term), reason=reason)
        search.now = now
        search.judged |= {
            t: search.judge(t, search.without(t), now, judged.p_value) for t, judged in search.judged.items()
        }
        search.progress(f"{term} leaves the model: {reason}")


def _share_of_another(search: Search, of: Judged) -> tuple[float, str]:
    """RMS of a term's effect over the largest of any other accepted term's, at the place where it shows most, and that term."""
    assert search.now is not None
    at = places(search.now.rows, search.bench.segments)[of.place]
    size = {t: float(np.sqrt(np.mean(j.effect[at] ** 2))) for t, j in search.judged.items()}
    another = max((t for t in size if t != of.term), key=lambda t: size[t])
    return size[of.term] / max(size[another], 1e-300), another
