"""Reaching a vehicle: bytes, its clock, its parameters, ArduCopter's commands. Must not interpret, must not hide a timeout."""
