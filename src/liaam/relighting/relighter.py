"""Relighting of one fitted image under any number of lights, or in one call, from the fit to the picture."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np

from liaam.errors import LiaamError, MethodError
from liaam.fitting import FitResult, Fitter, Method
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.formatting import short_repr
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response, to_linear
from liaam.photometry.encoding import refuse_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.photometry.picture import load_picture
from liaam.relighting.appearance import ShadowFree, check_colour, check_method
from liaam.relighting.extrapolation import FARTHEST, Surroundings
from liaam.relighting.highlights import below_white, spared
from liaam.relighting.lamp import (
    AMBIENT,
    Lamp,
    check_ambient,
    check_strength,
    direction_named,
    light_of,
    surface_of,
    surface_on_image,
)
from liaam.relighting.light_colour import LightColour, balanced, balanced_picture
from liaam.relighting.painting import REACH, Region, averages, box_of, eight_bits, log_light, paint, seen_triangles
from liaam.relighting.shading import SQUARE, Shading, find_shading, light_on_frame, light_on_image, noise_of_log

UNCERTAIN = 0.6  # Certainty of the light, of 1, below which a warning is given
LONGEST = 1.5  # Largest exposure relative to frontal light; a lamp from behind leaves the object dark
MOST_NOISE = 3.0  # Largest amplification of the noise of stored values
GRAIN = 1.0  # Standard deviation of the Gaussian that separates the noise, pixels

OWN: Literal["own"] = "own"  # Name of the light of the image itself, of which only the colour is corrected

LampsLike = str | Sequence[float] | Lamp | Sequence[Lamp]
Steadied = Callable[[Shading], Shading]


@dataclass(frozen=True, eq=False)
class FlatRegion:
    """The part of an image that may change, in its own light and under that of training; as in :class:`Relighter`."""

    region: Region
    log_flat: np.ndarray
    log_own: np.ndarray
    surroundings: Surroundings

    @classmethod
    def empty(cls) -> "FlatRegion":
        """Return the region of an object outside the image, which has no pixels."""
        no_pixels = np.zeros((0, 0, 3), np.float32)
        surroundings = Surroundings(
            inside=np.zeros((0, 0), bool),
            belongs=no_pixels,
            gloss=no_pixels,
            share=no_pixels,
            seen=no_pixels,
            reach=0.0,
        )
        region = Region.of(shape=np.zeros((1, 2)), box=(slice(0, 0), slice(0, 0)))
        return cls(region=region, log_flat=no_pixels, log_own=no_pixels, surroundings=surroundings)


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
        Logarithm of light with the object under the training light, but in the colour of the image's light. Clipped
        highlights may have more than white.
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
        model = fitter.model.reflected if result.reflected else fitter.model
        image, name = load_picture(image, name)
        refuse_grey(image, name, "relighting needs colours; give a colour image", MethodError)
        camera = fitter.camera or model.camera
        shape = result.registered
        if len(seen_triangles(image, shape, model)):
            appearance, shading = find_shading(model, image, shape, camera.response, result.status.ok)
            if steadied is not None:
                shading = steadied(shading)
            flat = _without_light(model, image, shape, camera.response, shading)
        else:  # the object is outside the image, which is left unchanged
            appearance = ShadowFree.unseen(model.levels[-1].appearances["log"])
            shading = _no_shading(model)
            flat = FlatRegion.empty()
        return cls(
            model=model,
            shape=shape,
            response=camera.response,
            picture=_in_eight_bits(image),
            appearance=appearance,
            frame_shading=shading,
            region=flat.region,
            log_flat=flat.log_flat,
            log_own=flat.log_own,
            surroundings=flat.surroundings,
        )

    @property
    def colour(self) -> LightColour:
        """Colour of the light of the whole image."""
        return self.frame_shading.colour

    def flat(self, strength: float = 1.0, balance: bool = True) -> np.ndarray:
        """Return the image with the object under the training light, (h, w, 3) uint8.

        ``strength`` is the share of the change of light, from 0 for the image as it is to 1. With ``balance``, the
        colour of the light (:attr:`colour`) is taken off the whole image; else it stays, on the object as well.
        """
        return self._changed(None, strength, self._correction(balance))

    def colour_corrected(self, strength: float = 1.0) -> np.ndarray:
        """Return the image in its own light, with the colour of the light (:attr:`colour`) corrected, (h, w, 3) uint8.

        ``strength`` is the share of the change, from 0 for the image as it is to 1.
        """
        check_strength(strength)
        correction = strength * self.colour.correction()
        return balanced_picture(self.picture, correction, self.response) if correction.any() else self.picture.copy()

    def shading(self) -> np.ndarray:
        """Return the removed shading, (h, w, 3) float32: log(image / flat image), 0 outside the mesh."""
        shading = np.zeros(self.picture.shape, np.float32)
        log_flat = np.minimum(self.log_flat, 0.0)  # what is brighter than white is stored as white
        shading[self.region.box] = self.covered[..., None] * (self.log_own - log_flat)
        return shading

    def certainty(self) -> np.ndarray:
        """Return how well the removed light is known, (h, w) float32: 0 to 1 inside the mesh, NaN outside it.

        It is exp(-d), where d is the standard deviation of the logarithm of the light: 0.8 means to about 20 %. It is
        lower where noise would have been amplified more than three times.
        """
        certainty = np.full(self.picture.shape[:2], np.nan, np.float32)
        if not self.inside.any():
            return certainty
        deviation, _ = paint(self.inside, self.region.shape, self.model, self.frame_shading.deviation[:, None])
        of_light = self.region.enlarged(np.exp(-deviation)).reshape(self.covered.shape)
        excess = self._excess(eight_bits(self.log_flat, self.response))
        certainty[self.region.box] = np.where(self.covered, of_light * (1.0 - excess), np.nan)
        return certainty

    @cached_property
    def certain(self) -> float:
        """Mean certainty inside the mesh; 0 if the object is outside the image."""
        return float(np.nanmean(self.certainty())) if self.inside.any() else 0.0

    def under(
        self, light: LampsLike, ambient: float = AMBIENT, strength: float = 1.0, balance: bool = True
    ) -> np.ndarray:
        """Return the image with the object under distant lamps, (h, w, 3) uint8.

        Uses Lambert's law on the model's surface, relative to a frontal lamp: under one white lamp from (0, 0, 1) the
        object is as in :meth:`flat`. A lamp from the side gives less light on average. Half of this loss (in
        logarithms) is compensated by the exposure, up to a factor 1.5, and so is half of the gain of
        several lamps.

        Parameters
        ----------
        light : str, (3,) float, Lamp, or sequence of Lamp
            Direction to a lamp (x to the right, y down, z to the viewer; its length does not matter), its name
            (``left``, ``right``, ``above``, ``below`` or ``front``), or lamps. Without lamps there is ambient light
            only.
        ambient : float
            Fraction of white ambient light, 0 to 1.
        strength : float
            Share of the change of light, from 0 for the image as it is to 1.
        balance : bool
            Whether the colour of the image's light is taken off the whole image, so that the lamps have their own.

        Raises
        ------
        LiaamError
            For a zero or non-finite direction or an unknown name, and for numbers out of range.
        """
        lamps = lamps_of(light)
        check_ambient(ambient)
        if not self.inside.any():
            return self.picture.copy()
        under_lamps = light_of(lamps, self.normals, ambient)
        frontal = light_of([Lamp((0.0, 0.0, 1.0))], self.normals, ambient)
        loss = float(frontal[self.inside].mean() / under_lamps[self.inside].mean())
        exposure = min(loss**0.5, LONGEST)
        change = self.surroundings.share * np.log(exposure * under_lamps / frontal)
        return self._changed(change, strength, self._correction(balance))

    def like(self, other: "Relighter", strength: float = 1.0, balance: bool = True) -> np.ndarray:
        """Return the image with the object under the light of another fitted image, (h, w, 3) uint8.

        ``strength`` is the share of the change of light, from 0 for the image as it is to 1. With ``balance``, the
        whole image takes the colour of the other's light; else it keeps its own.

        Raises
        ------
        LiaamError
            If the other image was fitted with another model.
        """
        if self.model is other.model.reflected or other.model is self.model.reflected:
            raise LiaamError("the two objects are of different sides; give an image of one of the same side")
        if other.model is not self.model:
            raise LiaamError("the two images were fitted with different models; fit both with the same model")
        if not self.inside.any():
            return self.picture.copy()
        shading = other.frame_shading
        on_mesh, _ = paint(self.inside, self.region.shape, self.model, shading.log)
        around = light_on_image(self.model, shading.coordinates, self.region)
        correction = self._correction(balance, other.colour)
        return self._changed(self.surroundings.spread(on_mesh, around), strength, correction)

    def _correction(self, balance: bool, to: LightColour | None = None) -> np.ndarray:
        """Return logarithms of the gains (3,) of the whole image that bring its light to a colour, or 0."""
        return self.colour.correction(to) if balance else np.zeros(3)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays of the picture."""
        values = [*vars(self).values(), *vars(self.surroundings).values()]
        return sum(value.nbytes for value in values if isinstance(value, np.ndarray))

    @property
    def inside(self) -> np.ndarray:
        """Pixels of light inside the mesh, (lh, lw) bool."""
        return self.surroundings.inside

    @cached_property
    def normals(self) -> np.ndarray:
        """Normals of the model's surface, rotated with the object, (lh, lw, 3) float32."""
        normals, _ = paint(self.inside, self.region.shape, self.model, surface_of(self.model))
        is_inside = self.inside[..., None]
        if self.model.relief is not None:
            normals = np.where(is_inside, normals, surface_on_image(self.model, self.region))
        elif is_inside.size:
            # Beyond the mesh, the surface continues as within two reaches.
            normals = np.where(is_inside, normals, averages(normals, is_inside, 2.0 * self.region.reach))
        pose = align(self.model.shape_model.mean, self.shape)
        rotation = pose.matrix / pose.scale
        normals[..., :2] = normals[..., :2] @ rotation.T.astype(np.float32)
        return normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)

    @cached_property
    def covered(self) -> np.ndarray:
        """Pixels of the box inside the mesh, (bh, bw) bool."""
        ones = np.ones((self.model.n_pixels, 1), np.float32)
        _, inside = paint(self.picture, self.shape, self.model, ones)
        return inside[self.region.box]

    @cached_property
    def _grain(self) -> np.ndarray:
        """The part of ``log_own`` that may be noise, (bh, bw, 3) float32."""
        light = to_linear(stored_values(self.picture[self.region.box]), self.response)
        deviation = noise_of_log(light, noise_deviation(self.picture, self.response))
        fine = self.log_own - cv2.GaussianBlur(self.log_own, (0, 0), GRAIN)
        # Fine structure of far more than two standard deviations of the noise is the object's own.
        relative = fine / (2.0 * np.maximum(deviation, 1e-6))
        share = np.exp(-0.5 * np.square(relative)).astype(np.float32)
        return fine * share

    def _changed(self, change: np.ndarray | None, strength: float, correction: np.ndarray) -> np.ndarray:
        """Return the flat image, with a change of log light (lh, lw, 1 or 3); noise stays low.

        ``strength`` is the share of the way from the logarithm of the image's own light to that, and to the whole
        image with its channels changed by the logarithms of gains in ``correction`` (3,).
        """
        check_strength(strength)
        if not self.inside.any():
            return self.picture.copy()
        correction = strength * correction
        is_balanced = bool(correction.any())
        picture = balanced_picture(self.picture, correction, self.response) if is_balanced else self.picture.copy()
        log_rgb = self.log_flat
        if change is not None:
            log_rgb = log_rgb + self.region.enlarged(change).reshape(*log_rgb.shape[:2], -1)
        if strength < 1.0:
            log_rgb = self.log_own + np.float32(strength) * (log_rgb - self.log_own)
        if is_balanced:
            log_rgb = balanced(log_rgb, self.log_own, correction)
        stored = eight_bits(log_rgb, self.response)
        excess = self._excess(stored)
        if (excess > 0.0).any():
            stored = eight_bits(log_rgb - excess[..., None] * self._grain, self.response)
        picture[self.region.box] = stored
        return picture

    def _excess(self, stored: np.ndarray) -> np.ndarray:
        """Return the share, (bh, bw), of noise that new stored values (bh, bw, 3) amplify too much."""
        before = _stored_brightness(self.picture[self.region.box])
        after = _stored_brightness(stored)
        return 1.0 - np.minimum(MOST_NOISE * before / after, 1.0)


def _stored_brightness(picture: np.ndarray) -> np.ndarray:
    """Return the luminance of stored values (h, w, 3) uint8, (h, w) float32, at least one step."""
    return np.maximum(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.float32(1.0))


def _in_eight_bits(image: np.ndarray) -> np.ndarray:
    """Return a copy of an image with stored values of 8 bits."""
    if image.dtype == np.uint8:
        return image.copy()
    return np.rint(255 * np.clip(stored_values(image), 0.0, 1.0)).astype(np.uint8)


def _no_shading(model: AAM) -> Shading:
    """Return the light of training, without any uncertainty."""
    modes, _ = light_on_frame(model)
    mean = model.levels[-1].appearances["log"].mean
    return Shading(
        coordinates=np.zeros(len(modes)),
        log=np.zeros_like(mean),
        deviation=np.zeros_like(mean[:, 0]),
        colour=LightColour.unknown(),
    )


def _without_light(
    model: AAM, image: np.ndarray, shape: np.ndarray, response: Response, shading: Shading
) -> FlatRegion:
    """Warp the light to the image, continue it beyond the mesh, and remove it."""
    if model.light is None:
        # Light fades out around the mesh within FARTHEST reaches, each of at least a pixel.
        margin = FARTHEST * (REACH * diagonal_of(shape) + 1.0)
        box = box_of(shape, margin, image.shape)
    else:  # the basis of light has a square around the object
        box = box_of(align(model.light.mean, shape)(SQUARE), 0.0, image.shape)
    region = Region.of(shape, box)
    of_size = np.empty(region.small[::-1], np.uint8)
    on_mesh, inside = paint(of_size, region.shape, model, shading.log)
    if not inside.any():
        return FlatRegion.empty()
    log_own = log_light(image[region.box], response)
    reduced = region.reduced(log_own)
    around = light_on_image(model, shading.coordinates, region)
    surroundings = Surroundings.of(inside, reduced - around, region.reach)
    light, whole = spared(log_own, reduced, surroundings.spread(on_mesh, around), surroundings, region)
    log_flat = below_white(whole - region.enlarged(light), whole)
    return FlatRegion(region=region, log_flat=log_flat, log_own=log_own, surroundings=surroundings)


def relight(
    model: AAM | str,
    image,
    light: LampsLike | None = None,
    *,
    like=None,
    ambient: float = AMBIENT,
    strength: float = 1.0,
    balance: bool = True,
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
    light : str, (3,) float, Lamp, or sequence of Lamp, optional
        Direction to a distant lamp (x to the right, y down, z to the viewer), its name (``left``, ``right``, ``above``,
        ``below`` or ``front``), or lamps. ``own`` keeps the light of the image and corrects its colour. By default the
        light of the training images, which removes the shading.
    like : image, optional
        Another image of such an object, whose light is used; not together with ``light``.
    ambient : float
        Fraction of ambient light with ``light``, 0 to 1.
    strength : float
        Share of the change of light, from 0 for the image as it is to 1.
    balance : bool
        Whether the colour of the light is corrected, in the whole image: by default, if it differs clearly from that
        of the training images. Else the image keeps the colour of its light, the object as well.
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
    >>> lit = liaam.relight(model, "new.png", "left", strength=0.7)                         # doctest: +SKIP
    """
    if light is not None and like is not None:
        raise LiaamError("light and like cannot be combined; give one of them")
    wanted: list[Lamp] | Relighter | Literal["own"] | None
    if isinstance(light, str) and light == OWN:
        if not balance:
            raise LiaamError(
                "light='own' corrects the colour of the light, and balance=False keeps it; give one of them"
            )
        wanted = OWN
    else:
        wanted = None if light is None else lamps_of(light)
    check_ambient(ambient)
    check_strength(strength)
    fitter = Fitter.of(model, method, caller=relight, **settings)
    check_colour(fitter.model)
    if like is not None:
        wanted, result = separated(fitter, like, like_init, "like")
        _warn(result, "like")
    relighter, result = separated(fitter, image, init)
    _warn(result, "image")
    if relighter.certain < UNCERTAIN:
        warnings.warn(f"image: {uncertainty_of(relighter)}", stacklevel=2)
    return shown(relighter, wanted, ambient, strength, balance)


def lamps_of(light: LampsLike) -> list[Lamp]:
    """Return the lamps of a direction or its name, a lamp or several lamps."""
    if isinstance(light, str):
        return [Lamp(direction_named(light))]
    if isinstance(light, FitResult):
        raise LiaamError(
            "the light is the result of a fit; give its landmarks as the start, init=result.landmarks, or relight that "
            "very fit with liaam.relighting.Relighter.of(fitter, image, result)"
        )
    several: list = [light] if isinstance(light, Lamp) else list(light)
    return several if all(isinstance(lamp, Lamp) for lamp in several) else [Lamp(several)]


def shown(
    relighter: Relighter,
    light: Sequence[Lamp] | Relighter | Literal["own"] | None = None,
    ambient: float = AMBIENT,
    strength: float = 1.0,
    balance: bool = True,
) -> np.ndarray:
    """Show an object under lamps, or the light of another image, its own of corrected colour, or that of training."""
    if light is None:
        return relighter.flat(strength, balance)
    if isinstance(light, Relighter):
        return relighter.like(light, strength, balance)
    if isinstance(light, str):
        return relighter.colour_corrected(strength)
    return relighter.under(light, ambient, strength, balance)


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
