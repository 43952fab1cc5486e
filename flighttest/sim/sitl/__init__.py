"""A real ArduPilot firmware as a vehicle on this machine: found, started, asked, ended."""
