"""Render a head with a pose, lights and a camera to an image with ground truth."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from scenes import body as figure, light as lighting
from scenes.body import Body, build_body
from scenes.camera import Camera, matrices_at
from scenes.chart import CONTOURS, Face, smoothstep
from scenes.head import Expression, Head, Pose, Traits
from scenes.light import DIFFUSE, Ambient, Lights, PointLight, Radiator
from scenes.paint import Textures, look_up, look_up_periodic, skin_tone, textures_of
from scenes.raster import draw, shown_triangles
from scenes.surface import face_of, landmark_points

Mixing = Literal["additive", "planckian"]
VIEWING_DISTANCE = 14.0  # head units: a camera at 1.4 m
FINE_MESH = 70.0  # pixels of a head unit from which every second row of the mesh is not enough: 75 at 240 x 180
BRIGHTEST = 0.8  # linear value given to the 98th percentile of the face


@dataclass(frozen=True)
class Scene:
    """An image of size ``(h, w)`` and its ground truth.

    Attributes
    ----------
    image : (h, w, 3) uint8, uint16 or float32
        The encoded image, with noise.
    linear : (h, w, 3) float32
        Linear values before noise and saturation.
    landmarks : (58, 2) float64
        x and y in pixels, with the origin at the centre of the top-left pixel, in the IMM set's order.
    contours : tuple of (tuple of int, bool)
        Landmarks that form lines, and whether the line is closed.
    theta : float
        True invariant angle of the camera, radians.
    reflectance : (h, w, 3) float32
        Linear values under a unit of the camera's white light, without shading.
    shading : (h, w) float32
        Irradiance, summed over the lights.
    shadow : (h, w) float32
        Fraction of the lamps' light that is missing, 0 (lit) to 1 (cast or attached shadow).
    mask : (h, w) bool
        Inside the hull of the landmarks.
    """

    image: np.ndarray
    linear: np.ndarray
    landmarks: np.ndarray
    contours: tuple[tuple[tuple[int, ...], bool], ...]
    theta: float
    reflectance: np.ndarray
    shading: np.ndarray
    shadow: np.ndarray
    mask: np.ndarray

    __repr__ = short_repr


def render(
    head: Head,
    pose: Pose | None = None,
    expression: Expression | None = None,
    lights: Lights = DIFFUSE,
    camera: Camera | None = None,
    size: tuple[int, int] = (320, 240),
    *,
    seed: int = 0,
    mixing: Mixing = "additive",
    radiator: Radiator = "wien",
    supersample: int = 2,
) -> Scene:
    """Render an image of a head.

    A pixel has one reflectance spectrum S and, per light, one irradiance. Its linear value in channel k is the sum over
    the lights of irradiance times the integral of E(lambda, T) S(lambda) Q_k(lambda), the image formation of the paper.

    Parameters
    ----------
    head, pose, expression
        Identity, pose and expression; frontal and neutral by default.
    lights : tuple of PointLight and Ambient
        Light sources.
    camera : Camera, optional
        Default: broad sensors, sRGB, 8 bits.
    size : (int, int)
        Height and width, pixels.
    seed : int
        Seed of the sensor's noise.
    mixing : {"additive", "planckian"}
        "additive" adds the lights' spectra, which is physically correct. "planckian" uses one Planckian
        spectrum per pixel, whose reciprocal temperature is the mean of the lights' weighted by irradiance. The
        paper's model then holds exactly, also where lights of different temperatures mix.
    radiator : {"wien", "planck"}
        Law of radiation.
    supersample : int
        Samples per pixel and axis, 1 to 4.

    Returns
    -------
    Scene

    Examples
    --------
    >>> from scenes import Head, lateral, render
    >>> scene = render(Head(3), lights=lateral("left"))
    >>> scene.image.shape, scene.landmarks.shape
    ((320, 240, 3), (58, 2))
    """
    _check_request(lights, size, mixing, supersample)
    pose, expression, camera = pose or Pose(), expression or Expression(), camera or Camera()
    face = face_of(head)
    body, sky = _figure(head, pose, expression, size, supersample)
    pixels = _draw_figure(body, sky, size, pose, supersample)
    colour = _shrink(_paint_pixels(pixels, face, textures_of(head), expression), supersample)
    irradiance, missing = _irradiances(body, pixels, lights, supersample)
    landmarks = landmarks_of(head, pose, expression, size)
    mask = _hull_mask(landmarks, size)
    linear = _develop(colour, irradiance, lights, camera, mixing, radiator) * camera.falloff(*size)[..., None]
    gain = camera.exposure or _auto_exposure(linear, mask)
    linear = linear * gain
    white = camera.matrix(1e6 / camera.white_K, radiator)
    return Scene(
        image=camera.expose(linear, np.random.default_rng([seed, head.seed, 0x0A15E])),
        linear=linear.astype(np.float32),
        landmarks=landmarks,
        contours=CONTOURS,
        theta=camera.theta(radiator),
        reflectance=(colour @ white.T).astype(np.float32),
        shading=irradiance.sum(axis=0).astype(np.float32),
        shadow=missing.astype(np.float32),
        mask=mask,
    )


def make_set(
    n: int,
    head: Head | None = None,
    lights: Lights = DIFFUSE,
    camera: Camera | None = None,
    seed: int = 0,
    size: tuple[int, int] = (320, 240),
    **options,
) -> list[Scene]:
    """Render ``n`` images of one head with random expressions and poses.

    Further ``options`` are passed to `render`. A longer set begins with the images of a shorter one.
    """
    if n < 1:
        raise LiaamError(f"a set of {n!r} images: give a number of at least 1")
    head = head or Head(0)
    scenes = []
    for i in range(n):
        rng = np.random.default_rng([seed, i, 0x5E7])
        pose, expression = random_pose(rng, size), random_expression(rng)
        scenes.append(render(head, pose, expression, lights, camera, size, seed=seed + i, **options))
    return scenes


def random_pose(rng: np.random.Generator, size: tuple[int, int] = (320, 240)) -> Pose:
    """Draw a natural pose for an image of the given size."""
    yaw, pitch, roll = np.clip(rng.normal(0, (0.10, 0.06, 0.045)), -0.26, 0.26)
    shift = 0.012 * min(size)
    x, y = np.clip(rng.normal(0, shift, 2), -2 * shift, 2 * shift)
    return Pose(float(yaw), float(pitch), float(roll), float(rng.uniform(0.95, 1.04)), float(x), float(y))


def random_expression(rng: np.random.Generator) -> Expression:
    """Draw an expression; about one in four faces is almost neutral."""
    amount = 0.15 if rng.random() < 0.25 else 1.0
    closed = 0.9 if rng.random() < 0.10 else 0.25 * rng.random()
    return Expression(
        mouth_open=float(amount * 0.8 * max(rng.uniform(-0.8, 1), 0)),
        smile=float(amount * rng.uniform(-0.45, 1)),
        brow_raise=float(amount * rng.uniform(-0.8, 1)),
        eye_close=float(amount * closed),
        pucker=float(amount * 0.7 * max(rng.uniform(-2, 1), 0)),
    )


def landmarks_of(head: Head, pose: Pose, expression: Expression, size: tuple[int, int]) -> np.ndarray:
    """Pixels (58, 2) of the landmarks in an image of a size (height, width), which need no rendering."""
    return _project(figure.turn(landmark_points(face_of(head), expression), pose.rotation()), size, pose)


def _head_unit(size: tuple[int, int]) -> float:
    """Pixels of a head unit in an image of a size (height, width), for a pose of scale 1."""
    height, width = size
    return min(height / 3.2, width / 2.4)


def _project(points: np.ndarray, size: tuple[int, int], pose: Pose) -> np.ndarray:
    """Pixels (x, y) of points (..., 3) in the viewer's axes, in perspective."""
    height, width = size
    unit = _head_unit(size) * pose.scale
    scale = unit * VIEWING_DISTANCE / (VIEWING_DISTANCE - points[..., 2])
    x, y = (width - 1) / 2 + pose.x, 0.47 * (height - 1) + pose.y
    return np.stack([x + scale * points[..., 0], y - scale * points[..., 1]], -1)


# Columns of the attributes that are interpolated over the triangles.
_CHART, _NORMAL, _POINT, _SKY, _PART = slice(0, 4), slice(4, 7), slice(7, 10), 10, 11


@lru_cache(maxsize=8)  # a set under several lights shows the same figures; 8 MB each
def _figure(head: Head, pose: Pose, expression: Expression, size: tuple[int, int], s: int) -> tuple[Body, np.ndarray]:
    """The posed figure, and the irradiance (n,) of its vertices under an open sky; 0 of those that are not seen."""
    step = 1 if _head_unit(size) >= FINE_MESH else 2
    body = build_body(face_of(head), pose, expression, step)
    shown = shown_triangles(_on_screen(body, size, pose, s), body.triangles, s * size[0], s * size[1])
    seen = np.zeros(len(body.points), bool)
    seen[body.triangles[shown]] = True
    return body, lighting.dome_irradiance(body, np.flatnonzero(seen))


def _on_screen(body: Body, size: tuple[int, int], pose: Pose, s: int) -> np.ndarray:
    """Columns, rows and nearness (n, 3) of the vertices, in samples."""
    at = (_project(body.points, size, pose) + 0.5) * s - 0.5
    return np.column_stack([at, body.points[:, 2]])


def _draw_figure(body: Body, sky: np.ndarray, size: tuple[int, int], pose: Pose, s: int) -> np.ndarray:
    """Attributes (s h, s w, 12) of the figure at every sample; part 0 is the wall."""
    attributes = np.column_stack([body.chart, body.normals, body.points, sky, body.part]).astype(np.float32)
    screen = _on_screen(body, size, pose, s)
    image, covered = draw(screen, body.triangles, attributes, s * size[0], s * size[1])
    wall = np.zeros(image.shape[-1], np.float32)
    wall[_NORMAL], wall[_SKY] = (0, 0, 1), 1
    image[~covered] = wall
    return image


def _paint_pixels(pixels: np.ndarray, face: Face, textures: Textures, expression: Expression) -> np.ndarray:
    """Reflectance (s h, s w, 3) of every sample."""
    t, part = face.traits, np.rint(pixels[..., _PART]).astype(np.int8)
    colour = np.empty((*part.shape, 3), np.float32)
    wall, head = part == 0, part == figure.HEAD
    colour[wall] = _wall(part.shape, t, textures)[wall]
    if head.any():
        colour[head] = _paint_face(pixels, head, textures, expression)
    weave, strands = textures.weave, textures.strands
    patterns = {
        figure.SKIN: (skin_tone(t.skin), lambda u, v: -0.12 + 0.02 * look_up_periodic(weave, u, v)),
        figure.CLOTH: (t.cloth_colour, lambda u, v: 0.09 * look_up_periodic(weave, 1.6 * u, 2.2 * v)),
        figure.HAIR: (t.hair_colour, lambda u, v: 0.17 * look_up_periodic(strands, 0.8 * u, 0.3 * v)),
    }
    for number, (tone, log_of) in patterns.items():
        own = part == number
        if not own.any():
            continue
        box = _box(own)
        log = log_of(*np.moveaxis(pixels[*box, :2], -1, 0))
        colour[own] = np.array(tone) * np.exp(log[own[box]])[..., None]
    return colour


def _paint_face(pixels: np.ndarray, head: np.ndarray, textures: Textures, expression: Expression) -> np.ndarray:
    """Reflectance (n, 3) of the samples of the head, whose skin has openings to the skull."""
    box = _box(head)
    u, v, skull_u, skull_v = np.moveaxis(pixels[*box, _CHART], -1, 0)
    head = head[box]
    skin, skull = look_up(textures.skin, u, v)[head], look_up(textures.skull, skull_u, skull_v)[head]
    # Close the remaining openings of the mesh between closed lips and lids.
    mouth, eyes = smoothstep(expression.mouth_open / 0.12), 1 - smoothstep((expression.eye_close - 0.75) / 0.2)
    opening = skin[:, 3] * np.where(v[head] < -0.3, mouth, eyes)
    return skin[:, :3] + opening[:, None] * (skull - skin[:, :3])


def _box(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns from the first to the last that a mask has, or none."""
    x, y, width, height = cv2.boundingRect(mask.view(np.uint8))
    return slice(y, y + height), slice(x, x + width)


def _wall(shape: tuple[int, int], t: Traits, textures: Textures) -> np.ndarray:
    """A plastered wall, brighter behind the head."""
    y, x = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
    glow = np.exp(-0.55 * (x**2 + (y + 0.25) ** 2))
    clouds = cv2.resize(cv2.GaussianBlur(textures.weave, (0, 0), 14), shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.array(t.wall_colour) * ((0.55 + 0.75 * glow) * np.exp(0.05 * clouds / clouds.std()))[..., None]


def _irradiances(body: Body, pixels: np.ndarray, lights: Lights, s: int) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance (n_lights, h, w) and the fraction of the lamps' light that is in shadow (h, w)."""
    shape = pixels.shape[:2]
    solid = pixels[..., _PART] > 0.5
    at = pixels[..., _POINT][solid].astype(float)
    normals = pixels[..., _NORMAL][solid].astype(float)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
    maps, blocked, lamps = [], np.zeros(shape, np.float32), 1e-12
    for source in lights:
        if isinstance(source, Ambient):
            maps.append(source.strength * _shrink(pixels[..., _SKY], s))
            continue
        facing, seen = normals @ source.unit, np.zeros(len(at), np.float32)
        towards = facing > 0
        seen[towards] = lighting.direct_visibility(body, at[towards], normals[towards], source)
        direct = np.full(shape, max(source.unit[2], 0.0), np.float32)
        direct[solid] = np.maximum(facing, 0) * seen
        maps.append(source.strength * _shrink(direct, s))
        hidden = np.zeros(shape, np.float32)
        hidden[solid] = 1 - seen * np.clip(facing / 0.05, 0, 1)
        blocked, lamps = blocked + source.strength * hidden, lamps + source.strength
    return np.stack(maps).astype(float), _shrink(blocked, s) / lamps


def _develop(
    colour: np.ndarray,
    irradiance: np.ndarray,
    lights: Lights,
    camera: Camera,
    mixing: Mixing,
    radiator: Radiator,
) -> np.ndarray:
    """Linear values (h, w, 3) of every pixel under all lights."""
    mired = np.array([1e6 / source.temperature_K for source in lights])
    colour = colour.astype(float)
    if mixing == "additive":
        return np.einsum("lhw,lkj,hwj->hwk", irradiance, camera.matrix(mired, radiator), colour, optimize=True)
    total = irradiance.sum(axis=0)
    mean = np.tensordot(mired, irradiance, 1) / np.maximum(total, 1e-12)
    matrices = matrices_at(camera, np.where(total > 0, mean, mired[0]), radiator)
    return total[..., None] * np.einsum("hwkj,hwj->hwk", matrices, colour)


def _auto_exposure(linear: np.ndarray, mask: np.ndarray) -> float:
    face = linear[mask] if mask.any() else linear.reshape(-1, 3)
    bright = float(np.percentile(face.max(axis=-1), 98))
    return BRIGHTEST / bright if bright > 0 else 1.0


def _hull_mask(landmarks: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    hull = cv2.convexHull(landmarks.astype(np.float32))
    mask = np.zeros(size, np.uint8)
    cv2.fillConvexPoly(mask, np.round(hull).astype(np.int32), 1)
    return mask.astype(bool)


def _shrink(samples: np.ndarray, s: int) -> np.ndarray:
    """Mean over the s x s samples of each pixel."""
    h, w = samples.shape[0] // s, samples.shape[1] // s
    return samples.reshape(h, s, w, s, *samples.shape[2:]).mean(axis=(1, 3))


def _check_request(lights: Lights, size: tuple[int, int], mixing: str, supersample: int) -> None:
    if not isinstance(lights, tuple) or not lights or not all(isinstance(s, PointLight | Ambient) for s in lights):
        raise LiaamError("the lights are a tuple of at least one PointLight or Ambient, such as DIFFUSE or lateral()")
    if len(size) != 2 or not all(isinstance(n, int | np.integer) and 32 <= n <= 4096 for n in size):
        raise LiaamError(f"the size is {size!r}: give (height, width), integers from 32 to 4096")
    if mixing not in ("additive", "planckian"):
        raise LiaamError(f"the mixing is {mixing!r}: give 'additive' or 'planckian'")
    if supersample not in (1, 2, 3, 4):
        raise LiaamError(f"supersample is {supersample!r}: give 1, 2, 3 or 4 samples per pixel and axis")
