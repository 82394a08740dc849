"""Remove the shading from a video: show each frame's object under the training light, without flicker.

The light changes slowly, so that of the frames is averaged over time. Everything else is of each frame. The colour of
the light stays: frames in which the object is not seen could not be corrected like the others.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.photometry.encoding import as_colour, refuse_grey
from liaam.relighting import Relighter
from liaam.relighting.appearance import check_colour, check_method
from liaam.relighting.shading import Shading

# Weights of a frame's light in the running average, at first and later: the light follows within about five and about
# twenty frames
FIRST_SHARE = 0.2
SHARE = 0.05


@dataclass(eq=False)
class ShadingRemover:
    """Removes the shading of an object, frame by frame.

    Attributes
    ----------
    fitter : Fitter
        Fitter of the frames, with all levels. Its method is ``soft-li`` or fits the appearance of log-RGB.
    """

    fitter: Fitter
    _model: AAM | None = field(default=None, init=False, repr=False)
    _before: Shading | None = field(default=None, init=False, repr=False)
    _frames: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        check_method(self.fitter)
        check_colour(self.fitter.model)

    def reset(self) -> None:
        """Reset the average, after the object was lost."""
        self._before = None
        self._frames = 0

    def remove(self, image: np.ndarray, result: FitResult, landmarks: np.ndarray) -> np.ndarray:
        """Return the image with the object under the training light.

        Parameters
        ----------
        image : (h, w, 3) uint8
        result : FitResult
            Fit of this frame by the fitter's method.
        landmarks : (n, 2) float
            Where the object is. Smoothed landmarks jitter less than the result's.

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
        part = self.fitter.lit_part_for(result).model
        if part is not self._model:
            self._model = part
            self.reset()
        return Relighter.of(
            self.fitter, image, replace(result, landmarks=landmarks), name="the video", steadied=self._steadied
        ).flat(balance=False)

    def _steadied(self, now: Shading) -> Shading:
        """Return the running average of the light."""
        before = self._before or now
        self._frames = self._frames + 1
        share = max(SHARE, min(FIRST_SHARE, 1.0 / self._frames))
        self._before = before.towards(now, share)
        return self._before
