"""The camera: spectral sensitivities, exposure, noise, response and quantisation."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from liaam.errors import LiaamError
from liaam.photometry.response import Response, from_linear, to_linear
from scenes.light import COLDEST_K, HOTTEST_K, Radiator, check_kelvin, spectrum

BASIS_PEAKS_NM, BASIS_WIDTH_NM = (605.0, 540.0, 460.0), 23.0
TABLE_SIZE = 400


@dataclass(frozen=True)
class Camera:
    """A camera with three Gaussian sensitivities.

    Attributes
    ----------
    peaks_nm : (float, float, float)
        Wavelengths of the channels R, G, B, nm.
    widths_nm : (float, float, float)
        Standard deviations of the sensitivities, nm. At 0 (line sensors) the paper's theory is exact.
    white_K : float
        Temperature of the light under which white appears white (fixed gains, no automatic white balance).
    exposure : float, optional
        Gain from reflectance times irradiance to linear values; None: bright parts of the face reach 0.8.
    vignetting : float
        Loss of light in the corners, 0 to 1.
    response : {"srgb", "linear"} or float
        A number is the exponent g of an encoding value**(1/g).
    read_noise : float
        Standard deviation of the noise in the dark, in linear units (1 is white).
    shot_noise : float
        Slope a of the variance of the linear value rho: variance = a rho + read_noise**2.
    bits : int, optional
        8 or 16 for integers; None for float32 in 0..1.
    """

    peaks_nm: tuple[float, float, float] = (600.0, 540.0, 460.0)
    widths_nm: tuple[float, float, float] = (28.0, 30.0, 24.0)
    white_K: float = 5000.0  # noqa: N815 - a kelvin is a K
    exposure: float | None = None
    vignetting: float = 0.08
    response: Response = "srgb"
    read_noise: float = 0.0015
    shot_noise: float = 0.0001
    bits: int | None = 8

    def __post_init__(self) -> None:
        if len(self.peaks_nm) != 3 or not all(380 <= p <= 720 for p in self.peaks_nm):
            raise LiaamError(f"Camera.peaks_nm is {self.peaks_nm!r}: give three wavelengths from 380 to 720 nm")
        if len(self.widths_nm) != 3 or not all(0 <= w <= 100 for w in self.widths_nm):
            raise LiaamError(f"Camera.widths_nm is {self.widths_nm!r}: give three widths from 0 to 100 nm")
        if self.bits not in (8, 16, None):
            raise LiaamError(f"Camera.bits is {self.bits!r}: give 8, 16 or None (float32)")
        is_exponent = isinstance(self.response, int | float) and 0.1 < self.response < 10
        if self.response not in ("srgb", "linear") and not is_exponent:
            raise LiaamError(f"Camera.response is {self.response!r}: give 'srgb', 'linear' or an exponent")
        for name in ("vignetting", "read_noise", "shot_noise"):
            if not 0 <= getattr(self, name) <= 1:
                raise LiaamError(f"Camera.{name} is {getattr(self, name)!r}: give a number from 0 to 1")
        if self.exposure is not None and not self.exposure > 0:
            raise LiaamError(f"Camera.exposure is {self.exposure!r}: give a positive gain, or None for automatic")
        check_kelvin("Camera.white_K", self.white_K)

    def matrix(self, mired: np.ndarray | float, radiator: Radiator) -> np.ndarray:
        """Matrices (..., 3, 3) from the coefficients of a reflectance to linear channel values.

        Row k holds the integrals of E(lambda, T) b_j(lambda) Q_k(lambda) over the wavelength, with the gains of the
        white balance. The reflectance spectrum is S = sum_j r_j b_j.
        """
        mired = np.asarray(mired, float)[..., None]
        nodes, sensitivity = self._quadrature()
        light = spectrum(nodes, mired, radiator)
        white = sensitivity @ spectrum(nodes, 1e6 / self.white_K, radiator)
        return np.einsum("...n,kn,jn->...kj", light, sensitivity / white[:, None], reflectance_basis(nodes))

    def theta(self, radiator: Radiator = "wien") -> float:
        """Return the true invariant angle, radians in 0..pi.

        L(theta) is orthogonal to the shift of log RGB with temperature. For line sensors and Wien's law it is
        90 deg + atan2(1/lB - 1/lG, 1/lB - 1/lR); otherwise the shift is that of a grey surface from 4000
        to 6500 K.
        """
        grey = self.matrix(np.array([1e6 / 4000, 1e6 / 6500]), radiator).sum(axis=-1)
        shift = np.log(grey[1] / grey[0])
        return float(np.arctan2(shift[0] - shift[2], shift[2] - shift[1]) % np.pi)

    def encode(self, linear: np.ndarray) -> np.ndarray:
        """Response of the camera: linear values in 0..1 to encoded values in 0..1."""
        return from_linear(np.clip(linear, 0, 1), self.response)

    def decode(self, encoded: np.ndarray) -> np.ndarray:
        """Inverse of `encode`."""
        return to_linear(np.clip(encoded, 0, 1), self.response)

    def expose(self, linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Simulate the exposure: noise, response and quantisation.

        Parameters
        ----------
        linear : (h, w, 3) array
            Linear values without noise; the sensor saturates at 1.

        Returns
        -------
        (h, w, 3) uint8, uint16 or float32
        """
        variance = self.shot_noise * linear + self.read_noise**2
        encoded = self.encode(linear + np.sqrt(variance) * rng.standard_normal(linear.shape))
        if self.bits is None:
            return encoded.astype(np.float32)
        return np.round(encoded * (2**self.bits - 1)).astype(np.uint8 if self.bits == 8 else np.uint16)

    def falloff(self, height: int, width: int) -> np.ndarray:
        """Vignetting (h, w): 1 at the centre."""
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        return 1 - self.vignetting * 0.5 * (x**2 + y**2)

    def noiseless(self, response: Response = "linear") -> "Camera":
        """Return the same camera without noise and quantisation."""
        return replace(self, read_noise=0.0, shot_noise=0.0, bits=None, response=response)

    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Wavelengths (n,) and the sensitivities' weights (3, n) for integrals over the spectrum."""
        offsets = [np.linspace(-3, 3, 41) if width > 0 else np.zeros(1) for width in self.widths_nm]
        nodes = [p + w * at for p, w, at in zip(self.peaks_nm, self.widths_nm, offsets, strict=True)]
        bells = [np.exp(-0.5 * at**2) for at in offsets]
        return np.concatenate(nodes), np.asarray(block_diag(*(bell / bell.sum() for bell in bells)))


def narrow_band_camera(
    peaks_nm: tuple[float, float, float] = (610.0, 540.0, 450.0), response: Response = "linear"
) -> Camera:
    """Camera of the paper's theory: line sensors, no noise, no quantisation, no vignetting.

    Examples
    --------
    >>> round(float(np.degrees(narrow_band_camera().theta("wien"))), 2)
    122.43
    """
    return Camera(peaks_nm, (0.0, 0.0, 0.0), vignetting=0.0).noiseless(response)


def reflectance_basis(wavelength_nm: np.ndarray) -> np.ndarray:
    """Three smooth positive spectra (3, n) that sum to 1: the red, green and blue parts of a reflectance."""
    peaks = np.array(BASIS_PEAKS_NM)[:, None]
    bells = np.exp(-0.5 * ((wavelength_nm - peaks) / BASIS_WIDTH_NM) ** 2 + 1e-12)
    return bells / bells.sum(axis=0)


def matrices_at(camera: Camera, mired: np.ndarray, radiator: Radiator) -> np.ndarray:
    """`Camera.matrix` for an image (h, w) of reciprocal temperatures, interpolated from a table.

    The logarithm is interpolated: for Wien's law and line sensors it is linear in 1/T.
    """
    grid = np.linspace(1e6 / HOTTEST_K, 1e6 / COLDEST_K, TABLE_SIZE)
    table = np.log(camera.matrix(grid, radiator))
    entries = [np.interp(mired, grid, table[:, k, j]) for k in range(3) for j in range(3)]
    return np.exp(np.stack(entries, -1)).reshape(*mired.shape, 3, 3)
