"""Terms that are no physics of their own: they mend another term's equation, bend towards something that has no name here, or put right
what the base suffered from that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import standard_errors
from flighttest.diagnose.fitted import Fitted, Judged
from flighttest.diagnose.judge import places
from flighttest.diagnose.model import flown
from flighttest.diagnose.plausible import LEAST_SIZE, is_amplitude
from flighttest.diagnose.search import Search

REMAINDER = 0.05  # of what another term does at the same place: an equation's own error may be as large
STANDS_IN = 0.25  # of the held-out excess where it shows: what leaves more than three quarters of it, beside all others, is a copy


def drop_remainders(search: Search) -> None:
    """Take out, the smallest first, what is dwarfed by another accepted term, then what takes little of an excess that stays, then what
    only steps call for that nobody explains."""
    for doubt in (_mends, _stands_in, _leans):
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


def _leans(search: Search) -> tuple[str, str]:
    """A term that shows most in one kind of maneuver and is called for by others, in which more stays unexplained than it explains; and
    why it is no name ('': it is). Physics without a name bends the base, and some term bends it back where the steps were well fitted."""
    assert search.now is not None
    rows, segments = search.now.rows, search.bench.segments
    kinds = np.array([s.kind for s in segments])[rows.segment]
    for term, judged in search.judged.items():
        strange = _unexplained_kinds(search, judged) - {judged.place[1]}
        rest = ~np.isin(kinds, list(strange))
        if not strange or size_without(search.now, term, rest) >= LEAST_SIZE:
            continue
        listed = " and ".join(flown(kind) for kind in sorted(strange))
        return term, f"only {listed} call for it, of which more stays unexplained than it explains"
    return "", ""


def _unexplained_kinds(search: Search, judged: Judged) -> set[str]:
    """Kinds of maneuver where, in some channel, more stays above the noise floor than a term's effect is there, and than the floor."""
    assert search.now is not None
    assert search.floor is not None
    found = set()
    for (channel, kind), at in places(search.now.rows, search.bench.segments).items():
        floor = search.floor.at(channel, kind) ** 2
        left = float(np.mean(search.now.rows.open_residual[at] ** 2)) - floor
        if left > max(floor, float(np.mean(judged.effect[at] ** 2))):
            found.add(kind)
    return found


def size_without(fitted: Fitted, term: str, rest: NDArray[np.bool_]) -> float:
    """Largest amplitude of a term in standard errors (clustered by response), estimated anew from some rows alone by one linear step.

    rest: (n,) which rows. A term without amplitudes stands for itself: infinite.
    """
    rows = fitted.rows
    columns, residual = rows.columns(fitted.names)[rest], rows.residual[rest]
    step = np.linalg.lstsq(columns, residual, rcond=1e-9)[0]
    moved = replace(rows, jacobian=rows.jacobian[rest], residual=residual - columns @ step, segment=rows.segment[rest])
    sizes = [
        abs(fitted.state.values[name] + float(by) - float(fitted.model.param[name].off or 0.0)) / error
        if error > 0
        else 0.0
        for name, by, error in zip(fitted.names, step, standard_errors(moved, fitted.names), strict=True)
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
