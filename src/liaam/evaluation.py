"""Measures of how well landmarks were found."""

import numpy as np


def point_error(shape: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of corresponding (n, 2) landmarks, pixels; missing (NaN) ones are left out."""
    return float(np.nanmean(np.linalg.norm(np.asarray(shape) - np.asarray(truth), axis=1)))


def inter_ocular_distance(shape: np.ndarray, left_eye: slice, right_eye: slice) -> float:
    """Distance between the centres of two eyes' landmarks (IOD), pixels."""
    return float(np.linalg.norm(shape[left_eye].mean(axis=0) - shape[right_eye].mean(axis=0)))


def nme(shape: np.ndarray, truth: np.ndarray, normaliser: float) -> float:
    """Normalised mean error: mean point-to-point distance as a share of a length such as the IOD."""
    return point_error(shape, truth) / normaliser


def cumulative_errors(errors: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Cumulative error distribution (CED): share of errors at or below each limit; NaN counts as failure."""
    errors = np.sort(np.where(np.isfinite(errors), errors, np.inf))
    return np.searchsorted(errors, limits, side="right") / max(len(errors), 1)
