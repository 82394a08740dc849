"""Fitting many pictures at once, on NumPy, PyTorch or JAX: the same objective, the same solver, a batch dimension."""

from liaam.fitting.batched.fitter import BatchFitter, BatchResult, fit_many

__all__ = ["BatchFitter", "BatchResult", "fit_many"]
