"""Overlays of rulers and scale bars on images, to check them by eye."""

import cv2
import numpy as np

from liaam.plotting.overlays import FRACTION_BITS, GREEN, ONE, RED, enlarged
from liaam.scale.bar import Bar
from liaam.scale.rulers import Ruler

_MOST_MARKS = 2000  # ticks that are drawn


def overlay_of_scale(image: np.ndarray, found: Ruler | Bar, label: str) -> np.ndarray:
    """Draw the line of the ticks of a ruler with a mark at each, or a scale bar with its ends, and a label.

    Parameters
    ----------
    image : (h, w, 3) or (h, w) array
    found : Ruler or Bar
    label : str
        Text beside it, such as the length of a pixel; letters that are not ASCII are drawn as ``?``.

    Returns
    -------
    (h', w', 3) uint8
        The image, enlarged if small.
    """
    picture, zoom = enlarged(image)
    first, last = (found.ends + 0.5) * zoom - 0.5
    n = min(found.n_ticks, _MOST_MARKS) if isinstance(found, Ruler) else 2
    axis = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
    arm = 8 * zoom * np.array([-axis[1], axis[0]])
    _line(picture, first, last, GREEN, zoom)
    for place in np.linspace(first, last, n):
        _line(picture, place - arm, place + arm, RED, 1)
    text = label.encode("ascii", "replace").decode()
    x, y = np.rint((first + last) / 2 + 3 * np.abs(arm).sum()).astype(int).tolist()
    cv2.putText(picture, text, (max(x - 150, 5), y), cv2.FONT_HERSHEY_SIMPLEX, 0.6, RED, 2, cv2.LINE_AA)
    return picture


def _line(picture: np.ndarray, start: np.ndarray, end: np.ndarray, colour: tuple[int, int, int], thick: int) -> None:
    begin, stop = (tuple(np.rint(point * ONE).astype(int).tolist()) for point in (start, end))
    cv2.line(picture, begin, stop, colour, thick, cv2.LINE_AA, FRACTION_BITS)
