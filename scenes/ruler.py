"""Rulers and scale bars of known period or length, on several grounds, tilted and blurred.

A scene is drawn at four times its size and reduced by averaging, so that edges lie at fractions of pixels. It is
blurred in linear light, as by a camera, or after it was encoded, as by a program.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from liaam.photometry import linear_to_srgb, srgb_to_linear

FINE = 4
"""Pixels that are drawn for one of the scene, along each side."""

RULERS = ("plain", "hierarchical", "numbered", "steel", "blocks", "clear")
"""Kinds of rulers: ticks of one length, of three, with numbers, light ones on grey, alternating blocks, and ticks
without a ground of their own."""

BARS = ("black", "white", "ended", "boxed")
"""Kinds of scale bars: black, white, with end marks, and in a box of its own."""

GROUNDS = ("paper", "gradient", "cloudy", "grain", "veins")
"""Kinds of grounds: even, with a gradient of light, with soft clouds, grained as wood, and crossed by curved lines."""


@dataclass(frozen=True)
class RulerScene:
    """An image with a ruler or a scale bar.

    Attributes
    ----------
    image : (h, w, 3) uint8
    kind, ground : str
    size : float
        Period of the ticks or length of the bar, in pixels; NaN if there is none in the image.
    angle : float
        Of the ruler to the horizontal, degrees.
    """

    image: np.ndarray
    kind: str
    ground: str
    size: float
    angle: float


def draw(
    kind: str,
    rng: np.random.Generator,
    *,
    ground: str = "paper",
    size: float | None = None,
    angle: float = 0.0,
    blur: float = 0.6,
    noise: float = 2.0,
    shape: tuple[int, int] = (480, 640),
    number: str = "5 mm",
    encoded: bool = False,
) -> RulerScene:
    """Draw a scene.

    Parameters
    ----------
    kind : str
        One of `RULERS` or `BARS`, or ``"none"``.
    rng : numpy.random.Generator
    ground : str
        One of `GROUNDS`.
    size : float, optional
        Period of the ticks, or length of the bar, in pixels; drawn by default: 6 to 22, or 60 to 250.
    angle : float
        Tilt, degrees.
    blur : float
        Standard deviation of the blur of the camera, pixels.
    noise : float
        Standard deviation of the noise, levels of 255.
    shape : tuple of int
        Height and width, pixels.
    number : str
        Printed beside a bar; "" for none.
    encoded : bool
        Whether it is reduced and blurred after it was encoded as sRGB.
    """
    height, width = shape
    canvas = _ground(ground, (height * FINE, width * FINE), rng)
    is_bar = kind in BARS
    size = size or float(rng.uniform(60, 250) if is_bar else rng.uniform(6, 22))
    centre = np.array([width * rng.uniform(0.45, 0.55), height * rng.uniform(0.35, 0.65)]) * FINE
    if is_bar:
        _draw_bar(canvas, kind, size * FINE, centre, np.deg2rad(angle), rng, number)
    elif kind != "none":
        _draw_ruler(canvas, kind, size * FINE, centre, np.deg2rad(angle), rng)
    light = canvas.astype(np.float32) / 255
    light = light if encoded else srgb_to_linear(light).astype(np.float32)
    small = cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA)
    if blur > 0:
        small = cv2.GaussianBlur(small, (0, 0), blur)
    small = 255 * (small if encoded else linear_to_srgb(small))
    tinted = small[:, :, None] * np.array([1.0, 0.98, 0.95]) + rng.normal(0, noise, (height, width, 3))
    image = np.clip(np.rint(tinted), 0, 255).astype(np.uint8)
    return RulerScene(image, kind, ground, size if kind != "none" else float("nan"), angle)


def _ground(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    height, width = shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    level = float(rng.uniform(120, 220))
    canvas = np.full(shape, level, np.float32)
    if kind == "gradient":
        canvas += 60 * (x / width - 0.5) + 40 * (y / height - 0.5)
    if kind in ("cloudy", "grain"):
        rough = rng.normal(0, 1, (height // 8, width // 8)).astype(np.float32)
        sigma = (6, 6) if kind == "cloudy" else (25, 1.2)
        soft = cv2.GaussianBlur(rough, (0, 0), sigmaX=sigma[0], sigmaY=sigma[1])
        canvas += 14 * cv2.resize(soft / soft.std(), (width, height), interpolation=cv2.INTER_CUBIC)
    canvas = np.clip(canvas, 0, 255).astype(np.uint8)
    if kind == "veins":
        for _ in range(14):
            start = rng.uniform(0, 1, 2) * (width, height)
            heading = rng.uniform(0, 2 * np.pi)
            turn = heading + np.cumsum(rng.normal(0, 0.08, 60))
            line = start + np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1) * 6 * FINE, axis=0)
            points = np.rint(line * 16).astype(np.int32)
            cv2.polylines(canvas, [points], False, level - 70, int(rng.integers(1, 3)) * FINE, cv2.LINE_AA, 4)
    return canvas


def fill(canvas: np.ndarray, corners: np.ndarray, level: float) -> None:
    """Fill a convex polygon given by corners (k, 2) in fine pixels; pixels at its edges are mixed by their share in it.

    The share is that of a straight edge at its distance. Functions of OpenCV draw polygons half a pixel too large.
    """
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 3, canvas.shape[::-1])
    if left >= right or top >= bottom:  # it lies beyond the canvas
        return
    y, x = np.mgrid[top:bottom, left:right].astype(np.float32) + 0.5
    share = np.ones(x.shape, np.float32)
    centre = corners.mean(axis=0)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.hypot(*(end - start))
        normal = np.array([-along[1], along[0]])
        normal = normal if normal @ (centre - start) > 0 else -normal
        distance = (x - start[0]) * normal[0] + (y - start[1]) * normal[1]
        share = np.minimum(share, np.clip(distance + 0.5, 0, 1))
    part = canvas[top:bottom, left:right]
    part[:] = np.rint(part + share * (level - part)).astype(np.uint8)


def _placed(boxes: np.ndarray, centre: np.ndarray, angle: float) -> np.ndarray:
    """Return points (..., 2) along and across the ruler as points of the canvas."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return boxes @ turn + centre


def _box(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _draw_ruler(
    canvas: np.ndarray, kind: str, period: float, centre: np.ndarray, angle: float, rng: np.random.Generator
) -> None:
    n = int(np.clip(380 * FINE / period, 16, 60))
    start = -period * n / 2
    thick = max(period * rng.uniform(0.12, 0.3), 1.2 * FINE)
    tall = rng.uniform(10, 16) * FINE
    dark, light = (90.0, 190.0) if kind == "steel" else (25.0, 240.0)
    body = _box(start - 2 * period, -8 * FINE, -start + 2 * period, 3.2 * tall)
    if kind not in ("clear",):
        fill(canvas, _placed(body, centre, angle), 130.0 if kind == "steel" else light)
    for i in range(n + 1):
        at = start + i * period
        if kind == "blocks":
            if i < n:
                fill(canvas, _placed(_box(at, 0, at + period / 2, tall), centre, angle), dark)
            continue
        longer = 1.0
        if kind in ("hierarchical", "numbered", "steel"):
            longer = 1.9 if i % 10 == 0 else 1.4 if i % 5 == 0 else 1.0
        level = 215.0 if kind == "steel" else dark
        fill(canvas, _placed(_box(at - thick / 2, 0, at + thick / 2, tall * longer), centre, angle), level)
    if kind == "numbered":
        for i in range(0, n + 1, 10):
            at = _placed(np.array([start + i * period, 2.6 * tall]), centre, angle)
            place = (int(at[0]), int(at[1]))
            cv2.putText(canvas, str(i // 10), place, cv2.FONT_HERSHEY_SIMPLEX, 0.4 * FINE, dark, FINE, cv2.LINE_AA)


def _draw_bar(
    canvas: np.ndarray,
    kind: str,
    length: float,
    centre: np.ndarray,
    angle: float,
    rng: np.random.Generator,
    number: str,
) -> None:
    thick = rng.uniform(3, 7) * FINE
    half = length / 2
    level = 250.0 if kind == "white" else 10.0
    if kind == "white":
        canvas[:] = (canvas * 0.45).astype(np.uint8)
    if kind == "boxed":
        fill(canvas, _placed(_box(-half * 1.3, -7 * thick, half * 1.3, 4 * thick), centre, angle), 250.0)
    if kind == "ended":
        for end in (-1, 1):
            outer = end * half
            inner = end * (half - 0.4 * thick)
            corners = _box(min(outer, inner), -1.5 * thick, max(outer, inner), 1.5 * thick)
            fill(canvas, _placed(corners, centre, angle), level)
        thick *= 0.5
    fill(canvas, _placed(_box(-half, -thick / 2, half, thick / 2), centre, angle), level)
    if number:
        write(canvas, number, _placed(np.array([0.0, -22.0 * FINE]), centre, angle), angle, level)


def write(canvas: np.ndarray, text: str, middle: np.ndarray, angle: float, level: float) -> None:
    """Draw a text along a bar, around its middle."""
    size = 0.45 * FINE
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, FINE)
    pad = 2 * FINE
    patch = np.zeros((height + 2 * pad, width + 2 * pad), np.uint8)
    cv2.putText(patch, text, (pad, height + pad), cv2.FONT_HERSHEY_SIMPLEX, size, 255, FINE + 2, cv2.LINE_AA)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = middle - turn @ (np.array(patch.shape[::-1]) / 2)
    inked = cv2.warpAffine(patch, np.column_stack([turn, shift]), canvas.shape[::-1]) / 255
    canvas[:] = np.rint(canvas + inked * (level - canvas)).astype(np.uint8)
