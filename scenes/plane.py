"""Flat scenes: a colour chart or a poster under uneven Planckian light with cast shadows.

Each pixel receives one Planckian spectrum with its own temperature and strength. With line sensors the paper's theory
holds exactly, also in shadows.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from scenes.camera import Camera, matrices_at
from scenes.light import Radiator, check_kelvin

CHART_ROWS = 4
CHART_COLUMNS = 6
BLACK = 0.03
"""Reflectance of the chart's background."""

GREYS = (0.88, 0.58, 0.36, 0.19, 0.09, 0.035)
"""Reflectances of the chart's last row, similar to those of commercial charts."""

CHART_COLOURS = (
    (0.17, 0.08, 0.06), (0.55, 0.31, 0.23), (0.12, 0.20, 0.34),
    (0.11, 0.15, 0.05), (0.24, 0.22, 0.44), (0.13, 0.52, 0.41),
    (0.70, 0.21, 0.03), (0.07, 0.10, 0.38), (0.55, 0.09, 0.12),
    (0.11, 0.04, 0.14), (0.35, 0.50, 0.05), (0.77, 0.37, 0.03),
    (0.03, 0.05, 0.30), (0.06, 0.30, 0.06), (0.45, 0.03, 0.04),
    (0.84, 0.57, 0.02), (0.51, 0.09, 0.31), (0.03, 0.24, 0.37),
)  # fmt: skip
"""Coefficients of the first three rows' reflectances in red, green and blue parts, approximately those of a chart."""


@dataclass(frozen=True)
class PlaneLight:
    """Light on a flat scene.

    Attributes
    ----------
    strength : (h, w) float64
        Irradiance.
    mired : (h, w) float64
        Reciprocal colour temperature, 1e6 / kelvin.
    """

    strength: np.ndarray
    mired: np.ndarray

    __repr__ = short_repr


def colour_chart(patch: int = 30, gap: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Make a chart of 24 patches on a dark background.

    Parameters
    ----------
    patch, gap : int
        Sizes, pixels.

    Returns
    -------
    reflectance : (h, w, 3) float64
        Coefficients of the reflectance in its red, green and blue parts (see ``Camera.matrix``).
    boxes : (24, 4) int
        x0, y0, x1, y1 of each patch; x1 and y1 are excluded.
    """
    colours = np.array([*CHART_COLOURS, *[(grey,) * 3 for grey in GREYS]])
    step = patch + gap
    reflectance = np.full((CHART_ROWS * step + gap, CHART_COLUMNS * step + gap, 3), BLACK)
    corners = [(gap + step * column, gap + step * row) for row in range(CHART_ROWS) for column in range(CHART_COLUMNS)]
    boxes = np.array([(x, y, x + patch, y + patch) for x, y in corners])
    for (x0, y0, x1, y1), colour in zip(boxes, colours, strict=True):
        reflectance[y0:y1, x0:x1] = colour
    return reflectance, boxes


@lru_cache(maxsize=16)  # pictures of one sheet in several lights
def poster(size: tuple[int, int] = (240, 320), seed: int = 0) -> np.ndarray:
    """Make a printed sheet of coloured discs and stripes of many sizes, with fine grain.

    Parameters
    ----------
    size : (int, int)
        Height and width, pixels.
    seed : int

    Returns
    -------
    (h, w, 3) float64, which may not be written to
        Coefficients of the reflectance in its red, green and blue parts.
    """
    rng = np.random.default_rng([seed, 0x905])  # a stream of its own, apart from those of lights and cameras
    height, width = _checked(size)
    y, x = np.mgrid[:height, :width].astype(float)
    sheet = np.broadcast_to(rng.uniform(0.25, 0.7, 3), (height, width, 3)).copy()
    for i in range(36):  # from large to small, so that the small ones are on top
        colour = np.exp(rng.uniform(np.log(0.06), np.log(0.85), 3))
        radius = 0.35 * min(height, width) * 0.92**i
        from_x = x - rng.uniform(0, width)
        from_y = y - rng.uniform(0, height)
        is_stripe = i % 3 == 2
        if is_stripe:
            angle = rng.uniform(0, np.pi)
            across = np.abs(np.cos(angle) * from_x + np.sin(angle) * from_y) - 0.25 * radius
            along = np.abs(np.sin(angle) * from_x - np.cos(angle) * from_y) - 2.0 * radius
            outside = np.maximum(across, along)  # distance from the border, negative inside
        else:
            outside = np.hypot(from_x, from_y * rng.uniform(0.6, 1.6)) - radius
        cover = np.clip(0.5 - outside / 1.5, 0, 1)[..., None]  # an edge a pixel or two wide
        sheet = sheet * (1 - cover) + colour * cover
    noise = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 2.0)
    grain = np.exp(0.06 * noise / noise.std())[..., None]
    sheet = np.clip(sheet * grain, 0.02, 0.95)
    sheet.flags.writeable = False
    return sheet


def uneven_light(
    size: tuple[int, int],
    seed: int = 0,
    *,
    lamp_K: float = 3600.0,
    sky_K: float = 8000.0,
    shadow: float = 0.75,
) -> PlaneLight:
    """Make light that varies over a plane, with cast shadows in which only bluish skylight remains.

    Parameters
    ----------
    size : (int, int)
        Height and width, pixels.
    seed : int
        Seed of the positions of lamp and shadows.
    lamp_K, sky_K : float
        Colour temperatures, kelvin.
    shadow : float
        Fraction of the light that comes from the lamp and is missing in shadows, 0 to 1.

    Returns
    -------
    PlaneLight
    """
    check_kelvin("lamp_K", lamp_K)
    check_kelvin("sky_K", sky_K)
    if not 0 <= shadow < 1:
        raise LiaamError(f"shadow is {shadow!r}: give a fraction from 0 to below 1")
    rng = np.random.default_rng([seed, 0x11947])  # a stream of its own, apart from those of posters and cameras
    height, width = _checked(size)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    slope_x, slope_y = rng.normal(0, 0.28, 2)
    lamp = np.exp(slope_x * x + slope_y * y - 0.15 * (x**2 + y**2))
    for _ in range(2):
        lamp = lamp * _outside_shadow(x, y, rng)
    lamp = shadow * lamp
    sky = (1 - shadow) * np.exp(rng.normal(0, 0.1) * x)
    share = lamp / (lamp + sky)
    return PlaneLight(strength=lamp + sky, mired=share * 1e6 / lamp_K + (1 - share) * 1e6 / sky_K)


def _outside_shadow(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return how much light of a lamp passes beside a wavy band, (h, w): 1, falling to 0.02 in its shadow.

    ``x`` and ``y`` (h, w) are from -1 to 1 over the plane.
    """
    angle = rng.uniform(0, 2 * np.pi)
    offset = rng.uniform(-0.4, 0.4)
    wave = 0.12 * np.sin(3 * (x * np.sin(angle) - y) + angle)
    distance = np.abs(np.cos(angle) * x + np.sin(angle) * y - offset + wave)  # from the middle of the band
    half_width = rng.uniform(0.15, 0.45)
    edge = rng.uniform(0.01, 0.06)
    return 0.02 + 0.98 * np.clip(0.5 + (distance - half_width) / edge, 0, 1)


def even_light(size: tuple[int, int], kelvin: float = 5000.0, strength: float = 1.0) -> PlaneLight:
    """Make uniform light on a plane of size (height, width)."""
    height, width = _checked(size)
    return PlaneLight(np.full((height, width), float(strength)), np.full((height, width), 1e6 / kelvin))


def photograph(
    reflectance: np.ndarray,
    light: PlaneLight,
    camera: Camera | None = None,
    *,
    seed: int = 0,
    exposure: float | None = None,
    homography: np.ndarray | None = None,
    radiator: Radiator = "wien",
) -> np.ndarray:
    """Render an image of a flat scene.

    Parameters
    ----------
    reflectance : (h, w, 3) float
        Coefficients of the reflectance in its red, green and blue parts.
    light : PlaneLight
    camera : Camera, optional
        Default: broad sensors, sRGB, 8 bits.
    seed : int
        Seed of the sensor's noise.
    exposure : float, optional
        Gain from reflectance times irradiance to linear values. By default the camera's, or one that maps the 99th
        percentile to 0.85.
    homography : (3, 3) float, optional
        From the scene's pixels to the image's. The image has the scene's size and is black outside the scene.
    radiator : {"wien", "planck"}

    Returns
    -------
    (h, w, 3) uint8, uint16 or float32
    """
    camera = camera or Camera()
    matrices = matrices_at(camera, light.mired, radiator)
    linear = np.einsum("hwkj,hwj->hwk", matrices, reflectance) * light.strength[..., None]
    exposure = exposure or camera.exposure
    if not exposure:
        exposure = 0.85 / float(np.percentile(linear.max(axis=-1), 99))
    linear = linear * exposure
    if homography is not None:
        size = (linear.shape[1], linear.shape[0])
        linear = cv2.warpPerspective(linear, np.asarray(homography, float), size, flags=cv2.INTER_CUBIC)
        linear = np.maximum(linear, 0.0)
    linear = linear * camera.falloff(*linear.shape[:2])[..., None]
    return camera.expose(linear, np.random.default_rng([seed, 0x91A7E]))


def _checked(size: tuple[int, int]) -> tuple[int, int]:
    """Return a size (height, width). Raise if it is none, or too small or large."""
    if len(size) != 2 or not all(8 <= s <= 8192 for s in size):
        raise LiaamError(f"a plane's size is {size!r}: give height and width, 8 to 8192 pixels")
    return size
