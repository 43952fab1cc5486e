"""Fly a multirotor's test maneuvers, identify its dynamics, and name the physics that the model lacks.

    import flighttest as ft

    flight = ft.read("flight.BIN")
    fitted = ft.fit(flight)
    print(fitted)                                   # the sentence; fitted.to_frame() and fitted.plot() show more
    print(fitted.model.equations())                 # symbols, units, references
    found = ft.diagnose(flight, model=fitted.model)

SI units, world North-West-Up, body Forward-Left-Up. Every error is a `FlighttestError` with a hint. What is imported on first use only
costs nothing before.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flighttest.api.answers import (
        Answer,
        Diagnosed,
        Fitted,
        Flown,
        Models,
        Planned,
        Responses,
        Validated,
        Validity,
        Written,
    )
    from flighttest.api.campaigns import Campaign, Checks, Demonstrated, Imported, Proved, Runs
    from flighttest.api.catalogue import Terms, terms
    from flighttest.api.comparing import against, compare, replay, twin
    from flighttest.api.comparisons import Compared, Opposed, Replayed, Twin
    from flighttest.api.fitted_model import FittedModel
    from flighttest.api.flights import fly, run
    from flighttest.api.tool import demo, doctor, export, fetch_log, import_log, prove, report, runs, serve, show, sign
    from flighttest.api.verbs import (
        accept,
        check_validity,
        diagnose,
        fit,
        models,
        plan,
        read,
        read_model,
        segment,
        simulate,
        validate,
    )
    from flighttest.errors import (
        FitError,
        FlighttestError,
        InputError,
        LinkError,
        ModelError,
        PreflightError,
        RecordingError,
        ScriptError,
        VehicleError,
    )
    from flighttest.physics.core import Contribution, Param, Port, Signals, State, Term
    from flighttest.physics.model import Model
    from flighttest.physics.simulated import Simulated
    from flighttest.pipeline.results import Progress, Status
    from flighttest.recording.model import Recording
    from flighttest.sim.simulation import Simulation
    from flighttest.version import __version__

__all__ = [
    "Answer",
    "Campaign",
    "Checks",
    "Compared",
    "Contribution",
    "Demonstrated",
    "Diagnosed",
    "FitError",
    "Fitted",
    "FittedModel",
    "FlighttestError",
    "Flown",
    "Imported",
    "InputError",
    "LinkError",
    "Model",
    "ModelError",
    "Models",
    "Opposed",
    "Param",
    "Planned",
    "Port",
    "PreflightError",
    "Progress",
    "Proved",
    "Recording",
    "RecordingError",
    "Replayed",
    "Responses",
    "Runs",
    "ScriptError",
    "Signals",
    "Simulated",
    "Simulation",
    "State",
    "Status",
    "Term",
    "Terms",
    "Twin",
    "Validated",
    "Validity",
    "VehicleError",
    "Written",
    "__version__",
    "accept",
    "against",
    "check_validity",
    "compare",
    "demo",
    "diagnose",
    "doctor",
    "export",
    "fetch_log",
    "fit",
    "fly",
    "import_log",
    "models",
    "plan",
    "prove",
    "read",
    "read_model",
    "replay",
    "report",
    "run",
    "runs",
    "segment",
    "serve",
    "show",
    "sign",
    "simulate",
    "terms",
    "twin",
    "validate",
]

_WHERE = {
    "flighttest.api.answers": (
        "Answer", "Diagnosed", "Fitted", "Flown", "Models", "Planned", "Responses", "Validated", "Validity", "Written",
    ),
    "flighttest.api.comparisons": ("Compared", "Opposed", "Replayed", "Twin"),
    "flighttest.api.campaigns": ("Campaign", "Checks", "Demonstrated", "Imported", "Proved", "Runs"),
    "flighttest.api.comparing": ("against", "compare", "replay", "twin"),
    "flighttest.api.flights": ("fly", "run"),
    "flighttest.api.tool": (
        "demo", "doctor", "export", "fetch_log", "import_log", "prove", "report", "runs", "serve", "show", "sign",
    ),
    "flighttest.api.catalogue": ("Terms", "terms"),
    "flighttest.api.fitted_model": ("FittedModel",),
    "flighttest.api.verbs": (
        "accept", "check_validity", "diagnose", "fit", "models", "plan", "read", "read_model", "segment", "simulate",
        "validate",
    ),
    "flighttest.errors": (
        "FitError", "FlighttestError", "InputError", "LinkError", "ModelError", "PreflightError", "RecordingError", "ScriptError",
        "VehicleError",
    ),
    "flighttest.physics.core": ("Contribution", "Param", "Port", "Signals", "State", "Term"),
    "flighttest.physics.model": ("Model",),
    "flighttest.physics.simulated": ("Simulated",),
    "flighttest.pipeline.results": ("Progress", "Status"),
    "flighttest.recording.model": ("Recording",),
    "flighttest.sim.simulation": ("Simulation",),
    "flighttest.version": ("__version__",),
}  # fmt: skip
_HOME = {name: module for module, names in _WHERE.items() for name in names}


if not TYPE_CHECKING:  # a type checker sees every name above, and reports which is not there

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'flighttest' has no attribute {name!r}")
        found = getattr(import_module(_HOME[name]), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


class _Package(ModuleType):
    """`plan` and `diagnose` are verbs here and packages inside: the import system, which would put the package in the verb's place, must
    not. `from flighttest.plan import ...` works as ever."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in _HOME):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
