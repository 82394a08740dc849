"""What is fitted: an image's surroundings as a method sees them, the noise in them, and what they show at a state."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from liaam.fitting.methods import Method
from liaam.photometry import NoiseModel, Response, from_linear, log_slope, noise_deviation
from liaam.sampling import Patch, make_patch
from liaam.shape import Similarity

MARGIN = 0.4
"""Surroundings of the start that a fit may visit, as a share of the object's diagonal."""

NEAR = 0.1
"""The same for levels that start where a coarser one stopped."""


LOGS = (-7.0, 0.5)
"""Logarithms of linear light between which its noise is worked out: from black to highlights."""

LOG_STEPS = 512
"""How many of them."""


@dataclass(frozen=True, eq=False)
class FitProblem:
    """One image to be fitted, as a method sees it.

    Attributes
    ----------
    patch : Patch
        Encoded surroundings of the start.
    pose : Similarity
        Model pixels to patch pixels.
    response : Response
        Of the image's camera.
    noise : float or NoiseModel
        Standard deviation of the noise that the patch's averaging leaves, in stored values of [0, 1]; or what is known
        of the camera's noise, in linear light.
    noise_left : float
        Share of it that the blur of the encoded channels leaves.
    slope_left : float
        Standard deviation of a gradient per model pixel that noise of unit deviation leaves after the blur.
    blur : float
        Model pixels.
    """

    patch: Patch
    pose: Similarity
    response: Response = "srgb"
    noise: float | NoiseModel = 0.0
    noise_left: float = 1.0
    slope_left: float = 1.0
    blur: float = 0.0

    @cached_property
    def relative_noise(self) -> np.ndarray:
        """Standard deviation of the logarithm by noise, at evenly spaced logarithms over :data:`LOGS`."""
        if isinstance(self.noise, NoiseModel):
            return self.relative_noise_of(np.exp(np.linspace(*LOGS, LOG_STEPS)))
        return self.noise * _slopes_of_logs(self.response)

    def relative_noise_of(self, linear: np.ndarray) -> np.ndarray:
        """Standard deviation of the logarithm of linear light (any shape) by noise."""
        if isinstance(self.noise, NoiseModel):
            return np.sqrt(self.noise.variance(linear)) / np.maximum(linear, 1e-6)
        return self.noise * _log_slope_of(linear, self.response)

    @classmethod
    def at(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        method: Method,
        response: Response,
        blur: float,
        noise: NoiseModel | float | None = None,
        margin: float | None = None,
    ) -> "FitProblem":
        """Cut and encode an image around a shape.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
        shape : (n, 2) float
            Start, image pixels.
        pose : Similarity
            Model pixels to image pixels.
        method : Method
        response : Response
            Of the image's camera.
        blur : float
            Model pixels.
        noise : NoiseModel or float, optional
            Of the image's camera, or as measured in the image; measured here if left out.
        margin : float, optional
            Surroundings that the fit may visit, as a share of the object's diagonal; :data:`MARGIN` if left out.
        """
        margin = MARGIN if margin is None else margin
        patch = make_patch(image, shape, pose, encoding=method.encoding, response=response, blur=blur, margin=margin)
        to_patch = Similarity(patch.from_image.matrix @ pose.matrix, patch.from_image(pose.offset[None])[0])
        if not method.weighs_noise:
            return cls(patch, to_patch, response, blur=blur)
        left, slope_left = _noise_left(to_patch.scale, blur)
        return cls(patch, to_patch, response, _noise(image, shape, patch, noise), left, slope_left, blur)


@lru_cache(maxsize=16)
def _slopes_of_logs(response: Response) -> np.ndarray:
    """Derivative of the logarithm by the stored value, at evenly spaced logarithms over :data:`LOGS`."""
    return _log_slope_of(np.exp(np.linspace(*LOGS, LOG_STEPS)), response)


def _log_slope_of(linear: np.ndarray, response: Response) -> np.ndarray:
    """Derivative of the logarithm of linear light by the stored value."""
    return log_slope(np.maximum(from_linear(linear, response), 1e-3), response)


def tied_together(blur: float) -> float:
    """Pixels that a Gaussian blur ties together to one independent value, 4 pi blur^2 or 1.

    It is also what the blur divides white noise's variance by.

    Parameters
    ----------
    blur : float
        Standard deviation, pixels.
    """
    return max(1.0, 4.0 * np.pi * blur**2)


def slope_left(blur: float) -> float:
    """Standard deviation of a central difference of white noise of unit deviation under a Gaussian blur, pixels."""
    return float(np.sqrt((1.0 - np.exp(-1.0 / blur**2)) / (8.0 * np.pi * blur**2))) if blur > 0.3 else np.sqrt(0.5)


def _noise_left(scale: float, blur: float) -> tuple[float, float]:
    """What a blur (model pixels; ``scale`` patch pixels each) leaves of noise, and of its gradient per model pixel."""
    return 1.0 / np.sqrt(tied_together(scale * blur)), scale * slope_left(scale * blur)


def _noise(image: np.ndarray, shape: np.ndarray, patch: Patch, known: NoiseModel | float | None) -> float | NoiseModel:
    """Noise around a shape after a patch's averaging."""
    reduce = 1.0 / patch.from_image.scale
    if isinstance(known, NoiseModel):
        return NoiseModel(known.slope / reduce**2, known.offset / reduce**2)
    return (noise_around(image, shape) if known is None else known) / reduce


def noise_around(image: np.ndarray, shape: np.ndarray) -> float:
    """Standard deviation of the noise around a shape, in stored values of [0, 1]."""
    low = np.maximum(shape.min(axis=0).astype(int), 0)
    high = np.maximum(shape.max(axis=0).astype(int) + 2, low + 8)
    return noise_deviation(image[low[1] : high[1], low[0] : high[0]])


@dataclass(frozen=True, eq=False)
class Look:
    """What a picture shows at a state, before it is weighed.

    Attributes
    ----------
    values : (n_pixels, c) float32
        Encoded samples of the image.
    columns : (n_free + 1, n_pixels * k) float32
        Derivatives of the residual by the free angles, and the residual P E(I) - P A itself in the last row.
    steep : (n_pixels, k, 2) float32
        Derivative of the residual by the place, x and y in the model's pixels.
    weights : (n_pixels,) float32
        Image weight in {0, 1}.
    """

    values: np.ndarray
    columns: np.ndarray
    steep: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(
        cls, values: np.ndarray, residual: np.ndarray, steep: np.ndarray, by_angles: np.ndarray, weights: np.ndarray
    ) -> "Look":
        """Make it of a residual (n_pixels, k) and derivatives by the free angles (n_free, n_pixels * k)."""
        own = residual.reshape(1, -1)
        return cls(values, np.concatenate([by_angles, own]) if len(by_angles) else own, steep, weights)

    @property
    def residual(self) -> np.ndarray:
        """P E(I) - P A, (n_pixels, k) float32."""
        return self.columns[-1].reshape(self.steep.shape[:2])

    @property
    def by_angles(self) -> np.ndarray:
        """Derivative of the residual by the free angles, (n_free, n_pixels * k) float32."""
        return self.columns[:-1]

    def with_residual(self, residual: np.ndarray) -> "Look":
        """Give the same with another residual."""
        return Look.of(self.values, residual, self.steep, self.by_angles, self.weights)
