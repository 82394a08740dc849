"""Weights of soft methods for many pictures at once: ``Objective.trust`` with a leading batch dimension."""

from array_api_compat import array_namespace

from liaam.fitting.batched.equations import Array
from liaam.fitting.batched.objective import BatchObjective, Look, Pictures, Shared, States, Trusts
from liaam.fitting.problem import LOGS
from liaam.fitting.trust import ALIKE, LEAST_UNEXPLAINED, MOST_DIRECTION_NOISE, MOVED, SOFT_ROWS, UNKNOWN
from liaam.kernels.reference import beyond_noise_batch, soft_noise_batch
from liaam.photometry.encoding import BRIGHTNESS, LOG_FLOOR, SOFTNESS


def soft_trust(objective: BatchObjective, shared: Shared, pictures: Pictures, state: States, look: Look) -> Trusts:
    """What noise and the model's errors make of each pixel's weight: ``trust.soft_trust``."""
    xp = objective.xp
    usable = look.weights * shared.root[:, 0] > 0  # (b, n)
    tied = xp.astype(pictures.tied, xp.float32)[:, None, None]
    noise = soft_noise_batch(
        look.values,
        pictures.relative,
        LOGS,
        pictures.left,
        SOFTNESS,
        LOG_FLOOR,
        BRIGHTNESS,
        UNKNOWN,
        MOST_DIRECTION_NOISE,
    )
    if not objective.objective.appearance.mean[:, 2].any():  # learnt from grey pictures
        noise = xp.concat([noise[..., :2], xp.full_like(noise[..., 2:5], UNKNOWN), noise[..., 5:]], axis=-1)
    squared_metric = xp.astype(xp.square(objective._at(shared.metric, state.angles[:, 1])), xp.float32)
    by_noise = noise @ xp.matrix_transpose(squared_metric)
    found = _unexplained(beyond_noise_batch(look.residual, by_noise, usable, 0.5 * UNKNOWN))
    variance = tied * (by_noise + _by_row(found, by_noise))
    unit = 1.0 / _mean(1.0 / variance, usable)
    root = shared.root * xp.sqrt(xp.astype(unit, xp.float32)[:, None, None] / variance)
    some = xp.any(usable, axis=1)
    return Trusts(
        xp.where(some[:, None, None], root, shared.root + xp.zeros_like(root)),
        xp.where(some, unit, xp.full_like(unit, float("nan"))),
        found,
        noise[..., 2] >= UNKNOWN,
    )


def _unexplained(sums: Array) -> Array:
    """Variance of the model's errors in each group of rows, (b, groups), by the sums of ``soft_variances``."""
    xp, found = array_namespace(sums), []
    for rows, _ in SOFT_ROWS:
        total = xp.sum(sums[:, rows, :], axis=1)
        count, squares, beyond = (total[:, i] for i in range(3))
        count = xp.clip(count, 1.0, None)
        found.append(xp.maximum(beyond / count, LEAST_UNEXPLAINED * squares / count + 1e-9))
    return xp.stack(found, axis=-1)


def _by_row(unexplained: Array, like: Array) -> Array:
    """Variance by the model's errors, correlation included, in each row of P, (b, 1, k) of the type of ``like``."""
    xp, model = array_namespace(like), []
    for group, (rows, correlated) in enumerate(SOFT_ROWS):
        own = xp.astype(correlated * unexplained[:, group], like.dtype)[:, None, None]
        model.append(own + xp.zeros_like(like[:, :1, rows]))
    return xp.concat(model, axis=-1)


def alike(before: Trusts, now: Trusts) -> Array:
    """Tell whether weights have hardly changed, (b,) bool: ``trust._alike``."""
    xp = array_namespace(now.unit)
    known = ~xp.isnan(before.unit) & ~xp.isnan(now.unit)
    changed = xp.astype(before.silent != now.silent, xp.float32)
    growth = xp.abs(xp.log(now.unexplained / before.unexplained))
    return known & xp.all(growth < ALIKE, axis=-1) & (xp.mean(changed, axis=-1) < MOVED)


def _mean(values: Array, kept: Array) -> Array:
    """Mean of (b, n, k) over the pixels of each picture that are kept (b, n), (b,) float64; 0 where none is."""
    xp = array_namespace(values)
    total = xp.sum(xp.where(kept[..., None], values, xp.zeros_like(values)), axis=(1, 2), dtype=xp.float64)
    count = xp.sum(xp.astype(kept, xp.float64), axis=1) * values.shape[2]
    return total / xp.clip(count, 1.0, None)
