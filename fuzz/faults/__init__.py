"""Kills, -9, at random moments: nothing is lost, nothing is half written, and what is resumed gives the same."""
