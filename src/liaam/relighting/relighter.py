"""Relighting of one fitted image under any number of lights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from liaam.errors import LiaamError, MethodError
from liaam.evaluation import short_repr
from liaam.fitting import FitResult, Fitter
from liaam.fitting.picture import load_picture
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response
from liaam.photometry.encoding import DARK, refuse_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.relighting.appearance import ShadowFree, check_method, shadow_free
from liaam.relighting.extrapolation import around, continued
from liaam.relighting.joint import appearance_in_light
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient, light_of
from liaam.relighting.lamplight import light_on_image, lit_frame, square_around
from liaam.relighting.painting import (
    REACH,
    as_eight_bit,
    box_of,
    eight_bits,
    log_light,
    of_stored,
    paint,
    seen_triangles,
)
from liaam.relighting.relief import normals_of
from liaam.relighting.shading import Seen, Shading, find_shading, stored_noise

LONGEST = 1.5
"""Largest exposure relative to frontal light; a lamp from behind leaves the object dark."""

BRIGHT = math.log(0.6)
"""Logarithm of light from which brightened pixels approach white gradually instead of being clipped."""


@dataclass(frozen=True, eq=False)
class Relighter:
    """A fitted image, separated into appearance under the training light and shading, for relighting.

    Make one with :meth:`of`, which computes everything that does not depend on the new light.

    Attributes
    ----------
    model : AAM
    shape : (n, 2) float64
        Fitted landmarks, image pixels.
    response : Response
        Response of the image's camera.
    picture : (h, w, 3) uint8
        The original image.
    appearance : ShadowFree
        The model's appearance under the training light.
    frame_shading : Shading
        The image's shading on the model's reference frame.
    box : (rows, columns)
        The part of the image that may change; the arrays below cover it.
    log_flat : (bh, bw, 3) float32
        Logarithm of light with the object under the training light, blended into the image around the mesh.
    log_shading : (bh, bw, 3) float32
        Logarithm of the shading that was removed.
    inside : (bh, bw) bool
        Inside the mesh.
    share : (bh, bw, 1) float32
        Weight of a new light: 1 inside the mesh, falling to 0 around it.
    normals : (bh, bw, 3) float32
        Normals of the inflated surface (:func:`liaam.relighting.relief.normals_of`), rotated with the object.
    """

    model: AAM
    shape: np.ndarray
    response: Response
    picture: np.ndarray
    appearance: ShadowFree
    frame_shading: Shading
    box: tuple[slice, slice]
    log_flat: np.ndarray
    log_shading: np.ndarray
    inside: np.ndarray
    share: np.ndarray
    normals: np.ndarray

    __repr__ = short_repr

    @classmethod
    def of(cls, fitter: Fitter, image, result: FitResult, prior: float = 1.0, name: str = "image") -> "Relighter":
        """Separate a fitted image into appearance and shading.

        Parameters
        ----------
        fitter : Fitter
            The fitter of ``result``. Its method is ``soft-li``, or compares logarithms with the ``log`` appearance.
        image : (h, w, 3) uint8, uint16 or float array, or path
            The fitted image.
        result : FitResult
            If its shape lies outside the image or has diverged, the image is left unchanged.
        prior : float
            See :func:`shadow_free`.
        name : str
            Name of the image in errors; for a path its file name is used.

        Raises
        ------
        MethodError
            For a method without the log appearance, for the fitter of another method, and for a grey image.
        """
        check_method(fitter, result)
        fitter = fitter.part_for(result.landmarks)
        (image, name), model = load_picture(image, name), fitter.model
        refuse_grey(image, name, "relighting needs colours; give a colour image", MethodError)
        response = (fitter.camera or model.camera).response
        if not len(seen_triangles(image, result.landmarks, model)):
            return _unchanged(model, image, result.landmarks, response)
        return _separated(model, image, result.landmarks, response, shadow_free(fitter, image, result, prior), prior)

    def flat(self) -> np.ndarray:
        """Return the image with the object under the training light, (h, w, 3) uint8."""
        return self._with(self.log_flat)

    def shading(self) -> np.ndarray:
        """Return the removed shading, (h, w, 3) float32: log(image / flat image), 0 outside the mesh."""
        whole = np.zeros(self.picture.shape, np.float32)
        whole[self.box] = np.where(self.inside[..., None], self.log_shading, 0.0)
        return whole

    def under(self, direction: Sequence[float], ambient: float = AMBIENT) -> np.ndarray:
        """Return the image with the object under a distant lamp, (h, w, 3) uint8; see :meth:`under_lamps`.

        Parameters
        ----------
        direction : (3,) float
            Direction to the lamp: x to the right, y down, z to the viewer; its length does not matter.
        ambient : float
            Fraction of ambient light, 0 to 1.

        Raises
        ------
        LiaamError
            For a zero or non-finite direction, and for ambient light out of range.
        """
        return self.under_lamps([Lamp(direction)], ambient)

    def under_lamps(self, lamps: Sequence[Lamp], ambient: float = AMBIENT) -> np.ndarray:
        """Return the image with the object under several distant lamps, (h, w, 3) uint8.

        Uses Lambert's law on the inflated surface, relative to a frontal lamp: under one white lamp from (0, 0, 1) the
        object is as in :meth:`flat`. A lamp from the side gives less light on average. Half of this loss (in
        logarithms) is compensated by the exposure, up to a factor 1.5, and so is half of the gain of
        several lamps.

        Parameters
        ----------
        lamps : sequence of Lamp
            May be empty: then there is ambient light only.
        ambient : float
            Fraction of white ambient light, 0 to 1.

        Raises
        ------
        LiaamError
            For ambient light out of range.
        """
        check_ambient(ambient)
        if not self.inside.any():
            return self.picture.copy()
        light, frontal = (light_of(given, self.normals, ambient) for given in (lamps, [Lamp((0.0, 0.0, 1.0))]))
        exposure = min(float(frontal[self.inside].mean() / light[self.inside].mean()) ** 0.5, LONGEST)
        return self._with(self.log_flat + self.share * np.log(exposure * light / frontal))

    def like(self, other: "Relighter") -> np.ndarray:
        """Return the image with the object under the light of another fitted image, (h, w, 3) uint8.

        Raises
        ------
        LiaamError
            If the other image was fitted with another model.
        """
        if other.model is not self.model:
            raise LiaamError("the two images were fitted with different models; fit both with the same model")
        light = other.appearance.light
        rest = other.frame_shading.log - lit_frame(self.model, light)
        if not self.inside.size:
            return self.picture.copy()
        values, inside = _painted(self.picture, self.box, self.shape, self.model, rest.astype(np.float32))
        weights = inside[..., None].astype(np.float32)
        nearby, _ = around(values, weights, self.log_flat, reach_of(self.shape))
        shading = self.share * np.where(weights > 0, values, nearby)
        shading += light_on_image(self.model, light, self.shape, self.box, self.inside.shape)
        return self._with(self.log_flat + shading, np.abs(shading).max(axis=2) > 0)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays of the picture."""
        arrays = (self.picture, self.log_flat, self.log_shading, self.inside, self.share, self.normals)
        return sum(array.nbytes for array in arrays)

    def _with(self, log_rgb: np.ndarray, relit: np.ndarray | bool = False) -> np.ndarray:
        """Return the image with new logarithms of light where it was changed, or is relit, (bh, bw) bool."""
        picture = self.picture.copy()
        changed = (self.share[..., 0] > 0) | self.log_shading.any(axis=2) | relit
        picture[self.box][changed] = eight_bits(log_rgb[changed], self.response)
        return picture


def reach_of(shape: np.ndarray) -> float:
    """Return the distance over which a new light fades out around the mesh, pixels."""
    return max(1.0, REACH * diagonal_of(shape))


def _separated(
    model: AAM, image: np.ndarray, shape: np.ndarray, response: Response, start: ShadowFree, prior: float
) -> Relighter:
    """Separate an image on the reference frame, warp the results to the image, and extrapolate them beyond the mesh."""
    seen = Seen.of(model, image, shape, response)
    appearance, log_rgb = appearance_in_light(model, seen, start, prior)
    shading = find_shading(model, seen, log_rgb, appearance.light)
    layers = (log_rgb, shading.log, shading.model_variance, shading.variance, normals_of(model.frame))
    light = appearance.light
    if model.light is None or not len(light):
        box = box_of(shape, 4 * reach_of(shape), image.shape)
    else:
        box = square_around(model.light, shape, image.shape)
    painted, inside = _painted(image, box, shape, model, np.column_stack(layers).astype(np.float32))
    if not inside.any():
        return _unchanged(model, image, shape, response)
    log_model, log_smooth, normals = painted[..., :3], painted[..., 3:6], painted[..., 8:]
    own = log_light(image[box], response)
    # The image's own detail, shrunk by the variances of model and image.
    deviation = noise_deviation(image)
    noise = of_stored(lambda stored: stored_noise(stored, response, deviation), image[box])
    variance = noise + painted[..., 7:8]
    detail = (own - log_model - log_smooth) * painted[..., 6:7] / np.maximum(painted[..., 6:7] + variance, 1e-12)
    detail = of_dark_channels(detail, stored_values(image[box]) <= DARK)
    weights = inside[..., None].astype(np.float32)
    lit = light_on_image(model, light, shape, box, inside.shape)
    beyond = continued(log_smooth - lit, inside, own, reach_of(shape))
    lightened = beyond.mean(axis=2, keepdims=True) < 0
    nearby, share = around(normals, weights, own, reach_of(shape), lightened=lightened)
    taken = np.where(inside[..., None], own - log_model - detail, lit + share * beyond)
    taken = own - below_white(own - taken, own) if len(light) else taken
    pose = align(model.shape_model.mean, shape)
    normals = np.where(inside[..., None], normals, nearby)
    normals[..., :2] = normals[..., :2] @ (pose.matrix / pose.scale).T.astype(np.float32)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
    return Relighter(
        model=model,
        shape=shape,
        response=response,
        picture=as_eight_bit(image),
        appearance=appearance,
        frame_shading=shading,
        box=box,
        log_flat=own - taken,
        log_shading=taken,
        inside=inside,
        share=np.where(inside[..., None], 1.0, share).astype(np.float32),
        normals=normals,
    )


def below_white(log_rgb: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Compress brightened highlights (h, w, 3) below white, keeping their hue; ``own`` is the original light."""
    brightest = log_rgb.max(axis=2, keepdims=True)
    excess = np.maximum(brightest - BRIGHT, 0.0)
    limited = brightest - excess - BRIGHT * (1.0 - np.exp(excess / BRIGHT))
    return log_rgb + np.minimum(np.maximum(limited, own.max(axis=2, keepdims=True)) - brightest, 0.0)


def of_dark_channels(detail: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Replace detail (h, w, 3) of dark channels by the mean of the other channels, or of all if all are dark.

    In a nostril often only red is bright enough, and detail in red alone would turn it cyan.
    """
    known = np.where(dark.all(axis=2, keepdims=True), True, ~dark)
    counts = known.sum(axis=2, keepdims=True, dtype=np.float32)
    return np.where(dark, (detail * known).sum(axis=2, keepdims=True) / counts, detail)


def _painted(
    image: np.ndarray, box: tuple[slice, slice], shape: np.ndarray, model: AAM, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what :func:`paint` gives within a box of the image."""
    return paint(image[box], shape - (box[1].start, box[0].start), model, values)


def _unchanged(model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> Relighter:
    """Return a relighter that leaves the image unchanged, for fits outside it or diverged."""
    known = model.levels[-1].appearances["log"]
    appearance = ShadowFree(known.mean, np.zeros(known.n_modes), np.sqrt(known.eigenvalues))
    zeros, none = np.zeros(model.n_pixels, np.float32), np.zeros((0, 0, 3), np.float32)
    shading, box = Shading(np.zeros_like(known.mean), zeros, zeros), (slice(0, 0), slice(0, 0))
    return Relighter(
        model,
        shape,
        response,
        as_eight_bit(image),
        appearance,
        shading,
        box,
        log_flat=none,
        log_shading=none,
        inside=np.zeros((0, 0), bool),
        share=none[..., :1],
        normals=none,
    )
