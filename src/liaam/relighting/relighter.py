"""Relighting of one fitted image under any number of lights."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.errors import LiaamError, MethodError
from liaam.evaluation import short_repr
from liaam.fitting import FitResult, Fitter
from liaam.fitting.picture import load_picture
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response
from liaam.photometry.encoding import SATURATED, refuse_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.relighting.appearance import ShadowFree, check_method, shadow_free
from liaam.relighting.basis import light_on_frame, light_on_image, square_around
from liaam.relighting.extrapolation import around, carried
from liaam.relighting.joint import appearance_in_light
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient, light_of
from liaam.relighting.painting import (
    REACH,
    as_eight_bit,
    box_of,
    eight_bits,
    log_light,
    paint,
    seen_triangles,
)
from liaam.relighting.relief import normals_of
from liaam.relighting.seen import Seen, noise_variance
from liaam.relighting.shading import Shading, find_shading

LONGEST = 1.5
"""Largest exposure relative to frontal light; a lamp from behind leaves the object dark."""

MOST_NOISE = 3.0
"""Largest amplification of the noise of stored values."""

GRAIN = 1.0
"""Standard deviation of the Gaussian that separates noise, pixels."""

CLIPPED_REACH = 0.1
"""Width of the transition to clipped highlights, which keep their light, in reaches."""

LEAST_CHANGE = 1e-4
"""Change of log light that counts as one."""

BRIGHT = math.log(0.6)
"""Logarithm of light from which brightened pixels approach white gradually instead of being clipped."""


@dataclass(frozen=True, eq=False)
class Relighter:
    """A fitted image, and its light relative to the training light, for relighting.

    The image is divided by its light and multiplied with another; nothing else changes. Make one with :meth:`of`, which
    computes everything that does not depend on the new light.

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
        The image's light on the model's reference frame.
    box : (rows, columns)
        The part of the image that may change; the arrays below cover it.
    log_flat : (bh, bw, 3) float32
        Logarithm of light with the object under the training light.
    log_own : (bh, bw, 3) float32
        That of the image.
    grain : (bh, bw, 3) float32
        The part of ``log_own`` that may be noise.
    deviation : (bh, bw) float32
        Standard deviation of the logarithm of the light that was removed, inside the mesh.
    inside : (bh, bw) bool
        Inside the mesh.
    share : (bh, bw, 1) float32
        Weight of a new light: 1 inside the mesh, falling to 0 around it.
    belongs : (bh, bw, 1) float32
        Weight of the light of a basis, which also knows the surroundings: 1 on the object, 0 in the background.
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
    log_own: np.ndarray
    grain: np.ndarray
    deviation: np.ndarray
    inside: np.ndarray
    share: np.ndarray
    belongs: np.ndarray
    normals: np.ndarray

    __repr__ = short_repr

    @classmethod
    def of(
        cls,
        fitter: Fitter,
        image,
        result: FitResult,
        prior: float = 1.0,
        name: str = "image",
        steadied: Callable[[Shading], Shading] | None = None,
    ) -> "Relighter":
        """Estimate the light of a fitted image.

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
        steadied : callable, optional
            Called with the estimated light; its result is used instead, as for the frames of a video.

        Raises
        ------
        MethodError
            For a method without the log appearance, for the fitter of another method, and for a grey image.
        """
        check_method(fitter, result)
        fitter = fitter.part_for(result)
        (image, name), model = load_picture(image, name), fitter.model
        refuse_grey(image, name, "relighting needs colours; give a colour image", MethodError)
        response = (fitter.camera or model.camera).response
        if not len(seen_triangles(image, result.landmarks, model)):
            return _unchanged(model, image, result.landmarks, response)
        start = shadow_free(fitter, image, result, prior)
        return _separated(model, image, result.landmarks, response, start, prior, steadied)

    def flat(self) -> np.ndarray:
        """Return the image with the object under the training light, (h, w, 3) uint8."""
        return self._with(self.log_flat)

    def shading(self) -> np.ndarray:
        """Return the removed shading, (h, w, 3) float32: log(image / flat image), 0 outside the mesh."""
        whole = np.zeros(self.picture.shape, np.float32)
        whole[self.box] = np.where(self.inside[..., None], self.log_own - self.log_flat, 0.0)
        return whole

    def certainty(self) -> np.ndarray:
        """Return how well the removed light is known, (h, w) float32: 0 to 1 inside the mesh, NaN outside it.

        It is exp(-d), where d is the standard deviation of the logarithm of the light: 0.8 means to about 20 %. It is
        lower where noise would have been amplified more than three times.
        """
        whole = np.full(self.picture.shape[:2], np.nan, np.float32)
        noisy = np.minimum(MOST_NOISE / self._amplified(self.log_flat), 1.0)
        whole[self.box] = np.where(self.inside, np.exp(-self.deviation) * noisy, np.nan)
        return whole

    @cached_property
    def certain(self) -> float:
        """Mean certainty inside the mesh; 0 if the object is outside the image."""
        return float(np.nanmean(self.certainty())) if self.inside.any() else 0.0

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
        if not self.inside.any():
            return self.picture.copy()
        light, rest = other.frame_shading.coordinates, other.frame_shading.log
        if self.model.light is not None:
            rest = other.frame_shading.rest
        values, _ = _painted(self.picture, self.box, self.shape, self.model, rest)
        nearby = carried(values, self.inside, self.log_flat, reach_of(self.shape))
        change = self.share * np.where(self.inside[..., None], values, nearby)
        change += self.belongs * light_on_image(self.model, light, self.shape, self.box, self.inside.shape)
        return self._with(self.log_flat + change)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays of the picture."""
        return sum(each.nbytes for each in vars(self).values() if isinstance(each, np.ndarray))

    def _with(self, log_rgb: np.ndarray) -> np.ndarray:
        """Return the image with new logarithms of light, (bh, bw, 3), where they differ; noise stays low."""
        picture = self.picture.copy()
        if not self.inside.any():
            return picture
        excess = 1.0 - np.minimum(MOST_NOISE / self._amplified(log_rgb), 1.0)
        changed = np.abs(log_rgb - self.log_own).max(axis=2) > LEAST_CHANGE
        fresh = eight_bits(log_rgb - excess[..., None] * self.grain, self.response)
        picture[self.box][changed] = fresh[changed]
        return picture

    def _amplified(self, log_rgb: np.ndarray) -> np.ndarray:
        """Return by how much new logarithms of light (bh, bw, 3) amplify the noise of stored values, (bh, bw)."""
        after, before = (eight_bits(each.mean(axis=2), self.response) for each in (log_rgb, self.log_own))
        return np.maximum(after, np.float32(1.0)) / np.maximum(before, np.float32(1.0))


def reach_of(shape: np.ndarray) -> float:
    """Return the distance over which a new light fades out around the mesh, pixels."""
    return max(1.0, REACH * diagonal_of(shape))


def _separated(
    model: AAM,
    image: np.ndarray,
    shape: np.ndarray,
    response: Response,
    start: ShadowFree,
    prior: float,
    steadied: Callable[[Shading], Shading] | None,
) -> Relighter:
    """Estimate the light on the reference frame, warp it to the image, and continue it beyond the mesh."""
    seen = Seen.of(model, image, shape, response)
    appearance, log_rgb, covariance = appearance_in_light(model, seen, start, prior)
    shading = find_shading(model, seen, log_rgb, appearance.light, covariance)
    shading = shading if steadied is None else steadied(shading)
    reach = reach_of(shape)
    around_it = box_of(shape, 4 * reach, image.shape)
    box = around_it if model.light is None else square_around(model.light, shape, image.shape)
    layers = np.column_stack([shading.log, shading.deviation, normals_of(model.frame)])
    painted, inside = _painted(image, box, shape, model, layers.astype(np.float32))
    if not inside.any():
        return _unchanged(model, image, shape, response)
    own, lit = log_light(image[box], response), light_on_image(model, shading.coordinates, shape, box, inside.shape)
    values, within = np.dstack([painted[..., :3] - lit, painted[..., 4:]]), inside[..., None]
    nearby, share, belongs = around(values, inside, own - lit, reach)
    light = np.where(within, painted[..., :3], share * nearby[..., :3] + belongs * lit)
    normals = np.where(within, painted[..., 4:], nearby[..., 3:])
    pose = align(model.shape_model.mean, shape)
    normals[..., :2] = normals[..., :2] @ (pose.matrix / pose.scale).T.astype(np.float32)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
    stored = stored_values(image[box])
    light *= unclipped(stored, reach)
    deviation = np.sqrt(noise_variance(stored, response, noise_deviation(image)))
    return Relighter(
        model=model,
        shape=shape,
        response=response,
        picture=as_eight_bit(image),
        appearance=appearance,
        frame_shading=shading,
        box=box,
        log_flat=below_white(own - light, own).astype(np.float32),
        log_own=own,
        grain=grain_of(own, deviation.astype(np.float32)),
        deviation=painted[..., 3],
        inside=inside,
        share=np.where(within, 1.0, share).astype(np.float32),
        belongs=belongs,
        normals=normals.astype(np.float32),
    )


def below_white(log_rgb: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Compress brightened highlights (h, w, 3) below white, keeping their hue; ``own`` is the original light."""
    brightest = log_rgb.max(axis=2, keepdims=True)
    excess = np.maximum(brightest - BRIGHT, 0.0)
    limited = brightest - excess - BRIGHT * (1.0 - np.exp(excess / BRIGHT))
    return log_rgb + np.minimum(np.maximum(limited, own.max(axis=2, keepdims=True)) - brightest, 0.0)


def unclipped(stored: np.ndarray, reach: float) -> np.ndarray:
    """Return weights (h, w, 1) of stored values (h, w, 3): 1, and smoothly 0 around highlights that are clipped."""
    import cv2

    clipped = np.asarray((stored >= SATURATED).any(axis=2), np.float32)
    return np.clip(1.0 - 2.0 * cv2.GaussianBlur(clipped, (0, 0), CLIPPED_REACH * reach), 0.0, 1.0)[..., None]


def grain_of(own: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Return the part of logarithms of light (h, w, 3) that may be noise of a standard deviation (h, w, 3)."""
    import cv2

    fine = own - cv2.GaussianBlur(own, (0, 0), GRAIN)
    return fine * np.exp(-0.5 * np.square(fine / (2.0 * np.maximum(deviation, 1e-6))))


def _painted(
    image: np.ndarray, box: tuple[slice, slice], shape: np.ndarray, model: AAM, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what :func:`paint` gives within a box of the image."""
    return paint(image[box], shape - (box[1].start, box[0].start), model, values)


def _unchanged(model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> Relighter:
    """Return a relighter that leaves the image unchanged, for fits outside it or diverged."""
    known = model.levels[-1].appearances["log"]
    appearance = ShadowFree(known.mean, np.zeros(known.n_modes), np.sqrt(known.eigenvalues))
    zeros, none = np.zeros_like(known.mean), np.zeros((0, 0, 3), np.float32)
    shading = Shading(np.zeros(len(light_on_frame(model))), zeros, zeros, zeros[:, 0])
    return Relighter(
        model,
        shape,
        response,
        as_eight_bit(image),
        appearance,
        shading,
        (slice(0, 0), slice(0, 0)),
        log_flat=none,
        log_own=none,
        grain=none,
        deviation=none[..., 0],
        inside=np.zeros((0, 0), bool),
        share=none[..., :1],
        belongs=none[..., :1],
        normals=none,
    )
