"""Maneuver scripts: model, loader, profiles. Must not contain time, vehicles or physics."""
