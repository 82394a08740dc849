"""Overlays of rulers and scale bars on images, to check them by eye."""

import cv2
import numpy as np

from liaam.drawing import LANDMARK, LOST
from liaam.plotting.overlays import draw_lines, enlarged, with_texts
from liaam.scale.bar import Bar
from liaam.scale.rulers import Ruler

_MOST_MARKS = 2000  # ticks that are drawn
_ACROSS = np.linspace(-2.0, 2.0, 5)  # pixels across the line of the ticks that are averaged, which all ticks cross
_SEEN = 0.35  # least contrast of a tick at an end, of the median contrast
LETTERS = 36  # Larger side of a picture in units of the size of letters


def overlay_of_scale(image: np.ndarray, found: Ruler | Bar, label: str) -> np.ndarray:
    """Draw the line of the ticks of a ruler with a mark at each, or a scale bar with its ends, and a label.

    The search may count places beyond a ruler's ticks where the edges of its card happen to lie. They have no marks.

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
    places = (found.ends + 0.5) * zoom - 0.5
    if isinstance(found, Ruler):
        places = _seen(picture, np.linspace(places[0], places[1], found.n_ticks), zoom)
        places = places[:: -(-len(places) // _MOST_MARKS)]
    first, last = places[0], places[-1]
    axis = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
    arm = 8 * zoom * np.array([-axis[1], axis[0]])
    draw_lines(picture, [np.stack([first, last])], LANDMARK, zoom)
    draw_lines(picture, [np.stack([place - arm, place + arm]) for place in places], LOST, zoom)
    size = max(picture.shape[:2]) / LETTERS
    margin = np.minimum(size * np.array([len(label) / 3, 1.0]), np.array(picture.shape[1::-1]) / 2)
    place = np.clip((first + last) / 2 + 3 * np.abs(arm).sum(), margin, picture.shape[1::-1] - margin)
    return with_texts(picture, place[None], [label], size)


def _seen(picture: np.ndarray, places: np.ndarray, zoom: float) -> np.ndarray:
    """Return the places of ticks (n, 2), without those at the ends where the picture has none.

    A tick is darker, or brighter, than the ground half a period before and behind it. That of the edge of a card is
    beside one side only, and is not followed by another one.
    """
    step = (places[-1] - places[0]) / max(len(places) - 1, 1)
    across = zoom * np.array([-step[1], step[0]]) / max(float(np.hypot(*step)), 1e-9)
    rows = places[:, None] + _ACROSS[:, None] * across
    grey = picture.mean(axis=2, dtype=np.float32)
    at, before, behind = (_values(grey, rows + shift * step) for shift in (0.0, -0.5, 0.5))
    sign = np.sign(np.median(at - 0.5 * (before + behind)))
    contrast = np.minimum(sign * (at - before), sign * (at - behind))  # a single edge differs from one side only
    is_seen = contrast >= _SEEN * np.median(contrast)
    pairs = np.flatnonzero(is_seen[:-1] & is_seen[1:])
    return places[pairs[0] : pairs[-1] + 2] if len(pairs) else places


def _values(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the mean values (n,) of an image (h, w) at points (n, k, 2), linearly interpolated."""
    x, y = np.moveaxis(points.astype(np.float32), 2, 0)
    return cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).mean(axis=1)
