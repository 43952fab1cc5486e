"""The vehicle of a command: the built-in one, a real firmware on this machine, or one on a link."""
