"""Heads from light-stage scans, rendered by rays under any light: a tool for making lamps and pictures of faces."""
