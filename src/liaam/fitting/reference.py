"""Reference implementation of the compiled loops over pixels, in plain NumPy.

These functions define the results of those of the same names in :mod:`liaam.fitting.residual`, ``jacobian``,
``weights``, ``equations`` and ``evaluate``, whose docstrings describe the parameters. Jacobians are formed in full, in
double precision. :attr:`liaam.fitting.level.Template.warp` may be any :class:`liaam.model.warp.Warp`.
"""

import numpy as np

from liaam.fitting.level import COLOUR, CORRELATED, GAIN, GRADIENTS, OFFSET, SHOWN, UNIT, Picture, Row, Template, Work
from liaam.fitting.weights import FACTORS, LEARNT, MOST_DIRECTION_NOISE, UNKNOWN
from liaam.kernels.reference import sample
from liaam.model.warp import Warp
from liaam.photometry.encoding import BRIGHTNESS, LOG_FLOOR, SOFTNESS


def by_reference(fields):
    """Return the tuple itself."""
    return fields


def copy(given: np.ndarray, out: np.ndarray) -> None:
    """Copy an array."""
    out[:] = given


def sample_picture(template: Template, picture: Picture, work: Work) -> None:
    """Sample the image term of eq 9, P(theta_2) E(I(W(x; p))), and its spatial gradient."""
    matrix, metric = picture.similarity[:, :2], work.metric.reshape(-1, 8).astype(np.float64)
    points = template.warp.points(work.p) @ matrix.T + picture.similarity[:, 2]
    values, gradients, work.usable[:] = sample(picture.pixels.reshape(picture.height, picture.width, 8), points)
    by_x, by_y = gradients[:, 0] @ metric.T, gradients[:, 1] @ metric.T  # per image pixel
    work.values[:], work.residual[:] = values.ravel(), (values @ metric.T).ravel()
    work.image_slopes[0::2] = (by_x * matrix[0, 0] + by_y * matrix[1, 0]).ravel()
    work.image_slopes[1::2] = (by_x * matrix[0, 1] + by_y * matrix[1, 1]).ravel()


def turn(parts: np.ndarray, theta: float, rows: np.ndarray) -> None:
    """Combine the parts of rows at an angle theta_1."""
    rows[:] = parts[0] + np.cos(theta) * parts[1] + np.sin(theta) * parts[2]


def transpose(rows: np.ndarray, lines: np.ndarray) -> None:
    """Transpose the modes."""
    lines.reshape(rows.shape[1], -1)[:, : len(rows) - 1] = rows[1:].T


def project(work: Work) -> None:
    """Project gain * E(I) + offset."""
    scales = work.scales
    metric = work.metric.reshape(-1, 8)[:, :7].astype(np.float64)
    shown = work.values.reshape(-1, 8)[:, :7] @ metric.T
    work.residual[:] = (scales[GAIN] * shown + scales[OFFSET] * metric.sum(axis=1)).ravel()
    work.image_slopes[:] *= np.float32(scales[GAIN] / scales[SHOWN])
    scales[SHOWN] = scales[GAIN]


def take_off(work: Work) -> None:
    """Subtract the appearance (eq 4) from samples."""
    work.residual[:] -= np.concatenate([[1.0], work.lam]) @ work.rows.astype(np.float64)


def mask(own: np.ndarray, usable: np.ndarray, root: np.ndarray) -> int:
    """Set the weights of unusable pixels to 0, and count these."""
    root[:] = (own.reshape(len(usable), -1) * usable[:, None]).ravel()
    return int((usable == 0).sum())


def sum_squares(work: Work, own: np.ndarray, sums: np.ndarray) -> None:
    """Sum weights, weighted samples and their squares, and weighted squares of the residual."""
    n, rows = len(work.usable), len(sums)
    weights = work.usable[:, None] * np.square(own.reshape(n, -1)[:, :rows], dtype=np.float64)
    samples = work.scales[GAIN] * (work.values.reshape(n, 8) @ work.metric.reshape(-1, 8)[:rows].T).astype(np.float64)
    left = work.residual.reshape(n, -1)[:, :rows].astype(np.float64)
    parts = weights, weights * samples, weights * np.square(samples), weights * np.square(left)
    sums[:] = np.stack([part.sum(axis=0) for part in parts], axis=1)


def with_modes(rows: np.ndarray, root: np.ndarray, column: np.ndarray, line: np.ndarray, out: np.ndarray) -> None:
    """Compute weighted products of a column with the modes, A'c."""
    out[: len(rows) - 1] = rows[1:].astype(np.float64) @ (np.square(root.astype(np.float64)) * column)


def subtract(work: Work) -> None:
    """Subtract modes from the residual, and sum its weighted squares."""
    work.residual[:] -= work.lam_step @ work.rows[1:].astype(np.float64)
    weights = np.square(work.root.astype(np.float64))
    work.sums[:] = weights @ np.square(work.residual.astype(np.float64)), weights.sum()


def weighted_gram(rows: np.ndarray, root: np.ndarray, block: np.ndarray, gram: np.ndarray) -> None:
    """Compute A'A under weights."""
    weighted = rows[1:].astype(np.float64) * root
    gram[:] = weighted @ weighted.T


def factorise(template: Template, work: Work, _unseen: int) -> None:
    """Compute the Cholesky factor of A'A + ridge over the usable pixels."""
    own, m = work.own, len(work.gram)
    blind = own * np.repeat(work.usable == 0, len(own) // len(work.usable))
    unseen_modes = (work.lines.reshape(len(own), -1)[:, :m] * blind[:, None]).astype(np.float64)
    work.factor[:] = np.linalg.cholesky(work.gram - unseen_modes.T @ unseen_modes + np.diag(template.ridge))


def expect(template: Template, work: Work) -> None:
    """Compute the spatial gradient of the fitted appearance, transformed to the image."""
    appearance_slopes = np.concatenate([[1.0], work.lam]) @ work.slopes
    work.expected[:] = template.warp.pulled(appearance_slopes.reshape(len(work.usable), 2, -1), work.p).ravel()


def jacobian(warp: Warp, p: np.ndarray, image_slopes: np.ndarray) -> np.ndarray:
    """Return dr/dp = dr/dW dW/dp (eq 10), (n k, n_p) float64, from spatial gradients dr/dW (2 n k,)."""
    by_warp = warp.jacobian(p)
    by_x, by_y = np.moveaxis(image_slopes.reshape(len(by_warp), -1, 2, 1).astype(np.float64), 2, 0)
    return (by_x * by_warp[:, None, 0] + by_y * by_warp[:, None, 1]).reshape(-1, by_warp.shape[2])


def sum_products(template: Template, work: Work, image_slopes: np.ndarray, expected: np.ndarray) -> None:
    """Compute E'J, A'J and E'r, and E' times the columns of the angles."""
    n_p, root = len(work.p), work.root[:, None].astype(np.float64)
    J = root * jacobian(template.warp, work.p, image_slopes)
    E = J if expected is image_slopes else root * jacobian(template.warp, work.p, expected)
    by_angles = root * work.columns.T
    work.hessian[:n_p, :n_p] = E.T @ J
    work.hessian[:n_p, n_p:] = E.T @ by_angles
    work.hessian[n_p:, :n_p] = work.hessian[:n_p, n_p:].T
    work.gradient[:n_p] = E.T @ (root[:, 0] * work.residual)
    work.aj[:, :n_p] = (work.rows[1:] * root[:, 0]) @ J


def dots(work: Work, f: int) -> None:
    """Compute weighted products of an angle column with all angle columns and with the residual."""
    columns, n_p = work.columns, len(work.p)
    weighted = np.square(work.root.astype(np.float64)) * columns[f]
    work.hessian[n_p + f, n_p:], work.gradient[n_p + f] = columns @ weighted, work.residual @ weighted


def angle_column(template: Template, row: Row, work: Work, f: int) -> None:
    """Differentiate the weighted residual by a free angle, divided by the square root of the weight."""
    (by_model, by_image), theta, parts = row.directions[:, f], work.angles[0], template.parts
    change = (work.values.reshape(-1, 8)[:, :7] @ work.slope.reshape(-1, 8)[:, :7].T).ravel()
    own_change = work.own_derivative * work.residual if len(work.own_derivative) else 0.0
    work.columns[f] = by_image * (change + own_change)
    if len(parts):
        work.columns[f] -= by_model * (
            np.concatenate([[1.0], work.lam]) @ (np.cos(theta) * parts[2] - np.sin(theta) * parts[1])
        )


def movement(template: Template, work: Work) -> float:
    """Return the root mean square movement of the landmarks by a step."""
    return template.warp.movement(work.step[: len(work.p)])


def cholesky(matrix: np.ndarray) -> bool:
    """Write the Cholesky factor to the lower triangle."""
    if not np.isfinite(np.tril(matrix)).all():
        return False
    try:
        matrix[:] = np.linalg.cholesky(np.tril(matrix) + np.tril(matrix, -1).T)
    except np.linalg.LinAlgError:
        return False
    return True


def solve_lower(factor: np.ndarray, right: np.ndarray) -> None:
    """Replace R by L^-1 R."""
    right[:] = np.linalg.solve(np.tril(factor), right)


def solve(factor: np.ndarray, right: np.ndarray) -> None:
    """Replace r by (L L')^-1 r."""
    lower = np.tril(factor)
    right[:] = np.linalg.solve(lower.T, np.linalg.solve(lower, right))


def solve_raised(matrix: np.ndarray, least: float, lines: np.ndarray, rotations: np.ndarray, right: np.ndarray) -> bool:
    """Replace r by (M+ + least)^-1 r, with 0 in place of the negative eigenvalues of M."""
    values, vectors = np.linalg.eigh(matrix)
    right[:] = vectors @ ((vectors.T @ right) / (np.maximum(values, 0.0) + least))
    return True


def eliminate(work: Work) -> None:
    """Compute the symmetrised J'QJ, and J'Qr (eq 5)."""
    factor, aj, hessian = work.factor, work.aj, work.hessian
    inverse = np.linalg.inv(np.tril(factor) @ np.tril(factor).T) if len(aj) else np.zeros((0, 0))
    hessian[:] -= aj.T @ inverse @ aj
    hessian[:] = 0.5 * (hessian + hessian.T)
    work.gradient[:] -= aj.T @ inverse @ work.ar


def log_noise(logs: np.ndarray, table: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Interpolate standard deviations of logarithms in a table, constant beyond its ends."""
    return np.interp(np.nan_to_num(logs, nan=span[0]), np.linspace(span[0], span[1], len(table)), table)


def row_variances(template: Template, picture: Picture, work: Work) -> None:
    """Compute variances of the rows of ``soft`` due to noise, usable colours, and sums of squares."""
    usable, own, kept = work.usable, template.own, picture.kept
    n, values = len(usable), work.values.reshape(-1, 8).astype(np.float64)
    direction, logs = values[:, :2], values[:, 2:5]
    work.known_now[:] = known = (values[:, 5] >= 0.99) & template.colours
    deviation, light = log_noise(logs, picture.noise, picture.span), np.exp(logs) * BRIGHTNESS
    slope = np.square(kept[1] * deviation * light).sum(axis=1) / np.square(light.sum(axis=1) + LOG_FLOOR)
    rest = np.clip(1.0 - np.square(direction).sum(axis=1), 0.0, None)
    noise = np.zeros((n, 8))
    by_direction = (slope * rest / SOFTNESS**2)[:, None] * (1.0 - np.square(direction) * (1.0 + rest)[:, None])
    noise[:, :2] = np.minimum(by_direction, MOST_DIRECTION_NOISE)
    of_logs = np.square(kept[0] * deviation) + np.square(0.5 * np.square(deviation))
    noise[:, 2:5] = np.where(known[:, None], of_logs, UNKNOWN)
    by_noise = noise @ np.square(work.metric.reshape(-1, 8).astype(np.float64)).T
    counts = (usable * own.reshape(n, -1)[:, 0] > 0)[:, None] & (by_noise < 0.5 * UNKNOWN)
    squares = np.square(work.residual.reshape(n, -1).astype(np.float64))
    work.row_sums[:] = np.stack([(counts * part).sum(axis=0) for part in (1.0, squares, squares - by_noise)], axis=1)
    work.variance[:] = by_noise.ravel()


def root_by_rows(template: Template, picture: Picture, work: Work) -> float:
    """Compute square roots of inverse variances, scaled to mean weight 1."""
    own, usable = template.own, work.usable
    rows = work.variance.reshape(len(usable), -1)
    groups = np.where(np.arange(rows.shape[1]) >= 2, COLOUR, GRADIENTS)
    by_model = np.array(CORRELATED)[groups] * work.unexplained[1, groups]
    rows[:] = picture.correlated * (rows + by_model)
    precision = 1.0 / rows.astype(np.float64)
    unit = 1.0 / precision[usable * own.reshape(rows.shape)[:, 0] > 0].mean()
    work.weighed[:] = own * np.sqrt(unit * precision).ravel()
    return float(unit)


def weigh_by_noise(template: Template, picture: Picture, _row: Row, work: Work) -> bool:
    """Compute variances due to noise and due to the model's errors."""
    usable, own, kept, errors = work.usable, template.own, picture.kept, template.errors
    if not usable.any():
        return False
    work.weighed[:] = own
    n = len(usable)
    deviation = log_noise(work.values.reshape(n, 8)[:, :3], picture.noise, picture.span)
    channels = work.noise.reshape(n, 8)
    channels[:, :3] = np.square(kept[0] * deviation) + np.square(0.5 * np.square(deviation))
    by_noise = channels.astype(np.float64) @ np.square(work.metric.reshape(-1, 8)).T
    counts = usable * own.reshape(n, -1)[:, 0] > 0
    squares, on_average = np.square(work.residual.reshape(n, -1)).mean(axis=1)[counts], by_noise.mean(axis=1)[counts]
    expected = on_average + FACTORS[:, None] * errors[counts] + 1e-300
    factor = FACTORS[(np.log(expected) + squares / expected).sum(axis=1).argmin()]
    work.by_model[:] = factor * errors
    work.variance[:] = (by_noise + work.by_model[:, None]).ravel()
    work.scales[UNIT] = 1.0 / np.mean(1.0 / (on_average + work.by_model[counts]))
    return True


def whiten(work: Work) -> None:
    """Compute the square root of noise weights at an angle, and its relative derivative."""
    at_angle, by_angle = (part.reshape(-1, 8).astype(np.float64) for part in (work.metric, work.slope))
    channels = work.noise.reshape(len(work.by_model), 8).astype(np.float64)
    variance = channels @ np.square(at_angle).T + work.by_model[:, None]
    work.own[:] = work.weighed * np.sqrt(work.scales[UNIT] / variance).ravel()
    if len(work.own_derivative):
        work.own_derivative[:] = (-(channels @ (at_angle * by_angle).T) / variance).ravel()


def loss_weights(loss: int, u: np.ndarray) -> np.ndarray:
    """Return weights of a robust loss for residuals in standard deviations."""
    of_each = (
        lambda: 1.345 / np.maximum(u, 1.345),
        lambda: 0.1 / np.maximum(u, 0.1),
        lambda: 1.0 / (1.0 + np.square(u / 2.385)),
        lambda: 1.0 / np.square(1.0 + np.square(u / 3.65)),
        lambda: np.square(np.maximum(1.0 - np.square(u / 4.685), 0.0)),
        lambda: np.exp(-0.5 * np.square(u)),
    )
    return of_each[loss]()


def weigh_by_loss(template: Template, row: Row, work: Work) -> None:
    """Multiply the weights by those of a robust loss."""
    usable, own, variance, errors = work.usable, template.own, work.variance, template.errors
    n, learnt = len(usable), row.loss == LEARNT
    squares = np.square(work.residual.reshape(n, -1).astype(np.float64))
    by = errors[:, None] + 1e-12 if learnt else variance.reshape(n, -1) if len(variance) else 1.0
    sizes = np.sqrt((squares / by).mean(axis=1))
    counts = usable * own.reshape(n, -1)[:, 0] > 0
    some = np.sort(sizes[counts & np.isfinite(sizes)])
    middle = some[len(some) // 2] if len(some) else 0.0
    scale = max(middle / row.median, 1.0 if learnt else 1e-9)
    finite = np.isfinite(sizes)
    robust = np.where(finite, loss_weights(row.loss, np.where(finite, sizes, 0.0) / scale), 0.0)
    if learnt:
        robust = robust / np.sqrt(errors + 1e-12)
        robust = robust / robust[counts].mean()
    work.weighed[:] *= np.repeat(np.sqrt(robust), len(work.weighed) // n).astype(np.float32)


def normalisation(template: Template, work: Work) -> None:
    """Compute the gain and offset that match the mean and standard deviation of the mean appearance."""
    n = len(work.usable)
    counts = work.usable * template.own.reshape(n, -1)[:, 0] > 0
    model = work.rows[0].reshape(n, -1)[counts].astype(np.float64)
    seen = work.values.reshape(n, 8)[counts, :7].astype(np.float64) @ work.metric.reshape(-1, 8)[:, :7].T
    gain = model.std() / seen.std() if seen.std() > 1e-6 else 1.0
    work.scales[[GAIN, OFFSET]] = gain, model.mean() - gain * seen.mean()
