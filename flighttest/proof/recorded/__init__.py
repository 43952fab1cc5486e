"""Sealed trials on recordings that others made: effects added to real flights, and pairs of flights whose difference is known."""
