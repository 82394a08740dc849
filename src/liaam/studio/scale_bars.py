"""Scale bars drawn into pictures that are saved."""

import math

import cv2
import numpy as np

SHARE = 0.25
"""Longest bar, as a fraction of the picture's width."""

STEPS = (1, 2, 5)
"""First digits of the lengths of bars."""

MARGIN = 0.03  # from the corner, and a third of it thick, as fractions of the shorter side


def bar_length(width: float) -> float:
    """Return the largest round length (1, 2 or 5 times a power of ten) of at most :data:`SHARE` of a width."""
    most = SHARE * width
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in STEPS if step * power <= most * (1 + 1e-9))


def with_scale_bar(image: np.ndarray, pixel: float, unit: str) -> np.ndarray:
    """Return an image (h, w, 3) uint8 with a scale bar in its lower right corner.

    Parameters
    ----------
    image : (h, w, 3) uint8
    pixel : float
        Length of a pixel, in the unit.
    unit : str
        Unit, written behind the length of the bar.
    """
    height, width = image.shape[:2]
    length = bar_length(width * pixel)
    along = length / pixel
    margin = max(2, round(MARGIN * min(height, width)))
    thick = max(1, margin // 3)
    right = width - 1 - margin
    left = right - round(along)
    bottom = height - 1 - margin
    drawn = np.ascontiguousarray(image).copy()
    for colour, edge in (((0, 0, 0), max(1, thick // 3)), ((255, 255, 255), 0)):
        corners = (left - edge, bottom - thick - edge), (right + edge, bottom + edge)
        cv2.rectangle(drawn, *corners, colour, cv2.FILLED)
    text = f"{length:g} {unit}".replace("µ", "u")  # the font has ASCII letters only
    size = 1.2 * margin / cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)[0][1]
    weight = max(1, round(2 * size))
    across = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, weight)[0][0]
    place = max(0, min(width - across - 1, (left + right - across) // 2)), bottom - thick - margin // 2
    cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3 * weight, cv2.LINE_AA)
    cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), weight, cv2.LINE_AA)
    return drawn
