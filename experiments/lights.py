"""Change the light of a real image whose landmarks are known.

Each light is a function (image, landmarks, rng) -> image of stored sRGB values, (h, w, 3) uint8. Its random values
depend only on the generator. Light is multiplied in linear values, rounded to 8 bits and clipped, as in a camera.
"""

from collections.abc import Callable

import numpy as np

from liaam.photometry import THETA_DEFAULT, linear_to_srgb, srgb_to_linear, temperature_direction

Light = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]
"""From an image (h, w, 3) uint8 under diffuse light, landmarks (n, 2) and a generator to an image (h, w, 3) uint8."""

SHADOW = (0.22, 0.28, 0.36)
"""Linear red, green and blue light in a cast shadow: skylight, which is bluer than sunlight."""

DAPPLE = (0.25, 0.30, 0.36)
"""The same between dapples."""

SHADOW_EDGE = 1.5
"""Half the width of a cast shadow's edge, pixels."""

SPOT_SIZE = 0.05
"""Size of dapples, as a fraction of the object's."""

HEAD = 1.25
"""Semi-axes of the head's ellipsoid, relative to those of the landmarks' box, which excludes forehead and hair."""


def unchanged(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Leave the light as it is."""
    del landmarks, rng
    return image


def hard_light(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Light a head from one side by a small lamp, with attached and cast shadows.

    The head is an ellipsoid around the landmarks with Lambertian shading. The side away from the lamp is in a cast
    shadow whose edge bulges as behind a nose. Lamp and ambient light have different colour temperatures.
    """
    x, y, radii = _about_head(image, landmarks)
    side = rng.choice([-1, 1])
    lamp = _towards(np.deg2rad(rng.uniform(50, 80)) * side, np.deg2rad(rng.uniform(-30, 10)))
    shading = np.clip(_ellipsoid(x / radii[0], y / radii[1]) @ lamp, 0, None)
    reaches = _beside_nose(x, y, radii, side, rng)
    ambient = rng.uniform(0.12, 0.3) * _colour(rng.uniform(-0.3, 0.5))
    key = rng.uniform(1.0, 1.5) * _colour(rng.uniform(-0.4, 0.4))
    return _lit(image, ambient + key * (shading * reaches)[..., None])


def circling_light(image: np.ndarray, landmarks: np.ndarray, turns: float) -> np.ndarray:
    """Light a head (h, w, 3) uint8 under diffuse light by a coloured lamp that swings from side to side, for videos.

    The head is an ellipsoid around the landmarks with Lambertian shading. The lamp swings from 60° left to 60° right,
    up and down a little, and from warm to cold and back; a turn of 1 is a full swing. The ambient light is dim and has
    another colour.
    """
    x, y, radii = _about_head(image, landmarks)
    phase = 2 * np.pi * turns
    lamp = _towards(np.deg2rad(60) * np.sin(phase), np.deg2rad(-10 + 20 * np.cos(phase)))
    shading = np.clip(_ellipsoid(x / radii[0], y / radii[1]) @ lamp, 0, None)
    key = 0.9 * _colour(0.35 * np.cos(0.7 * phase))
    return _lit(image, 0.2 * _colour(-0.2) + key * shading[..., None])


def _beside_nose(x: np.ndarray, y: np.ndarray, radii: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    """Fraction of a lamp's light that passes a nose-like profile, (h, w); x and y are relative to the head's centre."""
    tilt = rng.uniform(-0.35, 0.35)
    depth = -side * (x * np.cos(tilt) + y * np.sin(tilt)) - rng.uniform(-0.15, 0.25) * radii[0]
    depth = depth - 0.12 * radii[0] * np.exp(-(((y / radii[1] - 0.1) / 0.25) ** 2))
    penumbra = rng.uniform(1.5, 5)
    return 1 - rng.uniform(0.7, 1) * _step(2 * depth / penumbra)


def smooth_light(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shade an image smoothly, and change gain and offset of each channel.

    Log light is a random second-order polynomial of the position. Stored values of each channel are then scaled by
    about 25 %, shifted by about 0.03, and clipped to 8 bits.
    """
    x, y = _grid(image)
    centre, size = landmarks.mean(axis=0), _size(landmarks)
    u, v = (x - centre[0]) / size, (y - centre[1]) / size
    a, b, c, d, e = rng.normal(0, 1, 5) * [1.2, 1.2, 0.8, 0.8, 0.8]
    light = np.exp(a * u + b * v + c * u**2 + d * u * v + e * v**2 - 0.2)
    gain, offset = np.exp(rng.normal(0, 0.25, 3)), rng.normal(0, 0.03, 3)
    # Clip after the gain only, because a lower gain keeps values that the light alone would saturate.
    return _stored(linear_to_srgb(np.clip(_linear(image) * light[..., None], 0, 4)) * gain + offset)


def cast_shadow(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Apply a shadow of :data:`SHADOW` to a half-plane whose edge passes near the object's centre."""
    x, y = _grid(image)
    middle = landmarks.mean(axis=0) + rng.normal(0, 0.08, 2) * np.ptp(landmarks, axis=0)
    angle = rng.uniform(0, 2 * np.pi)
    depth = (x - middle[0]) * np.cos(angle) + (y - middle[1]) * np.sin(angle)
    return _shaded(image, _step(depth / SHADOW_EDGE), SHADOW)


def dapples(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Scatter spots of light, as under leaves. The light between them is :data:`DAPPLE`."""
    import cv2

    spots = cv2.GaussianBlur(rng.standard_normal(image.shape[:2]), (0, 0), SPOT_SIZE * _size(landmarks))
    return _shaded(image, 1 - _step(4 * spots / spots.std()), DAPPLE)


LIGHTS: dict[str, Light] = {
    "none": unchanged,
    "smooth": smooth_light,
    "shadow": cast_shadow,
    "dapples": dapples,
    "hard": hard_light,
}
"""Lights by name."""


def _about_head(image: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y of all pixels relative to the centre of the head, and its radii (2,), in pixels."""
    x, y = _grid(image)
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    centre = 0.5 * (low + high)
    return x - centre[0], y - centre[1], 0.5 * HEAD * (high - low)


def _grid(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of all pixels: x of shape (1, w), y of shape (h, 1), float64."""
    y, x = np.ogrid[: image.shape[0], : image.shape[1]]
    return x.astype(np.float64), y.astype(np.float64)


def _size(landmarks: np.ndarray) -> float:
    """Longer side of the landmarks' box, pixels."""
    return float(np.ptp(landmarks, axis=0).max())


def _step(x: np.ndarray) -> np.ndarray:
    """Rise from 0 to 1 about 0."""
    return 0.5 * (1.0 + np.tanh(x))


def _towards(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector towards a lamp: x to the right, y downwards, z towards the camera, (3,) float64."""
    level = np.cos(elevation)
    return np.array([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level])


def _ellipsoid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Normals of a unit sphere viewed from the front, (h, w, 3). Outside its outline they point nearly sideways."""
    u, v = np.broadcast_arrays(u, v)
    normals = np.stack([u, v, np.sqrt(np.clip(1 - u**2 - v**2, 0.02, None))], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _colour(temperature: float) -> np.ndarray:
    """Light of a colour temperature, shifted along d(122°) from white, (3,) float64."""
    return np.exp(temperature * temperature_direction(THETA_DEFAULT))


def _linear(image: np.ndarray) -> np.ndarray:
    return srgb_to_linear(image.astype(np.float64) / 255)


def _stored(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(255 * values), 0, 255).astype(np.uint8)


def _lit(image: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Multiply linear values by light, (h, w, 3)."""
    return _stored(linear_to_srgb(np.clip(_linear(image) * light, 0, 1)))


def _shaded(image: np.ndarray, mask: np.ndarray, left: tuple[float, float, float]) -> np.ndarray:
    """Reduce red, green and blue light to `left` where the mask (h, w) is 1, and keep it where the mask is 0."""
    mask = mask[..., None]
    return _lit(image, 1 - mask + mask * np.array(left))
