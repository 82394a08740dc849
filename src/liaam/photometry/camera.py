"""What is known of a camera: its angle, response, vignetting and noise, in one small readable file."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from liaam.errors import CameraError, LiaamError
from liaam.io import write_text_atomically
from liaam.io.files import existing_file, read_bytes, writable
from liaam.photometry.encoding import DARK, SATURATED, stored_values
from liaam.photometry.invariant import THETA_DEFAULT
from liaam.photometry.response import Response, describe_response, from_linear, parse_response, to_linear

FORMAT = "liaam-camera"
VERSION = 1

DIMMEST, BRIGHTEST = 0.02, 50.0
"""Least and largest share of light that vignetting may leave."""

MOST_COEFFICIENTS = 16
"""Coefficients of vignetting: each costs a pass over the picture."""

NOISIEST = 1e8
"""Largest slope and offset of noise, on the curve's own scale of light; more has no meaning, and squares of it end."""

LARGEST = 10_000_000
"""Bytes of a camera file at most."""


@dataclass(frozen=True)
class NoiseModel:
    """Noise of linear light: variance = slope * rho + offset (DESIGN section 1), rho in [0, 1].

    Attributes
    ----------
    slope : float
        a: photon noise, which grows with the light.
    offset : float
        b: noise in the dark.
    """

    slope: float
    offset: float

    def __post_init__(self) -> None:
        """Refuse what is no noise."""
        if not all(0 <= part <= NOISIEST for part in (self.slope, self.offset)):  # NaN is not
            raise CameraError(
                f"noise of slope {self.slope} and offset {self.offset}: give two numbers of at least 0, "
                f"and of {NOISIEST:g} at most"
            )

    def variance(self, linear: np.ndarray) -> np.ndarray:
        """Variance of linear light of given values (any shape)."""
        return self.slope * np.maximum(linear, 0.0) + self.offset


@dataclass(frozen=True)
class CameraModel:
    """What is known of a camera; each part has a sensible default.

    Attributes
    ----------
    theta : float
        Angle of the invariant projection, radians.
    theta_deviation : float, optional
        Its standard error, radians; None where the angle is assumed rather than measured.
    response : Response
        From stored values to linear light.
    vignetting : tuple of float
        Coefficients of r^2, r^4, ... of the share of light that arrives off the centre, 1 + sum v_i r^(2 i),
        with r = 1 in the corners; empty for none.
    noise : NoiseModel, optional
        Of linear light; None where it is estimated from each picture.
    history : tuple of str
        What was estimated from what, a sentence each.
    """

    theta: float = THETA_DEFAULT
    theta_deviation: float | None = None
    response: Response = "srgb"
    vignetting: tuple[float, ...] = ()
    noise: NoiseModel | None = None
    history: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Refuse a camera that cannot be."""
        if not np.isfinite(self.theta) or abs(self.theta) > 2 * np.pi:
            raise CameraError(f"theta {self.theta}: give the camera's angle in radians (122 degrees are 2.13)")
        if self.theta_deviation is not None and not 0 <= self.theta_deviation < np.inf:
            raise CameraError(f"theta_deviation {self.theta_deviation}: give a standard error of at least 0, or None")
        parse_response(self.response)
        _check_vignetting(self.vignetting)

    def falloff(self, height: int, width: int) -> np.ndarray:
        """Share of light that arrives at each pixel, (h, w) float32: 1 in the centre."""
        squared = squared_radius(np.arange(width)[None, :], np.arange(height)[:, None], height, width)
        return falloff_at(squared, self.vignetting).astype(np.float32)

    def flatten(self, image: np.ndarray) -> np.ndarray:
        """Undo the vignetting of a picture.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
            Stored values.

        Returns
        -------
        (h, w, 3)
            Stored values as they would be without vignetting, float32; the very same picture where there is none.
            What was dark or clipped stays so, and what was not does not become it.
        """
        if not self.vignetting:
            return image
        stored = stored_values(image)
        light = to_linear(stored, self.response) / self.falloff(*image.shape[:2])[..., None]
        flat = np.clip(from_linear(light, self.response), DARK, SATURATED).astype(np.float32)
        flat = np.where((stored < DARK) | (stored > SATURATED), stored, flat)
        return np.where(np.isfinite(image), flat, np.float32(np.nan)) if image.dtype.kind == "f" else flat

    def suited_to(self, *, raw: bool, response: str | None = None) -> "CameraModel":
        """Camera with the response of some pictures: the one given, or linear for RAW files."""
        if response is not None:
            return replace(self, response=parse_response(response))
        # A response that was measured is known better; srgb or a gamma speaks of the camera's finished pictures.
        return replace(self, response="linear") if raw and isinstance(self.response, str | float) else self

    def describe(self) -> dict:
        """Facts as JSON knows them; :func:`camera_from` reads them back."""
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


def _check_vignetting(vignetting: tuple[float, ...]) -> None:
    if len(vignetting) > MOST_COEFFICIENTS:
        raise CameraError(f"vignetting of {len(vignetting)} coefficients: give {MOST_COEFFICIENTS} at most")
    with np.errstate(over="ignore", invalid="ignore"):
        shares = _shares(vignetting)
    if not shares.min() >= DIMMEST:  # NaN is not
        raise CameraError(f"vignetting {vignetting}: hardly any light would arrive off the centre")
    if shares.max() > BRIGHTEST:
        raise CameraError(
            f"vignetting {vignetting}: more than {BRIGHTEST:g} times the light would arrive off the centre"
        )


def squared_radius(x: np.ndarray, y: np.ndarray, height: int, width: int) -> np.ndarray:
    """Squared distance of points from a picture's centre, 1 in its corners; x and y, pixels, are broadcast."""
    middle_x, middle_y = (width - 1) / 2.0, (height - 1) / 2.0
    corner = max(middle_x**2 + middle_y**2, 1e-12)  # a picture of one pixel has no corners
    return (np.square(x - middle_x) + np.square(y - middle_y)) / corner


def falloff_at(squared: np.ndarray, vignetting: Sequence[float] | np.ndarray) -> np.ndarray:
    """Share of light at squared distances from the centre (1 in the corners), same shape: 1 + sum v_i r^(2 i)."""
    return 1.0 + sum((v * squared ** (i + 1) for i, v in enumerate(vignetting)), np.zeros_like(squared))


def least_share(vignetting: Sequence[float] | np.ndarray) -> float:
    """Least share of light that arrives anywhere in the picture."""
    return float(_shares(vignetting).min())


def _shares(vignetting: Sequence[float] | np.ndarray) -> np.ndarray:
    """Shares of light that arrive from the centre to the corners."""
    return falloff_at(np.square(np.linspace(0.0, 1.0, 101)), vignetting)


def load_camera(path: str | os.PathLike) -> CameraModel:
    """Read a camera file, checking all of it.

    Raises
    ------
    CameraError
        If the file is missing, is no camera file, or says what cannot be.
    """
    path = Path(path)
    try:
        data = read_bytes(existing_file(path, CameraError, "camera file"), CameraError, LARGEST)
    except CameraError as fault:
        raise CameraError(f"{fault} Camera files are made with 'liaam calibrate'.") from fault
    try:
        facts = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError):
        facts = None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise CameraError(f"{path}: this is no camera file; make one with 'liaam calibrate'")
    if facts.get("version") != VERSION:
        raise CameraError(f"{path}: the camera file has version {facts.get('version')}, this liaam reads {VERSION}")
    unknown = set(facts) - {"format", "version", *CameraModel().describe()}
    if unknown or "theta_deg" not in facts:
        what = f"knows no {', '.join(sorted(unknown))}" if unknown else "needs theta_deg"
        raise CameraError(f"{path}: a camera file {what}; its entries are {', '.join(CameraModel().describe())}")
    try:
        return camera_from(facts)
    except (KeyError, TypeError, ValueError, OverflowError, LiaamError) as error:
        raise CameraError(
            f"{path}: the camera file contradicts itself ({error}); mend it or calibrate again"
        ) from error


def camera_from(facts: Mapping) -> CameraModel:
    """Camera of the facts of :meth:`CameraModel.describe`; raises what a forged file may make it raise."""
    error, noise = facts.get("theta_standard_error_deg"), facts.get("noise")
    return CameraModel(
        theta=float(np.deg2rad(float(facts["theta_deg"]))),
        theta_deviation=None if error is None else float(np.deg2rad(float(error))),
        response=parse_response(facts.get("response", "srgb")),
        vignetting=tuple(float(v) for v in facts.get("vignetting", ())),
        noise=None if noise is None else NoiseModel(float(noise["slope"]), float(noise["offset"])),
        history=tuple(writable(str(line)) for line in facts.get("history", ())),
    )
