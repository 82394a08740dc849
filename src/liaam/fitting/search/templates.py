"""What the search compares: gradient orientations of an image, and templates of them made from a reduced model.

Templates are the orientations that the reduced model expects in several rotations, and with the strongest shape mode at
both ends. Orientations hardly depend on the light, and every model has them, also one of grey images.
"""

from dataclasses import dataclass, replace

import numpy as np

from liaam import _core
from liaam.errors import MethodError
from liaam.model import AAM, MESH, Level, View
from liaam.model.appearance import AppearanceModel
from liaam.model.mesh import ReferenceFrame, signed_areas
from liaam.model.shape import ShapeModel, diagonal_of, rotation
from liaam.model.warp import PiecewiseAffineWarp
from liaam.photometry import Response
from liaam.photometry.encoding import value_luminance

# What was measured for these is in experiments/notes/engine.md.
TEMPLATE = 40.0  # diagonal of the reduced model, pixels
AVERAGED = 0.5  # standard deviation of the average of which a pixel of the reduced model is made, in its pixels

# Rotations of the mean shape, degrees, for objects about as in training and for any rotation, and of deformed shapes.
# These are deformed along the strongest shape mode by so many standard deviations, if that moves the landmarks by so
# many pixels of the reduced model (root mean square).
TURNS: dict[str, tuple[float, ...]] = {
    "upright": (-20.0, -10.0, 0.0, 10.0, 20.0),
    "all": tuple(np.arange(-180.0, 180.0, 15.0).tolist()),
}
BENT_TURNS: dict[str, tuple[float, ...]] = {
    "upright": (-10.0, 0.0, 10.0),
    "all": tuple(np.arange(-180.0, 180.0, 30.0).tolist()),
}
BEND = 1.5
BEND_WORTH = 0.4

# Luminance gradient per pixel of the reduced model, as a fraction of the image's contrast, at which orientations get
# 0.7 of their full length. It suppresses noise in flat regions and smooth shading.
SOFTNESS = 0.02
SAMPLES = 20_000  # pixels, about, from which an image's contrast is measured
CONTRASTS = (0.3, 1.0)  # limits on the measured contrast, so that flat images are not amplified further


@dataclass(frozen=True, eq=False)
class OrientationTemplate:
    """Gradient orientations that the reduced model expects, or a learnt filter on them."""

    # (c, h, w) float32: the first c of the channels of `channels_of`, shorter than 1 where the orientation varies; 0
    # outside the mesh.
    field: np.ndarray
    origin: np.ndarray  # (2,) position of the first pixel relative to the shape's centre, pixels
    turn: float  # rotation, radians
    p: np.ndarray  # (m + 4,) shape parameters of the reduced model
    part: int = 0  # index of the model's part


@dataclass(frozen=True, eq=False)
class Field:
    """Gradient orientations of an image at one resolution."""

    values: np.ndarray  # (h, w) complex64: cosine and sine, shorter than 1 where the gradient is weak
    length: np.ndarray  # (2,) width and height of a pixel of the field, image pixels

    @property
    def scale(self) -> float:
        """Image pixels per pixel of the field."""
        return float(np.sqrt(self.length.prod()))

    def to_image(self, points: np.ndarray) -> np.ndarray:
        """Convert pixels of the field to image pixels, (k, 2) float64."""
        return (points + 0.5) * self.length - 0.5

    def strength(self, points: np.ndarray) -> np.ndarray:
        """Return the weight of the orientation at image points (k, 2), (k,) float32; 0 outside."""
        import cv2  # heavy: imported when first needed

        at = ((points + 0.5) / self.length - 0.5).astype(np.float32)
        size = np.array(self.values.shape[::-1])
        # OpenCV samples no picture with a side of 32767 pixels or more, so what lies around the points is cut out.
        left, top = np.clip(np.floor(at.min(axis=0)), 0, size - 1).astype(int)
        right, bottom = np.clip(np.floor(at.max(axis=0)) + 2, 1, size).astype(int)
        x, y = (at - np.array([left, top], np.float32)).T[:, :, None]
        return cv2.remap(np.abs(self.values[top:bottom, left:right]), x, y, cv2.INTER_LINEAR)[:, 0]


@dataclass(frozen=True, eq=False)
class Grey:
    """Reduced luminance of an image, from which fields are made."""

    values: np.ndarray  # (h, w) float32, from 0 to 1
    reduce: int  # image pixels per pixel, along each axis

    @staticmethod
    def of(image: np.ndarray, response: Response, factor: float) -> "Grey":
        """Make the luminance of an image (h, w, 3), reduced by about ``factor`` but at least eight pixels across."""
        reduce = max(1, min(int(factor), min(image.shape[:2]) // 8))
        # Sixteen samples of a block suffice, so large images need not be decoded in full.
        stride = max(1, reduce // 4)
        reduce //= stride
        sparse = image[stride // 2 :: stride, stride // 2 :: stride]
        grey = value_luminance(sparse, response)
        if reduce > 1:
            rows = grey.shape[0] // reduce
            columns = grey.shape[1] // reduce
            grey = _core.area_means(np.ascontiguousarray(grey[: rows * reduce, : columns * reduce]), rows, columns)
        every = max(1, min(int(np.sqrt(grey.size / SAMPLES)), min(grey.shape) // 4))
        low, high = np.percentile(grey[::every, ::every], [1, 99]).astype(np.float32)
        np.clip(grey, low, high, out=grey)
        grey /= np.clip(high - low, *np.asarray(CONTRASTS, np.float32))
        return Grey(grey, reduce * stride)

    def field(self, size: float, small: AAM) -> Field:
        """Compute the orientations at the resolution where objects of ``size`` image pixels match the reduced model."""
        import cv2  # heavy: imported when first needed

        grey = self.values
        covered = np.array(grey.shape[::-1]) * self.reduce  # an incomplete block at the border was dropped
        width, height = np.maximum(np.rint(covered * (small.diagonal / size)), 8).astype(int)
        if width <= grey.shape[1] and height <= grey.shape[0]:
            resized = _core.area_means(np.ascontiguousarray(grey, np.float32), int(height), int(width))
        else:
            resized = cv2.resize(grey, (int(width), int(height)), interpolation=cv2.INTER_LINEAR)
        return Field(soft_directions(resized, small.levels[0].blur), covered / (width, height))


def channels_of(directions: np.ndarray, count: int) -> np.ndarray:
    """Return what the search compares of softly normalised gradients (h, w) complex, (count, h, w) float32.

    The first two channels are their cosines and sines. A count of 5 adds those of the doubled angle, as long, and the
    lengths: an edge has the same doubled angle whichever of its sides is the brighter one.
    """
    lengths = np.abs(directions)
    doubled = np.square(directions) / np.maximum(lengths, 1e-6)
    channels = [directions.real, directions.imag, doubled.real, doubled.imag, lengths]
    return np.stack(channels[:count]).astype(np.float32)


def turned_channels(channels: np.ndarray, turn: float) -> np.ndarray:
    """Return channels (c, h, w) of orientations that are turned by an angle in radians, each in its place."""
    turned = channels.copy()
    for first, multiple in ((0, 1), (2, 2)):
        if len(channels) >= first + 2:
            pair = (channels[first] + 1j * channels[first + 1]) * np.exp(1j * multiple * turn)
            turned[first : first + 2] = pair.real, pair.imag
    return turned


def soft_directions(grey: np.ndarray, blur: float) -> np.ndarray:
    """Compute softly normalised gradients, g / sqrt(|g|^2 + softness^2), (h, w) complex64, of an image (h, w) float32.

    It is blurred first, by a standard deviation of ``blur`` pixels.
    """
    import cv2  # heavy: imported when first needed

    if blur > 0.3:
        grey = cv2.GaussianBlur(grey, (0, 0), float(blur), borderType=cv2.BORDER_REPLICATE)
    grey = np.ascontiguousarray(grey, np.float32)
    return _core.soft_directions(grey, (1.0, 0.0, 0.0, 1.0), SOFTNESS).view(np.complex64)[..., 0]


def spectra(fields: np.ndarray, first: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Return Fourier transforms of fields (k, h, w) padded to a size, (k, 2, *size) float32: real, imaginary part.

    The fields are real or complex. Their first pixel comes to the row and column ``first``.
    """
    import cv2  # heavy: imported when first needed

    height, width = fields.shape[1:]
    top, left = first
    padded = np.zeros((len(fields), *size), np.complex64)  # of real fields, too: OpenCV takes twice as long for these
    padded[:, top : top + height, left : left + width] = fields
    parts = np.empty((len(fields), 2, *size), np.float32)
    for values, part in zip(padded, parts, strict=True):
        spectrum = values.view(np.float32).reshape(*size, 2)
        cv2.dft(spectrum, spectrum)
        cv2.split(spectrum, list(part))
    return parts


def is_searchable(model: AAM) -> bool:
    """Return whether a model has the gradient orientations that the search needs."""
    return "search" in model.levels[0].appearances


def shrink(model: AAM) -> AAM:
    """Reduce a model to the orientations of its coarsest level, on a smaller reference frame, if its own is larger.

    The result has one level and one appearance, ``orientation``. Without orientations MethodError is raised.
    """
    level = model.levels[0]
    if not is_searchable(model):
        raise MethodError(
            "the model has no gradient orientations, which the search needs; train it again, or give a start (--init)"
        )
    learnt = level.appearances["search"]
    shapes = model.shape_model
    factor = min(1.0, TEMPLATE / model.diagonal)
    frame = ReferenceFrame(shapes.mean * factor, model.triangles)
    at = (frame.pixels[:, ::-1] + frame.origin) / factor
    mask = learnt.mask

    def reduced(values: np.ndarray) -> np.ndarray:
        return _read(model.frame, values, mask, at, AVERAGED / factor if factor < 1.0 else 0.0)

    appearance = AppearanceModel(
        mean=reduced(learnt.mean),
        modes=np.array([reduced(mode) for mode in learnt.modes], np.float32).reshape(-1, len(at), 2),
        eigenvalues=learnt.eigenvalues,
        usable=np.clip(reduced(learnt.usable[:, None])[:, 0], 0.0, 1.0),
    )
    small = ShapeModel(frame.points, shapes.modes, shapes.eigenvalues * factor**2).seen_at(level.blur * factor)
    view = View(PiecewiseAffineWarp(frame, small), (Level(level.blur * factor, {"orientation": appearance}),))
    return replace(model, views={MESH: view})


def pixels_for_search(warp: PiecewiseAffineWarp) -> np.ndarray:
    """Return a mask of the pixels that the search needs of a model: they are averaged when it is reduced."""
    mask = np.zeros(warp.frame.n_pixels, bool)
    mask[warp.every(AVERAGED * diagonal_of(warp.rest) / TEMPLATE)] = True
    return mask


def _read(frame: ReferenceFrame, values: np.ndarray, mask: np.ndarray, at: np.ndarray, blur: float) -> np.ndarray:
    """Interpolate per-pixel values (n_pixels, c), known at a mask, at points (m, 2), after a blur by pixels, (m, c)."""
    import cv2  # heavy: imported when first needed

    # The last channel measures which fraction of an average is known and inside the mesh.
    picture = frame.picture(np.column_stack([values, mask]))
    if blur:
        picture = cv2.GaussianBlur(picture, (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
    x, y = (at - frame.origin).astype(np.float32).T[:, :, None]
    channels = [
        cv2.remap(np.ascontiguousarray(part), x, y, cv2.INTER_LINEAR)[:, 0] for part in np.moveaxis(picture, 2, 0)
    ]
    return (np.stack(channels[:-1], axis=1) / np.maximum(channels[-1], 1e-6)[:, None]).astype(np.float32)


def make_templates(small: AAM, rotations: str = "upright") -> tuple[OrientationTemplate, ...]:
    """Make the templates of a reduced model: mean and deformed shapes in several rotations."""
    shapes = small.shape_model
    straight = np.zeros(len(shapes.basis))
    templates = [_template(small, np.deg2rad(turn), straight) for turn in TURNS[rotations]]
    if not len(shapes.eigenvalues) or BEND * np.sqrt(shapes.eigenvalues[0] / shapes.n_points) < BEND_WORTH:
        return tuple(templates)
    for bend in (-BEND, BEND):
        p = straight.copy()
        p[0] = bend * np.sqrt(shapes.eigenvalues[0])
        if (signed_areas(shapes.shape(p), small.triangles) > 0).all():
            templates += [_template(small, np.deg2rad(turn), p) for turn in BENT_TURNS[rotations]]
    return tuple(templates)


def rotated_filters(values: np.ndarray, rotations: str, small: AAM) -> tuple[OrientationTemplate, ...]:
    """Make templates of a learnt filter (h, w, c), of the mean shape in several rotations."""
    import cv2  # heavy: imported when first needed

    height, width = values.shape[:2]
    centre = 0.5 * np.array([width - 1, height - 1])
    size = max(height, width)
    middle = 0.5 * np.array([size - 1, size - 1])
    straight = np.zeros(len(small.shape_model.basis))
    filters = []
    for turn in np.deg2rad(TURNS[rotations]):
        back = rotation(-turn)
        affine = np.column_stack([back, centre - back @ middle])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        channels = [np.ascontiguousarray(channel) for channel in np.moveaxis(values, 2, 0)]
        moved = np.stack([cv2.warpAffine(channel, affine, (size, size), flags=flags) for channel in channels])
        filters.append(OrientationTemplate(turned_channels(moved, turn), -middle, float(turn), straight))
    return tuple(filters)


def _template(small: AAM, turn: float, p: np.ndarray) -> OrientationTemplate:
    frame = ReferenceFrame(small.shape_model.shape(p) @ rotation(turn).T, small.triangles)
    at = np.einsum("nv,nvc->nc", frame.weights, small.shape_model.mean[frame.vertices])
    everywhere = np.ones(small.frame.n_pixels, bool)
    mean = _read(small.frame, small.levels[0].appearances["orientation"].mean, everywhere, at, 0.0)
    channels = np.moveaxis(frame.picture(mean), 2, 0).astype(np.float32)
    return OrientationTemplate(turned_channels(channels, turn), frame.origin, turn, p)
