"""Recordings to a model: segments, fit, validation, comparison, export, report."""
