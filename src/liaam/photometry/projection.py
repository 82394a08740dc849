"""The light-invariant image (paper section 2)."""

import numpy as np

from liaam.photometry.camera import CameraModel
from liaam.photometry.encoding import as_colour, encode, refuse_grey
from liaam.photometry.invariant import invariant


def invariant_image(
    image: np.ndarray, camera: CameraModel | None = None, *, blur: float = 0.0, name: str = "image"
) -> np.ndarray:
    """Light-invariant value L(theta) . log rho of every pixel (paper eq 7).

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
        Stored values.
    camera : CameraModel, optional
        Camera with theta and response; 122 degrees and sRGB by default. Vignetting scales all channels alike and does
        not affect the invariant.
    blur : float
        Standard deviation of a Gaussian blur of the logarithms, pixels.
    name : str
        Name of the image in error messages.

    Returns
    -------
    (h, w) float32
        NaN where a channel is dark or saturated.

    Raises
    ------
    ImageError
        If the array is not an image, or grey: three equal channels have no invariant.
    """
    camera = camera or CameraModel()
    return projected(log_picture(image, camera, blur=blur, name=name), camera.theta)


def log_picture(image: np.ndarray, camera: CameraModel, *, blur: float = 0.0, name: str = "image") -> np.ndarray:
    """Log-RGB and its mask, (h, w, 4) float32, of a colour image; parameters of :func:`invariant_image`."""
    image = as_colour(image, name)
    refuse_grey(image, name, "an invariant image needs colour")
    return encode(image, "log", camera.response, blur)


def projected(encoded: np.ndarray, theta: float) -> np.ndarray:
    """Invariant values (h, w) float32 of a :func:`log_picture`, NaN in masked pixels."""
    values = invariant(encoded[..., :3], theta).astype(np.float32)
    return np.where(encoded[..., 3] > 0, values, np.float32(np.nan))
