"""Scripts before a flight: compiled, checked against a zone, and predicted with a prior model."""
