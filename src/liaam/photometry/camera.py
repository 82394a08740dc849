"""Camera model: angle, response, vignetting and noise, and its JSON file."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from liaam.errors import CameraError, LiaamError
from liaam.io import write_text_atomically
from liaam.io.files import existing_file, json_object, read_bytes, writable
from liaam.photometry.encoding import stored_values, usable_range
from liaam.photometry.invariant import THETA_DEFAULT
from liaam.photometry.response import Response, describe_response, from_linear, parse_response, to_linear

FORMAT = "liaam-camera"
VERSION = 1

DIMMEST = 0.02  # Least relative light that vignetting may leave
BRIGHTEST = 50.0  # Largest one
MOST_COEFFICIENTS = 16  # Largest number of vignetting coefficients; each costs a pass over the image
# Largest slope and offset of noise, on the curve's scale of light; the squares of larger values might overflow
NOISIEST = 1e8
LARGEST = 10_000_000  # Largest size of a camera file, bytes


@dataclass(frozen=True)
class NoiseModel:
    """Noise of linear light: variance = slope * rho + offset, rho in [0, 1].

    Attributes
    ----------
    slope : float
        Photon noise, proportional to the light.
    offset : float
        Noise in the dark.
    """

    slope: float
    offset: float

    def __post_init__(self) -> None:
        """Check the values."""
        if not all(0 <= part <= NOISIEST for part in (self.slope, self.offset)):  # NaN is not
            raise CameraError(
                f"noise of slope {self.slope} and offset {self.offset}: give two numbers of at least 0 and "
                f"at most {NOISIEST:g}"
            )

    def variance(self, linear: np.ndarray) -> np.ndarray:
        """Variance of the noise at values of linear light (any shape)."""
        return self.slope * np.maximum(linear, 0.0) + self.offset


@dataclass(frozen=True)
class CameraModel:
    """Model of a camera; every part has a default.

    Attributes
    ----------
    theta : float
        Angle of the invariant projection, radians.
    theta_deviation : float, optional
        Its standard error, radians; None if the angle is assumed and not measured.
    response : Response
        Map from stored values to linear light.
    vignetting : tuple of float
        Coefficients v_i of the relative light 1 + sum v_i r^(2 i) at distance r from the centre, with r = 1 in the
        corners; empty for none.
    noise : NoiseModel, optional
        Noise of linear light; None to estimate it from each image.
    history : tuple of str
        Provenance of the values, one sentence per calibration.
    """

    theta: float = THETA_DEFAULT
    theta_deviation: float | None = None
    response: Response = "srgb"
    vignetting: tuple[float, ...] = ()
    noise: NoiseModel | None = None
    history: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Check the values."""
        if not np.isfinite(self.theta) or abs(self.theta) > 2 * np.pi:
            raise CameraError(f"theta {self.theta}: give the camera's angle in radians (122 degrees are 2.13)")
        if self.theta_deviation is not None and not 0 <= self.theta_deviation < np.inf:
            raise CameraError(f"theta_deviation {self.theta_deviation}: give a standard error of at least 0, or None")
        parse_response(self.response)
        if len(self.vignetting) > MOST_COEFFICIENTS:
            raise CameraError(f"vignetting of {len(self.vignetting)} coefficients: give at most {MOST_COEFFICIENTS}")
        with np.errstate(over="ignore", invalid="ignore"):
            shares = _shares(self.vignetting)
        fault = ""
        if not shares.min() >= DIMMEST:  # NaN is not
            fault = f"less than {DIMMEST:g} times the light would remain"
        elif shares.max() > BRIGHTEST:
            fault = f"more than {BRIGHTEST:g} times the light would result"
        if fault:
            raise CameraError(f"vignetting {self.vignetting}: {fault}; calibrate it again")

    def falloff(self, height: int, width: int) -> np.ndarray:
        """Relative light at each pixel, (h, w) float32: 1 at the centre."""
        squared = squared_radius(np.arange(width)[None, :], np.arange(height)[:, None], height, width)
        return falloff_at(squared, self.vignetting).astype(np.float32)

    def flatten(self, image: np.ndarray) -> np.ndarray:
        """Correct the vignetting of an image.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
            Stored values.

        Returns
        -------
        (h, w, 3)
            Stored values without vignetting, float32; the input itself if there are no coefficients. Dark and clipped
            pixels stay as they are, and no other pixel becomes dark or clipped.
        """
        if not self.vignetting:
            return image
        stored = stored_values(image)
        light = to_linear(np.minimum(stored, 1.0), self.response) / self.falloff(*image.shape[:2])[..., None]
        low, high = usable_range(self.response)
        flat = np.clip(from_linear(light, self.response), low, high).astype(np.float32)
        flat = np.where((stored < low) | (stored > high), stored, flat)
        if image.dtype.kind == "f":
            flat = np.where(np.isfinite(image), flat, np.float32(np.nan))
        return flat

    def suited_to(self, *, raw: bool, response: str | None = None) -> "CameraModel":
        """Return a copy with the given response, or by default a linear one for RAW files."""
        if response is not None:
            return replace(self, response=parse_response(response))
        # Keep a measured response; srgb or a gamma describes the camera's processed images, not its RAW files.
        is_measured = not isinstance(self.response, str | float)
        if not raw or is_measured:
            return self
        return replace(self, response="linear")

    def describe(self) -> dict:
        """Convert to a dict for JSON; :func:`camera_from` is the inverse."""
        error = self.theta_deviation
        return {
            "theta_deg": round(float(np.rad2deg(self.theta)), 9),
            "theta_standard_error_deg": None if error is None else round(float(np.rad2deg(error)), 9),
            "response": describe_response(self.response),
            "vignetting": list(self.vignetting),
            "noise": None if self.noise is None else {"slope": self.noise.slope, "offset": self.noise.offset},
            "history": list(self.history),
        }

    def save(self, path: str | os.PathLike) -> None:
        """Write the camera as a readable JSON file, atomically.

        Raises
        ------
        CameraError
            If the folder does not exist or cannot be written.
        """
        facts = {"format": FORMAT, "version": VERSION, **self.describe()}
        text = json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False)
        write_text_atomically(path, text + "\n", CameraError)


def squared_radius(x: np.ndarray, y: np.ndarray, height: int, width: int) -> np.ndarray:
    """Squared distance of points from an image's centre, 1 in its corners; x and y, pixels, are broadcast."""
    middle_x = (width - 1) / 2.0
    middle_y = (height - 1) / 2.0
    of_corner = max(middle_x**2 + middle_y**2, 1e-12)  # an image of one pixel has no corners
    return (np.square(x - middle_x) + np.square(y - middle_y)) / of_corner


def falloff_at(squared: np.ndarray, vignetting: Sequence[float] | np.ndarray) -> np.ndarray:
    """Relative light 1 + sum v_i r^(2 i) at squared distances r^2 from the centre (1 in the corners), same shape."""
    return 1.0 + sum((v * squared ** (i + 1) for i, v in enumerate(vignetting)), np.zeros_like(squared))


def least_share(vignetting: Sequence[float] | np.ndarray) -> float:
    """Least relative light in the image."""
    return float(_shares(vignetting).min())


def _shares(vignetting: Sequence[float] | np.ndarray) -> np.ndarray:
    """Relative light at 101 distances from the centre to the corners."""
    return falloff_at(np.square(np.linspace(0.0, 1.0, 101)), vignetting)


def check_camera(camera: object) -> None:
    """Raise if the argument is not a camera."""
    if not isinstance(camera, CameraModel):
        raise CameraError(f"{camera!r} is not a camera; of a file, give liaam.load_camera(path)")


def load_camera(path: str | os.PathLike) -> CameraModel:
    """Read and validate a camera file.

    Raises
    ------
    CameraError
        If the file is missing, not a camera file, or inconsistent.
    """
    path = Path(path)
    try:
        data = read_bytes(existing_file(path, CameraError, "camera file"), CameraError, LARGEST)
    except CameraError as fault:
        raise type(fault)(f"{fault} Camera files are made with 'liaam camera'.") from fault
    facts = json_object(data) or {}
    if facts.get("format") != FORMAT:
        raise CameraError(f"{path}: this is not a camera file; make one with 'liaam camera'")
    if facts.get("version") != VERSION:
        raise CameraError(
            f"{path}: the camera file has version {facts.get('version')}, this liaam reads version {VERSION}; make it "
            "again with 'liaam camera'"
        )
    unknown = set(facts) - {"format", "version", *CameraModel().describe()}
    if unknown or "theta_deg" not in facts:
        fault = f"unknown entry {', '.join(sorted(unknown))}" if unknown else "the entry theta_deg is missing"
        raise CameraError(f"{path}: {fault}; the entries are {', '.join(CameraModel().describe())}")
    try:
        return camera_from(facts)
    except (KeyError, TypeError, ValueError, OverflowError, LiaamError) as error:
        raise CameraError(f"{path}: the camera file contradicts itself ({error}); fix it or calibrate again") from error


def camera_from(facts: Mapping) -> CameraModel:
    """Make a camera from the dict of :meth:`CameraModel.describe`; invalid entries raise various exceptions."""
    error = facts.get("theta_standard_error_deg")
    noise = facts.get("noise")
    return CameraModel(
        theta=float(np.deg2rad(float(facts["theta_deg"]))),
        theta_deviation=None if error is None else float(np.deg2rad(float(error))),
        response=parse_response(facts.get("response", "srgb")),
        vignetting=tuple(float(v) for v in facts.get("vignetting", ())),
        noise=None if noise is None else NoiseModel(float(noise["slope"]), float(noise["offset"])),
        history=tuple(writable(str(line)) for line in facts.get("history", ())),
    )
