"""`Bench`: one set of segments, many models. Fits them, and hands out whitened rows with everything local projected out.

A response's initial state and its constant disturbance are local unknowns with priors; projecting them out (together with their prior rows)
turns inner products of rows into those of a generalised least squares problem, so that candidates can be compared by plain linear algebra.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flighttest.diagnose.rows import (
    BLIND,
    DISTURBANCE,
    FIRST_DISTURBANCE,
    FIRST_NOISE,
    LEAST_DISTURBANCE,
    RESOLUTION,
    FloatArray,
    Nuisance,
    Rows,
    State,
    freedom_of,
    in_order,
    project,
)
from flighttest.estimation.problem import Noise, Part, Problem, prior_std
from flighttest.identify.selection import able
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

LOCAL_STEPS = 2
BLOCKS = ("roll_pitch", "yaw", "translation")


def part_of(block: str) -> str:
    """Which bench compares a block of the model: roll and pitch together, yaw rate alone unless a term couples it to them."""
    return block if block in ("translation", "yaw") else "roll_pitch"


@dataclass
class Bench:
    """Usable segments of one vehicle and the models tried on them. block: one of `BLOCKS`, which parts are compared."""

    segments: tuple[Segment, ...]
    block: str
    filters_hz: Mapping[str, float] | None = None
    _problems: dict[Model, Problem] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """What goes to another process: not what was compiled here."""
        return self.__dict__ | {"_problems": {}}

    def problem(self, model: Model) -> Problem:
        """The problem of one model, parts of this block only (none where nothing moves it); kept."""
        if model not in self._problems:
            fed = {b.name: able(self.segments, b) for b in model.blocks if part_of(b.name) == self.block}
            self._problems[model] = Problem.build(self.segments, model, filters=self.filters_hz, fed=fed)
        return self._problems[model]

    def start(self, model: Model, values: Mapping[str, float] | None = None) -> State:
        """Where a first fit begins."""
        problem = self.problem(model)
        noise = Noise(
            {c: FIRST_NOISE[c] for p in problem.parts for c in p.outputs},
            {d: FIRST_DISTURBANCE[d] for p in problem.parts for d in p.block.disturbances},
        )
        state = State(problem.full_values(model.start(values)), {}, noise, np.inf)
        return replace(state, objective=self.objective(model, state))

    def moved(self, model: Model, state: State, values: Mapping[str, float] | None = None) -> State:
        """The same state under another model (or other values): what both know is kept."""
        full = self.problem(model).full_values(model.start())
        full |= {k: v for k, v in state.values.items() if k in full} | dict(values or {})
        made = replace(state, values=full)
        return replace(made, objective=self.objective(model, made))

    def locals(self, problem: Problem, state: State) -> list[FloatArray]:
        """Locals as the problem wants them: per part (m, n_locals)."""
        found = []
        for part in problem.parts:
            at = part.start_local()
            index = [r.index for r in part.responses]
            for k, name in enumerate(part.locals):
                if name in state.local:
                    mine = state.local[name][index]
                    at[:, k] = np.where(np.isfinite(mine), mine, at[:, k])
            found.append(at)
        return found

    def objective(self, model: Model, state: State) -> float:
        """Whitened sum of squares at a state; infinite where the simulation is not finite."""
        problem = self.problem(model)
        local = self.locals(problem, state)
        total = 0.0
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # a step too far may blow up the simulation: then it is infinitely bad
            for part, made, at in zip(problem.parts, problem.evaluate(state.values, local), local, strict=True):
                std = np.array([state.noise.channel[c] for c in part.outputs])
                total += float(np.sum((made.residual / std) ** 2))
                total += float(np.sum(((at - part.start_local()) / prior_std(part, state.noise)) ** 2))
        return total if np.isfinite(total) else np.inf

    def fit(
        self,
        model: Model,
        state: State,
        names: Sequence[str],
        *,
        iterations: int = 8,
        reweigh: bool = True,
        tolerance: float = 1e-4,
    ) -> State:
        """Damped Gauss-Newton over `names` and all locals, inside the parameters' bounds; noise estimated on the way if `reweigh`.

        A Jacobian serves up to three steps, since residuals cost a tenth of it. A state from which the simulation is not finite is given
        back as it is: nothing shows the way from there.
        """
        if not np.isfinite(state.objective):
            return state
        damping = 1e-3
        for _ in range(iterations):
            before = state
            linear = self._linear(model, state, names)
            taken = 0
            for _ in range(10):
                step = self._step(model, state, names, linear, damping, 0 if taken else LOCAL_STEPS)
                gain, flat = state.objective - step.objective, tolerance * state.objective / 10
                if gain > 0:
                    state, damping, taken = step, max(damping / 10, 1e-7), taken + 1
                    if taken == 3 or gain < flat:
                        break
                    linear = self._residuals_anew(model, state, linear)
                elif taken or damping > 1e5 or -gain < flat:
                    break  # the Jacobian has grown old, or there is no lower place near
                else:
                    damping = max(10 * damping, 1e-3)
            old = state.objective
            if reweigh:
                state = self._reweighed(model, state)
            settled = before.objective - old < tolerance * old
            if settled and all(
                abs(np.log(state.noise.channel[c] / before.noise.channel[c])) < 0.02 for c in state.noise.channel
            ):
                break
        return state

    def rows(self, model: Model, state: State, names: Sequence[str]) -> Rows:
        """Whitened, projected rows at a state, with Jacobian columns for `names` (amplitudes at off included)."""
        problem = self.problem(model)
        linear = self._linear(model, state, names)
        channels = tuple(dict.fromkeys(c for part in problem.parts for c in part.outputs))
        out: list[tuple[FloatArray, ...]] = []
        nuisance: list[Nuisance] = []
        freedom = 0.0
        for part, piece, at in zip(problem.parts, linear, self.locals(problem, state), strict=True):
            m, n, n_y = part.y.shape
            n_l, n_f = piece.j_l.shape[2], part.n_free_states
            std = np.tile([state.noise.channel[c] for c in part.outputs], n)
            stacked = np.concatenate([piece.j_l, np.broadcast_to(_diagonal(piece.prior), (m, n_l, n_l))], axis=1)
            start = np.linalg.qr(stacked[..., :n_f])[0] if n_f else np.zeros((m, n * n_y + n_l, 0))
            unknown = Nuisance(np.linalg.qr(stacked)[0], start, std, part.mask.reshape(m, -1))
            r = project(unknown.basis, np.concatenate([piece.r, piece.r_prior], axis=1)[..., None])[..., 0]
            # Without the disturbance: what it explained goes back into the residual.
            given = piece.r + np.einsum("mij,mj->mi", piece.j_l[..., n_f:], at[:, n_f:])
            given = np.concatenate([given, piece.r_prior], axis=1)
            given[:, n * n_y + n_f :] = 0.0
            unit = np.concatenate([std, np.zeros(n_l)])
            sample = np.concatenate([np.repeat(np.arange(n), n_y), np.full(n_f, -1), np.full(n_l - n_f, DISTURBANCE)])
            code = np.concatenate([np.tile([channels.index(c) for c in part.outputs], n), np.full(n_l, -1)])
            index = np.array([response.index for response in part.responses])
            nuisance.append(unknown)
            freedom += freedom_of(part, stacked, piece.prior)
            columns, open_columns = unknown.of(piece.j_p * std[:, None])
            every = r.shape
            out.append(
                (
                    r,
                    columns,
                    open_columns,
                    project(start, given[..., None])[..., 0] * unit,
                    np.broadcast_to(np.concatenate([std, np.ones(n_l)]), every),
                    np.broadcast_to(index[:, None], every),
                    np.broadcast_to(sample, every),
                    np.broadcast_to(code, every),
                )
            )
        cat = [in_order(nuisance, [o[k] for o in out]) for k in range(8)]
        segment, sample, channel = (cat[k].astype(np.intp) for k in (5, 6, 7))
        return Rows(
            residual=cat[0], jacobian=cat[1], open_residual=cat[3], open_jacobian=cat[2], scale=cat[4], segment=segment,
            sample=sample, channel=channel, channels=channels, names=tuple(names), nuisance=tuple(nuisance),
            freedom=freedom,
        )  # fmt: skip

    def slopes(self, model: Model, state: State, names: Sequence[str]) -> list[FloatArray]:
        """Per part (m, samples times outputs, len(names)): sensitivities of what is measured, in the channels' units."""
        problem = self.problem(model)
        found = []
        for part, made in zip(
            problem.parts, problem.evaluate(state.values, self.locals(problem, state), list(names)), strict=True
        ):
            m, n, n_y = part.y.shape
            jac = made.jacobian.reshape(m, n * n_y, -1)
            j_p = np.zeros((m, n * n_y, len(names)))
            for k, name in enumerate(made.columns[: jac.shape[2] - len(part.locals)]):
                j_p[..., list(names).index(name)] = jac[..., k]
            found.append(j_p)
        return found

    def blind(self, model: Model, state: State) -> frozenset[str]:
        """Base parameters that change nothing in this data (the voltage exponent where no voltage varies): left where they are."""
        names = self.problem(model).names
        found = set()
        linear = self._linear(model, state, names)
        for k, name in enumerate(names):
            scale = model.param[name].scale
            power = sum(float(np.sum(piece.j_p[..., k] ** 2)) for piece in linear) * scale**2
            if model.param[name].kind == "base" and power < BLIND:
                found.add(name)
        return frozenset(found)

    def secant(self, model: Model, state: State, changed: Model, there: State) -> list[FloatArray]:
        """Per part (m, samples times outputs, 1): change of what is measured from one model to another, in the channels' units.

        Both models must have the same parts; the locals are `state`'s.
        """
        first, second = self.problem(model), self.problem(changed)
        return [
            (a.residual - b.residual).reshape(part.y.shape[0], -1, 1)
            for part, a, b in zip(
                first.parts,
                first.evaluate(state.values, self.locals(first, state)),
                second.evaluate(there.values, self.locals(second, there)),
                strict=True,
            )
        ]

    # Inside one fit.

    def _linear(self, model: Model, state: State, names: Sequence[str]) -> list[_Piece]:
        problem = self.problem(model)
        local = self.locals(problem, state)
        pieces = []
        for part, made, at in zip(
            problem.parts, problem.evaluate(state.values, local, list(names)), local, strict=True
        ):
            m, n, n_y = part.y.shape
            n_l = len(part.locals)
            std = np.array([state.noise.channel[c] for c in part.outputs])
            jac = (made.jacobian / std[:, None]).reshape(m, n * n_y, -1)
            n_p = jac.shape[2] - n_l
            j_p = np.zeros((m, n * n_y, len(names)))
            for k, name in enumerate(made.columns[:n_p]):
                j_p[..., list(names).index(name)] = jac[..., k]
            prior = 1.0 / prior_std(part, state.noise)
            pieces.append(
                _Piece(
                    r=(made.residual / std).reshape(m, -1),
                    j_p=j_p,
                    j_l=jac[..., n_p:],
                    r_prior=(part.start_local() - at) * prior,
                    prior=prior,
                )
            )
        return pieces

    def _residuals_anew(self, model: Model, state: State, linear: list[_Piece]) -> list[_Piece]:
        problem = self.problem(model)
        local = self.locals(problem, state)
        found = []
        for part, made, at, old in zip(
            problem.parts, problem.evaluate(state.values, local), local, linear, strict=True
        ):
            std = np.array([state.noise.channel[c] for c in part.outputs])
            m = part.y.shape[0]
            found.append(
                replace(
                    old,
                    r=(made.residual / std).reshape(m, -1),
                    r_prior=(part.start_local() - at) * old.prior,
                )
            )
        return found

    def _step(
        self, model: Model, state: State, names: Sequence[str], linear: list[_Piece], damping: float, local_steps: int
    ) -> State:
        problem = self.problem(model)
        n_p = len(names)
        h, g = np.zeros((n_p, n_p)), np.zeros(n_p)
        solved = []
        for piece in linear:
            h_ll = np.matmul(piece.j_l.transpose(0, 2, 1), piece.j_l) + _diagonal(piece.prior**2)
            g_l = np.einsum("mij,mi->mj", piece.j_l, piece.r) + piece.r_prior * piece.prior
            h_lp = np.matmul(piece.j_l.transpose(0, 2, 1), piece.j_p)
            both = np.linalg.solve(h_ll, np.concatenate([h_lp, g_l[..., None]], axis=2))
            by_p, by_r = both[..., :n_p], both[..., n_p]
            h += np.einsum("mij,mik->jk", piece.j_p, piece.j_p) - np.einsum("mlj,mlk->jk", h_lp, by_p)
            g += np.einsum("mij,mi->j", piece.j_p, piece.r) - np.einsum("mlj,ml->j", h_lp, by_r)
            solved.append((by_p, by_r))
        param = model.param
        at = np.array([state.values[n] for n in names])
        size = np.sqrt(np.maximum(np.diag(h), 1e-12)) if n_p else np.ones(0)
        free = np.ones(n_p, dtype=bool)
        step = np.zeros(n_p)
        # A parameter at its bound that wants to leave is held there and the rest solved again.
        for _ in range(1 + n_p):
            active = np.flatnonzero(free)
            if not active.size:
                break
            hs = h[np.ix_(active, active)] / np.outer(size[active], size[active])
            hs = hs + (damping + 1e-9) * np.eye(active.size)
            step[:] = 0.0
            step[active] = np.linalg.solve(hs, g[active] / size[active]) / size[active]
            low = np.array([param[n].lower for n in names])
            high = np.array([param[n].upper for n in names])
            out = free & (((at + step < low) & (at <= low)) | ((at + step > high) & (at >= high)))
            if not out.any():
                break
            free &= ~out
        new = np.clip(at + step, [param[n].lower for n in names], [param[n].upper for n in names]) if n_p else at
        step = new - at
        local = dict(state.local)
        for part, (by_p, by_r), old in zip(problem.parts, solved, self.locals(problem, state), strict=True):
            self._keep(local, part, old + by_r - np.einsum("mlj,j->ml", by_p, step))
        values = {**state.values, **dict(zip(names, new.tolist(), strict=True))}
        made = State(values, local, state.noise, np.inf)
        made = replace(made, objective=self.objective(model, made))
        for _ in range(local_steps):
            if made.objective < state.objective:
                break
            # Where parameters make up for each other (gain, voltage, heat), what is left of second order is mostly a constant
            # force per response: the locals take it up, and a long step along the valley is not refused for it.
            made = self._locals_anew(model, made, linear)
        return made

    def _locals_anew(self, model: Model, state: State, linear: list[_Piece]) -> State:
        """The same parameters with every response's locals moved to fit, by the Jacobian at hand."""
        problem = self.problem(model)
        local = dict(state.local)
        for part, piece, old in zip(
            problem.parts, self._residuals_anew(model, state, linear), self.locals(problem, state), strict=True
        ):
            h = np.matmul(piece.j_l.transpose(0, 2, 1), piece.j_l) + _diagonal(piece.prior**2)
            g = np.einsum("mij,mi->mj", piece.j_l, piece.r) + piece.r_prior * piece.prior
            self._keep(local, part, old + np.linalg.solve(h, g[..., None])[..., 0])
        made = replace(state, local=local)
        return replace(made, objective=self.objective(model, made))

    def _keep(self, local: dict[str, FloatArray], part: Part, moved: FloatArray) -> None:
        """Write one part's locals (m, n_locals) into columns over all segments."""
        index = [r.index for r in part.responses]
        for k, name in enumerate(part.locals):
            column = local.get(name, np.full(len(self.segments), np.nan)).copy()
            column[index] = moved[:, k]
            local[name] = column

    def _reweighed(self, model: Model, state: State) -> State:
        """Noise as the residuals show it; the disturbances' spread as the locals do."""
        problem = self.problem(model)
        local = self.locals(problem, state)
        squares: dict[str, list[float]] = {}
        spread: dict[str, list[float]] = {}
        for part, made, at in zip(problem.parts, problem.evaluate(state.values, local), local, strict=True):
            for k, c in enumerate(part.outputs):
                mask = part.mask[..., k]
                squares.setdefault(c, []).extend((np.sum(made.residual[..., k] ** 2), float(mask.sum())))
            for k, d in enumerate(part.block.disturbances):
                spread.setdefault(d, []).extend(at[:, part.n_free_states + k] ** 2)
        channel = {
            c: max(float(np.sqrt(sum(v[::2]) / max(sum(v[1::2]), 1.0))), RESOLUTION[c]) for c, v in squares.items()
        }
        disturbance = {
            d: max(float(np.sqrt(np.mean(v))), LEAST_DISTURBANCE * FIRST_DISTURBANCE[d]) for d, v in spread.items()
        }
        fresh = replace(state, noise=Noise(channel, disturbance))
        return replace(fresh, objective=self.objective(model, fresh))


@dataclass(frozen=True)
class _Piece:
    """One part, linearised: whitened residual (m, n), columns (m, n, p) and (m, n, l), residual and root precision of the priors (m, l)."""

    r: FloatArray
    j_p: FloatArray
    j_l: FloatArray
    r_prior: FloatArray
    prior: FloatArray


def _diagonal(values: FloatArray) -> FloatArray:
    """(m, l) to (m, l, l)."""
    return values[..., None] * np.eye(values.shape[-1])
