"""`Model`: terms composed into CasADi functions, one declaration for fit, simulation and export.

    model = Model(("body", "linear_drag"))          # the paper's
    (model + "ground_effect").params                # what can be estimated
    print(model.equations())                        # symbols, units and references
    model.blocks                                    # what the fit integrates: roll, pitch, yaw, translation
    model.system                                    # everything chained: x_dot, y = system.function(x, u, p)

A model without attitude loops (`attitude_loops=False`) takes the attitude as input and has neither omega, zeta nor sigma_r.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.errors import ModelError
from flighttest.frames import G_M_S2
from flighttest.physics import body
from flighttest.physics.blocks import Block, BlockStore, attitude_blocks, measured_velocity_block, translation_block
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Param, Term
from flighttest.physics.equations import ModelEquations, citations_of, equations_of
from flighttest.physics.simulated import Simulated, run_open_loop
from flighttest.physics.system import AtRest, RestSolver, System, build_system

if TYPE_CHECKING:
    import pandas as pd

NOMINAL_VOLTAGE_V = 22.2
CELL_V, FULL_CELL_V = 3.7, 4.25  # of a lithium polymer cell: nominal, and the most that a charged one shows
LEAST_VOLTAGE_V = 2.0  # less is no reading of a battery
ROTOR_HEIGHT_M = 0.2
PAPER_TERMS = ("body", "linear_drag")


def pack_voltage(voltage_v: ArrayLike) -> float | None:
    """Nominal voltage, V, of the lithium pack that readings (n,), V, are of: 3.7 V times the fewest cells that reach the highest of them
    (99th percentile); None where there is no reading. Thrust is K T where the voltage is nominal: far from it K and alpha are one."""
    volts = np.asarray(voltage_v, dtype=float)
    volts = volts[np.isfinite(volts) & (volts > LEAST_VOLTAGE_V)]
    return CELL_V * math.ceil(float(np.quantile(volts, 0.99)) / FULL_CELL_V) if volts.size else None


@dataclass(frozen=True)
class Model:
    """Physics to be fitted, simulated or exported.

    terms: ids, 'body' first; ids not in the catalogue come with their `Term` in `extra`. channel_delays: each channel (attitude, yaw
    rate, thrust) has a delay of its own (T_d_attitude, T_d_yaw_rate, T_d_thrust; T_d is their mean), else one T_d. rotor_height_m: of the
    rotors above the landing gear's feet.
    Equal models compare equal; models derived from one another (`+`, `-`, `dataclasses.replace`) share what was compiled of their blocks.
    """

    terms: tuple[str, ...] = PAPER_TERMS
    nominal_voltage_v: float = NOMINAL_VOLTAGE_V
    g_m_s2: float = G_M_S2
    channel_delays: bool = True
    attitude_loops: bool = True
    extra: Mapping[str, Term] = field(default_factory=dict, hash=False)
    rotor_height_m: float = ROTOR_HEIGHT_M
    store: BlockStore = field(default_factory=BlockStore, compare=False, repr=False)

    def __post_init__(self) -> None:
        ids = tuple(dict.fromkeys(("body", *self.terms)))
        object.__setattr__(self, "terms", ids)
        known = {**catalogue(), **self.extra}
        for i in ids:
            if i != "body" and i not in known:
                near = get_close_matches(i, [*known, "body"], 1)
                raise ModelError(
                    f"no term is called {i!r}", f"did you mean {near[0]!r}?" if near else "see `flighttest terms`"
                )
        names = [p.name for p in self.params] + [s.name for t in self.built_terms for s in t.states]
        twice = {n for n in names if names.count(n) > 1}
        if twice:
            raise ModelError(
                f"terms {', '.join(ids)} share the names {', '.join(sorted(twice))}", "rename them in one term"
            )

    def __repr__(self) -> str:
        return f"<Model {' + '.join(self.terms)}: {len(self.params)} parameters>"

    @cached_property
    def built_terms(self) -> tuple[Term, ...]:
        """The terms besides the body; without attitude loops, those of the attitude block are left out."""
        known = {**catalogue(), **self.extra}
        found = tuple(known[i] for i in self.terms if i != "body")
        return found if self.attitude_loops else tuple(t for t in found if block_of(t) != "attitude")

    @cached_property
    def params(self) -> tuple[Param, ...]:
        """Every parameter, in the order of every vector and covariance: attitude, thrust, terms, delays."""
        attitude = body.ATTITUDE_PARAMS if self.attitude_loops else ()
        if not self.channel_delays:
            delays: tuple[Param, ...] = (body.DELAY,)
        else:
            delays = body.CHANNEL_DELAYS if self.attitude_loops else body.CHANNEL_DELAYS[-1:]
        return (*attitude, *body.THRUST_PARAMS, *(p for t in self.built_terms for p in t.params), *delays)

    @cached_property
    def param(self) -> dict[str, Param]:
        """Parameters by name."""
        return {p.name: p for p in self.params}

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in order."""
        return tuple(p.name for p in self.params)

    def term_of(self, name: str) -> str:
        """Id of the term that owns a parameter ('body' for the base's)."""
        return next((t.id for t in self.built_terms if any(p.name == name for p in t.params)), "body")

    def start(self, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """Start values: nominal for the body and the paper's drag, off for amplitudes, nominal for shapes; `values` override.

        Values for T_d also set channel delays that are not given themselves, and the other way round.
        """
        paper = {p.name for t in self.built_terms if t.id == "linear_drag" for p in t.params}
        found = {
            p.name: p.off if p.kind == "amplitude" and p.off is not None and p.name not in paper else p.nominal
            for p in self.params
        }
        given = dict(values or {})
        channels = [given[n] for n in body.DELAY_PARAM.values() if n in given]
        if "T_d" not in given and channels:
            given["T_d"] = sum(channels) / len(channels)
        for name in body.DELAY_PARAM.values():
            if name not in given and "T_d" in given:
                given[name] = given["T_d"]
        found.update({k: float(v) for k, v in given.items() if k in found})
        return found

    def hover_throttle(self, values: Mapping[str, float], voltage_v: ArrayLike) -> NDArray[np.float64]:
        """Throttle that holds height at these voltages, V, of their shape: with what hangs below and whatever else pulls in still air."""
        return self.hover(values, voltage_v).throttle.reshape(np.shape(voltage_v))

    def hover_throttle_of_body(self, values: Mapping[str, float], voltage_v: ArrayLike) -> NDArray[np.float64]:
        """Throttle that carries the weight of the body alone at these voltages, V, of their shape: g / (K (U / U_n)^alpha)."""
        ratio = np.asarray(voltage_v, dtype=float) / self.nominal_voltage_v
        return np.asarray(self.g_m_s2 / (values["K"] * ratio ** values["alpha"]))

    def hover(self, values: Mapping[str, float], voltage_v: ArrayLike) -> AtRest:
        """Throttle and states at rest in the air, level, at n voltages, V. values: all parameters by name."""
        volts, places = np.unique(np.asarray(voltage_v, dtype=float).ravel(), return_inverse=True)
        alone = self.hover_throttle_of_body(values, volts)
        p = np.array([values[name] for name in self.system.params])
        found = self._rest.at(p, volts, alone, self.g_m_s2)
        return AtRest(found.throttle[places], found.states[:, places])

    @cached_property
    def _rest(self) -> RestSolver:
        return RestSolver(self.system)

    def with_terms(self, *terms: str | Term) -> Model:
        """This model with further terms (ids, or Terms that need not be in the catalogue)."""
        extra = dict(self.extra) | {t.id: t for t in terms if isinstance(t, Term)}
        ids = tuple(t.id if isinstance(t, Term) else t for t in terms)
        return replace(self, terms=(*self.terms, *ids), extra=extra)

    def without_terms(self, *ids: str) -> Model:
        """This model without some of its terms."""
        return replace(self, terms=tuple(t for t in self.terms if t not in ids))

    def __add__(self, term: str | Term) -> Model:
        """This model with one more term; ModelError where there is none of this id, or where names clash."""
        return self.with_terms(term) if isinstance(term, str | Term) else NotImplemented

    def __sub__(self, term: str | Term) -> Model:
        """This model without one of its terms; ModelError where it has none of this id."""
        name = term.id if isinstance(term, Term) else term
        if name not in self.terms or name == "body":
            raise ModelError(f"the model has no term {name!r} to leave out", f"its terms are {', '.join(self.terms)}")
        return self.without_terms(name)

    def equations(self, values: Mapping[str, float] | None = None) -> ModelEquations:
        """The model written out: equations, symbols, units, references; `print` it. values: parameters by name, to show beside them."""
        return equations_of(self.built_terms, self.params, self.attitude_loops, values)

    def citations(self) -> tuple[str, ...]:
        """The literature behind the model, each work once."""
        return citations_of(self.built_terms)

    def simulate(
        self,
        inputs: Mapping[str, ArrayLike] | pd.DataFrame,
        values: Mapping[str, float] | None = None,
        start: Mapping[str, float] | None = None,
    ) -> Simulated:
        """Run the model open loop.

        inputs: t_s (n,) s and any of `system.inputs` by channel name, (n,) each: references are held from sample to sample and act one
        delay later, voltage_v and what has no delay is interpolated; a missing throttle holds height, a missing voltage is the nominal
        one, other missing inputs are 0. values: parameters by name, `start()` for the rest. start: states by name at t_s[0], 0 for the rest
        (thrust: hover). InputError names what cannot be used.
        """
        return run_open_loop(self, inputs, values, start)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The independent parts the fit integrates: attitude axes (joined where a term couples them) and translation.

        The translation takes the measured attitude, rates, height and voltage as known signals. Models that agree in the terms of a block
        share it, with all that was compiled of it.
        """
        constants = self.constants
        known = tuple(constants.items())
        loops: tuple[Block, ...] = ()
        if self.attitude_loops:
            terms, params = self._only("attitude")
            loops = self.store.of(("attitude", terms, params, known), lambda: attitude_blocks(terms, params, constants))
        own, names = self._only("translation")
        return *loops, *self.store.of(
            ("translation", own, names, known), lambda: (translation_block(own, names, constants),)
        )

    @cached_property
    def measured_velocity(self) -> Block:
        """The translation at the measured velocity: specific force and world acceleration, nothing integrated but the lags."""
        return measured_velocity_block(*self._only("translation"), self.constants)

    def _only(self, block: str) -> tuple[tuple[Term, ...], tuple[Param, ...]]:
        """Terms that act in a block, and the parameters without those of other terms."""
        own = tuple(t for t in self.built_terms if block_of(t) in (block, "delay"))
        others = {p.name for t in self.built_terms if t not in own for p in t.params}
        return own, tuple(p for p in self.params if p.name not in others)

    @cached_property
    def system(self) -> System:
        """Everything chained, without the delays (inputs are the delayed ones): for simulation, validation and export."""
        return build_system(self.built_terms, self.params, self.constants, self.attitude_loops)

    @property
    def constants(self) -> dict[str, float]:
        """As in model.yaml: g m/s^2, nominal_voltage_v, rotor_height_m."""
        return {"g": self.g_m_s2, "nominal_voltage_v": self.nominal_voltage_v, "rotor_height_m": self.rotor_height_m}
