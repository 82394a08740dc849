"""Overlays of rulers and scale bars on images, to check them by eye."""

import numpy as np

from liaam.drawing import LANDMARK, LOST
from liaam.plotting.overlays import draw_lines, enlarged, with_texts
from liaam.scale.bar import Bar
from liaam.scale.rulers import Ruler

_MOST_MARKS = 2000  # ticks that are drawn
LETTERS = 36  # Larger side of a picture in units of the size of letters


def overlay_of_scale(image: np.ndarray, found: Ruler | Bar, label: str) -> np.ndarray:
    """Draw the line of the ticks of a ruler with a mark at each, or a scale bar with its ends, and a label.

    Parameters
    ----------
    image : (h, w, 3) or (h, w) array
    found : Ruler or Bar
    label : str
        Text beside it, such as the length of a pixel.

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
    draw_lines(picture, [np.stack([first, last])], LANDMARK, zoom)
    draw_lines(picture, [np.stack([place - arm, place + arm]) for place in np.linspace(first, last, n)], LOST, zoom)
    size = max(picture.shape[:2]) / LETTERS
    margin = np.minimum(size * np.array([len(label) / 3, 1.0]), np.array(picture.shape[1::-1]) / 2)
    place = np.clip((first + last) / 2 + 3 * np.abs(arm).sum(), margin, picture.shape[1::-1] - margin)
    return with_texts(picture, place[None], [label], size)
