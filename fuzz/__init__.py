"""Hostile inputs, thousands a second, in child processes with limits on time and memory: ``python -m fuzz``."""
