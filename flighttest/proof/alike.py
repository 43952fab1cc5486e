"""Effects that no diagnosis can be asked to tell apart in the proof's campaign: what a base refit leaves of them is alike."""

# Cosine above `oracle.CONFUSABLE`, as `python -m benchmarks.alike` finds it on quiet flights of one vehicle, every effect of usual size.
ALIKE: dict[str, tuple[str, ...]] = {}
