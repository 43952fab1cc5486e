"""Is a model still valid for this vehicle: declared changes, statistical tests on new data, what must be flown again."""
