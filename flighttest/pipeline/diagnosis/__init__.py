"""Recordings and a model to a diagnosis, against a simulator if asked, and the script to fly next."""
