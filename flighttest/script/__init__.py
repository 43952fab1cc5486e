"""Maneuver scripts: model, loader, profiles. Must not know time, vehicles or physics."""
