"""One fitted picture, ready for any number of lights."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.errors import LiaamError, MethodError
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response
from liaam.photometry.encoding import DARK, as_colour, refuse_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.relighting.appearance import ShadowFree, check_method, shadow_free
from liaam.relighting.beyond import around, continued
from liaam.relighting.painting import REACH, box_around, eight_bits, log_light, paint, seen_triangles
from liaam.relighting.relief import normals_of
from liaam.relighting.shading import Seen, Shading, find_shading, noise_variance
from liaam.relighting.together import appearance_in_light

AMBIENT = 0.25
"""Share of light that comes from everywhere, unless told otherwise."""

LONGEST = 1.5
"""How many times as strong as in front a lamp may be: one from behind leaves the object dark."""

DARKEST = 0.02
"""Least share of light: without ambient light, what is turned away would be black, and black has no logarithm."""


@dataclass(frozen=True, eq=False)
class Relighter:
    """A fitted picture in parts: what the object looks like under the training light, and what it takes to relight it.

    Make one with :meth:`of`; everything that a light does not change is worked out there.

    Attributes
    ----------
    model : AAM
    shape : (n, 2) float64
        Fitted landmarks, image pixels.
    response : Response
        Of the image's camera.
    picture : (h, w, 3) uint8
        The picture as it was.
    appearance : ShadowFree
        Of the model, under the training light.
    frame_shading : Shading
        The picture's shading on the model's reference frame.
    box : (rows, columns)
        The part of the picture that may change; the arrays below are of it.
    log_flat : (bh, bw, 3) float32
        Logarithm of light with the object under the training light; around the mesh on the way to the picture.
    log_shading : (bh, bw, 3) float32
        What was taken off.
    inside : (bh, bw) bool
        Inside the mesh.
    share : (bh, bw, 1) float32
        How much a new light counts: 1 inside the mesh, less and less around it.
    normals : (bh, bw, 3) float32
        Of the made-up surface (:func:`liaam.relighting.relief.normals_of`), turned like the object.
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

    @classmethod
    def of(
        cls, fitter: Fitter, image: np.ndarray, result: FitResult, prior: float = 1.0, name: str = "image"
    ) -> "Relighter":
        """Take a fitted picture apart.

        Parameters
        ----------
        fitter : Fitter
            The one that made the fit; its method is ``soft-li`` or compares logarithms with the ``log`` appearance.
        image : (h, w, 3) uint8, uint16 or float array
            The picture fitted.
        result : FitResult
            Of a fit that went wrong, the picture stays as it is where nothing can be said.
        prior : float
            See :func:`shadow_free`.
        name : str
            What to call the image in errors.

        Raises
        ------
        MethodError
            For a method without the log appearance, another fitter than the fit's, and a grey picture.
        """
        check_method(fitter, result)
        image, model = as_colour(image, name), fitter.model
        refuse_grey(image, name, "shading is told by colours; give a colour picture", MethodError)
        response = (fitter.camera or model.camera).response
        if not len(seen_triangles(image, result.landmarks, model)):
            return _as_it_is(model, image, result.landmarks, response)
        seen = Seen.of(model, image, result.landmarks, response)
        appearance, log_rgb = appearance_in_light(model, seen, shadow_free(fitter, image, result, prior), prior)
        shading = find_shading(model, seen, log_rgb)
        return _taken_apart(model, image, result.landmarks, response, appearance, log_rgb, shading)

    def flat(self) -> np.ndarray:
        """Picture with the object under the training light, (h, w, 3) uint8."""
        return self._with(self.log_flat)

    def shading(self) -> np.ndarray:
        """What was taken off, (h, w, 3) float32: natural logarithm of picture over flat picture, 0 outside the mesh."""
        whole = np.zeros(self.picture.shape, np.float32)
        whole[self.box] = np.where(self.inside[..., None], self.log_shading, 0.0)
        return whole

    def under(self, direction: Sequence[float], ambient: float = AMBIENT) -> np.ndarray:
        """Picture with the object under a far lamp, (h, w, 3) uint8.

        Lambert's law on the made-up surface, relative to a lamp in front: under (0, 0, 1) the object is as in
        :meth:`flat`. Of what a lamp from aside lights less on the whole, half is made up for (in logarithms), up
        to :data:`LONGEST` times, as a photographer would: so neither side is lost.

        Parameters
        ----------
        direction : (3,) float
            Towards the lamp: x to the right, y down, z to the viewer; of any length but 0.
        ambient : float
            Share of light that comes from everywhere, 0 to 1.

        Raises
        ------
        LiaamError
            For a direction of three zeros or of no numbers, and an ambient light out of range.
        """
        lamp = unit_direction(direction)
        check_ambient(ambient)
        if not self.inside.any():
            return self.picture.copy()
        shade, frontal = (lambert(facing, ambient) for facing in (self.normals @ lamp, self.normals[..., 2]))
        exposure = min(float(frontal[self.inside].mean() / shade[self.inside].mean()) ** 0.5, LONGEST)
        return self._with(self.log_flat + self.share * np.log(exposure * shade / frontal)[..., None])

    def like(self, other: "Relighter") -> np.ndarray:
        """Picture with the object under the light of another picture of the same model, (h, w, 3) uint8.

        Raises
        ------
        LiaamError
            If the other picture was fitted with another model.
        """
        if other.model is not self.model:
            raise LiaamError("the two pictures were fitted with different models; fit both with one")
        values, inside = paint(self.picture, self.shape, self.model, other.frame_shading.log)
        weights = inside[self.box][..., None].astype(np.float32)
        if not weights.size:
            return self.picture.copy()
        nearby, _ = around(values[self.box], weights, self.log_flat, self._reach)
        shading = np.where(weights > 0, values[self.box], nearby)
        return self._with(self.log_flat + self.share * shading)

    @cached_property
    def _reach(self) -> float:
        return reach_of(self.shape)

    def _with(self, log_rgb: np.ndarray) -> np.ndarray:
        """The picture with other light in the box, where it may change."""
        picture = self.picture.copy()
        changed = self.share[..., 0] > 0
        picture[self.box][changed] = eight_bits(log_rgb[changed], self.response)
        return picture


def unit_direction(direction: Sequence[float]) -> np.ndarray:
    """Direction of unit length, (3,) float32.

    Raises
    ------
    LiaamError
        If it is not three finite numbers, or all of them are 0.
    """
    try:
        light = np.asarray(direction, dtype=np.float64)
    except (TypeError, ValueError):
        light = np.zeros(0)
    if light.shape != (3,) or not np.isfinite(light).all() or not light.any():
        shown = ",".join(f"{value:g}" for value in light.ravel()) or repr(direction)
        raise LiaamError(
            f"light from {shown}: give three numbers x,y,z, not all 0: to the right, down, and to the viewer"
        )
    light = light / np.abs(light).max()
    return (light / np.linalg.norm(light)).astype(np.float32)


def check_ambient(ambient: float) -> None:
    """Complain about a share of ambient light that is none."""
    if not 0.0 <= ambient <= 1.0:
        raise LiaamError(f"ambient light {ambient:g}: give a share from 0 (only the lamp) to 1 (no lamp)")


def lambert(facing: np.ndarray, ambient: float) -> np.ndarray:
    """Light on a surface by the cosine between its normal and the lamp, and the share of ambient light."""
    return np.maximum(ambient + (1.0 - ambient) * np.maximum(facing, 0.0), DARKEST)


def reach_of(shape: np.ndarray) -> float:
    """How far a new light fades into what is around the mesh, pixels."""
    return max(1.0, REACH * diagonal_of(shape))


def _taken_apart(
    model: AAM,
    image: np.ndarray,
    shape: np.ndarray,
    response: Response,
    appearance: ShadowFree,
    log_rgb: np.ndarray,
    shading: Shading,
) -> Relighter:
    """Carry what is known on the reference frame to the picture, and over the mesh's border."""
    layers = (log_rgb, shading.log, shading.model_variance, shading.variance, normals_of(model.frame))
    painted, inside = paint(image, shape, model, np.column_stack(layers).astype(np.float32))
    if not inside.any():
        return _as_it_is(model, image, shape, response)
    box = box_around(inside, 4 * reach_of(shape))
    painted, inside = painted[box], inside[box]
    log_model, log_smooth, normals = painted[..., :3], painted[..., 3:6], painted[..., 8:]
    own = log_light(image[box], response)
    # The picture's own detail, as far as it says more than the model does.
    doubt = noise_variance(own, response, noise_deviation(image)) + painted[..., 7:8]
    detail = (own - log_model - log_smooth) * painted[..., 6:7] / np.maximum(painted[..., 6:7] + doubt, 1e-12)
    detail = of_dark_channels(detail, stored_values(image[box]) <= DARK)
    weights = inside[..., None].astype(np.float32)
    beyond = continued(log_smooth, inside, own, reach_of(shape))
    lightened = beyond.mean(axis=2, keepdims=True) < 0
    nearby, share = around(normals, weights, own, reach_of(shape), lightened=lightened)
    taken = np.where(inside[..., None], own - log_model - detail, share * beyond)
    turned = align(model.shape_model.mean, shape)
    normals = np.where(inside[..., None], normals, nearby)
    normals[..., :2] = normals[..., :2] @ (turned.matrix / turned.scale).T.astype(np.float32)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
    return Relighter(
        model=model,
        shape=shape,
        response=response,
        picture=eight_bit(image),
        appearance=appearance,
        frame_shading=shading,
        box=box,
        log_flat=own - taken,
        log_shading=taken,
        inside=inside,
        share=np.where(inside[..., None], 1.0, share).astype(np.float32),
        normals=normals,
    )


def of_dark_channels(detail: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Detail (h, w, 3) with that of the other channels, or of all, where one is too dark (h, w, 3) to have its own.

    Of a nostril often red alone is left, and detail of red alone would make it cyan.
    """
    known = np.where(dark.all(axis=2, keepdims=True), True, ~dark)
    counts = known.sum(axis=2, keepdims=True, dtype=np.float32)
    return np.where(dark, (detail * known).sum(axis=2, keepdims=True) / counts, detail)


def _as_it_is(model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> Relighter:
    """A picture of which nothing can be relit: its fit lies outside of it, or has blown up."""
    known = model.levels[-1].appearances["log"]
    appearance = ShadowFree(known.mean, np.zeros(known.n_modes), np.sqrt(known.eigenvalues))
    zeros, none = np.zeros(model.n_pixels, np.float32), np.zeros((0, 0, 3), np.float32)
    shading, box = Shading(np.zeros_like(known.mean), zeros, zeros), (slice(0, 0), slice(0, 0))
    return Relighter(
        model,
        shape,
        response,
        eight_bit(image),
        appearance,
        shading,
        box,
        log_flat=none,
        log_shading=none,
        inside=np.zeros((0, 0), bool),
        share=none[..., :1],
        normals=none,
    )


def eight_bit(image: np.ndarray) -> np.ndarray:
    """A picture as (h, w, 3) uint8."""
    return np.rint(255 * np.clip(stored_values(image), 0.0, 1.0)).astype(np.uint8)
