"""Fast variances by noise, and the weights of soft methods (contract: ``reference``)."""

import numpy as np

from liaam.jit import F as _F
from liaam.jit import jit as _jit


@_jit
def _exp(x):
    """Exponential of logarithms of light, to a few millionths between -8 and 8, and no branch in it."""
    y = min(max(x, _F(-20.0)), _F(20.0)) * _F(1 / 32)
    high = _F(1 / 6) + y * (_F(1 / 24) + y * (_F(1 / 120) + y * _F(1 / 720)))
    y = _F(1.0) + y * (_F(1.0) + y * (_F(1 / 2) + y * high))
    for _ in range(5):
        y *= y
    return y


PIXELS = 512
"""Pixels whose channels are laid out one after the other while their variances are worked out: side by side, as they
lie in memory, they would be dealt with one by one."""


@_jit
def _log_deviations(logs, relative, first, steps, place, deviations):
    """Interpolate the standard deviation of logarithms in its table; beyond it the nearest counts."""
    top = len(relative) - 2
    for i in range(len(logs)):
        at = min(max((logs[i] - first) * steps, _F(0.0)), _F(top + 1))
        place[i] = min(np.int32(at), np.int32(top))
        deviations[i] = at - _F(place[i])
    for i in range(len(logs)):
        low = relative[place[i]]
        deviations[i] = low + deviations[i] * (relative[place[i] + 1] - low)


@_jit
def _add_light(logs, deviations, brightness, light, spread):
    """Add a channel's light, and the square of how far it varies."""
    for i in range(len(logs)):
        own = brightness * _exp(logs[i])
        light[i] += own
        spread[i] += (deviations[i] * own) * (deviations[i] * own)


@_jit
def _log_variances(deviations, known, left, unknown, out):
    """Variance of logarithms, with what their curvature makes of noise."""
    for i in range(len(deviations)):
        square = deviations[i] * deviations[i]
        out[i] = left * square + _F(0.25) * square * square if known[i] > _F(0.0) else unknown


@_jit
def _direction_variances(x, y, light, spread, left, most, out_x, out_y):
    """Variance of the components of a direction, to first order; of light and spread nothing is left."""
    for i in range(len(x)):
        rest = max(_F(1.0) - x[i] * x[i] - y[i] * y[i], _F(0.0))
        spread[i] = left * spread[i] * rest / (light[i] * light[i])
        light[i] = _F(1.0) + rest
    for i in range(len(x)):
        out_x[i] = min(spread[i] * (_F(1.0) - x[i] * x[i] * light[i]), most)
    for i in range(len(x)):
        out_y[i] = min(spread[i] * (_F(1.0) - y[i] * y[i] * light[i]), most)


@_jit
def _row_variances(a, b, c, d, e, squared, out):
    """Variance of a row of the metric, of those of the first five channels."""
    for i in range(len(out)):
        out[i] = squared[0] * a[i] + squared[1] * b[i] + squared[2] * c[i] + squared[3] * d[i] + squared[4] * e[i]


@_jit
def _add_beyond(residual, own, weights, limit, sums):
    """Add how many pixels count, their squared residuals, and these less the variance by noise."""
    count = squares = beyond = _F(0.0)
    for i in range(len(own)):
        counts = weights[i] > _F(0.0) and own[i] < limit
        square = residual[i] * residual[i]
        count += _F(1.0) if counts else _F(0.0)
        squares += square if counts else _F(0.0)
        beyond += square - own[i] if counts else _F(0.0)
    sums[0] += count
    sums[1] += squares
    sums[2] += beyond


@_jit
def _copy(source, target):
    for i in range(len(source)):
        target[i] = source[i]


@_jit
def _soft_variances(
    values, residual, weights, squared, relative, first, steps, left, numbers, colours, noise, by_noise, sums
):
    floor, unknown, most, limit = numbers[0], numbers[1], numbers[2], numbers[3]
    brightness, place = numbers[4:], np.empty(PIXELS, np.int32)
    # Rows of one array by their number: taken apart, they are not known to be without gaps.
    planes, room = np.empty((5, PIXELS), _F), np.empty((6, PIXELS), _F)
    for begin in range(0, len(values), PIXELS):
        end = min(begin + PIXELS, len(values))
        n = end - begin
        x, y, light, spread, known, own = room[0, :n], room[1, :n], room[2, :n], room[3, :n], room[4, :n], room[5, :n]
        light[:] = floor
        spread[:] = _F(0.0)
        for i in range(n):
            known[i] = _F(1.0) if colours and values[begin + i, 5] >= _F(0.99) else _F(0.0)
        for c in range(3):
            _copy(values[begin:end, 2 + c], x)
            _log_deviations(x, relative, first, steps, place[:n], own)
            _add_light(x, own, brightness[c], light, spread)
            _log_variances(own, known, left[0], unknown, planes[2 + c, :n])
        _copy(values[begin:end, 0], x)
        _copy(values[begin:end, 1], y)
        _direction_variances(x, y, light, spread, left[1], most, planes[0, :n], planes[1, :n])
        for c in range(5):
            _copy(planes[c, :n], noise[begin:end, c])
        for i in range(n):
            noise[begin + i, 5] = _F(0.0)
        for r in range(len(squared)):
            a, b, c, d, e = planes[0, :n], planes[1, :n], planes[2, :n], planes[3, :n], planes[4, :n]
            _row_variances(a, b, c, d, e, squared[r], own)
            _copy(own, by_noise[begin:end, r])
            _copy(residual[begin:end, r], x)
            _add_beyond(x, own, weights[begin:end], limit, sums[r])


def soft_variances(
    values: np.ndarray,
    residual: np.ndarray,
    weights: np.ndarray,
    squared: np.ndarray,
    relative: np.ndarray,
    span: tuple[float, float],
    left: tuple[float, float],
    softness: float,
    floor: float,
    brightness: np.ndarray,
    unknown: float,
    most: float,
    colours: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.soft_variances`."""
    noise, by_noise, sums = np.empty_like(values), np.empty_like(residual), np.zeros((residual.shape[1], 3))
    steps = (len(relative) - 1) / (span[1] - span[0])
    shares = np.array([left[0] ** 2, (left[1] / softness) ** 2], _F)
    numbers = np.array([floor, unknown, most, 0.5 * unknown, *brightness], _F)
    table = relative.astype(_F), _F(span[0]), _F(steps)
    _soft_variances(
        values, residual, weights, squared.astype(_F), *table, shares, numbers, colours, noise, by_noise, sums
    )
    return noise, by_noise, sums


@_jit
def _soft_roots(by_noise, models, tied, own, weights, k, roots):
    counts, used, count, total = np.empty(len(models), _F), np.empty(PIXELS, _F), 0, 0.0
    for begin in range(0, len(own), len(models)):
        end = min(begin + len(models), len(own))
        variance, root, out = by_noise[begin:end], own[begin:end], roots[begin:end]
        first, kept = root[::k], weights[begin // k : end // k]
        for i in range(len(kept)):
            counted = kept[i] * first[i] > _F(0.0)
            used[i] = _F(1.0) if counted else _F(0.0)
            count += k if counted else 0
        for r in range(k):
            _copy(used[: len(kept)], counts[r : end - begin : k])
        part = _F(0.0)
        for e in range(end - begin):
            precision = _F(1.0) / (tied * variance[e] + models[e])
            part += counts[e] * precision
            out[e] = root[e] * np.sqrt(precision)
        total += part
    unit = count / total if count else np.nan
    scale = _F(np.sqrt(unit))
    for e in range(len(roots)):
        roots[e] *= scale
    return unit


def soft_roots(
    by_noise: np.ndarray, model: np.ndarray, tied: float, own: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, float]:
    """See :func:`liaam.kernels.reference.soft_roots`."""
    roots, k = np.empty_like(by_noise), by_noise.shape[1]
    models = np.tile(model.astype(_F), PIXELS)
    unit = _soft_roots(by_noise.reshape(-1), models, _F(tied), own.reshape(-1), weights, k, roots.reshape(-1))
    return roots, float(unit)
