"""The level of a fit in NumPy, as one would write it beside the paper: residual, weights, derivatives.

:class:`Problem` defines the results of the compiled core (``src/core``), which is tested against it, and replaces it
where the core could not be built. It also fits what the core leaves out (:mod:`liaam.fitting.reference`). The loop over
it is :mod:`liaam.fitting.reference.loop`.

Arrays of pixels are (n, k) float64, for k rows of the metric P.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.encoding_constants import BRIGHTNESS, LOG_FLOOR, SOFTNESS
from liaam.fitting.methods import ALL_COLOUR, CORRELATED, GRADIENT_ROWS, LOSSES
from liaam.fitting.thresholds import THRESHOLDS
from liaam.image_reference import CHANNELS, sample

if TYPE_CHECKING:
    from liaam.fitting.loop.encoded_image import EncodedImage

UNKNOWN = 1e5  # variance of a pixel whose logarithm is not usable: far above any, so that its weight is almost 0
# Lower bound on the unexplained variance, as a fraction of the residual's: an overestimated noise would leave none.
LEAST_UNEXPLAINED = 0.02
MOST_DIRECTION_NOISE = 0.5  # upper bound on the variance of each component of a direction: that of a random direction

FACTORS = np.concatenate((np.zeros(1), np.geomspace(1e-3, 30.0, 19)))  # on the learnt errors: the likeliest is used

BY_MODEL, BY_NOISE, BY_ROWS = range(3)  # numbers of the weights, in the order of liaam.fitting.methods.WEIGHTS
SQUARES = 0  # Numbers of the losses, in the order of liaam.fitting.methods.LOSSES
HUBER, L1, CAUCHY, GEMAN_MCCLURE, TUKEY, LEARNT = range(1, 1 + len(LOSSES))

# Residuals in standard deviations at which these losses begin to differ much from squares, with the usual efficiency of
# 95 % for Gaussian residuals.
HUBER_AT = 1.345
CAUCHY_AT = 2.385
GEMAN_MCCLURE_AT = 3.65
TUKEY_AT = 4.685
L1_AT = 0.1  # residual below which the weight of l1, its inverse, stops growing


class Problem:
    """An objective at one encoded image, with the state of the fit and all that follows from it.

    Each method says what it computes. Those on which others depend:

    Attributes
    ----------
    p, angles, lam : (n_p,), (2,) and (m,) float64
        The state: shape parameters, (theta_1, theta_2) and lambda.
    values, samples : (n, 8) and (n, k) float64
        Channels of the image at W(x; p), and their product with P(theta_2).
    usable : (n,)
        1 where these are inside the image and usable, else 0.
    residual : (n, k) float64
        Image minus model (eq 10).
    gradients, expected : (n, k, 2) float64
        Derivatives of the samples by x and y of W(x; p), model pixels: the image's own, and those that the fitted
        appearance has.
    sqrt_weights, masked : (n, k) float64
        Square roots of the weights, and these with 0 where a pixel is not usable.
    gram, factor : (m, m) float64
        A'A of the weighted modes A, and the Cholesky factor of that with the ridge.
    ar, aj : (m,) and (m, n_q) float64
        A'r and A'J.
    hessian, expected_hessian : (n_q, n_q) float64
        E'QJ of the last derivatives, and of the last ones with the expected gradient in both, E'QE.
    gradient : (n_q,) float64
        E'Qr.
    squares, weight : float
        Sums of the weighted squares of the residual, and of the weights.
    """

    def __init__(self, objective: Any, image: "EncodedImage") -> None:
        self.warp = objective.warp
        self.fields = objective.fields
        self.image = image
        self.normalise = objective.method.normalise
        self.n = len(self.fields["errors"])
        self.k = len(self.fields["metric"][0]) // CHANNELS  # three parts, each (k, CHANNELS) in one row
        # P(theta_1) A_0 and P(theta_1) A_i (eq 4), and their gradients: constant, or constant, cos and sin part.
        self.mode_parts = objective.mean_and_modes.astype(np.float64)  # (1 or 3, 1 + m, n k)
        self.mode_gradient_parts = objective.gradients_of_modes

    def begin(self, p: np.ndarray, angles, lam: np.ndarray) -> None:
        """Set a state, and the model's weights."""
        n = self.n
        k = self.k
        self.set_state(p, angles, lam)
        self.model_sqrt_weights = self.fields["sqrt_weights"].reshape(n, k).astype(np.float64)
        self.base_sqrt_weights = self.model_sqrt_weights.copy()
        self.sqrt_weights = self.model_sqrt_weights.copy()
        self.weight_slope = np.zeros((n, k))
        self.channel_noise = np.zeros((n, CHANNELS))
        self.model_variance = np.ones(n)
        self.variance = np.ones((n, k))
        self.noise_variance = 1.0 if self.fields["weighting"] == BY_NOISE else np.nan
        # Of the last weights by rows: pixels with colour, and unexplained variances of gradients and colour.
        self.has_colour_before = np.full(n, np.nan)
        self.unexplained_before = np.full(2, np.nan)
        self.gain = 1.0
        self.offset = 0.0
        n_q = len(self.p) + self.fields["directions"].shape[1]
        self.expected_hessian = np.zeros((n_q, n_q))

    def set_state(self, p: np.ndarray, angles, lam: np.ndarray) -> None:
        """Set the unknowns: p, (theta_1, theta_2) and lambda."""
        self.p = np.array(p, np.float64)
        self.angles = np.array(angles, np.float64)
        self.lam = np.array(lam, np.float64)

    def evaluate(self, solves: bool) -> None:
        """Compute the residual of eq 10 and its squares, with the best lambda if ``solves``."""
        self._set_metric()
        self._project_model()
        matrix = self.image.from_model.matrix
        points = self.warp.points(self.p) @ matrix.T + self.image.from_model.offset  # W(x; p), eq 3
        self.values, slopes_of_channels, self.usable = sample(self.image.channels, points)
        self.samples = self.values @ self.metric.T
        # Gradients of the rows: by x and y of the patch, (n, 2, k) and (n k, 2), then of the model, (n, k, 2).
        by_axis = (slopes_of_channels.reshape(-1, CHANNELS) @ self.metric.T).reshape(-1, 2, self.k)
        by_row = np.ascontiguousarray(by_axis.swapaxes(1, 2)).reshape(-1, 2)
        self.sample_slopes = (by_row @ matrix).reshape(-1, self.k, 2)
        if solves:
            self.lam[:] = 0.0
        self._subtract_appearance()
        self.solve_appearance(weighed=False, solves=solves)

    def _set_metric(self) -> None:
        """P(theta_2), whose invariant row is L(theta_2) (eq 7 and 8), and its derivative."""
        constant, by_cos, by_sin = self.fields["metric"].reshape(3, self.k, CHANNELS).astype(np.float64)
        c = np.cos(self.angles[1])
        s = np.sin(self.angles[1])
        self.metric = constant + c * by_cos + s * by_sin
        self.metric_slope = c * by_sin - s * by_cos

    def _project_model(self) -> None:
        """P(theta_1) A_0 and P(theta_1) A_i, and their gradients."""
        if len(self.mode_parts) == 1:  # theta_1 is fixed
            self.modes = self.mode_parts[0]
            self.mode_gradients = self.mode_gradient_parts[0]
            return
        factors = np.array([1.0, np.cos(self.angles[0]), np.sin(self.angles[0])])
        self.modes = np.tensordot(factors, self.mode_parts, axes=1)
        self.mode_gradients = np.tensordot(factors, self.mode_gradient_parts, axes=1)

    def _subtract_appearance(self) -> None:
        """Samples minus the appearance (eq 4)."""
        # An offset of all channels but the last one, which is the weight.
        offset = self.offset * self.metric[:, :-1].sum(axis=1)
        samples = self.gain * self.samples + offset
        self.residual = samples - self._combined(self.modes).reshape(self.n, self.k)
        self.gradients = self.gain * self.sample_slopes

    def _combined(self, modes: np.ndarray) -> np.ndarray:
        """Add the modes times lambda to the mean; ``modes`` begin with the mean, (1 + m, ...)."""
        return np.concatenate([[1.0], self.lam]) @ modes

    def solve_appearance(self, weighed: bool, solves: bool) -> None:
        """Solve (A'A + ridge) dl = A'r for the step of lambda, if ``solves``, and sum the squares that are left."""
        if self.fields["weighting"] == BY_NOISE:
            self._weigh_at_angle()
        elif weighed:
            self.sqrt_weights = self.base_sqrt_weights.copy()
        self.masked = self.sqrt_weights * self.usable[:, None]
        ridge = self.fields["ridge"]
        weighted = self.modes[1:] * self.masked.ravel()
        self.gram = weighted @ weighted.T
        try:
            self.factor = np.linalg.cholesky(self.gram + np.diag(ridge))
        except np.linalg.LinAlgError:  # by rounding: use the diagonal, for small steps of lambda
            self.factor = np.diag(np.sqrt(np.maximum(self.gram.diagonal(), 0.0) + ridge))
        self.ar = weighted @ (self.masked * self.residual).ravel() - ridge * self.lam
        if solves:
            step = self.solve_modes(self.ar)
            self.lam += step
            self.residual = self.residual - (step @ self.modes[1:]).reshape(self.n, self.k)
            self.ar = np.zeros_like(self.ar)
        self.squares = float(np.square(self.masked * self.residual).sum())
        self.weight = float(np.square(self.masked).sum())

    def solve_modes(self, right: np.ndarray) -> np.ndarray:
        """Multiply by (A'A + ridge)^-1."""
        if not len(right):  # there are no modes
            return right
        return np.linalg.solve(self.factor.T, np.linalg.solve(self.factor, right))

    # Derivatives

    def differentiate(self, image_in_j: bool, image_in_e: bool) -> None:
        """Compute the Hessian E'QJ and the gradient E'Qr, with Q the projection on the complement of the modes.

        J has the image's own gradient, or the one that the model expects; so has E.
        """
        n_p = len(self.p)
        masked = self.masked.ravel()
        if not (image_in_j and image_in_e):
            self.expected = self.model_gradient()
        self.columns = self.angle_columns()
        J = self._weighted_jacobian(self.gradients if image_in_j else self.expected)
        E = J if image_in_e == image_in_j else self._weighted_jacobian(self.gradients if image_in_e else self.expected)
        self.aj = (self.modes[1:] * masked) @ J
        hessian = E.T @ J
        # E and J have the same derivatives by the angles, C. Between p and the angles both blocks are E'C, which has no
        # noise of the image's own gradient if E has the expected one.
        hessian[n_p:, :n_p] = hessian[:n_p, n_p:].T
        hessian -= self.aj.T @ self.solve_modes(self.aj)
        self.hessian = 0.5 * (hessian + hessian.T)
        self.gradient = E.T @ (masked * self.residual.ravel()) - self.aj.T @ self.solve_modes(self.ar)

    def _weighted_jacobian(self, gradients: np.ndarray) -> np.ndarray:
        """dr/dq times the square roots of weights, (n k, n_q), from spatial gradients (n, k, 2)."""
        masked = self.masked.ravel()[:, None]
        by_p = self.by_parameters(gradients)
        n_p = by_p.shape[1]
        jacobian = np.empty((len(by_p), n_p + len(self.columns)))  # filled in place: new memory costs as much again
        np.multiply(masked, by_p, out=jacobian[:, :n_p])
        np.multiply(masked, self.columns.T, out=jacobian[:, n_p:])
        return jacobian

    def by_parameters(self, gradients: np.ndarray) -> np.ndarray:
        """dr/dp = dr/dW dW/dp, (n k, n_p), from spatial gradients dr/dW (n, k, 2)."""
        # Not optimised: products of matrices as small as (k, 2) take twice as long.
        return np.einsum("nka,nai->nki", gradients, self.warp.jacobian(self.p)).reshape(-1, len(self.p))

    def model_gradient(self) -> np.ndarray:
        """Spatial gradient of the fitted appearance, transformed to the image, (n, k, 2)."""
        slopes = self._combined(self.mode_gradients).reshape(self.n, 2, self.k)
        return self.warp.pulled(slopes, self.p).astype(np.float64)

    def angle_columns(self) -> np.ndarray:
        """Derivatives by the free angles, (n_free, n k): L'(theta_2) log I and -L'(theta_1) A."""
        of_image = self.values @ self.metric_slope.T + self.weight_slope * self.residual
        columns = []
        for d_theta_1, d_theta_2 in self.fields["directions"].T:  # by a free angle
            column = d_theta_2 * of_image.ravel()
            if len(self.mode_parts) == 3:
                _, by_cos, by_sin = self.mode_parts
                c = np.cos(self.angles[0])
                s = np.sin(self.angles[0])
                column = column - d_theta_1 * self._combined(c * by_sin - s * by_cos)
            columns.append(column)
        return np.array(columns).reshape(-1, self.n * self.k)

    # Weights

    def reweigh(self, solves: bool) -> bool:
        """Update the weights at the current residual; return whether they changed."""
        weighting = self.fields["weighting"]
        loss = self.fields["loss"]
        if weighting == BY_MODEL and loss == SQUARES and not self.normalise:
            return False
        if weighting == BY_ROWS:
            changed = self._weigh_by_rows()
        elif weighting == BY_NOISE:
            changed = self._weigh_by_noise()
        else:
            changed = self._weigh_by_model()
        if not changed:
            return False
        if loss != SQUARES:
            self._weigh_by_loss()
        if self.normalise:
            self._subtract_appearance()
        self.solve_appearance(weighed=True, solves=solves)
        return True

    @property
    def counts(self) -> np.ndarray:
        """Pixels that are usable and have a weight, (n,) bool."""
        return self.usable * self.model_sqrt_weights[:, 0] > 0

    def _weigh_by_model(self) -> bool:
        """Set the model's weights; with photometric normalisation, also gain and offset of the samples."""
        if not self.usable.any():
            return False
        self.base_sqrt_weights = self.model_sqrt_weights.copy()
        if self.normalise:
            self._normalise()
        return True

    def _normalise(self) -> None:
        """Bring the samples to the mean and the standard deviation of the mean appearance."""
        mean = self.modes[0].reshape(self.n, self.k)[self.counts]
        seen = self.samples[self.counts]
        if not mean.size:
            self.gain = 1.0
            self.offset = 0.0
            return
        deviation = float(seen.std())
        self.gain = float(mean.std()) / deviation if deviation > 1e-6 else 1.0
        self.offset = float(mean.mean() - self.gain * seen.mean())

    def _weigh_by_rows(self) -> bool:
        """Weigh each row by noise and by the unexplained variance of its group, gradients or colour."""
        noise = self._row_noise()
        counts = self.counts[:, None] & (noise < 0.5 * UNKNOWN)
        group = np.where(np.arange(self.k) >= GRADIENT_ROWS, 1, 0)
        unexplained = np.array([self._unexplained(noise, counts, group == g) for g in (0, 1)])
        if not counts.any() or (self._are_alike(unexplained) and not self.fields["loss"]):
            return False
        self.has_colour_before = self.has_colour
        self.unexplained_before = unexplained
        self.variance = self.image.correlated * (noise + CORRELATED[group] * unexplained[group])
        self.noise_variance = float(1.0 / (1.0 / self.variance[self.counts]).mean())
        self.base_sqrt_weights = self.model_sqrt_weights * np.sqrt(self.noise_variance / self.variance)
        return True

    def _unexplained(self, noise: np.ndarray, counts: np.ndarray, rows: np.ndarray) -> float:
        """Mean square of the residual beyond its noise, over the values of some rows that count."""
        counted = counts[:, rows]
        squares = np.square(self.residual)[:, rows]
        number = max(int(counted.sum()), 1)
        least = LEAST_UNEXPLAINED * squares[counted].sum() / number + 1e-9
        return max((squares - noise[:, rows])[counted].sum() / number, least)

    def _are_alike(self, unexplained: np.ndarray) -> bool:
        """Return whether weights by rows would be about the same as the last ones."""
        with np.errstate(invalid="ignore"):
            change = np.abs(np.log(unexplained / self.unexplained_before))
        n_changed = (self.has_colour != self.has_colour_before).sum()
        return bool((change < THRESHOLDS["ALIKE"]).all() and n_changed <= THRESHOLDS["CHANGED"] * self.n)

    def _row_noise(self) -> np.ndarray:
        """Variance of the rows of ``soft`` due to noise, to first order, (n, k).

        A direction is o = g / s of a gradient g, with s^2 = |g|^2 + e^2 and e the softness. Noise of variance v in each
        component of g gives o the covariance v (do/dg)(do/dg)', where do/dg = (I - o o') / s. With the rest
        t = 1 - |o|^2 = e^2 / s^2, that is (v t / e^2) (I - (1 + t) o o').
        """
        direction = self.values[:, :2]
        logs = self.values[:, 2:5]
        share_of_colour = self.values[:, 5]
        self.has_colour = ((share_of_colour >= ALL_COLOUR) & self.fields["colours"]).astype(float)
        deviation = self._log_noise(logs)
        light = np.exp(np.clip(logs, -20.0, 20.0)) * BRIGHTNESS  # clipped, so that it stays finite
        slope_variance = np.square(self.image.slope_noise_gain * deviation * light).sum(axis=1)
        slope_variance /= np.square(light.sum(axis=1) + LOG_FLOOR)
        rest = np.clip(1.0 - np.square(direction).sum(axis=1), 0.0, None)
        by_slope = slope_variance * rest / SOFTNESS**2
        of_direction = by_slope[:, None] * (1.0 - np.square(direction) * (1.0 + rest)[:, None])
        noise = np.zeros((self.n, CHANNELS))
        noise[:, :2] = np.minimum(of_direction, MOST_DIRECTION_NOISE)
        noise[:, 2:5] = np.where(self.has_colour[:, None] > 0, self._log_variance(deviation), UNKNOWN)
        return noise @ np.square(self.metric).T

    def _log_noise(self, logs: np.ndarray) -> np.ndarray:
        """Standard deviation of logarithms due to noise, from the image's table."""
        first, last = self.image.log_range
        tabulated = np.linspace(first, last, len(self.image.log_noise))
        return np.interp(np.nan_to_num(logs, nan=first), tabulated, self.image.log_noise)

    def _log_variance(self, deviation: np.ndarray) -> np.ndarray:
        """Mean squared error of logarithms: variance, which the blur reduces, and squared bias, which it does not."""
        blurred = np.square(self.image.value_noise_gain * deviation)
        bias = 0.5 * np.square(deviation)  # log(x + n) is log x + n / x - (n / x)^2 / 2 on average
        return blurred + np.square(bias)

    def _weigh_by_noise(self) -> bool:
        """Compute variances due to noise and due to the model's errors; those of the rows depend on theta_2."""
        if not self.usable.any():
            return False
        self.base_sqrt_weights = self.model_sqrt_weights.copy()
        counts = self.counts
        errors = self.fields["errors"]
        self.channel_noise[:, :3] = self._log_variance(self._log_noise(self.values[:, :3]))
        by_noise = self.channel_noise @ np.square(self.metric).T
        squares = np.square(self.residual).mean(axis=1)[counts]
        noise = by_noise.mean(axis=1)[counts]
        # The factor on the model's errors under which the residuals are most likely, as Gaussians with this variance.
        expected = noise + FACTORS[:, None] * errors[counts] + 1e-300
        minus_log_likelihoods = (np.log(expected) + squares / expected).sum(axis=1)
        factor = FACTORS[minus_log_likelihoods.argmin()]
        self.model_variance = factor * errors
        self.variance = by_noise + self.model_variance[:, None]
        if counts.any():
            self.noise_variance = float(1.0 / np.mean(1.0 / (noise + self.model_variance[counts])))
        return True

    def _weigh_at_angle(self) -> None:
        """Square root of noise weights at theta_2, and its relative derivative."""
        variance = self.channel_noise @ np.square(self.metric).T + self.model_variance[:, None]
        self.sqrt_weights = self.base_sqrt_weights * np.sqrt(self.noise_variance / variance)
        if self.fields["directions"].size:
            self.weight_slope = -(self.channel_noise @ (self.metric * self.metric_slope).T) / variance

    def _weigh_by_loss(self) -> None:
        """Multiply the weights by those of a robust loss, whose scale is the median residual's."""
        is_learnt = self.fields["loss"] == LEARNT
        errors = self.fields["errors"]
        variance = errors[:, None] + 1e-12 if is_learnt else self.variance
        sizes = np.sqrt((np.square(self.residual) / variance).mean(axis=1))
        is_finite = np.isfinite(sizes)
        counted = np.sort(sizes[self.counts & is_finite])
        median = counted[len(counted) // 2] if len(counted) else 0.0
        least_scale = 1.0 if is_learnt else 1e-9  # the learnt errors are a lower bound
        scale = max(median / self.fields["gaussian_median"], least_scale)
        weights = loss_weights(self.fields["loss"], np.where(is_finite, sizes, 0.0) / scale)
        weights = np.where(is_finite, weights, 0.0)
        if is_learnt:  # by the density, which is higher where errors are small
            weights = weights / np.sqrt(errors + 1e-12)
            weights = weights / max(float(weights[self.counts].mean()), 1e-300)
        self.base_sqrt_weights = self.base_sqrt_weights * np.sqrt(weights)[:, None]

    def arrays(self) -> dict[str, Any]:
        """Return arrays and numbers at the state, in the shapes of the core's; derivatives only where computed."""
        by_row = ("residual", "base_sqrt_weights", "sqrt_weights", "masked", "variance", "weight_slope")  # (n, k)
        spatial = ("gradients", "expected")  # (n, k, 2)
        of_appearance = ("values", "usable", "metric", "gain", "offset", "modes", "lam", "noise_variance")
        of_equations = ("squares", "weight", "gram", "factor", "ar", "columns", "aj", "hessian", "gradient")
        arrays: dict[str, Any] = {}
        for name, value in vars(self).items():
            if name in by_row:
                arrays[name] = value.ravel()
            elif name in spatial:
                arrays[name] = value.reshape(-1, 2)
            elif name in of_appearance or name in of_equations:
                arrays[name] = value
        return arrays


def loss_weights(loss: int, u: np.ndarray) -> np.ndarray:
    """Return weights of residuals of u standard deviations, for a number of :data:`liaam.fitting.methods.LOSSES`."""
    if loss == HUBER:
        return HUBER_AT / np.maximum(u, HUBER_AT)
    if loss == L1:
        return L1_AT / np.maximum(u, L1_AT)
    if loss == CAUCHY:
        return 1.0 / (1.0 + np.square(u / CAUCHY_AT))
    if loss == GEMAN_MCCLURE:
        return 1.0 / np.square(1.0 + np.square(u / GEMAN_MCCLURE_AT))
    if loss == TUKEY:
        return np.square(np.maximum(1.0 - np.square(u / TUKEY_AT), 0.0))
    if loss == LEARNT:
        return np.exp(-0.5 * np.square(u))
    return np.ones_like(u)


def contrast(problem: Problem, sqrt_weights: np.ndarray, n_rows: int) -> np.ndarray:
    """Return four sums over the pixels, of each of the first rows, (n_rows, 4).

    They are those of the weights, of the weighted samples and their squares, and of the weighted squared residual.
    """
    weights = problem.usable[:, None] * np.square(sqrt_weights[:, :n_rows])
    samples = problem.gain * problem.samples[:, :n_rows]
    residual = problem.residual[:, :n_rows]
    parts = weights, weights * samples, weights * np.square(samples), weights * np.square(residual)
    return np.stack([part.sum(axis=0) for part in parts], axis=1)
