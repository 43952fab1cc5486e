"""What may be nothing though it predicts better: questions to a term that is needed by every other measure (`comparison`). They are asked
last, since they take fits and a covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from flighttest.diagnose.selection.admissible import unit_suffix
from flighttest.diagnose.selection.candidates import null_value, redundant
from flighttest.diagnose.selection.comparison import Fitted, level_of, rows_in_noise_of
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import FloatArray, Linearisation
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.physics.core import Contribution, Param, Signals, Term, Values


def may_be_nothing(term: Term, fitted: Fitted, without: Fitted, estimator: Estimator, candidates: int) -> str:
    """Why a term that is needed beside the rest of a fitted model may be nothing all the same, empty where it is something. without: the
    model fitted without it; candidates: terms of the search."""
    known = estimator.covariance(fitted.model, fitted.at, fitted.names)
    absent = may_be_absent(term, fitted, gain_over(without, term, fitted, estimator), known, estimator, candidates)
    return absent or undriven(term, fitted, known, estimator)


def gain_over(smaller: Fitted, term: Term, fitted: Fitted, estimator: Estimator) -> float:
    """Twice what a fitted model's log likelihood is above a smaller one's, in its noise and in the strata that contain information on a
    term: what a load takes of the velocity's own error, beside a recorded specific force, is no sign of it."""
    before, after = (_counted(rows_in_noise_of(fitted, one, estimator), term) for one in (smaller, fitted))
    return float(before @ before - after @ after)


def _counted(rows: Linearisation, term: Term) -> FloatArray:
    """Whitened residuals of the strata that contain information on a term."""
    aside = [k for k, name in enumerate(rows.strata) if name in redundant(term, rows.strata)]
    return np.asarray(rows.residual[~np.isin(rows.stratum, aside)])


def undriven(term: Term, fitted: Fitted, known: Covariance, estimator: Estimator) -> str:
    """Why a term whose states settle may be no part of the vehicle, empty where what moves the vehicle moves them, too.

    States that are free at the start of every response follow whatever wanders slowly in it, the error of an estimator for one. The same
    states as they swing where the vehicle hovers are as free, and what is flown does not move them: a term is the vehicle's where these are
    worse, by the likelihood ratio of `may_be_absent`, at the level of one question.
    """
    if not any(s.settles for s in term.states):
        return ""
    model = fitted.model.without_terms(term.id).with_terms(replace(term, build=_in_hover(term)))
    at = estimator.fit(model, estimator.moved(model, fitted.at).without_correlation, fitted.names)
    swinging = Fitted(model, fitted.names, at, estimator.linearise(model, at, fitted.names), fitted.inactive)
    if not swinging.finite:
        return ""
    own = [p.name for p in term.params if p.name in known.names]
    found, level = _p_value(known, own, gain_over(swinging, term, fitted, estimator)), level_of(1)
    if found < level:
        return ""
    return f"as it swings where nothing is flown it explains as much (p {found:.2g}, asked {level:.2g}): the flight does not move it"


def _in_hover(term: Term) -> Callable[[Signals, Values, Values], Contribution]:
    """What a term adds where its states are pulled by the thrust of hover alone."""
    return lambda s, p, x: term.build(replace(s, force=s.rotation[2, :].T * s.g), p, x)


def may_be_absent(
    term: Term, fitted: Fitted, gain: float, known: Covariance, estimator: Estimator, candidates: int
) -> str:
    """Why a term may be absent, empty where that is excluded at the level of a search (`level_of`): likelihood ratio, adjusted to the
    covariance that is printed beside the name (Rotnitzky & Jewell 1990). gain: twice the difference of the log likelihoods in one noise,
    fitted data; known: that covariance.

        F = gain / tr(C_model^-1 C),     p, dof degrees of freedom;

    C_model (p, p) of the term's parameters, as if the noise were all; C with what differs between cells, what all cells share, and how
    controls answered (`Estimator.covariance`); dof the fewest of their intervals. Of one coefficient F is the square of its value over its
    standard error. Of others that ratio falls again far from the null value, or where a coefficient and a delay are one direction (Hauck &
    Donner 1977), and means nothing for nonlinear parameters (Davies 1977); the likelihood ratio has neither fault.

    A term of several coefficients is there where one of them is: each is asked by itself as well, the others estimated anew, and all
    questions share the level (Bonferroni). Together they are only as sure as the least certain of them.

    On the frozen bench p is below 4e-6 for 160 of 161 hidden terms, and above 4e-4 for the one that was named and not hidden:
    cross-validation alone counts in a noise whose variance is 1 to 3000 times too small for what the equations err.
    """
    own = [p for p in term.params if p.name in known.names]
    if not own:
        return "nothing here determines any of its parameters"
    single = [p for p in own if p.kind == "amplitude" and p.alone]
    single = single if len(single) > 1 else []
    level = level_of(candidates) / (1 + len(single))
    found = _p_value(known, [p.name for p in own], gain)
    for p in single:
        if found < level:
            break
        found = min(found, _p_value(known, [p.name], _gain_of(p, fitted, estimator)))
    if found < level:
        return ""
    words = []
    for p in own:
        std, dof = known.of(np.eye(len(known.names))[known.names.index(p.name)])
        words.append(f"{p.name} is {fitted.at.values[p.name]:.2g} +- {interval_factor(dof) * std:.1g}{unit_suffix(p)}")
    return f"{', '.join(words)}, which may be nothing (p {found:.2g}, asked {level:.2g})"


def _p_value(known: Covariance, names: Sequence[str], gain: float) -> float:
    """Of the gain that some parameters make, were their effect nothing."""
    own = [known.names.index(n) for n in names]
    scale = np.sqrt(np.diag(known.model)[own])
    of_noise, whole = (c[np.ix_(own, own)] / np.outer(scale, scale) for c in (known.model, known.whole))
    inflation = float(np.trace(np.linalg.pinv(of_noise, hermitian=True) @ whole))
    dof = min(known.of(np.eye(len(known.names))[k])[1] for k in own)
    return fisher_beyond(max(gain, 0.0) / inflation, len(own), dof)


def _gain_of(coefficient: Param, fitted: Fitted, estimator: Estimator) -> float:
    """Twice the log likelihood that one coefficient is worth, in the noise of the model that has it."""
    names = tuple(n for n in fitted.names if n != coefficient.name)
    start = estimator.moved(fitted.model, fitted.at, {coefficient.name: null_value(coefficient)})
    return estimator.fit(fitted.model, start, names, noise=False).objective - fitted.at.objective
