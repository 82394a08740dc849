"""Photographs of generated fly wings under a microscope: left or right, whole or torn, with a ruler."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from scenes.ruler import draw

FINE = 3
"""Pixels that are drawn for one of the photograph, along each side."""

SHAPE = (300, 500)
"""Height and width of a photograph without the ruler, pixels."""

PERIOD = 9.0
"""Pixels from one tick of the ruler to the next."""

LANDMARKS = np.array(
    [
        (55, 150),  # 1 hinge, veins at the margin
        (165, 95),
        (320, 82),
        (415, 115),
        (452, 158),  # 5 tip
        (400, 203),
        (280, 228),
        (150, 205),
        (175, 148),  # 9 crossings of veins
        (280, 135),
        (292, 170),
        (150, 165),
    ],
    float,
)
"""Landmarks of the mean right wing, (12, 2), pixels."""

_VEINS = ((0, 8, 9, 3), (0, 11, 10, 4), (11, 7), (9, 10), (10, 6), (8, 2), (9, 4))
_MARGIN = (0, 1, 2, 3, 4, 5, 6, 7)
_GROUND = np.array([214.0, 212.0, 205.0])
_MEMBRANE = np.array([176.0, 168.0, 150.0])
_VEIN = np.array([84.0, 66.0, 48.0])
_REACH = 110.0  # pixels over which landmarks move together
_TORN = 330.0  # x beyond which a torn wing is missing, pixels
_SHIFT = 4  # bits of the fraction of a coordinate, as OpenCV draws lines at 16ths of a pixel


@dataclass(frozen=True)
class Wing:
    """A photograph of a wing.

    Attributes
    ----------
    image : (h, w, 3) uint8
    landmarks : (12, 2) float64
        Pixels.
    is_there : (12,) bool
        Which landmarks have not been torn off.
    """

    image: np.ndarray
    landmarks: np.ndarray
    is_there: np.ndarray


def random_wing(rng: np.random.Generator, common: float = 4.0, own: float = 1.0) -> np.ndarray:
    """Draw the landmarks (12, 2) of a right wing, which move together with those near them, and each for itself."""
    return LANDMARKS + moved(rng, common, own)


def moved(
    rng: np.random.Generator, common: float, own: float, landmarks: np.ndarray = LANDMARKS, reach: float = _REACH
) -> np.ndarray:
    """Draw movements of landmarks (n, 2), (n, 2), by standard deviations in pixels.

    ``common`` is that of what they share with those within about ``reach`` pixels.
    """
    apart = np.linalg.norm(landmarks[:, None] - landmarks, axis=2)
    together = np.linalg.cholesky(np.exp(-np.square(apart / reach)) + 1e-6 * np.eye(len(landmarks)))
    return common * together @ rng.normal(size=landmarks.shape) + own * rng.normal(size=landmarks.shape)


def draw_wing(landmarks: np.ndarray, rng: np.random.Generator, *, is_left: bool = False, is_torn: bool = False) -> Wing:
    """Draw a photograph of a wing of these landmarks (12, 2) of a right one.

    A left wing is its mirror image. Of a torn one the tip is missing.
    """
    placed = landmarks @ _turn(rng.normal(0, 0.04)).T
    placed += np.array(SHAPE[::-1]) / 2 - placed.mean(axis=0) + rng.normal(0, 5, 2)
    picture = _painted(placed, rng)
    # The x of the tear in each row, a random walk; it is drawn of whole wings, too, whose noise is then the same.
    tear = _TORN + rng.normal(0, 6) + 5 * np.cumsum(rng.normal(size=SHAPE[0])) / 10
    is_there = np.ones(len(placed), bool)
    if is_torn:
        beyond = np.arange(SHAPE[1]) > tear[:, None]
        picture = np.where(beyond[..., None], _ground(), picture)
        rows = np.clip(placed[:, 1].astype(int), 0, SHAPE[0] - 1)
        is_there = placed[:, 0] < tear[rows]
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7) + rng.normal(0, 2.5, picture.shape)
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if is_left:
        image = image[:, ::-1]
        placed = placed * [-1.0, 1.0] + [SHAPE[1] - 1.0, 0.0]
    strip = draw("hierarchical", rng, size=PERIOD, shape=(80, SHAPE[1]), noise=2.0).image
    return Wing(np.concatenate([image, strip]), placed, is_there)


def _turn(angle: float) -> np.ndarray:
    """Return the matrix (2, 2) of a rotation by an angle in radians."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _ground() -> np.ndarray:
    """Ground of a photograph, (h, w, 3), darker towards the corners as under a microscope."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    away = np.square((x - SHAPE[1] / 2) / SHAPE[1]) + np.square((y - SHAPE[0] / 2) / SHAPE[0])
    return _GROUND * (1.0 - 0.25 * away[..., None])


def _painted(landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Paint a wing on its ground, (h, w, 3)."""
    ground = _ground()
    fine = cv2.resize(ground, None, fx=FINE, fy=FINE)
    blade = np.zeros(fine.shape[:2], np.float32)
    outline = _through(landmarks[[*_MARGIN, 0]], is_closed=True)
    cv2.fillPoly(blade, [_fixed(outline)], 1.0, cv2.LINE_8, _SHIFT)
    grain = cv2.GaussianBlur(rng.standard_normal(blade.shape, np.float32), (0, 0), 1.2) * 14  # hairs of the membrane
    shade = cv2.resize(rng.normal(0, 4, (4, 6)), blade.shape[::-1], interpolation=cv2.INTER_CUBIC)
    membrane = _MEMBRANE + (grain + shade)[..., None]
    fine = np.where(blade[..., None] > 0, membrane, fine)
    _line(fine, outline, 3.4)
    for vein in _VEINS:
        _line(fine, _through(landmarks[[*vein]]), 2.4)
    return cv2.resize(fine, SHAPE[::-1], interpolation=cv2.INTER_AREA)


def _through(points: np.ndarray, is_closed: bool = False) -> np.ndarray:
    """Points of a smooth line through points (n, 2)."""
    from scipy.interpolate import CubicSpline

    places = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    line = CubicSpline(places, points, bc_type="periodic" if is_closed else "natural")
    return line(np.linspace(0, places[-1], 200))


def _fixed(points: np.ndarray) -> np.ndarray:
    """Return points (n, 2) of the photograph in the fine picture, as OpenCV's whole numbers with ``_SHIFT``."""
    fine = (points + 0.5) * FINE - 0.5  # 0 is the centre of the first pixel
    return np.rint(fine * 2**_SHIFT).astype(np.int32)


def _line(fine: np.ndarray, points: np.ndarray, thickness: float) -> None:
    """Draw a vein through points (n, 2) of the photograph into the fine picture, as thick as so many of its pixels."""
    cv2.polylines(fine, [_fixed(points)], False, _VEIN.tolist(), round(thickness * FINE), cv2.LINE_8, _SHIFT)
