"""Diagnosis of free flight alone, by the prediction errors of each part of the model."""

from flighttest.diagnose.free_flight.assembly import diagnose_free_flight

__all__ = ["diagnose_free_flight"]
