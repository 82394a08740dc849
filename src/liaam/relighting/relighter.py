"""Relighting of one fitted image under any number of lights, or in one call, from the fit to the picture."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from liaam.errors import LiaamError, MethodError
from liaam.evaluation import short_repr
from liaam.fitting import FitResult, Fitter, Method
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.picture import load_picture
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response, to_linear
from liaam.photometry.encoding import refuse_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.relighting.appearance import ShadowFree, check_colour, check_method
from liaam.relighting.extrapolation import FARTHEST, Surroundings
from liaam.relighting.highlights import below_white, spared
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient, light_of, normals_of
from liaam.relighting.painting import REACH, Region, averages, box_of, eight_bits, log_light, paint, seen_triangles
from liaam.relighting.shading import SQUARE, Shading, find_shading, light_on_frame, light_on_image, noise_of_log

UNCERTAIN = 0.6  # Certainty of the light, of 1, below which a warning is given
LONGEST = 1.5  # Largest exposure relative to frontal light; a lamp from behind leaves the object dark
MOST_NOISE = 3.0  # Largest amplification of the noise of stored values
GRAIN = 1.0  # Standard deviation of the Gaussian that separates the noise, pixels

Light = Sequence[float] | Lamp | Sequence[Lamp]
Steadied = Callable[[Shading], Shading]

NOTHING = np.zeros((0, 0, 3), np.float32)
NO_SURROUNDINGS = Surroundings(np.zeros((0, 0), bool), NOTHING, NOTHING, NOTHING, NOTHING, 0.0)
UNSEEN = (Region.of(np.zeros((1, 2)), (slice(0, 0), slice(0, 0))), NOTHING, NOTHING, NO_SURROUNDINGS)


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
    region : Region
        The part of the image that may change, (bh, bw) pixels, and its resolution of light, (lh, lw). There are no
        pixels if the object is outside the image.
    log_flat : (bh, bw, 3) float32
        Logarithm of light with the object under the training light. Clipped highlights may have more than white.
    log_own : (bh, bw, 3) float32
        That of the image.
    surroundings : Surroundings
        How far light extends around the mesh.
    """

    model: AAM
    shape: np.ndarray
    response: Response
    picture: np.ndarray
    appearance: ShadowFree
    frame_shading: Shading
    region: Region
    log_flat: np.ndarray
    log_own: np.ndarray
    surroundings: Surroundings

    __repr__ = short_repr

    @classmethod
    def of(
        cls, fitter: Fitter, image, result: FitResult, name: str = "image", steadied: Steadied | None = None
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
        fitter = fitter.lit_part_for(result)  # without a basis of light, beards count as shade
        (image, name), model = load_picture(image, name), fitter.model
        refuse_grey(image, name, "relighting needs colours; give a colour image", MethodError)
        response, shape = (fitter.camera or model.camera).response, result.landmarks
        eight = image.dtype == np.uint8
        picture = image.copy() if eight else np.rint(255 * np.clip(stored_values(image), 0.0, 1.0)).astype(np.uint8)
        if not len(seen_triangles(image, shape, model)):
            known = model.levels[-1].appearances["log"]
            shading = Shading(np.zeros(len(light_on_frame(model)[0])), np.zeros_like(known.mean), known.mean[:, 0] * 0)
            return cls(model, shape, response, picture, ShadowFree.unseen(known), shading, *UNSEEN)
        appearance, shading = find_shading(model, image, shape, response)
        shading = shading if steadied is None else steadied(shading)
        rest = _removed(model, image, shape, response, shading)
        return cls(model, shape, response, picture, appearance, shading, *rest)

    def flat(self) -> np.ndarray:
        """Return the image with the object under the training light, (h, w, 3) uint8."""
        return self._changed()

    def shading(self) -> np.ndarray:
        """Return the removed shading, (h, w, 3) float32: log(image / flat image), 0 outside the mesh."""
        whole = np.zeros(self.picture.shape, np.float32)
        whole[self.region.box] = self.covered[..., None] * (self.log_own - np.minimum(self.log_flat, 0.0))
        return whole

    def certainty(self) -> np.ndarray:
        """Return how well the removed light is known, (h, w) float32: 0 to 1 inside the mesh, NaN outside it.

        It is exp(-d), where d is the standard deviation of the logarithm of the light: 0.8 means to about 20 %. It is
        lower where noise would have been amplified more than three times.
        """
        whole = np.full(self.picture.shape[:2], np.nan, np.float32)
        if self.inside.any():
            deviation = self.frame_shading.deviation[:, None]
            known = np.exp(-paint(self.inside, self.region.shape, self.model, deviation)[0])
            excess = self._excess(eight_bits(self.log_flat, self.response))
            known = self.region.enlarged(known).reshape(self.covered.shape) * (1.0 - excess)
            whole[self.region.box] = np.where(self.covered, known, np.nan)
        return whole

    @cached_property
    def certain(self) -> float:
        """Mean certainty inside the mesh; 0 if the object is outside the image."""
        return float(np.nanmean(self.certainty())) if self.inside.any() else 0.0

    def under(self, light: Light, ambient: float = AMBIENT) -> np.ndarray:
        """Return the image with the object under distant lamps, (h, w, 3) uint8.

        Uses Lambert's law on the inflated surface, relative to a frontal lamp: under one white lamp from (0, 0, 1) the
        object is as in :meth:`flat`. A lamp from the side gives less light on average. Half of this loss (in
        logarithms) is compensated by the exposure, up to a factor 1.5, and so is half of the gain of
        several lamps.

        Parameters
        ----------
        light : (3,) float, Lamp, or sequence of Lamp
            Direction to a lamp (x to the right, y down, z to the viewer; its length does not matter), or lamps. Without
            lamps there is ambient light only.
        ambient : float
            Fraction of white ambient light, 0 to 1.

        Raises
        ------
        LiaamError
            For a zero or non-finite direction, and for ambient light out of range.
        """
        lamps = lamps_of(light)
        check_ambient(ambient)
        if not self.inside.any():
            return self.picture.copy()
        made, frontal = (light_of(given, self.normals, ambient) for given in (lamps, [Lamp((0.0, 0.0, 1.0))]))
        exposure = min(float(frontal[self.inside].mean() / made[self.inside].mean()) ** 0.5, LONGEST)
        return self._changed(self.surroundings.share * np.log(exposure * made / frontal))

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
        shading, region = other.frame_shading, self.region
        values, _ = paint(self.inside, region.shape, self.model, shading.log)
        return self._changed(self.surroundings.spread(values, light_on_image(self.model, shading.coordinates, region)))

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays of the picture."""
        return sum(getattr(each, "nbytes", 0) for part in (self, self.surroundings) for each in vars(part).values())

    @property
    def inside(self) -> np.ndarray:
        """Pixels of light inside the mesh, (lh, lw) bool."""
        return self.surroundings.inside

    @cached_property
    def normals(self) -> np.ndarray:
        """Normals of the inflated surface, rotated with the object, (lh, lw, 3) float32."""
        pose, radius = align(self.model.shape_model.mean, self.shape), 2.0 * self.region.reach
        values, _ = paint(self.inside, self.region.shape, self.model, normals_of(self.model.frame))
        known = self.inside[..., None]
        normals = np.where(known, values, averages(values, known, radius) if known.size else values)
        normals[..., :2] = normals[..., :2] @ (pose.matrix / pose.scale).T.astype(np.float32)
        return normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)

    @cached_property
    def covered(self) -> np.ndarray:
        """Pixels of the box inside the mesh, (bh, bw) bool."""
        known = np.ones((self.model.n_pixels, 1), np.float32)
        return paint(self.picture, self.shape, self.model, known)[1][self.region.box]

    @cached_property
    def _grain(self) -> np.ndarray:
        """The part of ``log_own`` that may be noise, (bh, bw, 3) float32."""
        light = to_linear(stored_values(self.picture[self.region.box]), self.response)
        deviation = noise_of_log(light, noise_deviation(self.picture, self.response))
        fine = self.log_own - cv2.GaussianBlur(self.log_own, (0, 0), GRAIN)
        return fine * np.exp(-0.5 * np.square(fine / (2.0 * np.maximum(deviation, 1e-6)))).astype(np.float32)

    def _changed(self, change: np.ndarray | None = None) -> np.ndarray:
        """Return the flat image, with a change of log light (lh, lw, 1 or 3); noise stays low."""
        picture, log_rgb = self.picture.copy(), self.log_flat
        if not self.inside.any():
            return picture
        if change is not None:
            log_rgb = log_rgb + self.region.enlarged(change).reshape(*log_rgb.shape[:2], -1)
        made = eight_bits(log_rgb, self.response)
        excess = self._excess(made)
        if (excess > 0.0).any():
            made = eight_bits(log_rgb - excess[..., None] * self._grain, self.response)
        picture[self.region.box] = made
        return picture

    def _excess(self, made: np.ndarray) -> np.ndarray:
        """Return the share, (bh, bw), of noise that new stored values (bh, bw, 3) amplify too much."""
        grey = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (self.picture[self.region.box], made))
        before, after = (np.maximum(each, np.float32(1.0)) for each in grey)
        return 1.0 - np.minimum(MOST_NOISE * before / after, 1.0)


def _removed(model: AAM, image: np.ndarray, shape: np.ndarray, response: Response, shading: Shading) -> tuple:
    """Warp the light to the image, continue it beyond the mesh, and remove it; return a relighter's last fields."""
    margin = FARTHEST * (REACH * diagonal_of(shape) + 1.0)
    reached, margin = (shape, margin) if model.light is None else (align(model.light.mean, shape)(SQUARE), 0.0)
    region = Region.of(shape, box_of(reached, margin, image.shape))
    painted, inside = paint(np.empty(region.small[::-1], np.uint8), region.shape, model, shading.log)
    if not inside.any():
        return UNSEEN
    own, lit = log_light(image[region.box], response), light_on_image(model, shading.coordinates, region)
    small = region.reduced(own)
    surroundings = Surroundings.of(inside, small - lit, region.reach)
    light, whole = spared(own, small, surroundings.spread(painted, lit), surroundings, region)
    return region, below_white(whole - region.enlarged(light), whole), own, surroundings


def relight(
    model: AAM | str,
    image,
    light: Light | None = None,
    *,
    like=None,
    ambient: float = AMBIENT,
    init=None,
    like_init=None,
    method: str | Method = DEFAULT_METHOD,
    **settings,
) -> np.ndarray:
    """Fit a model to an image, and show the object in another light.

    For many images or lights, make a :class:`liaam.relighting.Relighter` of a fit.

    Parameters
    ----------
    model : AAM or "face"
        Trained on colour images, or the name of a model that comes with liaam.
    image : (h, w, 3) uint8, uint16 or float array, or path
    light : (3,) float, Lamp, or sequence of Lamp, optional
        Direction to a distant lamp (x to the right, y down, z to the viewer), or lamps. By default the light of the
        training images, which removes the shading.
    like : image, optional
        Another image of such an object, whose light is used; not together with ``light``.
    ambient : float
        Fraction of ambient light with ``light``, 0 to 1.
    init, like_init : start, optional
        Starts of the fits to the two images, as for :func:`liaam.fit`. By default the objects are searched for.
    method : str or Method
        ``soft-li``, or a method on logarithms such as ``li``.
    **settings
        Other keyword arguments of :func:`liaam.fit`.

    Returns
    -------
    (h, w, 3) uint8 array

    Warns
    -----
    UserWarning
        If a fit may be wrong, or the light is uncertain.

    Raises
    ------
    LiaamError
        If ``light`` and ``like`` are given, an argument is invalid, or an image or the model is grey.

    Examples
    --------
    >>> flat = liaam.relight(model, "new.png")                                              # doctest: +SKIP
    >>> lit = liaam.relight(model, "new.png", (1, 0, 1))                                    # doctest: +SKIP
    """
    if light is not None and like is not None:
        raise LiaamError("light and like cannot be combined; give one of them")
    lamps = None if light is None else lamps_of(light)
    check_ambient(ambient)
    fitter, other = Fitter.of(model, method, known=relight, **settings), None
    check_colour(fitter.model)
    if like is not None:
        other, result = separated(fitter, like, like_init, "like")
        _warn(result, "like")
    relighter, result = separated(fitter, image, init)
    _warn(result, "image")
    if relighter.certain < UNCERTAIN:
        warnings.warn(f"image: {uncertainty_of(relighter)}", stacklevel=2)
    return shown(relighter, lamps, other, ambient)


def lamps_of(light: Light) -> list[Lamp]:
    """Return the lamps of a direction, a lamp or several lamps."""
    if isinstance(light, FitResult):
        raise LiaamError(
            "the light is the result of a fit; give its landmarks as the start, init=result.landmarks, or relight that "
            "very fit with liaam.relighting.Relighter.of(fitter, image, result)"
        )
    several: list = [light] if isinstance(light, Lamp) else list(light)
    return several if all(isinstance(lamp, Lamp) for lamp in several) else [Lamp(several)]


def shown(
    relighter: Relighter, lamps: Sequence[Lamp] | None = None, other: Relighter | None = None, ambient: float = AMBIENT
) -> np.ndarray:
    """Show an object under lamps, or the light of another image, or that of training."""
    if other is not None:
        return relighter.like(other)
    return relighter.flat() if lamps is None else relighter.under(lamps, ambient)


def separated(fitter: Fitter, image, init=None, name: str = "image") -> tuple[Relighter, FitResult]:
    """Fit an image and separate it into appearance and shading."""
    result = fitter.fit(image, init, name)
    return Relighter.of(fitter, image, result, name=name), result


def uncertainty_of(relighter: Relighter) -> str:
    """Say that the light of an image is not well known."""
    return (
        f"the light is uncertain ({relighter.certain:.2f} of 1): the image may be too dark, clipped or unlike the "
        "training images; look at the map of certainty"
    )


def _warn(result: FitResult, name: str) -> None:
    if not result.status.ok:
        warnings.warn(f"{name}: {result.status}: {result.message}", stacklevel=3)
