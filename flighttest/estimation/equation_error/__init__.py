"""Equation error with autoregressive noise: least squares on whitened equations of motion, in time linear in the samples.

An equation of motion, evaluated at what was measured, leaves a residual r_k = e_k of coloured noise: gusts, vibration, noise of the
sensors. With A(q) e_k = white (A autoregressive, of the residual itself), least squares on A(q) r_k is the prediction error method
(Ljung, System Identification, 2nd ed., sections 7.2 and 13.4): where what flies the vehicle answers disturbances, it stays
consistent as long as A describes the noise and commands act after a delay, since A(q) r_k is then what could not be predicted from the past
that the commands answer. Ordinary least squares, A = 1, is not.

autoregression: the noise of an equation; initial_states: of what swings; random_effects: these, and what an instrument is off by;
streams: equations over stretches of flight; least_squares: a step and its errors; lack_of_fit: what the equations get wrong.
"""

from flighttest.estimation.equation_error.autoregression import Autoregression, autoregression
from flighttest.estimation.equation_error.initial_states import InitialStates, PredictedStates
from flighttest.estimation.equation_error.lack_of_fit import lack_of_fit, second_order
from flighttest.estimation.equation_error.least_squares import (
    Whitened,
    block_covariances,
    block_rows,
    heterogeneity,
    step,
    whiten,
)
from flighttest.estimation.equation_error.random_effects import beside_random_effects, misfit_of, without_levels
from flighttest.estimation.equation_error.streams import Stream, log_scale, noises

__all__ = [
    "Autoregression",
    "InitialStates",
    "PredictedStates",
    "Stream",
    "Whitened",
    "autoregression",
    "beside_random_effects",
    "block_covariances",
    "block_rows",
    "heterogeneity",
    "lack_of_fit",
    "log_scale",
    "misfit_of",
    "noises",
    "second_order",
    "step",
    "whiten",
    "without_levels",
]
