"""A thin ArduCopter around any plant: modes, commands, guided targets, safety, telemetry."""
