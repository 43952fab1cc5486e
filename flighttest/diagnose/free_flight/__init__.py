"""Free flight by the prediction errors of each part of the model."""

from flighttest.diagnose.free_flight.answer import by_prediction_errors

__all__ = ["by_prediction_errors"]
