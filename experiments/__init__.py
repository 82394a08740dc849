"""Experiments that measure liaam and write tables and figures."""
