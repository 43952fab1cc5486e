"""Terms that are no physics of their own: they mend another term's equation, or bend towards something that has no name here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flighttest.diagnose.judge import places
from flighttest.diagnose.search import Search

REMAINDER = 0.05  # of what another term does at the same place: an equation's own error may be as large
STANDS_IN = 0.25  # of the held-out excess where it shows: what leaves more than three quarters of it, beside all others, is a copy


def drop_remainders(search: Search) -> None:
    """Take out, the smallest first, what is dwarfed by another accepted term, then what takes little of an excess that stays."""
    for doubt in (_mends, _stands_in):
        while search.judged and search.now is not None:
            term, reason = doubt(search)
            if not reason:
                break
            now = search.without(term)
            search.refused[term] = replace(search.judged.pop(term), reason=reason)
            search.now = now
            search.judged |= {
                t: search.judge(t, search.without(t), now, judged.p_value) for t, judged in search.judged.items()
            }
            search.progress(f"{term} leaves the model: {reason}")


def _mends(search: Search) -> tuple[str, str]:
    """The term that is smallest beside another at the place where it shows most, and why it is a remainder ('': it is none)."""
    if len(search.judged) < 2:
        return "", ""
    shares = {term: _share_of_another(search, term) for term in search.judged}
    term = min(shares, key=lambda t: shares[t][0])
    share, another = shares[term]
    if share >= REMAINDER:
        return term, ""
    return term, f"it does {100 * share:.1f} % of what {another} does there, and no equation is known that well"


def _stands_in(search: Search) -> tuple[str, str]:
    """The term that takes the smallest share of the excess where it shows, and why it is no name for it ('': it is)."""
    term = min(search.judged, key=lambda t: search.judged[t].gain)
    gain = search.judged[term].gain
    if gain >= STANDS_IN:
        return term, ""
    return (
        term,
        f"it takes {100 * max(gain, 0.0):.0f} % of the error where it shows: it may stand in for what stays unexplained",
    )


def _share_of_another(search: Search, term: str) -> tuple[float, str]:
    """RMS of a term's effect over the largest of any other accepted term's, at the place where it shows most, and that term."""
    assert search.now is not None
    at = places(search.now.rows, search.bench.segments)[search.judged[term].place]
    size = {t: float(np.sqrt(np.mean(j.effect[at] ** 2))) for t, j in search.judged.items()}
    another = max((t for t in size if t != term), key=lambda t: size[t])
    return size[term] / max(size[another], 1e-300), another
