"""Free flight by prediction errors: the translation and the attitude loops from flights that a pilot or another controller flew.

stretches: the flight without gaps; chunks: pieces of it integrated side by side; equations: what translation and loops leave over them;
priors: what is assumed of parameters; estimate: these, by least squares on whitened residuals; estimated: what comes of it; winds: a wind
of each flight; equation_fit: the estimates as a `Fit`.
"""

from flighttest.identify.free_flight.equation_fit import fit_by_prediction_errors, parts_by_prediction_errors
from flighttest.identify.free_flight.estimate import estimate
from flighttest.identify.free_flight.estimated import FreeFlight
from flighttest.identify.free_flight.stretches import stretches

__all__ = ["FreeFlight", "estimate", "fit_by_prediction_errors", "parts_by_prediction_errors", "stretches"]
