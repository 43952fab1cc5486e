"""Is a model still valid for its vehicle: the command `status`, its evidence, and what to fly again."""
