"""Terms that are no physics of their own: they mend another term's equation, bend towards something that has no name here, or put right
what the base suffered from that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import estimate_from
from flighttest.diagnose.fitted import LEAST_FLOORS, Fitted, Judged
from flighttest.diagnose.judge import places
from flighttest.diagnose.model import flown
from flighttest.diagnose.plausible import LEAST_SIZE, is_amplitude
from flighttest.diagnose.search import Search

REMAINDER = 0.05  # of what another term does at the same place: an equation's own error may be as large
FEWEST = 5  # responses that must be left for their scatter to be an error
MOSTLY = 0.5  # of its noise floors where a term shows most: what it does to other channels by the way says little of it
STANDS_IN = 0.25  # of the held-out excess where it shows: what leaves more than three quarters of it, beside all others, is a copy


def drop_remainders(search: Search) -> None:
    """Take out, one by one and the most doubtful first, what is dwarfed by another accepted term, what takes little of an excess that
    stays, and what only steps call for that nobody explains; all are judged anew after each."""
    while search.judged and search.now is not None:
        doubted = (doubt(search) for doubt in (_mends, _stands_in, _leans))
        term, reason = next((found for found in doubted if found[1]), ("", ""))
        if not reason:
            return
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


def _leans(search: Search) -> tuple[str, str]:
    """A term that is called for only by kinds of maneuver in which more stays unexplained than it takes away, and why it is no name ('': it
    is). Physics without a name bends the base there, and some term bends it back where the steps were well fitted, or copies a part."""
    assert search.now is not None
    kinds = np.array([s.kind for s in search.bench.segments])[search.now.rows.segment]
    found = []
    for term, judged in search.judged.items():
        strange = _unexplained_kinds(search, judged)
        size = size_without(search.now, term, ~np.isin(kinds, list(strange))) if strange else np.inf
        if size < LEAST_SIZE:
            listed = " and ".join(flown(kind) for kind in sorted(strange))
            found.append((size, term, f"only {listed} show it, and more error stays in those than it takes away"))
    return min(found)[1:] if found else ("", "")


def _unexplained_kinds(search: Search, judged: Judged) -> set[str]:
    """Kinds of maneuver where, in some channel that mostly shows a term or in the force on a velocity that does, more stays above the noise
    floor than its effect is there, and than the floor."""
    assert search.now is not None
    assert search.floor is not None
    rows, floor = search.now.rows, search.floor
    table = places(rows, search.bench.segments)
    power = {place: float(np.mean(judged.effect[at] ** 2)) for place, at in table.items()}
    size = {c: max(power[p] for p in table if p[0] == c) ** 0.5 / floor.of(c) for c, _ in table}
    shows = {c for c, floors in size.items() if floors >= max(LEAST_FLOORS, MOSTLY * max(size.values()))}
    shows |= {f"{force}{c[1:]}2" for c in shows if c.startswith("v_") for force in "fa"}
    found = set()
    for (channel, kind), at in table.items():
        usual = floor.at(channel, kind) ** 2
        left = float(np.mean(rows.open_residual[at] ** 2)) - usual
        if channel in shows and left > max(usual, power[channel, kind]):
            found.add(kind)
    return found


def size_without(fitted: Fitted, term: str, rest: NDArray[np.bool_]) -> float:
    """Largest amplitude of a term in standard errors (clustered by response), estimated anew from some rows alone by one linear step;
    infinite where nothing can be said: too few responses are left, or a term has no amplitude.

    rest: (n,) which rows.
    """
    if np.unique(fitted.rows.segment[rest]).size < FEWEST:
        return np.inf
    step, std = estimate_from(fitted.rows, fitted.names, rest)
    sizes = [
        abs(fitted.state.values[name] + float(by) - float(fitted.model.param[name].off or 0.0)) / float(error)
        if error > 0
        else 0.0
        for name, by, error in zip(fitted.names, step, std, strict=True)
        if is_amplitude(term, name, fitted.model)
    ]
    return max(sizes, default=np.inf)


def _share_of_another(search: Search, term: str) -> tuple[float, str]:
    """RMS of a term's effect over the largest of any other accepted term's, at the place where it shows most, and that term."""
    assert search.now is not None
    at = places(search.now.rows, search.bench.segments)[search.judged[term].place]
    size = {t: float(np.sqrt(np.mean(j.effect[at] ** 2))) for t, j in search.judged.items()}
    another = max((t for t in size if t != term), key=lambda t: size[t])
    return size[term] / max(size[another], 1e-300), another
