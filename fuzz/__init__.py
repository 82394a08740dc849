"""Fuzzing in child processes with limits on time and memory: ``python -m fuzz``."""
