"""Importers: ArduPilot dataflash, telemetry logs, PX4 ulog, plain tables.

Must not fit, and must not repair silently: what was lost, chosen or derived is noted in the recording's provenance.
"""

from flighttest.logs.importing import import_log

__all__ = ["import_log"]
