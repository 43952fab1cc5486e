"""The autopilot's fence: how it is brought aboard, and what breaches it."""
