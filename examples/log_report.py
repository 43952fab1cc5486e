"""What a recording shows, as a typed script of a user: `python examples/log_report.py LOG [LOG ...]`.

`make check` holds it to `mypy --strict` against the installed package.
"""

from __future__ import annotations

import sys
from pathlib import Path

import flighttest as ft


def known(fitted: ft.Fitted) -> dict[str, float]:
    """Parameters that the recordings make known, by name, SI."""
    return {name: e.value for name, e in fitted.parameters.items() if e.identifiable}


def best(logs: list[ft.Recording], terms: list[ft.Term]) -> tuple[str, ft.Fitted]:
    """The term whose addition to the paper's model leaves the least of the specific force upwards."""
    fits = {term.id: ft.fit(*logs, model=ft.Model() + term) for term in terms}
    name = min(fits, key=lambda i: fits[i].fit.quality["f_z_m_s2"].rmse)
    return name, fits[name]


def main(paths: list[Path]) -> int:
    """Read, cut, fit, and say what is known; 1 where nothing can be used."""
    try:
        logs = [ft.read(path) for path in paths]
        responses = ft.segment(*logs)
        print(responses.sentence)
        fitted = ft.fit(*logs)
    except ft.FlighttestError as error:
        print(f"{error.message}\n{error.hint}", file=sys.stderr)
        return 1
    print(fitted.sentence)
    for name, value in known(fitted).items():
        print(f"{name:<14} {value:10.4g}")
    name, _ = best(logs, [ft.terms.ground_effect, ft.terms.quadratic_drag])
    print(f"fits thrust best when added: {name}")
    for work in fitted.model.citations():
        print(f"  {work}")
    step = fitted.model.simulate({"t_s": [0.0, 0.5, 1.0], "roll_ref_rad": [0.0, 0.2, 0.2]})
    print(f"roll 0.5 s after a step of 0.2 rad: {step.channels['roll_rad'][-1]:.3f} rad")
    plan = ft.plan("spot_check")
    return 0 if plan.ok else 1


if __name__ == "__main__":
    sys.exit(main([Path(word) for word in sys.argv[1:]]))
