"""The Cramer-Rao bound of a fit: what noise leaves to any unbiased estimator that measures an image this way.

The image is data, one noisy value per pixel and channel; the model's shape, appearance and angles are unknown.
The Fisher information is that of the Gauss-Newton Hessian with each pixel whitened by its own noise,
taken at the truth of a picture without noise.
"""

from dataclasses import dataclass

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.methods import Method, get_method
from liaam.fitting.objective import Objective, make_objectives
from liaam.fitting.problem import FitProblem
from liaam.fitting.reference import angle_column, jacobian
from liaam.fitting.solver import SolverOptions
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
        Covariance of each landmark, square pixels of the image; infinite variances where too little is seen to
        tell the shape.
    rms : float
        Root mean square distance of the landmarks from the truth, pixels of the image.
    theta : float
        Standard deviation of the image's angle theta_2, radians; NaN for methods without one, infinite where the
        light does not show it.
    """

    landmarks: np.ndarray
    rms: float
    theta: float

    @property
    def mean_distance(self) -> float:
        """Expected distance of a landmark from the truth if errors are Gaussian, mean over landmarks, pixels."""
        from scipy.special import ellipe

        if not np.isfinite(self.rms):
            return np.inf
        low, high = np.linalg.eigvalsh(self.landmarks).T
        flatness = 1.0 - np.divide(low, high, out=np.ones_like(low), where=high > 0)
        return float((np.sqrt(2.0 * high / np.pi) * ellipe(np.clip(flatness, 0.0, 1.0))).mean())


UNSEEN = 1e-9
"""Information about an angle, relative to that of the image's part before nuisances are taken out, that is
rounding."""

RIDGE = 1e-8
"""Relative ridge on the Gram matrix of the appearance, far below any mode that can be seen."""


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
    """Bound for one picture under white noise of its stored values.

    An object at least twice as large as the reference frame is averaged down first, as a fit does: the bound is then
    that of the averaged picture. Train with a larger frame for the bound of all pixels.

    Parameters
    ----------
    model : AAM
        All of whose modes are taken to be free; shape and appearance have no prior.
    image : (h, w, 3) uint8, uint16 or float array
        Without noise.
    shape : (n, 2) float
        True landmarks, image pixels.
    method : str or Method
        What is measured: its encoding, metric, free angles and extra modes count, its weights and loss do not.
    sigma : float
        Standard deviation of the noise, in stored values of [0, 1].
    theta : float, optional
        True angle of the image's camera, radians; the model's own if left out.
    response : Response, optional
        Of the image's camera; the training camera's if left out.

    Returns
    -------
    Bound

    Raises
    ------
    MethodError
        For a method on orientations of gradients: their noise depends on the gradient, and is not Gaussian.
    """
    method, response = get_method(method), model.response if response is None else response
    if method.encoding in ("orientation", "soft"):
        raise MethodError(
            f"method {method.name}: the noise of gradient orientations is not known, so no bound is; "
            "take 'li' or another method of values or logarithms"
        )
    objective = make_objectives(model, method, "reference")[-1].of_all_pixels
    shapes = model.views[method.view].shape_model
    pose = align(shapes.mean, shape)
    problem = FitProblem.at(as_colour(image), shape, pose, method, response, blur=0.0)
    p = shapes.parameters(pose.inverse()(shape))
    angles = np.array([model.theta, model.theta if theta is None else theta])
    density = _pixels_per_sample(model, shape)[model.views[method.view].warp.every(0.0)]
    covariance, n_p = _covariance(objective, problem, p, angles, density, sigma), len(p)
    modes = shapes.basis.reshape(n_p, -1, 2) @ pose.matrix.T
    if np.isfinite(covariance[:n_p, :n_p]).all():
        # Whatever is infinite is an angle's: landmarks do not depend on it where no light shows it.
        landmarks = np.einsum("inx,ij,jny->nxy", modes, covariance[:n_p, :n_p], modes, optimize=True)
    else:
        landmarks = np.tile(np.diag([np.inf, np.inf]), (model.n_points, 1, 1))
    # Where one angle stands for both cameras, or both are free, the last is the image's.
    deviation = float(np.sqrt(covariance[-1, -1])) if len(covariance) > n_p else np.nan
    return Bound(landmarks, float(np.sqrt(np.trace(landmarks, axis1=1, axis2=2).mean())), deviation)


def _pixels_per_sample(model: AAM, shape: np.ndarray) -> np.ndarray:
    """Image pixels that each of the model's pixels stands for, (n_pixels,) float64."""
    areas = signed_areas(shape, model.triangles) / signed_areas(model.shape_model.mean, model.triangles)
    return np.maximum(areas, 0.0)[model.frame.owners]


def _covariance(
    objective: Objective, problem: FitProblem, p: np.ndarray, angles: np.ndarray, density: np.ndarray, sigma: float
) -> np.ndarray:
    """Inverse Fisher information of (p, free angles) with the appearance's coordinates marginalised."""
    method, n, n_p = objective.method, len(density), objective.warp.n_parameters
    work, only_look = objective.work(objective.start(p)._replace(angles=angles)), SolverOptions(max_iterations=0)
    objective.solve(problem, work, only_look.controls(expected=False, reweigh=False, look=True))
    objective.equations(work)
    metric = method.image_metric(angles[1])
    noise = _channel_noise(work.values.reshape(n, -1)[:, : metric.shape[1]], method.encoding, problem.response, sigma)
    whitening = _whitening(noise, metric)
    whitening *= np.sqrt(density * work.usable * (objective.appearance.usable > 0))[:, None, None]

    def whitened(rows: np.ndarray) -> np.ndarray:
        each = rows.reshape(len(rows), n, method.n_rows)
        return np.einsum("nkr,jnr->jnk", whitening, each, optimize=True).reshape(len(rows), -1)

    J = whitened(np.concatenate([jacobian(objective.warp, p, work.steep).T, work.columns]))
    scale = np.square(J).sum(axis=1)
    if scale[n_p:].size:
        # One angle for both cameras: its column is what the light's change shows, which may be rounding only.
        by_image, none = np.empty((1, len(work.residual))), np.zeros(0)
        seen = work.values, none, work.residual
        angle_column(0.0, 1.0, work.slope, *seen, none, float(angles[0]), work.lam, by_image[0])
        least = np.square(method.angle_directions[1]) * np.square(whitened(by_image)).sum()
        scale[n_p:] = np.maximum(scale[n_p:], least)
    return _inverse(_information(J, whitened(work.rows[1:])), scale)


def _information(J: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Products of rows J (n_q, e) once they are projected on the complement of rows A (m, e)."""
    A = A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), 1e-300)
    aj = A @ J.T
    return J @ J.T - aj.T @ np.linalg.solve(A @ A.T + RIDGE * np.eye(len(A)), aj)


def _inverse(information: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Inverse of an information matrix; infinite for parameters with a share in what is not seen at all."""
    root = np.sqrt(np.maximum(scale, 1e-300))
    seen, axes = np.linalg.eigh(information / np.outer(root, root))
    blind = seen < UNSEEN
    kept = axes[:, ~blind]
    covariance = (kept / seen[~blind]) @ kept.T / np.outer(root, root)
    unknown = np.asarray((np.abs(axes[:, blind]) > 1e-3).any(axis=1))
    covariance[unknown, unknown] = np.inf
    return covariance


def _channel_noise(values: np.ndarray, encoding: str, response: Response, sigma: float) -> np.ndarray:
    """Standard deviation of encoded channels, (n, 3) float64, under white noise of the stored values."""
    values = values.astype(np.float64)
    if encoding == "log":
        return sigma * log_slope(np.maximum(from_linear(np.exp(values), response), 1e-4), response)
    if response == "srgb":
        return np.full(values.shape, sigma)
    stored = np.maximum(from_linear(srgb_to_linear(values), response), 1e-4)
    return sigma * log_slope(stored, response) / log_slope(np.maximum(values, 1e-4), "srgb")


def _whitening(deviation: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Matrices W (n, k, k) with W P Sigma P' W' = I for channels of independent noise."""
    covariance = np.einsum("kc,nc,lc->nkl", metric, np.square(deviation), metric)
    return np.linalg.inv(np.linalg.cholesky(covariance))
