"""Experiments: protocols that use the engine many times and write tables and figures."""
