"""Loops over pixels of images: compiled (``fast``) and in plain NumPy (``reference``), with the same interface."""
