"""The catalogue of physics as `ft.terms`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING

from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Term

if TYPE_CHECKING:
    import pandas as pd

    from flighttest.api.answers import Answer


class Terms(Mapping[str, Term]):
    """Every term there is, by id: `ft.terms.ground_effect` or `ft.terms["ground_effect"]`; add one to a model with `+`.

    Terms of other packages join by the entry-point group `flighttest.terms`.
    """

    def __getitem__(self, term_id: str) -> Term:
        """The term of this id; KeyError where there is none."""
        return catalogue()[term_id]

    def __iter__(self) -> Iterator[str]:
        return iter(catalogue())

    def __len__(self) -> int:
        return len(catalogue())

    def __getattr__(self, term_id: str) -> Term:
        """The term of this id; AttributeError names the nearest where there is none."""
        if term_id.startswith("_"):
            raise AttributeError(term_id)
        known = catalogue()
        if term_id not in known:
            near = get_close_matches(term_id, known, 1)
            raise AttributeError(f"no term is called {term_id!r}{f'; did you mean {near[0]!r}?' if near else ''}")
        return known[term_id]

    def __repr__(self) -> str:
        return f"<Terms: {', '.join(self)}>"

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *catalogue()]

    def describe(self, *ids: str) -> Answer:
        """The catalogue as a table, or everything about the terms of these ids. InputError where there is none of an id."""
        from flighttest.api.answers import Answer
        from flighttest.pipeline.info import terms as table

        result = table(ids)
        return Answer(document=result.document, data=result.data, status=result.status)

    def to_frame(self) -> pd.DataFrame:
        """One row per term, indexed by id: family, title, equation, parameters with units, source, and the maneuver that shows it."""
        import pandas as pd

        rows = [
            {
                "id": t.id, "family": t.family, "title": t.title, "equation": t.equation,
                "parameters": ", ".join(f"{p.name} ({p.unit})" for p in t.params), "source": t.source, "shown_by": t.reveals,
            }
            for t in self.values()
        ]  # fmt: skip
        return pd.DataFrame(rows).set_index("id")


terms = Terms()


def shipped_maneuvers() -> tuple[str, ...]:
    """Names of the maneuver scripts that come with the program."""
    from flighttest.script.shipped import shipped_names

    return tuple(shipped_names())
