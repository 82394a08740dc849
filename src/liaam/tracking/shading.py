"""Remove the shading from a video: show each frame's object under the training light (paper eq 11), without flicker.

A Kalman filter smooths the appearance parameters. The appearance blends into the image by weights fixed to the object,
because pixels at the mesh's border may enter and leave it between frames. The mesh follows the smoothed landmarks.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.model.shape import diagonal_of
from liaam.photometry.encoding import as_colour, refuse_grey
from liaam.relighting import paint, shadow_free
from liaam.relighting.appearance import by_invariant
from liaam.relighting.painting import REACH, soft_edge

CHANGE = 0.1
"""Standard deviation of the change of an appearance parameter per frame, in standard deviations of its mode."""


@dataclass(eq=False)
class ShadingRemover:
    """Removes the shading of an object, frame by frame.

    Attributes
    ----------
    fitter : Fitter
        Fitter of the frames, with all levels. Its method is ``soft-li`` or fits the appearance of log-RGB.
    """

    fitter: Fitter
    _part: Fitter = field(init=False, repr=False)
    _before: tuple[np.ndarray, np.ndarray] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        method, model = self.fitter.objectives[-1].method, self.fitter.model
        if method.appearance not in ("log", "soft"):
            raise MethodError(
                f"method {method.name} does not fit the appearance of log-RGB, so it cannot remove shading; "
                "track with 'soft-li', 'li', 'li-pc', 'li-pcs' or 'chroma'"
            )
        if not model.is_colour:
            raise MethodError(
                "the model was trained on grey images, and estimating shading needs colour; train on colour images"
            )
        self._use(self.fitter.parts[0])

    def _use(self, part: Fitter) -> None:
        """Use the fitter of one of the model's parts."""
        # soft-li determines the appearance from the invariant.
        is_soft = part.objectives[-1].method.appearance == "soft"
        self._part, self._before, self._log = part, None, by_invariant(part) if is_soft else part
        self._weights = soft_edge(part.model)

    def reset(self) -> None:
        """Reset the filter, after the object was lost."""
        self._before = None

    def remove(self, image: np.ndarray, result: FitResult, landmarks: np.ndarray) -> np.ndarray:
        """Return the image with the object under the training light.

        Parameters
        ----------
        image : (h, w, 3) uint8
        result : FitResult
            Fit of this frame by the fitter's method.
        landmarks : (n, 2) float
            Where to paint. Smoothed landmarks jitter less than the result's.

        Returns
        -------
        (h, w, 3) uint8

        Raises
        ------
        MethodError
            For a grey image.
        """
        image = as_colour(image)
        refuse_grey(image, "the video", "estimating shading needs colour; give a colour video", MethodError)
        part = self.fitter.part_for(result.landmarks)
        if part is not self._part:
            self._use(part)
        if self._log is not part:
            result = replace(result, method=self._log.objectives[-1].method, theta=np.nan)
        seen, appearance = shadow_free(self._log, image, result), self._log.view.levels[-1].appearances["log"]
        now = seen.lam, np.square(seen.deviations)
        if self._before is not None:
            now = filtered(*self._before, *now, CHANGE**2 * appearance.eigenvalues)
        self._before = now
        model, camera = part.model, part.camera or part.model.camera
        from liaam.relighting.blending import blended

        log_rgba = np.concatenate([appearance.texture(now[0]), self._weights[:, None]], axis=1)
        painted, _ = paint(image, landmarks, model, log_rgba)
        return blended(image, painted, camera.response, max(1.0, REACH * diagonal_of(landmarks)))


def filtered(
    before: np.ndarray, variance: np.ndarray, measured: np.ndarray, noise: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Kalman filter of independent random walks with steps of variance ``change``. Return mean and variance (m,)."""
    predicted = variance + change
    gain = predicted / np.maximum(predicted + noise, 1e-300)
    return before + gain * (measured - before), gain * noise
