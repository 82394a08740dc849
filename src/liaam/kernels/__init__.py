"""Loops over pixels of pictures: compiled (``fast``), and in plain NumPy (``reference``), under one contract."""
