"""Loops over pixels of images: compiled, and the samples that define a fit in plain NumPy."""
