"""Free flight by equation error: the translation at the measured attitude and velocity, an hour of flight in seconds.

    flown = stretches(segments)                      # windows of free flight joined
    found = estimate(flown, Model())                 # K, alpha, drag, lag and delay with errors
    found = estimate(flown, Model() + "steady_wind", per_flight=("w_north", "w_west"))   # one wind per flight, drag shared

Where an accelerometer was recorded, its three axes are the equations; else the increments of velocity, world axes, against the mean of the
modelled acceleration at both ends. Both are compared over whole stretches, without initial states and without integration of the velocity,
so that a gust is noise of its own moment and of no later one. The noise is autoregressive and estimated (`estimation.equation_error`),
which keeps estimates consistent where a pilot or a position loop answers gusts, as long as the model is driven by the past alone: by
commands, which act after a delay, and by the velocity predicted from the samples before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError
from flighttest.estimation.equation_error import Autoregression, Stream, block_rows, heterogeneity, noises, step, whiten
from flighttest.identify.dead_time import thrust_gain
from flighttest.identify.motion_equations import Equations, chunk, stretches
from flighttest.physics.core import Param
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

__all__ = ["FreeFlight", "estimate", "stretches"]

FloatArray = NDArray[np.float64]

ITERATIONS = 25
CONVERGED = 0.02  # of a standard error
PRIOR_SIZES = 3.0  # as of the candidates of a diagnosis: prior standard deviation in usual sizes
ALPHA_STD = 0.5  # motors on a battery have 1 to 2
STARTS: tuple[dict[str, float], ...] = tuple(
    {"sigma_t": sigma, "T_d_thrust": delay, "T_d": delay} for sigma in (15.0, 6.0) for delay in (0.02, 0.08, 0.2)
)
START_S, PIECES = 60.0, 4  # of flight that local optima are looked for in
FIRST_ITERATIONS = 6
LEAST_SHARE = 1e-3  # of a step, below which it is given up
LEANS = 0.7  # of its prior's standard deviation: a parameter with a larger error was not determined by the flight


@dataclass(frozen=True)
class FreeFlight:
    """What free flight shows of the translation.

    values: parameters by name, those of one flight as `name@flight`; std: standard errors of the estimated ones, robust over 1 to 5 s;
    covariance (q, q) in the order of `names`; noise: per channel the spectrum of what is left; rms: per channel of the residual, m/s^2;
    seconds: of flight used; priors: names whose error is mostly the prior's; spread: by name of a shared parameter, the standard deviation
    by which flights differ in it beyond their errors (in `covariance` already); inflation: median ratio of the robust variances to those of
    the information alone, at least 1, by which differences of log likelihoods are to be divided (Burnham and Anderson 2002, section 2.5);
    blocks: of the robust covariance.
    """

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: FloatArray
    noise: Mapping[str, Autoregression]
    rms: Mapping[str, float]
    seconds: float
    flights: tuple[str, ...]
    iterations: int
    converged: bool
    log_likelihood: float
    priors: frozenset[str] = frozenset()
    spread: Mapping[str, float] = field(default_factory=dict)
    inflation: float = 1.0
    blocks: int = 0

    @property
    def std(self) -> dict[str, float]:
        """Standard error of each estimated parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def start_of(flown: Sequence[Segment], model: Model) -> dict[str, float]:
    """Start values: K from the ratio of force to throttle, drag nominal, lag and delay of usual motors."""
    values = model.start()
    gain = thrust_gain(flown, model.nominal_voltage_v)
    if gain is not None and "K" in model.param:
        values["K"] = float(np.clip(gain, model.param["K"].lower * 1.01, model.param["K"].upper * 0.99))
    return values | {n: v for n, v in STARTS[0].items() if n in values}


def prior_of(p: Param) -> tuple[float, float]:
    """Mean and standard deviation of a parameter's prior where none is given: usual sizes of linear coefficients, else none."""
    if p.name == "alpha":
        return p.nominal, ALPHA_STD
    if p.kind == "amplitude" and p.off is not None and p.name not in ("d_x", "d_y", "d_z"):
        return p.off, PRIOR_SIZES * max(abs(p.nominal - p.off), 1e-12)
    return p.nominal, np.inf


def estimate(
    flown: Sequence[Segment],
    model: Model,
    *,
    start: Mapping[str, float] | None = None,
    free: Sequence[str] | None = None,
    per_flight: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> FreeFlight:
    """Gauss-Newton on the whitened equations, noise and parameters in turn.

    flown: of `stretches`; free: names that are estimated (default: all that act); per_flight: names with a value per flight; priors: name,
    or `name@flight`, to (mean, standard deviation). FitError where there is nothing to estimate from.
    """
    if not flown:
        raise FitError(
            "no free flight with attitude, velocity and throttle of 4 s or more",
            "see `flighttest segment` for what was recorded",
        )
    values = {**start_of(flown, model), **dict(start or {})}
    asked = _Asked(model, free, tuple(per_flight), dict(priors or {}))
    if not set(start or {}) & {"sigma_t", "T_d_thrust", "T_d"}:
        # Lag and delay have local optima: each start is followed for a while on a part of the flight.
        few = _some(flown)
        tried = [_Descent(Equations(model, few), asked, values | _known(one, values)) for one in STARTS]
        for one in tried:
            one.run(FIRST_ITERATIONS)
        best = max(tried, key=lambda d: d.log_likelihood)
        values |= {n: best.values[n] for n in ("sigma_t", "T_d_thrust", "T_d", "K") if n in best.values}
    descent = _Descent(Equations(model, flown), asked, values)
    descent.run(ITERATIONS)
    return descent.found()


def _known(some: Mapping[str, float], values: Mapping[str, float]) -> dict[str, float]:
    return {n: v for n, v in some.items() if n in values}


def _some(flown: Sequence[Segment]) -> list[Segment]:
    """Stretches of at most `START_S` in all, the most from where the throttle moves most."""
    pieces: list[tuple[float, int, Segment]] = []
    for s in flown:
        period = float(np.median(np.diff(s.t_s)))
        n = max(round(START_S / PIECES / period), 10)
        for a in range(0, max(s.t_s.size - n, 1), n):
            piece = chunk(s, {}, a, min(a + n, s.t_s.size))
            pieces.append((float(np.std(piece.u["throttle"][1])), len(pieces), piece))
    return [p for _, _, p in sorted(pieces, reverse=True)[:PIECES]]


@dataclass(frozen=True)
class _Asked:
    model: Model
    free: Sequence[str] | None
    per_flight: tuple[str, ...]
    priors: Mapping[str, tuple[float, float]]

    def prior(self, column: str) -> tuple[float, float]:
        name = column.split("@")[0]
        return self.priors.get(column) or self.priors.get(name) or prior_of(self.model.param[name])


class _Descent:
    """Where an estimate stands: values, streams at them, noise of these."""

    def __init__(self, equations: Equations, asked: _Asked, values: Mapping[str, float]) -> None:
        self.equations, self.asked = equations, asked
        self.names = [n for n in equations.params if asked.free is None or n in asked.free]
        self.values = dict(values)
        own = [n for n in asked.per_flight if n in self.names]
        self.values |= {f"{n}@{f}": values.get(f"{n}@{f}", values[n]) for f in equations.flights for n in own}
        self.streams, self.columns = self._at(self.values)
        if not self.streams:
            raise FitError("no stretch of free flight without gaps is long enough", "see `flighttest segment`")
        param = asked.model.param
        self.params = [param[c.split("@")[0]] for c in self.columns]
        self.mean, self.std = (np.array([asked.prior(c)[k] for c in self.columns]) for k in (0, 1))
        period = float(np.median(np.concatenate([np.diff(s.t_s) for s in equations.flown])))
        self.rows = block_rows(sum(float(np.ptp(s.t_s)) for s in equations.flown), period)
        self.noise = noises(self.streams)
        self.iterations, self.converged = 0, False

    def _at(self, values: Mapping[str, float]) -> tuple[list[Stream], tuple[str, ...]]:
        with np.errstate(all="ignore"):
            return self.equations.streams(values, self.names, self.asked.per_flight)

    @property
    def point(self) -> FloatArray:
        return np.array([self.values[c] for c in self.columns])

    def cost(self, streams: Sequence[Stream], at: FloatArray) -> float:
        """Whitened sum of squares with the prior's; not a number where the model is not."""
        total = sum(float(np.sum(self.noise[s.channel].whitened(s.residual) ** 2)) for s in streams)
        if len(streams) < len(self.streams):
            return np.inf  # a residual that is not finite is no stretch: it must not pay to lose one
        return total + float(np.sum(((at - self.mean) / self.std) ** 2))

    @property
    def log_likelihood(self) -> float:
        """Of the innovations, with the noise of this point."""
        scale = sum(
            (s.residual.size - self.noise[s.channel].order) * np.log(self.noise[s.channel].std) for s in self.streams
        )
        return float(-scale - 0.5 * self.cost(self.streams, self.point))

    def run(self, iterations: int) -> None:
        """Steps until none moves a parameter by a fiftieth of its standard error, or none leads downhill."""
        for _ in range(iterations):
            self.iterations += 1
            at = self.point
            made = step(whiten(self.streams, self.noise, self.rows), self.mean - at, self.std)
            before, share = self.cost(self.streams, at), 1.0
            limit = np.array([3.0 * max(p.scale, 1e-9) for p in self.params])
            delta = np.where(np.isfinite(made.delta), made.delta, 0.0)
            delta = delta * min(1.0, float(np.min(limit / np.maximum(np.abs(delta), 1e-300), initial=np.inf)))
            while share > LEAST_SHARE:
                moved = np.clip(at + share * delta, [p.lower for p in self.params], [p.upper for p in self.params])
                values = self.values | dict(zip(self.columns, moved.tolist(), strict=True))
                streams, _ = self._at(values)
                if self.cost(streams, moved) <= before * (1 + 1e-9):
                    break
                share *= 0.5
            else:
                self.converged = True
                return
            error = np.sqrt(np.maximum(np.diag(made.covariance), 1e-300))
            self.values, self.streams, self.noise = values, streams, noises(streams)
            if np.all(np.abs(moved - at) < CONVERGED * error):
                self.converged = True
                return

    def found(self) -> FreeFlight:
        """The answer at this point, with errors that hold what flights differ by."""
        rows = whiten(self.streams, self.noise, self.rows)
        made = step(rows, self.mean - self.point, self.std)
        own = np.array(["@" in c for c in self.columns])
        spread, extra = heterogeneity(rows, own, self.std)
        covariance = made.robust + extra
        error = np.sqrt(np.diag(covariance))
        leaning = frozenset(
            c for c, e, s in zip(self.columns, error, self.std, strict=True) if np.isfinite(s) and e > LEANS * s
        )
        channels = dict.fromkeys(s.channel for s in self.streams)
        every = {c: np.concatenate([s.residual for s in self.streams if s.channel == c]) for c in channels}
        return FreeFlight(
            self.asked.model, self.columns, self.values, covariance, self.noise,
            {c: float(np.sqrt(np.mean(r**2))) for c, r in every.items()},
            float(sum(s.t_s[-1] - s.t_s[0] for s in self.equations.flown)), self.equations.flights, self.iterations, self.converged,
            self.log_likelihood, leaning, {c: float(v) for c, v in zip(self.columns, spread, strict=True) if v > 0.0},
            _inflation(made.covariance, made.robust), int(rows.block.max(initial=-1)) + 1,
        )  # fmt: skip


def _inflation(model: FloatArray, robust: FloatArray) -> float:
    known = np.isfinite(np.diag(robust)) & np.isfinite(np.diag(model)) & (np.diag(model) > 0.0)
    ratio = np.diag(robust)[known] / np.diag(model)[known]
    return max(float(np.median(ratio)), 1.0) if ratio.size else 1.0
