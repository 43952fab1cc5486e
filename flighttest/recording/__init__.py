"""A recording: what was measured in one flight, on the vehicle's clock, in SI units and NWU/FLU.

Must not resample, filter or guess.
"""

from flighttest.recording.model import Marker, Provenance, Recording, Series

__all__ = ["Marker", "Provenance", "Recording", "Series"]
