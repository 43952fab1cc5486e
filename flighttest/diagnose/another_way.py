"""Several terms that together stand in for others: a step forward is never taken back as a whole, so the search starts again without
the term that set its course, and the better of the two models is kept."""

from __future__ import annotations

from dataclasses import replace

from flighttest.diagnose.fitted import explained
from flighttest.diagnose.remainders import drop_remainders
from flighttest.diagnose.search import Search

MANY = 3  # terms of one block: so many are more often copies of fewer than so many effects at once
NEARLY = 0.95  # of what one model explains: another that explains as much is as good, and the one with fewer names is believed


def another_way(search: Search) -> tuple[Search, str]:
    """The search itself, or one that began without its first term; and what is to be said where both explain the flights.

    Kept is the model that explains more (information criterion), of two that explain nearly as much the one with fewer terms. A model
    that only lacks some of the terms is no other way: each of them earned its place beside the others.
    """
    if len(search.judged) < MANY:
        return search, ""
    first = next(iter(search.judged))
    search.progress(f"trying to do without {first}")
    pool = tuple(t for t in search.pool if t.id != first)
    other = replace(search, pool=pool, now=search.base, judged={}, refused={}, pinned={})
    other.go_on()
    if not other.judged:
        return search, ""  # nothing is found without it, and with it the search would go the same way again
    # Beside what was found without it, it may still be needed.
    other.pool = search.pool
    other.go_on()
    drop_remainders(other)
    if set(other.judged) <= set(search.judged):
        return search, ""
    by_worth = sorted((search, other), key=worth)
    lesser, best = by_worth
    if worth(lesser) < NEARLY * worth(best):
        return best, ""
    kept, given_up = sorted(by_worth, key=lambda s: (len(s.judged), -worth(s)))
    return kept, (
        f"{_listed(given_up)} together would explain these flights as well as {_listed(kept)}: "
        + ("the fewer are named" if len(kept.judged) < len(given_up.judged) else "the slightly better set is named")
    )


def worth(search: Search) -> float:
    """What a search came to explain."""
    assert search.base is not None
    assert search.now is not None
    return explained(search.base, search.now)


def _listed(search: Search) -> str:
    *first, last = search.judged
    return f"{', '.join(first)} and {last}" if first else last
