"""Calibrations that need the engine: of scenes whose pictures have to be aligned first, and from fits of a model."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from liaam.errors import CameraError
from liaam.evaluation import rms_error
from liaam.fitting import FitResult, FitStatus
from liaam.photometry import AngleEstimate, CameraModel
from liaam.photometry.estimate import WIDEST_ERROR, axis_difference
from liaam.progress import Progress
from liaam.registration import Registration, register
from liaam.warp import apply_homography, picture_corners

STILL = 0.25
"""Movement of the corners, pixels, up to which a picture counts as aligned and is not sampled anew."""

FEWEST_FITS = 5
"""Fits that a pooled angle needs at least."""

HUBER = 1.5
"""Scale of Huber's loss for the pooled angle, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Pictures brought into the frame of the first.

    Attributes
    ----------
    pictures : tuple of (h, w, 3) arrays
    masks : tuple of (h, w) bool
        Where each shows anything.
    moved : tuple of float
        How far each had to be moved, pixels at the corners (root mean square).
    """

    pictures: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]
    moved: tuple[float, ...]


def align_pictures(
    pictures: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Aligned:
    """Align pictures of one scene with the first, whatever the light in each.

    Parameters
    ----------
    pictures : sequence of (h, w, 3) uint8, uint16 or float arrays
    camera : CameraModel, optional
        Gives response and angle.
    names : sequence of str, optional
        What to call the pictures in errors.
    progress : callable, optional
        Called with (done, total, name) before each picture.

    Returns
    -------
    Aligned

    Raises
    ------
    CameraError
        If a picture cannot be aligned; the message names it.
    """
    first, camera = pictures[0], camera or CameraModel()
    aligned, masks, moved = [first], [np.ones(first.shape[:2], dtype=bool)], [0.0]
    for picture, found in zip(pictures[1:], _register_all(pictures, camera, names, progress), strict=True):
        moved.append(_corner_movement(found.homography, first.shape[:2]))
        if moved[-1] <= STILL and picture.shape == first.shape:
            aligned.append(picture)
            masks.append(masks[0])
            continue
        sampled, mask = found.warp(picture)
        aligned.append(sampled)
        masks.append(mask)
    return Aligned(tuple(aligned), tuple(masks), tuple(moved))


def homographies_between(
    pictures: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> list[np.ndarray]:
    """Homographies from the pixels of each picture to those of the first, (3, 3) float64 each.

    Parameters and errors are those of :func:`align_pictures`.
    """
    found = _register_all(pictures, camera or CameraModel(), names, progress)
    return [np.eye(3), *(np.linalg.inv(one.homography) for one in found)]


def _register_all(
    pictures: Sequence[np.ndarray], camera: CameraModel, names: Sequence[str] | None, progress: Progress | None
) -> list[Registration]:
    """Register the first picture with each of the others."""
    names, found = names or [f"picture {i + 1}" for i in range(len(pictures))], []
    for i, (picture, name) in enumerate(zip(pictures[1:], names[1:], strict=True)):
        if progress:
            progress(i, len(pictures) - 1, name)
        found.append(register(pictures[0], picture, response=camera.response, theta=camera.theta))
        if not found[-1].status.ok:
            raise CameraError(
                f"{name} could not be aligned with {names[0]} ({found[-1].message}); take the pictures from a tripod "
                "and leave the alignment out, or choose pictures that differ less"
            )
    return found


def _corner_movement(homography: np.ndarray, size: tuple[int, int]) -> float:
    """Root mean square movement of the picture's corners by a homography, pixels."""
    corners = picture_corners(*size)
    return rms_error(apply_homography(homography, corners), corners)


def theta_from_fits(results: Iterable[FitResult]) -> AngleEstimate:
    """Angle of a camera pooled over fits that estimate it (methods ``li-pc`` and ``li-pcs``; paper section 2.2).

    Each fit's own covariance knows nothing of what the model cannot explain, so the error is taken from how much
    the fits differ; a few that went wrong are outliers to Huber's loss.

    Parameters
    ----------
    results : iterable of FitResult
        Fits of pictures of one camera under lights that differ from the training light.

    Returns
    -------
    AngleEstimate
        ``light_change`` is NaN: fits do not tell it.

    Raises
    ------
    CameraError
        If the fits do not estimate a free angle.
    """
    results, nan = list(results), float("nan")
    if any(result.method.free_angles not in ("both", "shared") for result in results):
        raise CameraError(
            "to pool a camera's angle, fit with method li-pcs (one camera) or li-pc (another one trained)"
        )
    told = [r for r in results if r.status is FitStatus.CONVERGED and np.isfinite(r.theta)]
    unseen = sum(r.status is FitStatus.LIGHT_UNOBSERVABLE for r in results)
    left = f"{len(results) - len(told)} of {len(results)} fits tell no angle ({unseen} saw no change of light)"
    if len(told) < FEWEST_FITS:
        message = f"{left}; at least {FEWEST_FITS} are needed: fit more pictures, under lights other than in training"
        return AngleEstimate(nan, float("inf"), message, nan, len(told))
    angles = np.array([r.theta for r in told])
    centre = float(np.angle(np.exp(2j * angles).mean()) / 2 % np.pi)  # only up to a half turn
    offset, error = _huber_location(np.array([axis_difference(angle, centre) for angle in angles]))
    from scipy.stats import t  # heavy: imported when first needed

    theta, spread = (centre + offset) % np.pi, np.rad2deg(error * np.sqrt(len(told)))
    error *= float(t.ppf(0.975, len(told) - 1)) / 1.96
    message = f"{len(told)} fits differ by {spread:.2f}°; {left}"
    if error > WIDEST_ERROR:
        return AngleEstimate(theta, float("inf"), f"{message}: too much", nan, len(told))
    return AngleEstimate(theta, error, message, nan, len(told)).doubted()


def _huber_location(values: np.ndarray) -> tuple[float, float]:
    """Huber's estimate of location and its standard error."""
    centre = float(np.median(values))
    # Never far below the deviation: of a few values more than half may be equal by chance.
    scale = max(1.4826 * float(np.median(np.abs(values - centre))), 0.2 * float(values.std()), 1e-9)
    for _ in range(50):
        moved = float(np.clip((values - centre) / scale, -HUBER, HUBER).mean() * scale)
        centre += moved
        if abs(moved) < 1e-12:
            break
    u = (values - centre) / scale
    inside = float((np.abs(u) < HUBER).mean())
    psi = np.clip(u, -HUBER, HUBER)
    n = len(values)
    return centre, scale * float(np.sqrt(np.square(psi).sum() / (n - 1) / n)) / max(inside, 0.1)
