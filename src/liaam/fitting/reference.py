"""The level of a fit in NumPy, as one would write it beside the paper: residual, weights, derivatives.

:class:`Problem` defines the results of the compiled core (``src/core``), which is tested against it, and replaces it
where the core could not be built. It also fits what the core leaves out: homographies, photometric normalisation, and
the joint elimination of the appearance. The loop over it is :mod:`liaam.fitting.reference_loop`.

Arrays of pixels are (n, k) float64, for k rows of the metric P.
"""

from typing import Any

import numpy as np

from liaam.fitting.level_image import LevelImage
from liaam.fitting.thresholds import THRESHOLDS
from liaam.photometry.encoding import BRIGHTNESS, LOG_FLOOR, SOFTNESS
from liaam.reference import sample

UNKNOWN = 1e5  # variance of a pixel whose logarithm is not usable
LEAST_UNEXPLAINED = 0.02  # lower bound on the unexplained variance, as a fraction of the residual's
MOST_DIRECTION_NOISE = 0.5  # upper bound on the variance of each component of a direction: that of a random direction

# Number of rows of ``soft`` that are gradients (the others are colour), and factors on the number of correlated pixels
# for the model's errors in gradients and in colour: they are patches rather than grains, and widest in colour.
GRADIENT_ROWS, CORRELATED = 2, np.array([8.0, 30.0])

FACTORS = np.concatenate((np.zeros(1), np.geomspace(1e-3, 30.0, 19)))  # on the learnt errors: the likeliest is used
LEARNT = 6  # number of the loss ``learnt``


class Problem:
    """An objective at one encoded image, with the state of the fit and all that follows from it."""

    def __init__(self, objective: Any, image: LevelImage) -> None:
        self.warp, self.f, self.image = objective.warp, objective.fields, image
        self.normalise = objective.method.normalise
        self.n, self.k = len(self.f["errors"]), len(self.f["metric"][0]) // 8
        self.rows, self.slopes = self.f["rows"].astype(np.float64), self.f["slopes"]

    def begin(self, p: np.ndarray, angles, lam: np.ndarray) -> None:
        """Set a state, and the model's weights."""
        f = self.f
        self.set_state(p, angles, lam)
        self.own = f["sqrt_weights"].reshape(self.n, self.k).astype(np.float64)
        self.base_sqrt_weights, self.sqrt_weights = self.own.copy(), self.own.copy()
        self.weight_slope = np.zeros((self.n, self.k))
        self.channel_noise, self.model_variance = np.zeros((self.n, 8)), np.ones(self.n)
        self.variance = np.ones((self.n, self.k))
        self.noise_variance = 1.0 if f["weighting"] == 1 else np.nan
        self.known_before, self.unexplained_before = np.full(self.n, np.nan), np.full(2, np.nan)
        self.gain, self.offset = 1.0, 0.0
        n_q = len(self.p) + f["directions"].shape[1]
        self.expected_hessian = np.zeros((n_q, n_q))

    def set_state(self, p: np.ndarray, angles, lam: np.ndarray) -> None:
        """Set the unknowns: p, (theta_1, theta_2) and lambda."""
        self.p, self.angles, self.lam = (np.array(each, np.float64) for each in (p, angles, lam))

    @property
    def modes(self) -> np.ndarray:
        """P(theta_1) A_i, (m, n k)."""
        return self.rows[1:]

    def evaluate(self, solves: bool) -> None:
        """Compute the residual of eq 10 and its squares, with the best lambda if ``solves``."""
        self._set_metric()
        self._project_model()
        matrix, offset = self.image.from_model.matrix, self.image.from_model.offset
        points = self.warp.points(self.p) @ matrix.T + offset  # W(x; p), eq 3
        self.values, by_place, self.usable = sample(self.image.channels, points)
        self.samples = self.values @ self.metric.T
        self.sample_slopes = np.einsum("nac,kc->nka", by_place, self.metric) @ matrix  # by x and y, model pixels
        if solves:
            self.lam[:] = 0.0
        self._subtract_appearance()
        self.solve_appearance(False, solves)

    def _set_metric(self) -> None:
        """P(theta_2), whose invariant row is L(theta_2) (eq 7 and 8), and its derivative."""
        constant, by_cos, by_sin = self.f["metric"].reshape(3, self.k, 8).astype(np.float64)
        c, s = np.cos(self.angles[1]), np.sin(self.angles[1])
        self.metric, self.metric_slope = constant + c * by_cos + s * by_sin, c * by_sin - s * by_cos

    def _project_model(self) -> None:
        """P(theta_1) A_0 and P(theta_1) A_i, and their gradients, where theta_1 is free."""
        if self.f["row_parts"].size:
            at = np.array([1.0, np.cos(self.angles[0]), np.sin(self.angles[0])])
            self.rows = np.tensordot(at, self.f["row_parts"].astype(np.float64), axes=1)
            self.slopes = np.tensordot(at, self.f["slope_parts"], axes=1)

    def _subtract_appearance(self) -> None:
        """Samples minus the appearance (eq 4)."""
        shown = self.gain * self.samples + self.offset * self.metric[:, :7].sum(axis=1)
        self.residual = shown - self._combined(self.rows).reshape(self.n, self.k)
        self.gradients = self.gain * self.sample_slopes

    def _combined(self, rows: np.ndarray) -> np.ndarray:
        return np.concatenate([[1.0], self.lam]) @ rows

    def solve_appearance(self, weighed: bool, solves: bool) -> None:
        """Solve (A'A + ridge) dl = A'r for the step of lambda, if ``solves``, and sum the squares that are left."""
        if self.f["weighting"] == 1:
            self._weigh_at_angle()
        elif weighed:
            self.sqrt_weights = self.base_sqrt_weights.copy()
        self.masked = self.sqrt_weights * self.usable[:, None]
        ridge, weighted = self.f["ridge"], self.modes * self.masked.ravel()
        self.gram = weighted @ weighted.T
        try:
            self.factor = np.linalg.cholesky(self.gram + np.diag(ridge))
        except np.linalg.LinAlgError:  # by rounding: use the diagonal, for small steps of lambda
            self.factor = np.diag(np.sqrt(np.maximum(self.gram.diagonal(), 0.0) + ridge))
        self.ar = weighted @ (self.masked * self.residual).ravel() - ridge * self.lam
        if solves:
            step = self.solve_modes(self.ar)
            self.lam += step
            self.residual = self.residual - (step @ self.modes).reshape(self.n, self.k)
            self.ar = np.zeros_like(self.ar)
        self.squares = float(np.square(self.masked * self.residual).sum())
        self.weight = float(np.square(self.masked).sum())

    def solve_modes(self, right: np.ndarray) -> np.ndarray:
        """Multiply by (A'A + ridge)^-1."""
        return np.linalg.solve(self.factor.T, np.linalg.solve(self.factor, right)) if len(right) else right

    # Derivatives

    def differentiate(self, image_in_j: bool, image_in_e: bool) -> None:
        """Compute the Hessian E'QJ and the gradient E'Qr, with Q the projection on the complement of the modes.

        J has the image's own gradient, or the one that the model expects; so has E.
        """
        n_p, masked = len(self.p), self.masked.ravel()
        if not (image_in_j and image_in_e):
            self.expected = self.model_gradient()
        self.columns = self.angle_columns()
        by_angles = self.columns.T * masked[:, None]
        J, E = (
            np.hstack([masked[:, None] * self.by_parameters(own), by_angles])
            for own in (
                self.gradients if image_in_j else self.expected,
                self.gradients if image_in_e else self.expected,
            )
        )
        self.aj = (self.modes * masked) @ J
        hessian = E.T @ J
        hessian[n_p:, :n_p] = hessian[:n_p, n_p:].T
        hessian -= self.aj.T @ self.solve_modes(self.aj)
        self.hessian = 0.5 * (hessian + hessian.T)
        self.gradient = E.T @ (masked * self.residual.ravel()) - self.aj.T @ self.solve_modes(self.ar)

    def by_parameters(self, gradients: np.ndarray) -> np.ndarray:
        """dr/dp = dr/dW dW/dp, (n k, n_p), from spatial gradients dr/dW (n, k, 2)."""
        return np.einsum("nka,nai->nki", gradients, self.warp.jacobian(self.p), optimize=True).reshape(-1, len(self.p))

    def model_gradient(self) -> np.ndarray:
        """Spatial gradient of the fitted appearance, transformed to the image, (n, k, 2)."""
        slopes = self._combined(self.slopes).reshape(self.n, 2, self.k)
        return self.warp.pulled(slopes, self.p).astype(np.float64)

    def angle_columns(self) -> np.ndarray:
        """Derivatives by the free angles, (n_free, n k): L'(theta_2) log I and -L'(theta_1) A."""
        change = self.values @ self.metric_slope.T + self.weight_slope * self.residual
        columns = []
        for by_model, by_image in self.f["directions"].T:
            column = by_image * change.ravel()
            if self.f["row_parts"].size:
                _, by_cos, by_sin = self.f["row_parts"].astype(np.float64)
                c, s = np.cos(self.angles[0]), np.sin(self.angles[0])
                column = column - by_model * self._combined(c * by_sin - s * by_cos)
            columns.append(column)
        return np.array(columns).reshape(-1, self.n * self.k)

    # Weights

    def reweigh(self, solves: bool) -> bool:
        """Update the weights at the current residual; return whether they changed."""
        ways = (self._weigh_by_model, self._weigh_by_noise, self._weigh_by_rows)
        changes = self.f["weighting"] > 0 or self.f["loss"] > 0 or self.normalise
        if not changes or not ways[self.f["weighting"]]():
            return False
        if self.f["loss"]:
            self._weigh_by_loss()
        if self.normalise:
            self._subtract_appearance()
        self.solve_appearance(True, solves)
        return True

    @property
    def counts(self) -> np.ndarray:
        """Pixels that are usable and have a weight, (n,) bool."""
        return self.usable * self.own[:, 0] > 0

    def _weigh_by_model(self) -> bool:
        if not self.usable.any():
            return False
        self.base_sqrt_weights = self.own.copy()
        if self.normalise:
            mean, seen = (each[self.counts] for each in (self.rows[0].reshape(self.n, self.k), self.samples))
            spread, deviation = (float(each.std()) if each.size else 0.0 for each in (mean, seen))
            self.gain = spread / deviation if deviation > 1e-6 else 1.0
            self.offset = float(mean.mean() - self.gain * seen.mean()) if mean.size else 0.0
        return True

    def _weigh_by_rows(self) -> bool:
        """Weigh each row by noise and by the unexplained variance of its group."""
        noise = self._row_noise()
        counts = self.counts[:, None] & (noise < 0.5 * UNKNOWN)
        group = np.where(np.arange(self.k) >= GRADIENT_ROWS, 1, 0)
        squares = np.square(self.residual)
        self.unexplained = np.empty(2)
        for g in (0, 1):
            counted, own = counts[:, group == g], squares[:, group == g]
            number = max(int(counted.sum()), 1)
            least = LEAST_UNEXPLAINED * own[counted].sum() / number + 1e-9
            self.unexplained[g] = max((own - noise[:, group == g])[counted].sum() / number, least)
        with np.errstate(invalid="ignore"):
            alike = np.abs(np.log(self.unexplained / self.unexplained_before)) < THRESHOLDS["ALIKE"]
        same = alike.all() and (self.known != self.known_before).sum() <= THRESHOLDS["CHANGED"] * self.n
        if not counts.any() or (same and not self.f["loss"]):
            return False
        self.known_before, self.unexplained_before = self.known, self.unexplained
        self.variance = self.image.correlated * (noise + CORRELATED[group] * self.unexplained[group])
        self.noise_variance = float(1.0 / (1.0 / self.variance[self.counts]).mean())
        self.base_sqrt_weights = self.own * np.sqrt(self.noise_variance / self.variance)
        return True

    def _row_noise(self) -> np.ndarray:
        """Variance of the rows of ``soft`` due to noise, to first order, (n, k).

        With o = g / sqrt(|g|^2 + e^2), do/dg = (I - o o') / sqrt(|g|^2 + e^2), and the square root follows from |o|.
        """
        direction, logs = self.values[:, :2], self.values[:, 2:5]
        self.known = ((self.values[:, 5] >= 0.99) & self.f["colours"]).astype(float)
        deviation, light = self._log_noise(logs), np.exp(np.clip(logs, -20.0, 20.0)) * BRIGHTNESS
        slope = np.square(self.image.slope_left * deviation * light).sum(axis=1)
        slope /= np.square(light.sum(axis=1) + LOG_FLOOR)
        rest = np.clip(1.0 - np.square(direction).sum(axis=1), 0.0, None)
        noise = np.zeros((self.n, 8))
        of_direction = (slope * rest / SOFTNESS**2)[:, None] * (1.0 - np.square(direction) * (1.0 + rest)[:, None])
        noise[:, :2] = np.minimum(of_direction, MOST_DIRECTION_NOISE)
        noise[:, 2:5] = np.where(self.known[:, None] > 0, self._log_variance(deviation), UNKNOWN)
        return noise @ np.square(self.metric).T

    def _log_noise(self, logs: np.ndarray) -> np.ndarray:
        """Standard deviation of logarithms due to noise, from the image's table."""
        first, last = self.image.log_range
        at = np.linspace(first, last, len(self.image.log_noise))
        return np.interp(np.nan_to_num(logs, nan=first), at, self.image.log_noise)

    def _log_variance(self, deviation: np.ndarray) -> np.ndarray:
        """Variance of logarithms: the blur reduces it, but not the bias due to the logarithm's curvature."""
        return np.square(self.image.value_left * deviation) + np.square(0.5 * np.square(deviation))

    def _weigh_by_noise(self) -> bool:
        """Compute variances due to noise and due to the model's errors; those of the rows depend on theta_2."""
        if not self.usable.any():
            return False
        self.base_sqrt_weights, counts, errors = self.own.copy(), self.counts, self.f["errors"]
        self.channel_noise[:, :3] = self._log_variance(self._log_noise(self.values[:, :3]))
        by_noise = self.channel_noise @ np.square(self.metric).T
        squares, noise = np.square(self.residual).mean(axis=1)[counts], by_noise.mean(axis=1)[counts]
        expected = noise + FACTORS[:, None] * errors[counts] + 1e-300
        factor = FACTORS[(np.log(expected) + squares / expected).sum(axis=1).argmin()]
        self.model_variance = factor * errors
        self.variance = by_noise + self.model_variance[:, None]
        if counts.any():
            self.noise_variance = float(1.0 / np.mean(1.0 / (noise + self.model_variance[counts])))
        return True

    def _weigh_at_angle(self) -> None:
        """Square root of noise weights at theta_2, and its relative derivative."""
        variance = self.channel_noise @ np.square(self.metric).T + self.model_variance[:, None]
        self.sqrt_weights = self.base_sqrt_weights * np.sqrt(self.noise_variance / variance)
        if self.f["directions"].size:
            self.weight_slope = -(self.channel_noise @ (self.metric * self.metric_slope).T) / variance

    def _weigh_by_loss(self) -> None:
        """Multiply the weights by those of a robust loss, whose scale is the median residual's."""
        learnt, errors = self.f["loss"] == LEARNT, self.f["errors"]
        by = errors[:, None] + 1e-12 if learnt else self.variance
        sizes = np.sqrt((np.square(self.residual) / by).mean(axis=1))
        finite = np.isfinite(sizes)
        some = np.sort(sizes[self.counts & finite])
        middle = some[len(some) // 2] if len(some) else 0.0
        scale = max(middle / self.f["gaussian_median"], 1.0 if learnt else 1e-9)
        robust = np.where(finite, loss_weights(self.f["loss"], np.where(finite, sizes, 0.0) / scale), 0.0)
        if learnt:
            robust = robust / np.sqrt(errors + 1e-12)
            robust = robust / max(float(robust[self.counts].mean()), 1e-300)
        self.base_sqrt_weights = self.base_sqrt_weights * np.sqrt(robust)[:, None]

    def arrays(self) -> dict[str, Any]:
        """Return arrays and numbers at the state, in the shapes of the core's."""
        flat = ("residual", "base_sqrt_weights", "sqrt_weights", "masked", "variance", "weight_slope")
        found = {name: getattr(self, name).ravel() for name in flat}
        found |= {name: getattr(self, name).reshape(-1, 2) for name in ("gradients", "expected") if hasattr(self, name)}
        others = ("values", "usable", "rows", "metric", "noise_variance", "squares", "weight", "lam", "gram", "factor")
        found |= {name: getattr(self, name) for name in others}
        optional = ("ar", "columns", "aj", "hessian", "gradient", "gain", "offset")
        return found | {name: getattr(self, name) for name in optional if hasattr(self, name)}


def loss_weights(loss: int, u: np.ndarray) -> np.ndarray:
    """Return weights of residuals of u standard deviations, for a number of :data:`liaam.fitting.methods.LOSSES`."""
    of_each = (
        lambda: np.ones_like(u),
        lambda: 1.345 / np.maximum(u, 1.345),  # huber
        lambda: 0.1 / np.maximum(u, 0.1),  # l1: below a tenth of a standard deviation the weight stops growing
        lambda: 1.0 / (1.0 + np.square(u / 2.385)),  # cauchy
        lambda: 1.0 / np.square(1.0 + np.square(u / 3.65)),  # geman-mcclure
        lambda: np.square(np.maximum(1.0 - np.square(u / 4.685), 0.0)),  # tukey
        lambda: np.exp(-0.5 * np.square(u)),  # learnt
    )
    return of_each[loss]()


def contrast(problem: Problem, sqrt_weights: np.ndarray, shown: int) -> np.ndarray:
    """Sum weights, weighted samples and their squares, and weighted squares of the residual, per row, (shown, 4)."""
    weights = problem.usable[:, None] * np.square(sqrt_weights[:, :shown])
    samples, left = problem.gain * problem.samples[:, :shown], problem.residual[:, :shown]
    parts = weights, weights * samples, weights * np.square(samples), weights * np.square(left)
    return np.stack([part.sum(axis=0) for part in parts], axis=1)
