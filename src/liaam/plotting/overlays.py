"""Overlays of landmarks, contours, meshes, ellipses and label faults on images.

Lines, dots and letters are bright with a dark edge, so that they can be seen on any ground.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from liaam.datasets.label_faults import LabelFault
from liaam.drawing import ABSENT, ELLIPSE, LANDMARK, LOST, as_picture, ellipses as outlines_of, line_of, rgb
from liaam.model import AAM
from liaam.model.contours import Contours

if TYPE_CHECKING:
    from liaam.fitting import FitResult

EXPECTED = "#ffdc40"  # Colour of the expected positions of faulty landmarks
DARK = (0, 0, 0)  # Colour of the edges
BRIGHT = (255, 255, 255)  # Colour of letters

LARGE = 1000  # Larger side in pixels to which small images are about enlarged
LARGE_FRAME = 700  # That of frames of a video, which take longer to write
# OpenCV draws between pixel centres with fixed-point numbers, of so many bits after the point.
FRACTION_BITS = 4
ONE = 2**FRACTION_BITS  # A pixel in these numbers
FARTHEST = 1e6  # Largest coordinate in pixels that is drawn, so that these numbers do not overflow
SMALLEST_RADIUS = 1.2  # Of a dot beside lines of one pixel, in pixels
SMALLEST_LETTERS = 11  # Size of the smallest letters in pixels
_IN_FONT = str.maketrans({"–": "-", "−": "-"})  # Signs that Pillow's font lacks
OPACITY = 0.75  # Of ellipses and meshes, which are less important than the landmarks below them
NEIGHBOURS = 4  # Nearest landmarks of a landmark, from which its label is moved away

Lines = list[np.ndarray]
"""Lines through points (m, 2), pixels."""


def enlarged(image: np.ndarray, large: int = LARGE) -> tuple[np.ndarray, int]:
    """Return a copy of an image to draw on, (h', w', 3) uint8, enlarged if small, and the zoom factor."""
    picture = as_picture(image)
    zoom = max(1, round(large / max(picture.shape[:2])))
    if zoom == 1:
        return picture.copy(), 1
    return cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), zoom


def overlay(
    image: np.ndarray,
    shape: np.ndarray,
    model: AAM,
    covariances: np.ndarray | None = None,
    *,
    colour: str = LANDMARK,
    labels: Sequence[str] = (),
    mesh: bool = False,
    caption: str = "",
    large: int = LARGE,
    absent: np.ndarray | None = None,
) -> np.ndarray:
    """Draw a fitted shape on its image.

    Parameters
    ----------
    image : (h, w, 3) array
    shape : (n, 2) float
        Landmarks in image pixels.
    model : AAM
        Model with the contours and the mesh.
    covariances : (n, 2, 2) float, optional
        Covariances of the landmarks in square pixels, drawn as 95 % confidence ellipses.
    colour : str
        Colour of the landmarks and contours, such as ``#40ff8c``.
    labels : sequence of str
        Texts beside the landmarks, such as their numbers.
    mesh : bool
        Whether to draw the triangles between the landmarks.
    caption : str
        Text in the corner at the bottom left, after a dot of the colour.
    large : int
        Larger side in pixels to which a small image is about enlarged, by a whole factor.
    absent : (n,) bool, optional
        Landmarks that are not there, drawn as red rings.

    Returns
    -------
    (h', w', 3) uint8
        The image, enlarged if small so that the lines do not cover it.
    """
    picture, zoom = enlarged(image, large)
    points = (shape + 0.5) * zoom - 0.5
    if mesh:
        _draw_mesh(picture, points, model.triangles, colour)
    spread = None if covariances is None else zoom**2 * np.asarray(covariances)
    draw_shape(picture, points, model.contours, spread, colour, absent)
    if labels:
        picture = _with_labels(picture, points, labels)
    if caption:
        write_caption(picture, caption, colour)
    return picture


def overlay_of_fit(
    image: np.ndarray,
    result: "FitResult",
    model: AAM,
    *,
    ellipses: bool = False,
    labels: Sequence[str] = (),
    mesh: bool = False,
) -> np.ndarray:
    """Draw a fit on its image, green if it may be used, amber if it is doubtful and red if it failed.

    The status and the quality, and the side of the object if there are two, are in a corner. The parameters are those
    of :func:`overlay`; ``ellipses`` says whether to draw those of the landmarks, which a failed fit does not have.
    """
    covariances = result.landmark_covariances if ellipses and not result.status.lost else None
    look = {"labels": labels, "mesh": mesh, "colour": result.status.colour, "caption": caption_of(result)}
    return overlay(image, result.landmarks, model, covariances, absent=result.absent, **look)


def caption_of(result: "FitResult") -> str:
    """Return the status and the quality of a fit in a few words, and the side of the object if the model has two."""
    if result.status.lost:
        return f"failed: {result.status}"
    remedy = "" if result.status.ok else ": check it"
    side = f", {result.side}" if result.side else ""
    return f"{result.status}, quality {result.quality_text}{side}{remedy}"


def draw_shape(
    picture: np.ndarray,
    points: np.ndarray,
    contours: Contours = (),
    covariances: np.ndarray | None = None,
    colour: str = LANDMARK,
    absent: np.ndarray | None = None,
    thinnest: int = 1,
) -> None:
    """Draw landmarks (n, 2) with their contours and 95 % ellipses on a picture (h, w, 3) uint8, in place.

    Of ``absent`` ones, (n,) bool, rings are drawn. Lines are at least ``thinnest`` pixels thick, and dots as
    much larger.
    """
    points = _within_reach(points)
    thick = max(thinnest, _thickness(picture, points))
    if covariances is not None:
        rings = outlines_of(points, np.asarray(covariances))
        closed_rings = list(np.concatenate([rings, rings[:, :1]], axis=1))
        _draw_faintly(picture, closed_rings, ELLIPSE, max(1, thick // 2))
    draw_lines(picture, [line_of(points, indices, closed) for indices, closed in contours], colour, thick)
    radius = max(_radius(picture, points), thinnest * SMALLEST_RADIUS)
    is_absent = np.zeros(len(points), bool) if absent is None else absent
    draw_dots(picture, points[~is_absent], colour, radius)
    draw_rings(picture, points[is_absent], ABSENT, 2.0 * radius, thick)


def _within_reach(points: np.ndarray) -> np.ndarray:
    """Return points (n, 2) that can be drawn; those of a failed fit may be anywhere."""
    return np.clip(np.nan_to_num(points), -FARTHEST, FARTHEST)


def _extent(picture: np.ndarray, points: np.ndarray) -> float:
    """Return the larger side of the box around points in pixels, at least 1 and at most four times the picture's."""
    return float(np.clip(np.ptp(points, axis=0).max(initial=0.0), 1.0, 4 * max(picture.shape[:2])))


def _thickness(picture: np.ndarray, points: np.ndarray) -> int:
    """Return the thickness of lines: seen on the object, and where the picture is shown in some 800 pixels."""
    return max(1, round(_extent(picture, points) / 300), round(max(picture.shape[:2]) / 800))


def _radius(picture: np.ndarray, points: np.ndarray) -> float:
    """Return the radius of dots in pixels. They are as thick lines are, but must not merge."""
    wanted = max(_extent(picture, points) / 180, max(picture.shape[:2]) / 400)
    return max(SMALLEST_RADIUS, min(wanted, 0.4 * _spacing(points)))


def _spacing(points: np.ndarray) -> float:
    """Return the lower quartile of the distances of points (n, 2) to their nearest neighbours."""
    if len(points) < 2:
        return np.inf
    return float(np.quantile(np.sort(_distances(points), axis=1)[:, 1], 0.25))


def _distances(points: np.ndarray) -> np.ndarray:
    """Return the distances (n, n) between points."""
    return np.linalg.norm(points[:, None] - points, axis=2)


def draw_lines(picture: np.ndarray, lines: Lines, colour: str, thickness: int) -> None:
    """Draw lines with dark edges on a picture, in place."""
    fixed = [np.rint(np.clip(line * ONE, -(2**30), 2**30)).astype(np.int32) for line in lines]
    edge = thickness + 2 * max(1, thickness // 2)
    for paint, width in ((DARK, edge), (rgb(colour), thickness)):
        cv2.polylines(picture, fixed, False, paint, width, cv2.LINE_AA, FRACTION_BITS)


def draw_dots(picture: np.ndarray, points: np.ndarray, colour: str, radius: float) -> None:
    """Draw dots with dark edges at points (n, 2) on a picture, in place."""
    edge = max(1.0, 0.4 * radius)
    for paint, size in ((DARK, radius + edge), (rgb(colour), radius)):
        for x, y in np.rint(points * ONE).astype(int).tolist():
            cv2.circle(picture, (x, y), int(ONE * size), paint, -1, cv2.LINE_AA, FRACTION_BITS)


def draw_rings(picture: np.ndarray, points: np.ndarray, colour: str, radius: float, thickness: int) -> None:
    """Draw rings with dark edges around points (n, 2) on a picture, in place."""
    for paint, width in ((DARK, thickness + 2 * max(1, thickness // 2)), (rgb(colour), thickness)):
        for x, y in np.rint(points * ONE).astype(int).tolist():
            cv2.circle(picture, (x, y), int(ONE * radius), paint, width, cv2.LINE_AA, FRACTION_BITS)


def _draw_faintly(picture: np.ndarray, lines: Lines, colour: str, thickness: int) -> None:
    """Draw slightly transparent lines with dark edges on a picture, in place."""
    before = picture.copy()
    draw_lines(picture, lines, colour, thickness)
    cv2.addWeighted(picture, OPACITY, before, 1 - OPACITY, 0, dst=picture)


def _draw_mesh(picture: np.ndarray, points: np.ndarray, triangles: np.ndarray, colour: str) -> None:
    """Draw the edges of triangles (k, 3) of points (n, 2) on a picture, slightly transparent, in place."""
    points = _within_reach(points)
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    _draw_faintly(picture, list(points[edges]), colour, max(1, _thickness(picture, points) // 2))


def _with_labels(picture: np.ndarray, points: np.ndarray, labels: Sequence[str]) -> np.ndarray:
    """Return a picture with a text beside each point, on the side where fewer other points are."""
    points = _within_reach(points)
    # Seen where the picture is shown in some 800 pixels, unless that covers the neighbours.
    wanted = min(max(picture.shape[:2]) / 64, _spacing(points))
    size = max(SMALLEST_LETTERS, _extent(picture, points) / 40, wanted)
    nearest = np.argsort(_distances(points), axis=1)[:, 1 : 1 + NEIGHBOURS]
    away = points - points[nearest].mean(axis=1) if nearest.size else np.zeros(points.shape)
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    directions = np.where(lengths > 0, away / np.maximum(lengths, 1e-9), (0.0, -1.0))
    return with_texts(picture, points + (_radius(picture, points) + 0.7 * size) * directions, labels, size)


def with_texts(picture: np.ndarray, places: np.ndarray, texts: Iterable[str], size: float) -> np.ndarray:
    """Return a picture with texts around places (n, 2); their letters are bright, with dark edges."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    font = _font(round(size))
    edge = max(1, round(size / 8))
    for (x, y), text in zip(places.tolist(), texts, strict=True):
        draw.text((x, y), text, font=font, fill=BRIGHT, anchor="mm", stroke_width=edge, stroke_fill=DARK)
    return np.array(image)


def write_caption(picture: np.ndarray, text: str, colour: str) -> None:
    """Write a text after a dot of a colour on a dark band at the bottom left of a picture, in place.

    What is too long for a line of the smallest letters continues in the next.
    """
    from PIL import Image, ImageDraw

    text = text.translate(_IN_FONT)
    size = max(SMALLEST_LETTERS, round(max(picture.shape[:2]) / 36))
    while size > SMALLEST_LETTERS and _width_of_caption(text, size) > picture.shape[1]:
        size -= 1
    font = _font(size)
    pad = size // 2
    lines = _lines_of_caption(text, size, picture.shape[1])
    step = round(font.getbbox("Ag")[3]) + pad
    height = min(step * len(lines), picture.shape[0])
    corner = picture[picture.shape[0] - height :, : max(_width_of_caption(line, size) for line in lines)]
    band = Image.fromarray((0.25 * corner).astype(np.uint8))
    draw = ImageDraw.Draw(band)
    middle = step // 2
    radius = max(2, round(0.28 * size))
    draw.ellipse((pad, middle - radius, pad + 2 * radius, middle + radius), fill=rgb(colour))
    for i, line in enumerate(lines):
        draw.text((pad + size, middle + i * step), line, font=font, fill=BRIGHT, anchor="lm")
    corner[:] = np.asarray(band)


def _lines_of_caption(text: str, size: int, width: int) -> list[str]:
    """Break a caption in letters of a size at blanks into lines that are as wide as a picture, pixels."""
    first, *words = text.split(" ")
    lines = [first]
    for word in words:
        longer = f"{lines[-1]} {word}"
        if _width_of_caption(longer, size) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _width_of_caption(text: str, size: int) -> int:
    """Return the width of a caption in letters of a size, with its dot and margins."""
    return round(_font(size).getlength(text)) + 2 * (size // 2) + size


@cache
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def thumbnail(image: np.ndarray, result: "FitResult", size: int) -> np.ndarray:
    """Draw a fit on a small picture of its object, or if it failed of the whole image.

    Parameters
    ----------
    image : (h, w, 3) array
    result : FitResult
    size : int
        Larger side of the picture in pixels.

    Returns
    -------
    (h', w', 3) uint8
    """
    points = result.landmarks
    whole = np.array(image.shape[1::-1])
    low = np.zeros(2, int)
    high = whole
    if not result.status.lost and np.isfinite(points).all():
        margin = 0.4 * float(np.ptp(points, axis=0).max(initial=0.0)) + 4
        low = np.clip(np.floor(points.min(axis=0) - margin), 0, whole - 1).astype(int)
        high = np.clip(np.ceil(points.max(axis=0) + margin), low + 1, whole).astype(int)
    # Drawn at twice the size, since lines of one pixel would be hidden by their dark edges, which are not thinner.
    scale = 2 * size / float((high - low).max())
    width, height = np.maximum(np.rint((high - low) * scale), 2).astype(int).tolist()
    part = as_picture(image[low[1] : high[1], low[0] : high[0]])
    picture = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    shape = (points - low + 0.5) * scale - 0.5
    draw_shape(picture, shape, result.contours, colour=result.status.colour, absent=result.absent, thinnest=2)
    return cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA)


def overlay_of_faults(image: np.ndarray, points: np.ndarray, faults: Sequence[LabelFault]) -> np.ndarray:
    """Draw landmarks on their image, faulty ones in red and numbered, with yellow lines to their expected positions.

    The faults are described in the corner. Without any, all landmarks are numbered.

    Parameters
    ----------
    image : (h, w, 3) array
    points : (n, 2) float
        Landmarks in image pixels; NaN where missing, which are not drawn.
    faults : sequence of LabelFault
        Faults of this image; may be empty.

    Returns
    -------
    (h', w', 3) uint8
        The surroundings of the landmarks, enlarged.
    """
    is_known = np.asarray(np.isfinite(points).all(axis=1))
    known = points[is_known]
    margin = 0.15 * np.ptp(known, axis=0).max() + 5
    size_of_image = np.array(image.shape[1::-1])
    low = np.clip(np.floor(known.min(axis=0) - margin), 0, size_of_image).astype(int)
    high = np.clip(np.ceil(known.max(axis=0) + margin), 0, size_of_image).astype(int)
    if (high - low < 8).any():  # the landmarks are outside the image
        low = np.zeros(2, int)
        high = size_of_image
    picture, zoom = enlarged(image[low[1] : high[1], low[0] : high[0]])

    def at(places: np.ndarray) -> np.ndarray:
        """Return the places in the picture of places (k, 2) of the image."""
        return _within_reach((places - low + 0.5) * zoom - 0.5)

    size = max(picture.shape[:2]) / LARGE
    radius = max(2.0, 5 * size)
    faulty = sorted({i for fault in faults for i in fault.points if is_known[i]})
    moves = [at(np.stack([points[i], fault.expected[i]])) for fault in faults for i in fault.points if is_known[i]]
    draw_lines(picture, moves, EXPECTED, max(1, round(2 * size)))
    draw_dots(picture, np.array([end for _, end in moves]).reshape(-1, 2), EXPECTED, 0.7 * radius)
    draw_dots(picture, at(known), LANDMARK, radius)
    draw_dots(picture, at(points[faulty]), LOST, radius)
    numbered = faulty if faults else np.flatnonzero(is_known).tolist()
    numbers = [str(i + 1) for i in numbered]
    picture = with_texts(picture, at(points[numbered]) + 3.5 * radius * np.array([1.0, -1.0]), numbers, 20 * size)
    if faults:
        write_caption(picture, "; ".join(fault.message for fault in faults), LOST)
    return picture
