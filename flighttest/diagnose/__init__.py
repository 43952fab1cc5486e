"""Locate a mismatch, say what physics was left out, model it and show the fit improve."""
