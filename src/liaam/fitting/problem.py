"""The fit problem: the encoded region of an image around the start, and its noise."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from liaam.fitting.level import Picture
from liaam.fitting.methods import Method
from liaam.model.sampling import Light, Patch, make_patch
from liaam.model.shape import Similarity, corners_of
from liaam.photometry import NoiseModel, Response, from_linear, log_slope, noise_deviation

MARGIN = 0.4
"""Margin around the start that a fit may use, as a fraction of the object's diagonal."""

NEAR = 0.1
"""The same for levels that start from a coarser level's solution."""


LOGS = (-7.0, 0.5)
"""Range of logarithms of linear light for which noise is tabulated, from black to highlights."""

LOG_STEPS = 512
"""Number of entries of that table."""


@dataclass(frozen=True, eq=False)
class FitProblem:
    """One image to be fitted, in a method's encoding.

    Attributes
    ----------
    patch : Patch
        Encoded region around the start.
    pose : Similarity
        Model pixels to patch pixels.
    response : Response
        Response of the image's camera.
    noise : float or NoiseModel
        Noise after the patch's averaging: its standard deviation in stored values of [0, 1], or the camera's noise
        model in linear light.
    noise_left : float
        Fraction of its standard deviation left after the blur of the encoded channels.
    slope_left : float
        Standard deviation of a gradient per model pixel after the blur, for noise of unit standard deviation.
    blur : float
        Standard deviation of the blur, model pixels.
    pull, towards : (n_p, n_p), (n_p,) float64
        Precision and mean of p by the points of another landmarker; empty for none.
    """

    patch: Patch
    pose: Similarity
    response: Response = "srgb"
    noise: float | NoiseModel = 0.0
    noise_left: float = 1.0
    slope_left: float = 1.0
    blur: float = 0.0
    pull: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    towards: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def picture(self, correlated: float, noisy: bool) -> Picture:
        """Return the image in the form that the loop takes, with a noise table if ``noisy``."""
        channels = self.patch.channels
        return Picture(
            pixels=channels.reshape(-1),
            height=channels.shape[0],
            width=channels.shape[1],
            similarity=np.ascontiguousarray(np.column_stack([self.pose.matrix, self.pose.offset]), np.float64),
            noise=self.relative_noise.astype(np.float32) if noisy else np.zeros(2, np.float32),
            span=np.array(LOGS),
            kept=np.array([self.noise_left, self.slope_left], np.float64),
            correlated=float(correlated),
            pull=self.pull,
            towards=self.towards,
        )

    @cached_property
    def relative_noise(self) -> np.ndarray:
        """Standard deviation of the logarithm due to noise, at evenly spaced logarithms over :data:`LOGS`."""
        if isinstance(self.noise, NoiseModel):
            linear = np.exp(np.linspace(*LOGS, LOG_STEPS))
            return np.sqrt(self.noise.variance(linear)) / np.maximum(linear, 1e-6)
        return self.noise * _slopes_of_logs(self.response)

    @classmethod
    def at(
        cls,
        image: np.ndarray | Light,
        shape: np.ndarray,
        pose: Similarity,
        method: Method,
        response: Response,
        blur: float,
        noise: NoiseModel | float | None = None,
        margin: float = MARGIN,
    ) -> "FitProblem":
        """Crop and encode an image around a shape.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32, or Light
        shape : (n, 2) float
            Start, image pixels.
        pose : Similarity
            Model pixels to image pixels.
        method : Method
        response : Response
            Response of the image's camera.
        blur : float
            Standard deviation of the blur, model pixels.
        noise : NoiseModel or float, optional
            Noise of the image; by default it is measured here.
        margin : float
            Margin that the fit may use, as a fraction of the object's diagonal.
        """
        patch = make_patch(image, shape, pose, encoding=method.encoding, response=response, blur=blur, margin=margin)
        to_patch = Similarity(patch.from_image.matrix @ pose.matrix, patch.from_image(pose.offset[None])[0])
        if not method.weighs_noise:
            return cls(patch, to_patch, response, blur=blur)
        of_patch = to_patch.scale * blur
        left = 1.0 / np.sqrt(correlated_pixels(of_patch)), to_patch.scale * slope_left(of_patch)
        picture = image.image if isinstance(image, Light) else image
        return cls(patch, to_patch, response, _noise(picture, shape, patch, noise), *left, blur)


@lru_cache(maxsize=16)
def _slopes_of_logs(response: Response) -> np.ndarray:
    """Return the derivative of the logarithm by the stored value, at evenly spaced logarithms over :data:`LOGS`."""
    stored = from_linear(np.exp(np.linspace(*LOGS, LOG_STEPS)), response)
    return log_slope(np.maximum(stored, 1e-3), response)


def correlated_pixels(blur: float) -> float:
    """Return the number of pixels per independent value after a Gaussian blur (pixels): max(1, 4 pi blur^2).

    The blur divides the variance of white noise by this number.
    """
    return max(1.0, 4.0 * np.pi * blur**2)


def slope_left(blur: float) -> float:
    """Return the standard deviation of central differences of unit white noise after a Gaussian blur (pixels)."""
    return float(np.sqrt((1.0 - np.exp(-1.0 / blur**2)) / (8.0 * np.pi * blur**2))) if blur > 0.3 else np.sqrt(0.5)


def _noise(image: np.ndarray, shape: np.ndarray, patch: Patch, known: NoiseModel | float | None) -> float | NoiseModel:
    """Return the noise around a shape after a patch's averaging."""
    reduce = 1.0 / patch.from_image.scale
    if isinstance(known, NoiseModel):
        return NoiseModel(known.slope / reduce**2, known.offset / reduce**2)
    return (noise_around(image, shape) if known is None else known) / reduce


def noise_around(image: np.ndarray, shape: np.ndarray) -> float:
    """Measure the standard deviation of the noise around a shape, in stored values of [0, 1]."""
    low, high = (corner.astype(int) for corner in corners_of(shape))
    low = np.maximum(low, 0)
    high = np.maximum(high + 2, low + 8)
    return noise_deviation(image[low[1] : high[1], low[0] : high[0]])
