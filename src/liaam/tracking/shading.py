"""A video without its shading: each frame's object under the light of training (paper eq 11), steady over time.

Three things would make it flicker, and are seen to. The appearance's coordinates jump with every frame's noise: they
are filtered, each as fast as it may change and as far as the frame shows it. Pixels at the mesh's border are in it in
one frame and out of it in the next: the appearance goes over into the picture softly, by weights that are fixed to the
object. And the mesh trembles: it lies where the smoothed landmarks do. The picture around the mesh keeps its own
colours, but for the shading next to it, which is taken off less and less further out: so no seam shows on cheeks and
forehead.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.photometry import Response, from_linear, is_grey, to_linear
from liaam.photometry.encoding import as_colour, stored_values
from liaam.relighting import ShadowFree, paint, shadow_free
from liaam.shape import diagonal_of

SOFT_EDGE = 0.05
"""Width of the border in which the appearance goes over into the picture, as a share of the model's diagonal."""

REACH = 0.04
"""How far beyond the mesh shading is taken off: deviation of a Gaussian, as a share of the shape's diagonal."""

CHANGE = 0.1
"""Standard deviation of the change of an appearance's coordinate from frame to frame, in those of its mode: a face
needs some ten frames to become another."""


@dataclass(eq=False)
class ShadingRemover:
    """Takes the shading off an object, frame by frame.

    Attributes
    ----------
    fitter : Fitter
        The one that fits the frames, of all levels; its method is ``soft-li`` or fits the appearance of log-RGB.
    """

    fitter: Fitter
    _lam: np.ndarray | None = field(default=None, init=False, repr=False)
    _variance: np.ndarray | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        method, model = self.fitter.objectives[-1].method, self.fitter.model
        if method.appearance not in ("log", "soft"):
            raise MethodError(
                f"method {method.name} does not fit the appearance of log-RGB, so no shading can be taken off; "
                "track with 'soft-li', 'li', 'li-pc', 'li-pcs' or 'chroma'"
            )
        if not model.is_colour:
            raise MethodError("the model is of grey pictures, and shading is told by colours; train on colour pictures")
        # Of what soft-li measures, the invariant tells the appearance.
        self._log = replace(self.fitter, method="li") if method.appearance == "soft" else self.fitter
        self._weights = soft_edge(model)

    def reset(self) -> None:
        """Forget the frames before: the object has been lost."""
        self._lam = self._variance = None

    def remove(self, image: np.ndarray, result: FitResult, landmarks: np.ndarray) -> np.ndarray:
        """Picture with the object under the training light.

        Parameters
        ----------
        image : (h, w, 3) uint8
        result : FitResult
            Of this frame, by the fitter's method.
        landmarks : (n, 2) float
            Where to paint; smoothed landmarks tremble less than the result's.

        Returns
        -------
        (h, w, 3) uint8

        Raises
        ------
        MethodError
            For a grey picture.
        """
        image = as_colour(image)
        if is_grey(image):
            raise MethodError(
                "the video is grey (three equal channels), and shading is told by colours; give a colour video"
            )
        log = self._log is not self.fitter
        seen = shadow_free(self._log, image, replace(result, method="li", theta=np.nan) if log else result)
        log_rgb = self._filtered(seen)
        model, camera = self.fitter.model, self.fitter.camera or self.fitter.model.camera
        painted, _ = paint(image, landmarks, model, np.concatenate([log_rgb, self._weights[:, None]], axis=1))
        return blended(image, painted, camera.response, max(1.0, REACH * diagonal_of(landmarks)))

    def _filtered(self, seen: ShadowFree) -> np.ndarray:
        """Logarithms of the appearance (n_pixels, 3), its coordinates filtered over time."""
        appearance = self._log.objectives[-1].of_all_pixels.appearance
        noise = np.square(seen.deviations)
        if self._lam is None or self._variance is None:
            self._lam, self._variance = seen.lam, noise
        else:
            self._lam, self._variance = filtered(
                self._lam, self._variance, seen.lam, noise, CHANGE**2 * appearance.eigenvalues
            )
        return appearance.texture(self._lam)


def filtered(
    before: np.ndarray, variance: np.ndarray, measured: np.ndarray, noise: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Kalman filter of values that wander, each by itself: mean and variance (m,) after a measurement.

    Parameters
    ----------
    before, variance : (m,) float
        Belief so far.
    measured, noise : (m,) float
        Values measured, and their variances.
    change : (m,) float
        Variance of a step.
    """
    predicted = variance + change
    gain = predicted / np.maximum(predicted + noise, 1e-300)
    return before + gain * (measured - before), gain * noise


def soft_edge(model: AAM) -> np.ndarray:
    """Weights of the model's pixels, (n_pixels,) float32: 0 at the mesh's border, 1 well inside."""
    from scipy.ndimage import distance_transform_edt

    inside = model.frame.picture(np.ones(model.n_pixels, np.float32), 0.0) > 0
    depth = np.asarray(distance_transform_edt(np.pad(inside, 1)))[1:-1, 1:-1]
    share = np.clip((depth - 1.0) / (SOFT_EDGE * model.diagonal), 0.0, 1.0)
    return (share * share * (3.0 - 2.0 * share))[inside].astype(np.float32)


def blended(image: np.ndarray, painted: np.ndarray, response: Response, reach: float) -> np.ndarray:
    """Lay an appearance over a picture, and take the shading next to it off.

    Parameters
    ----------
    image : (h, w, 3) array
    painted : (h, w, 4) float32
        Logarithms of light, and their weights.
    response : Response
        Of the image's camera.
    reach : float
        How far shading is taken off beyond the weights, pixels.

    Returns
    -------
    (h, w, 3) uint8
    """
    import cv2

    stored = stored_values(image)
    picture = np.rint(255 * stored).astype(np.uint8)
    rows, columns = _box(painted[..., 3] > 0, 4 * reach)
    weights = painted[rows, columns, 3:]
    if not weights.size:
        return picture
    floor = 0.5 * float(to_linear(np.array(1 / 255), response))
    own = np.log(np.maximum(to_linear(stored[rows, columns], response), floor)).astype(np.float32)
    shading = own - painted[rows, columns, :3]
    spread = cv2.GaussianBlur(np.concatenate([weights * shading, weights], axis=2), (0, 0), reach)
    around = spread[..., :3] / np.maximum(spread[..., 3:], 1e-6)
    fading = np.clip(2.5 * spread[..., 3:], 0.0, 1.0)
    taken = weights * shading + (1.0 - weights) * fading * fading * (3.0 - 2.0 * fading) * around
    fresh = np.clip(from_linear(np.exp(own - taken), response), 0.0, 1.0)
    changed = np.abs(taken).max(axis=2) > 0
    picture[rows, columns][changed] = np.rint(255 * fresh).astype(np.uint8)[changed]
    return picture


def _box(inside: np.ndarray, margin: float) -> tuple[slice, slice]:
    """Rows and columns of a mask (h, w) and so much around it; none of an empty one."""
    slices = []
    for axis in (1, 0):
        (seen,) = np.nonzero(inside.any(axis=axis))
        first, last = (seen[0], seen[-1] + 1) if len(seen) else (0, 0)
        grown = round(margin) if len(seen) else 0
        slices.append(slice(max(0, int(first) - grown), int(last) + grown))
    return slices[0], slices[1]
