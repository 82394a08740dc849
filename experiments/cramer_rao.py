"""The Cramer-Rao bound of a fit: the smallest covariance of any unbiased estimator that uses the same measurements.

The image is the data, one noisy value per pixel and channel. Shape, appearance and angles are the unknowns. The Fisher
information is the Gauss-Newton Hessian with each pixel whitened by its own noise, evaluated at the true parameters on
an image without noise.
"""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import Objective, make_objectives
from liaam.fitting.methods import Method, get_method
from liaam.formatting import short_repr
from liaam.model import AAM
from liaam.model.mesh import signed_areas
from liaam.model.shape import align
from liaam.photometry import Response, from_linear, log_slope, srgb_to_linear
from liaam.photometry.encoding import as_colour


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest covariance of an unbiased estimate.

    Attributes
    ----------
    landmarks : (n, 2, 2) float64
        Covariance of each landmark, square pixels of the image. Infinite if the shape cannot be estimated.
    rms : float
        Root mean square distance of the landmarks from the truth, pixels of the image.
    theta : float
        Standard deviation of the image's angle theta_2, radians. NaN for methods without angles, infinite if the
        light makes theta_2 unobservable.
    """

    landmarks: np.ndarray
    rms: float
    theta: float

    __repr__ = short_repr

    @property
    def mean_distance(self) -> float:
        """Expected distance of a landmark from the truth under Gaussian errors, mean over landmarks, pixels."""
        from scipy.special import ellipe

        if not np.isfinite(self.rms):
            return np.inf
        low, high = np.linalg.eigvalsh(self.landmarks).T
        flatness = 1.0 - np.divide(low, high, out=np.ones_like(low), where=high > 0)
        return float((np.sqrt(2.0 * high / np.pi) * ellipe(np.clip(flatness, 0.0, 1.0))).mean())


UNSEEN = 1e-9
"""Information about an angle that counts as rounding error, relative to the information in the image alone, before
the nuisance parameters are eliminated."""

RIDGE = 1e-8
"""Relative ridge on the Gram matrix of the appearance, far below any observable mode."""


def cramer_rao_bound(
    model: AAM,
    image: np.ndarray,
    shape: np.ndarray,
    method: str | Method,
    sigma: float,
    *,
    theta: float | None = None,
    response: Response | None = None,
) -> Bound:
    """Compute the Cramer-Rao bound for one image under white noise of its stored values.

    As in a fit, an object at least twice as large as the reference frame is averaged down first. The bound then
    applies to the averaged image. Train with a larger frame for the bound of all pixels.

    Parameters
    ----------
    model : AAM
        All its modes are free; shape and appearance have no prior.
    image : (h, w, 3) uint8, uint16 or float array
        Image without noise.
    shape : (n, 2) float
        True landmarks, image pixels.
    method : str or Method
        Its encoding, metric, free angles and extra modes define the measurement. Its weights and loss are ignored.
    sigma : float
        Standard deviation of the noise, in stored values of [0, 1].
    theta : float, optional
        True angle of the image's camera, radians; by default the model's.
    response : Response, optional
        Response of the image's camera; by default the training camera's.

    Returns
    -------
    Bound

    Raises
    ------
    MethodError
        For methods that compare gradient orientations, whose noise depends on the gradient and is not Gaussian, or the
        channels of a function.
    """
    method, response = get_method(method), model.response if response is None else response
    if method.encoding_name in ("orientation", "soft", "features"):
        what = "a function's channels" if callable(method.encoding) else "gradient orientations"
        raise MethodError(
            f"method {method.name}: the noise of {what} is unknown, so there is no bound; "
            "use 'li' or another method that compares values or logarithms"
        )
    objective = make_objectives(model, method, thinning=0.0)[-1]
    shapes = model.views[method.view].shape_model
    pose = align(shapes.mean, shape)
    encoded = EncodedImage.at(as_colour(image), shape, pose, method, response, blur=0.0)
    p = shapes.parameters(pose.inverse()(shape))
    angles = np.array([model.theta, model.theta if theta is None else theta])
    density = _pixels_per_sample(model, shape)[model.views[method.view].warp.every(0.0)]
    covariance, n_p = _covariance(objective, encoded, response, p, angles, density, sigma), len(p)
    modes = shapes.basis.reshape(n_p, -1, 2) @ pose.matrix.T
    if np.isfinite(covariance[:n_p, :n_p]).all():
        # An infinite variance can only be an angle's. Landmarks do not depend on an unobservable angle.
        landmarks = np.einsum("inx,ij,jny->nxy", modes, covariance[:n_p, :n_p], modes, optimize=True)
    else:
        landmarks = np.tile(np.diag([np.inf, np.inf]), (model.n_points, 1, 1))
    # The last parameter is theta_2, also if one angle serves both cameras.
    deviation = float(np.sqrt(covariance[-1, -1])) if len(covariance) > n_p else np.nan
    return Bound(landmarks, float(np.sqrt(np.trace(landmarks, axis1=1, axis2=2).mean())), deviation)


def _pixels_per_sample(model: AAM, shape: np.ndarray) -> np.ndarray:
    """Return the number of image pixels per model pixel, (n_pixels,) float64."""
    areas = signed_areas(shape, model.triangles) / signed_areas(model.shape_model.mean, model.triangles)
    return np.maximum(areas, 0.0)[model.frame.owners]


def _covariance(
    objective: Objective,
    encoded: EncodedImage,
    response: Response,
    p: np.ndarray,
    angles: np.ndarray,
    density: np.ndarray,
    sigma: float,
) -> np.ndarray:
    """Return the inverse Fisher information of (p, free angles) with lambda marginalised."""
    method, n, n_p = objective.method, len(density), objective.warp.n_parameters
    problem = objective.problem(encoded)
    problem.begin(p, tuple(angles), np.zeros(objective.n_lambda))
    problem.evaluate(True)
    problem.differentiate(True, True)
    seen = SimpleNamespace(**problem.arrays())
    metric = method.image_metric(angles[1])
    noise = _channel_noise(seen.values[:, : metric.shape[1]], method.encoding, response, sigma)
    whitening = _whitening(noise, metric)
    whitening *= np.sqrt(density * seen.usable * (objective.appearance.usable > 0))[:, None, None]

    def whitened(rows: np.ndarray) -> np.ndarray:
        each = rows.reshape(len(rows), n, method.n_rows)
        return np.einsum("nkr,jnr->jnk", whitening, each, optimize=True).reshape(len(rows), -1)

    by_place = seen.gradients.reshape(n, method.n_rows, 2).astype(np.float64)
    by_p = np.einsum("nka,nai->ink", by_place, objective.warp.jacobian(p), optimize=True).reshape(n_p, -1)
    J = whitened(np.concatenate([by_p, seen.columns]))
    scale = np.square(J).sum(axis=1)
    if scale[n_p:].size:
        # One angle for both cameras: its column depends on the change of light and may be rounding error only.
        slope = (method.image_metric(angles[1] + 1e-4) - method.image_metric(angles[1] - 1e-4)) / 2e-4
        by_image = (seen.values[:, : slope.shape[1]] @ slope.T).astype(np.float64)
        least = np.square(method.angle_directions[1]) * np.square(whitened(by_image.reshape(1, -1))).sum()
        scale[n_p:] = np.maximum(scale[n_p:], least)
    return _inverse(_information(J, whitened(seen.modes[1:])), scale)


def _information(J: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Return J'QJ: inner products of rows J (n_q, e) projected on the complement of rows A (m, e)."""
    A = A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), 1e-300)
    aj = A @ J.T
    return J @ J.T - aj.T @ np.linalg.solve(A @ A.T + RIDGE * np.eye(len(A)), aj)


def _inverse(information: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Invert an information matrix; parameters with a component in its null space get infinite variance."""
    root = np.sqrt(np.maximum(scale, 1e-300))
    seen, axes = np.linalg.eigh(information / np.outer(root, root))
    blind = seen < UNSEEN
    kept = axes[:, ~blind]
    covariance = (kept / seen[~blind]) @ kept.T / np.outer(root, root)
    unknown = np.asarray((np.abs(axes[:, blind]) > 1e-3).any(axis=1))
    covariance[unknown, unknown] = np.inf
    return covariance


def _channel_noise(values: np.ndarray, encoding: str, response: Response, sigma: float) -> np.ndarray:
    """Return the standard deviation of encoded channels, (n, 3) float64, under white noise of the stored values."""
    values = values.astype(np.float64)
    if encoding == "log":
        return sigma * log_slope(np.maximum(from_linear(np.exp(values), response), 1e-4), response)
    if response == "srgb":
        return np.full(values.shape, sigma)
    stored = np.maximum(from_linear(srgb_to_linear(values), response), 1e-4)
    return sigma * log_slope(stored, response) / log_slope(np.maximum(values, 1e-4), "srgb")


def _whitening(deviation: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Return matrices W (n, k, k) with W P Sigma P' W' = I for channels with independent noise."""
    covariance = np.einsum("kc,nc,lc->nkl", metric, np.square(deviation), metric)
    return np.linalg.inv(np.linalg.cholesky(covariance))
