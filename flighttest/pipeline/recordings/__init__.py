"""Recordings as every command takes them: opened, deduplicated, with fingerprint, time budget and battery."""
