"""Measures and formats that several experiments share."""

import numpy as np


def roc_area(right: np.ndarray, wrong: np.ndarray) -> float:
    """Area under the ROC curve of the quality for right and wrong fits. NaN if either is empty."""
    if not len(right) or not len(wrong):
        return np.nan
    return float(np.mean(right[:, None] > wrong) + 0.5 * np.mean(right[:, None] == wrong))


def or_dash(value: float | None, style: str = ".3f") -> str:
    """Format a number, or return a dash for None."""
    return "–" if value is None else format(value, style)


def percent(share: float | None, digits: int = 2) -> str:
    """Format a fraction in per cent, or a dash."""
    return "–" if share is None else f"{100 * share:.{digits}f}"
