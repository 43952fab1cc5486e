"""Sealed cases, a blind diagnosis, a scoreboard. Must not let diagnose see the truth."""
