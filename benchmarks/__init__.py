"""Benchmarks of liaam: each module prints named metrics; ``python -m benchmarks`` runs them all."""
