"""Diagnosis of free flight alone: translation by equation error, attitude loops by output error on part of the windows."""

from flighttest.diagnose.free_flight.assembly import diagnose_free_flight, is_free_flight

__all__ = ["diagnose_free_flight", "is_free_flight"]
