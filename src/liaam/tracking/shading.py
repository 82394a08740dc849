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
from liaam.model.shape import diagonal_of
from liaam.photometry import is_grey
from liaam.photometry.encoding import as_colour
from liaam.relighting import ShadowFree, paint, shadow_free
from liaam.relighting.painting import REACH, blended, soft_edge

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
        if self._log is not self.fitter:
            result = replace(result, method=self._log.objectives[-1].method, theta=np.nan)
        seen = shadow_free(self._log, image, result)
        log_rgb = self._filtered(seen)
        model, camera = self.fitter.model, self.fitter.camera or self.fitter.model.camera
        painted, _ = paint(image, landmarks, model, np.concatenate([log_rgb, self._weights[:, None]], axis=1))
        return blended(image, painted, camera.response, max(1.0, REACH * diagonal_of(landmarks)))

    def _filtered(self, seen: ShadowFree) -> np.ndarray:
        """Logarithms of the appearance (n_pixels, 3), its coordinates filtered over time."""
        appearance = self._log.view.levels[-1].appearances["log"]
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
