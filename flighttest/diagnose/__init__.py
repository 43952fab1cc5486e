"""Locate a mismatch, name the missing physics, model it and show the fit improve.

from flighttest.diagnose import diagnose
found = diagnose(segments)
found.verdict, found.findings, found.to_json()
"""

from flighttest.diagnose.model import Diagnosis, Finding, Located, TermVerdict, Verdict
from flighttest.diagnose.run import Support, diagnose

__all__ = ["Diagnosis", "Finding", "Located", "Support", "TermVerdict", "Verdict", "diagnose"]
