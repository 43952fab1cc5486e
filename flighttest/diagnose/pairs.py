"""Two effects that hide each other: neither earns its place alone, both do together.

Asked where a candidate, refitted, improved the fit far beyond chance and was refused, and none that was kept improves it as much: alone it
may be bent by what it lacks (a shaped reference, by a third pole of the loop). From the optimum it leads to, the catalogue is screened
once more, and the two are judged each in the other's presence, by the bar that holds for all.
"""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.diagnose.fitted import LEAST_BIC, Fitted, Judged, explained
from flighttest.diagnose.screen import best_per_term
from flighttest.diagnose.search import Search

PROMISING = 5 * LEAST_BIC
OF_NAMED = 0.05  # of what is named already: less may be the error of its equations, and pairs are costly
MOST_FIRST, MOST_SECOND = 2, 2


def look_ahead(search: Search, refused: Sequence[tuple[Judged, Fitted]]) -> bool:
    """Take two candidates at once where both are kept; the search is as it was otherwise. refused: what was refitted in vain."""
    now, columns, pinned = search.now, search.held_columns(), dict(search.pinned)
    assert now is not None
    assert search.base is not None
    least = max(PROMISING, OF_NAMED * explained(search.base, now))
    promising = sorted((j.bic, k) for k, (j, _) in enumerate(refused) if j.bic < -least)
    tried: set[frozenset[str]] = set()
    for _, k in promising[:MOST_FIRST]:
        first, fitted = refused[k]
        search.now = fitted
        search.linearise()
        seconds = [s for s in best_per_term(search.scores) if s.beyond_chance and s.bic < -LEAST_BIC]
        for s in seconds[:MOST_SECOND]:
            two = frozenset((first.term, s.variant.term.id))
            if two in tried:
                continue
            tried.add(two)
            search.progress(f"refitting with {first.term} and {s.variant.term.id} together")
            both = search.refitted_with(s, fitted)
            second = search.judge(s.variant.term.id, fitted, both, s.p_value)
            if not second.kept:
                continue
            again = search.judge(first.term, search.refitted_without(first.term, both), both, first.p_value)
            if again.kept:
                search.take(both, again, second)
                return True
    search.now, search.pinned = now, pinned
    search.hold_columns(columns)
    return False
