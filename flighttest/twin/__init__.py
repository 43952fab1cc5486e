"""An identified model as a vehicle: for the built-in simulator, for what-ifs on recorded commands, and as files for other simulators."""
