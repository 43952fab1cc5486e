"""A model written out: its equations, its symbols with units and references, and the literature behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from flighttest.physics.body import DELAY
from flighttest.physics.core import Param, Term

if TYPE_CHECKING:
    import pandas as pd

PAPER = "Modeling and Identification of Multirotor Drone Dynamics for Onboard MPC Motion Planning"

_ATTITUDE = (
    ("phi_dd = omega_phi^2 (phi_r - phi) - 2 zeta_phi omega_phi phi_dot", "paper, Eq. 4"),
    ("theta_dd = omega_theta^2 (theta_r - theta) - 2 zeta_theta omega_theta theta_dot", "paper, Eq. 4"),
    ("r_dot = sigma_r (r_r - r)", "paper, Eq. 4"),
    ("psi_dot = (r / cos(phi) + tan(phi) theta_dot) / cos(theta)", "paper, Eq. 3 with q eliminated"),
)
_TRANSLATION = (
    ("a_t_dot = sigma_t (K (U / U_n)^alpha T - a_t)", "paper, Eq. 4"),
    ("p_dot = v", "definition of velocity"),
    ("v_dot = R(phi, theta, psi) ((0, 0, a_t) + f) - (0, 0, g)", "paper, Eq. 2 and 4"),
)


@dataclass(frozen=True)
class Equation:
    """One line: which term it comes from ('body' for the paper's own), the text, and its reference."""

    term: str
    text: str
    reference: str


@dataclass(frozen=True)
class Symbol:
    """One parameter: its name in files and options, its symbol, unit, meaning, reference, and the term that owns it; value where known."""

    name: str
    symbol: str
    unit: str
    meaning: str
    reference: str
    term: str
    value: float | None = None


@dataclass(frozen=True)
class ModelEquations:
    """A model written out. `print` it, or take the symbols as a table with `to_frame`."""

    equations: tuple[Equation, ...]
    symbols: tuple[Symbol, ...]

    def __str__(self) -> str:
        lines = [f"{e.text}    [{e.term}: {e.reference}]" for e in self.equations]
        names, symbols, units = (max(len(getattr(s, k)) for s in self.symbols) for k in ("name", "symbol", "unit"))
        lines.append("")
        for s in self.symbols:
            value = "" if s.value is None else f"{s.value:>10.5g}  "
            lines.append(
                f"{s.name:<{names}}  {s.symbol:<{symbols}}  {value}{s.unit:<{units}}  {s.meaning} [{s.reference}]"
            )
        return "\n".join(lines)

    def to_frame(self) -> pd.DataFrame:
        """One row per symbol, indexed by name: symbol, unit, meaning, reference, term, value."""
        import pandas as pd

        return pd.DataFrame([asdict(s) for s in self.symbols]).set_index("name")


def equations_of(
    terms: Sequence[Term], params: Sequence[Param], attitude_loops: bool, values: Mapping[str, float] | None = None
) -> ModelEquations:
    """The equations of a model in evaluation order.

    terms: those beside the body; params: all of the model's; attitude_loops: whether the body has them; values: parameters by name, where
    their numbers are wanted beside the symbols.

    World North-West-Up, body Forward-Left-Up, SI. A reference acts one delay after it was sent; `<-` marks what a term changes.
    """
    lines = [Equation("body", text, reference) for text, reference in (_ATTITUDE if attitude_loops else ())]
    lines += [Equation("body", text, reference) for text, reference in _TRANSLATION]
    delays = [p for p in params if p.name.startswith(DELAY.name)]
    acts = ", ".join(f"{p.name} ({p.doc.removeprefix('delay of ')})" for p in delays)
    lines.append(Equation("body", f"references act at t - delay: {acts}", "paper, section 2"))
    ports = {port: k for k, port in enumerate(type(terms[0].port))} if terms else {}
    for term in sorted(terms, key=lambda t: ports[t.port]):
        lines.append(Equation(term.id, term.equation, term.source))
    known = values or {}
    owner = {p.name: term.id for term in terms for p in term.params}
    symbols = tuple(
        Symbol(p.name, p.symbol, p.unit, p.doc, p.source, owner.get(p.name, "body"), known.get(p.name)) for p in params
    )
    return ModelEquations(tuple(lines), symbols)


def citations_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """The literature behind a model, each work once: the paper first, then the sources of its terms in the model's order."""
    works = [work.strip() for term in terms for work in term.source.split(";")]
    return tuple(dict.fromkeys([PAPER, *(w for w in works if not w.startswith("paper"))]))
