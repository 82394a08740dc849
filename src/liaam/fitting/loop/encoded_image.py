"""The encoded level: the region of an image around the start in a method's encoding, and its noise."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from liaam import _core
from liaam.fitting.methods import Method
from liaam.model.sampling import AveragedImage, Patch, make_patch
from liaam.model.shape import Similarity, corners_of
from liaam.photometry import NoiseModel, Response, linear_to_srgb, log_slope, noise_deviation

MARGIN = 0.4  # around the start that a fit may use, as a fraction of the object's diagonal
NEAR = 0.1  # the same for levels that start from a coarser level's solution
LOG_RANGE = (-7.0, 0.5)  # of logarithms of linear light for which noise is tabulated, from black to highlights
LOG_STEPS = 512  # entries of that table
NO_NOISE = np.zeros(2, np.float32)  # the table for methods that do not weigh noise
LEAST_BLUR = 0.3  # blur in pixels up to which it leaves white noise as it is


@dataclass(frozen=True, eq=False)
class EncodedImage:
    """An image in a method's encoding, ready for an objective."""

    patch: Patch  # encoded region around the start
    from_model: Similarity  # model pixels to patch pixels
    # (s,) float32: standard deviation of the logarithm due to noise, at evenly spaced logarithms over LOG_RANGE
    log_noise: np.ndarray = field(default_factory=NO_NOISE.copy)
    value_noise_gain: float = 1.0  # of the blur of the encoded channels: the fraction of it that is left
    # Standard deviation of a gradient per model pixel after that blur, for noise of unit standard deviation
    slope_noise_gain: float = 1.0
    blur: float = 0.0  # its standard deviation, model pixels
    correlated: float = 1.0  # number of sampled pixels per independent residual, for weights by rows
    # Precision and mean of p by the points of another landmarker, (n_p, n_p) and (n_p,) float64; empty for none.
    point_precision: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    points: np.ndarray = field(default_factory=lambda: np.zeros(0))

    log_range = LOG_RANGE

    @property
    def channels(self) -> np.ndarray:
        """Encoded pixels, (h, w, 8) float32; the last channel is the weight."""
        return self.patch.channels

    @cached_property
    def compiled(self) -> Any:
        """The image in the form that the core takes."""
        height, width = self.channels.shape[:2]
        first_log, last_log = LOG_RANGE
        return _core.make_image(
            {
                "pixels": self.channels.reshape(-1),
                "height": height,
                "width": width,
                "from_model": np.column_stack([self.from_model.matrix, self.from_model.offset]),
                "first_log": first_log,
                "last_log": last_log,
                "log_noise": self.log_noise,
                "value_noise_gain": self.value_noise_gain,
                "slope_noise_gain": self.slope_noise_gain,
                "correlated": self.correlated,
                "point_precision": self.point_precision,
                "points": self.points,
            }
        )

    @classmethod
    def at(
        cls,
        image: np.ndarray | AveragedImage,
        shape: np.ndarray,
        pose: Similarity,
        method: Method,
        response: Response,
        blur: float,
        noise: NoiseModel | float | None = None,
        margin: float = MARGIN,
        density: float = 1.0,
    ) -> "EncodedImage":
        """Crop and encode an image around a shape (n, 2) in it.

        The pose maps model pixels to image pixels, ``blur`` is in model pixels, ``margin`` a fraction of the object's
        diagonal, and ``density`` the fraction of the frame's pixels that are sampled. The noise is measured here by
        default.
        """
        patch = make_patch(image, shape, pose, encoding=method.encoding, response=response, blur=blur, margin=margin)
        from_model = Similarity(patch.from_image.matrix @ pose.matrix, patch.from_image(pose.offset[None])[0])
        # In an image smaller than the model's frame, one image pixel covers several model pixels.
        correlated = max(1.0, density * max(correlated_pixels(blur), 1.0 / from_model.scale**2))
        if not method.weighs_noise:
            return cls(patch, from_model, blur=blur, correlated=correlated)
        if noise is None:
            picture = image.image if isinstance(image, AveragedImage) else image
            noise = noise_around(picture, shape, response)
        # The patch averages over blocks of the image, which reduces noise by their side.
        table = (noise_table(noise) * patch.from_image.scale).astype(np.float32)
        blur_on_patch = from_model.scale * blur  # patch pixels
        return cls(
            patch,
            from_model,
            log_noise=table,
            value_noise_gain=1.0 / np.sqrt(correlated_pixels(blur_on_patch)),
            slope_noise_gain=from_model.scale * slope_noise_gain(blur_on_patch),
            blur=blur,
            correlated=correlated,
        )


def noise_table(noise: NoiseModel | float) -> np.ndarray:
    """Return the standard deviation of the logarithm due to noise, at evenly spaced logarithms over ``LOG_RANGE``.

    ``noise`` is the standard deviation in sRGB-encoded values of [0, 1], or the camera's noise model in linear light.
    """
    if isinstance(noise, NoiseModel):
        linear = np.exp(np.linspace(*LOG_RANGE, LOG_STEPS))
        return np.sqrt(noise.variance(linear)) / np.maximum(linear, 1e-6)
    return noise * _slopes_of_logs()


@lru_cache(maxsize=1)
def _slopes_of_logs() -> np.ndarray:
    """Return the derivative of the logarithm by the sRGB-encoded value, at the logarithms of :func:`noise_table`."""
    encoded = linear_to_srgb(np.exp(np.linspace(*LOG_RANGE, LOG_STEPS)))
    return log_slope(np.maximum(encoded, 1e-3))


def correlated_pixels(blur: float) -> float:
    """Return the number of pixels per independent value after a Gaussian blur (pixels): max(1, 4 pi blur^2).

    The blur divides the variance of white noise by this number.
    """
    return max(1.0, 4.0 * np.pi * blur**2)


def slope_noise_gain(blur: float) -> float:
    """Return the standard deviation of central differences of unit white noise after a Gaussian blur (pixels)."""
    if blur <= LEAST_BLUR:
        return np.sqrt(0.5)
    return float(np.sqrt((1.0 - np.exp(-1.0 / blur**2)) / (8.0 * np.pi * blur**2)))


def noise_around(image: np.ndarray, shape: np.ndarray, response: Response) -> float:
    """Measure the standard deviation of the noise around a shape, in sRGB-encoded values of [0, 1]."""
    low, high = (corner.astype(int) for corner in corners_of(shape))
    low = np.maximum(low, 0)
    high = np.maximum(high + 2, low + 8)  # at least 8 pixels, from which noise can be measured
    return noise_deviation(image[low[1] : high[1], low[0] : high[0]], response)
