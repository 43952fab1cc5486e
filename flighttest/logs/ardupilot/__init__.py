"""ArduPilot dataflash logs: bytes to columns, columns to a recording."""
