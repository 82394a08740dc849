"""Layers of a fit: residual, shading, the picture without its shading, and the object under another light.

These functions work on arrays; :mod:`liaam.studio.fits` caches their results.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from liaam.fitting import FitResult, Fitter
from liaam.fitting.detection import Detection
from liaam.fitting.solution import residual_at
from liaam.io import image_size
from liaam.model.shape import Similarity
from liaam.model.sides import reflected_points
from liaam.photometry import is_grey, linear_to_srgb
from liaam.photometry.encoding import stored_values
from liaam.relighting import Relighter, paint
from liaam.studio.contract import ColourScale
from liaam.studio.pictures import averaged, read_for_work, work_size
from liaam.tracking.motion import rescaled

LAYERS = ("residual", "shading", "flat", "balanced", "normals")
"""Names of the layers, as the page asks for them; flat is the picture without its shading, balanced that with its own
light, of which the colour is corrected."""

RESIDUAL_COLOURS = ((33, 102, 172), (247, 247, 247), (178, 24, 43))
"""Colours below, at and above 0: the picture is darker than, equal to, or brighter than the model."""

SHADING_COLOURS = ((38, 36, 92), (148, 148, 148), (255, 214, 92))  # of shadow, of the training light, of brighter light
SHADING_LIMIT = float(np.log(4.0))
"""Limit of the colour scale: 1/4 and 4 times the training light. It is the same for all pictures, to compare them."""

UNSEEN = 4
"""Change of stored values, of 255, that nobody sees."""

CHANGED_SHARE = 99.0  # percentile of the changes inside the object that is compared with it

RESIDUAL_SHARE = 98.0  # percentile of the absolute residual that limits the colour scale

_CHANNELS = {
    "luminance": ("luminance",),
    "rgb": ("red", "green", "blue"),
    "chromaticity": ("log-chromaticity 1", "log-chromaticity 2"),
    "orientation": ("cosine of the gradient's direction", "sine of the gradient's direction"),
    "soft": ("gradient across", "gradient down", "invariant"),
    "invariant": ("invariant",),
}
"""Legend of the channels of each metric."""


def residual_of(fitter: Fitter, image: np.ndarray, result: FitResult) -> tuple[np.ndarray, ColourScale]:
    """Return the channel of a fit's residual with the largest mean square.

    It is (n_pixels, 2) float32: image minus model at the pixels of the model's frame, and whether the image was usable.
    Also return its colour scale.
    """
    fitter = fitter.part_for(result)
    method = result.method
    model = fitter.model
    residual, usable = residual_at(fitter, image, result)
    mean_squares = np.square(residual, dtype=np.float64).mean(axis=0)
    channel = int(np.nan_to_num(mean_squares).argmax())
    values = np.stack([residual[:, channel], usable], axis=1)

    sizes = np.abs(values[values[:, 1] > 0, 0])
    sizes = sizes[np.isfinite(sizes)]
    limit = float(np.percentile(sizes, RESIDUAL_SHARE)) if len(sizes) else 0.0
    names = _CHANNELS.get(method.metric, ())
    what = names[channel] if channel < len(names) else method.metric
    scale: ColourScale = {"limit": max(limit, 1e-6), "what": what}

    frame = fitter.view.warp.frame
    if frame is not model.frame:  # select the model's pixels from those of a larger frame
        columns_and_rows_between = (model.frame.origin - frame.origin).astype(int)
        rows, columns = (model.frame.pixels + columns_and_rows_between[::-1]).T
        values = frame.picture(values)[rows, columns]
    return values, scale


def scaled(result: FitResult, size: tuple[int, int], to: tuple[int, int]) -> FitResult:
    """Convert a fit from one picture size (width, height) to another."""
    if size == to:
        return result
    factor = float(np.sqrt(to[0] * to[1] / (size[0] * size[1])))

    def moved(points: np.ndarray) -> np.ndarray:
        return rescaled(points, (size[1], size[0]), (to[1], to[0]))

    def moved_detection(detection: Detection) -> Detection:
        return replace(
            detection,
            landmarks=moved(detection.landmarks),
            scale=detection.scale * factor,
            others=tuple(moved_detection(other) for other in detection.others),
        )

    return replace(
        result,
        landmarks=moved(result.landmarks),
        landmark_covariances=result.landmark_covariances * factor**2,
        shift=None if result.shift is None else moved(result.landmarks) - moved(result.registered),
        pose=Similarity(result.pose.matrix * factor, moved(result.pose.offset[None])[0]),
        history=tuple(replace(step, landmarks=moved(step.landmarks)) for step in result.history),
        found=None if result.found is None else moved_detection(result.found),
    )


def fit_file(fitter: Fitter, path: Path) -> FitResult:
    """Fit the picture in a file, or a half or a quarter of a large one, and return the result in its pixels."""
    size = image_size(path)
    if work_size(*size) == size:
        return fitter.fit(path)
    image = read_for_work(path)
    return scaled(fitter.fit(image, name=path.name), (image.shape[1], image.shape[0]), size)


def start_at(start: Any, size: tuple[int, int], to: tuple[int, int]) -> Any:
    """Convert a start of a fit, a box or a shape (n, 2), from one picture size (width, height) to another."""
    if size == to:
        return start
    corners = np.reshape(start, (-1, 2))  # of a box, which is left, top, right, bottom
    moved = rescaled(corners, (size[1], size[0]), (to[1], to[0]))
    return tuple(moved.ravel().tolist()) if isinstance(start, tuple) else moved


def residual_layer(
    fitter: Fitter, image: np.ndarray, result: FitResult, to: tuple[int, int]
) -> tuple[np.ndarray, ColourScale]:
    """Draw the residual of a fit at a size (width, height), where the image is usable; also return its colour scale."""
    values, scale = residual_of(fitter, image, result)
    model = fitter.part_for(result).model
    shape = rescaled(result.registered, image.shape[:2], (to[1], to[0]))
    canvas = np.broadcast_to(np.uint8(0), (to[1], to[0], 3))  # takes no memory
    if result.reflected:  # the residual is that of the image reversed left to right
        painted, inside = paint(canvas, reflected_points(shape, to[0]), model, values)
        painted = painted[:, ::-1]
        inside = inside[:, ::-1]
    else:
        painted, inside = paint(canvas, shape, model, values)
    return coloured(painted[..., 0] / scale["limit"], RESIDUAL_COLOURS, inside & (painted[..., 1] > 0.5)), scale


def taken_apart(
    fitter: Fitter, image: np.ndarray, result: FitResult, to: tuple[int, int], raw: bool = False
) -> Relighter:
    """Create the relighter of a fit, which gives sRGB, at a size (width, height) of at most that of the picture.

    ``raw`` says that the picture is of a RAW file: its values are linear light.
    """
    small = averaged(image, to)
    if raw:
        small = linear_to_srgb(stored_values(small)).astype(np.float32)
        fitter = replace(fitter, camera=replace(fitter.camera or fitter.model.camera, response="srgb"))
    return Relighter.of(fitter, small, scaled(result, (image.shape[1], image.shape[0]), to))


def is_even(light: Relighter, flat: np.ndarray) -> bool:
    """Whether the light of a picture is so much as in training that, ``flat`` (h, w, 3), it looks the same."""
    if not light.inside.any():
        return True
    before = light.picture[light.region.box].astype(np.int16)
    changes = np.abs(flat[light.region.box] - before).max(axis=2)[light.covered]
    return not changes.size or bool(np.percentile(changes, CHANGED_SHARE) <= UNSEEN)


def shading_layer(light: Relighter, to: tuple[int, int]) -> np.ndarray:
    """Draw the shading, log of the ratio of the picture to its flat appearance, at a size (width, height)."""
    shading = light.shading()
    inside = np.any(shading != 0, axis=2).astype(np.float32)
    mean = averaged(shading.mean(axis=2), to)
    coverage = averaged(inside, to)  # share of each pixel that has a shading
    mean_inside = mean / np.maximum(coverage, 1e-6)
    return coloured(mean_inside / SHADING_LIMIT, SHADING_COLOURS, coverage > 0.5)


def normals_layer(light: Relighter) -> tuple[np.ndarray, list[float]]:
    """Encode x and y of the normals, and the share of the light of lamps, as (h, w, 3) uint8 in the light's size.

    Also return their part of the picture, (left, top, width, height), as fractions of its sides.
    """
    layer = np.dstack([128 + 127 * light.normals[..., :2], 255 * light.surroundings.share])
    if not layer.size:  # the object is outside the picture, and images have at least a pixel
        layer = np.zeros((1, 1, 3))
    rows, columns = light.region.box
    height, width = light.picture.shape[:2]
    box_width, box_height = light.region.size
    box = [columns.start / width, rows.start / height, box_width / width, box_height / height]
    return np.rint(layer).astype(np.uint8), box


def why_not_flat(fitter: Fitter, image: np.ndarray, result: FitResult) -> str | None:
    """Return why the shading of a fit cannot be computed, or None if it can."""
    method = result.method
    if not np.isfinite(result.landmarks).all():
        return "the fit lost the object, so it has no shading: fit again from a better start"
    if method.appearance not in ("log", "soft"):
        others = "'soft-li', 'li', 'li-pc', 'li-pcs' or 'chroma'"
        return f"method {method.name} does not separate colour from shading: fit with {others}"
    if not fitter.model.is_colour:
        return "the model was trained on grey pictures, but shading needs colour: train on colour pictures"
    if is_grey(image):
        return "the picture is grey, but shading needs colour: use a colour picture"
    return None


def coloured(values: np.ndarray, colours: tuple[tuple[int, int, int], ...], inside: np.ndarray) -> np.ndarray:
    """Map values (h, w) to the colours at -1, 0 and 1, and between them, (h, w, 4) uint8, transparent but ``inside``.

    Values are clipped to -1 to 1. A table of 255 colours is quicker than an interpolation for each pixel.
    """
    places = np.linspace(-1, 1, 255)
    table = np.stack([np.interp(places, (-1, 0, 1), channel) for channel in np.array(colours).T], axis=1)
    index = np.rint((np.clip(np.nan_to_num(values), -1, 1) + 1) * 127).astype(np.uint8)
    colour = np.rint(table).astype(np.uint8)[index]
    opaque = np.full_like(index, 255)
    return np.dstack([colour, opaque]) * inside[..., None]
