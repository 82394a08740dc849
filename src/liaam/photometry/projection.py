"""The invariant image of a picture (paper section 2)."""

import numpy as np

from liaam.photometry.camera import CameraModel
from liaam.photometry.encoding import as_colour, encode, refuse_grey
from liaam.photometry.invariant import invariant


def invariant_image(
    image: np.ndarray, camera: CameraModel | None = None, *, blur: float = 0.0, name: str = "image"
) -> np.ndarray:
    """Light-invariant value L(theta) . log rho of every pixel (paper eq 8).

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
        Stored values.
    camera : CameraModel, optional
        Gives theta and response; 122 degrees and sRGB if left out. Vignetting dims all channels alike, which the
        invariant does not see.
    blur : float
        Standard deviation of a Gaussian blur of the logarithms, pixels.
    name : str
        What to call the image in errors.

    Returns
    -------
    (h, w) float32
        NaN where a channel is dark or saturated, so that its logarithm says nothing.

    Raises
    ------
    ImageError
        If the array is no image, or grey: three equal channels have no invariant.
    """
    camera = camera or CameraModel()
    return projected(log_picture(image, camera, blur=blur, name=name), camera.theta)


def log_picture(image: np.ndarray, camera: CameraModel, *, blur: float = 0.0, name: str = "image") -> np.ndarray:
    """Log-RGB and its mask, (h, w, 4) float32, of a picture that has colour; parameters as of the invariant image."""
    image = as_colour(image, name)
    refuse_grey(image, name, "an invariant image needs colour")
    return encode(image, "log", camera.response, blur)


def projected(encoded: np.ndarray, theta: float) -> np.ndarray:
    """Invariant values (h, w) float32 of a :func:`log_picture`, NaN where it is masked."""
    values = invariant(encoded[..., :3], theta).astype(np.float32)
    return np.where(encoded[..., 3] > 0, values, np.float32(np.nan))
