"""Weights of pixels: from noise, the model's errors, or a robust loss (docs/explanation/theory.md).

Weights are updated between steps and fixed within one. Compiled; arrays of pixels are flat, residual e = i k + r is
row r of pixel i. :mod:`liaam.fitting.reference` defines the result of each function.
"""

import numpy as np

from liaam.fitting.equations import clear, copy
from liaam.fitting.level import COLOUR, CORRELATED, GAIN, GRADIENTS, OFFSET, PLANE, UNIT, Picture, Row, Template, Work
from liaam.kernels.compiled import compiled, inlined
from liaam.kernels.fields import Double1, F, Single1
from liaam.kernels.vectors import SIZE
from liaam.photometry.encoding import BRIGHTNESS, LOG_FLOOR, SOFTNESS

BY_MODEL, BY_NOISE, BY_ROWS = 0, 1, 2
"""Kinds of weights (:attr:`liaam.fitting.level.Row.weights`)."""

UNKNOWN = 1e5
"""Variance assigned to a pixel whose logarithm is not usable."""

LEAST_UNEXPLAINED = 0.02
"""Lower bound on the unexplained variance, as a fraction of the residual's."""

MOST_DIRECTION_NOISE = 0.5
"""Upper bound on the variance of each component of a direction: that of a random direction."""

ALIKE = 0.2
"""Change of the logarithm of an unexplained variance below which weights are kept."""

CHANGED = 0.02
"""Fraction of pixels that may become usable, or cease to be, before weights are updated."""

FACTORS = np.concatenate((np.zeros(1), np.geomspace(1e-3, 30.0, 19)))
"""Candidate factors on the model's learnt errors; the most likely one is used."""

LEARNT = 5
"""Index of the loss ``learnt``."""


@inlined
def exponential(x: np.float32) -> np.float32:
    """Return the exponential of a logarithm of light, branch-free, to a few millionths between -8 and 8."""
    y = x if x < F(20.0) else F(20.0)
    y = (y if y > F(-20.0) else F(-20.0)) * F(1 / 32)
    high = F(1 / 6) + y * (F(1 / 24) + y * (F(1 / 120) + y * F(1 / 720)))
    y = F(1.0) + y * (F(1.0) + y * (F(1 / 2) + y * high))
    y *= y
    y *= y
    y *= y
    y *= y
    return F(y * y)


@inlined
def log_noise(log: np.float32, table: np.ndarray, first: np.float32, steps: np.float32) -> np.float32:
    """Interpolate the standard deviation of a logarithm due to noise in a table, constant beyond its ends."""
    last, top = len(table) - 2, F(len(table) - 1)
    at = (log - first) * steps
    at = at if at > F(0.0) else F(0.0)  # also for NaN
    at = at if at < top else top
    at_least = np.int32(at)
    at_least = at_least if at_least < last else np.int32(last)
    low = table[at_least]
    return low + (at - F(at_least)) * (table[at_least + 1] - low)


@compiled
def row_variances(template: Template, picture: Picture, work: Work) -> None:
    """Compute the variance of the rows of ``soft`` due to noise, to first order, and sums of squared residuals.

    With o = g / sqrt(|g|^2 + e^2), do/dg = (I - o o') / sqrt(|g|^2 + e^2), and the square root follows from |o|.
    Writes ``work.variance``, ``known_now`` and ``row_sums``.
    """
    values, residual, usable, own, metric = work.values, work.residual, work.usable, template.own, work.metric
    table, span, kept, planes = picture.noise, picture.span, picture.kept, work.planes
    variance, known, sums, colours = work.variance, work.known_now, work.row_sums, template.colours
    n, k = len(usable), len(sums)
    first, steps = F(span[0]), F((len(table) - 1) / (span[1] - span[0]))
    keep, slope, most = F(kept[0] * kept[0]), F((kept[1] / SOFTNESS) ** 2), F(MOST_DIRECTION_NOISE)
    logs, deviation, light, spread, counts = planes[0], planes[1], planes[2], planes[3], planes[4]
    clear(sums)
    for begin in range(0, n, PLANE):
        size = PLANE if begin + PLANE < n else n - begin
        usable_logs = known[begin : begin + size]
        for i in range(size):
            usable_logs[i] = F(1.0) if colours and values[SIZE * (begin + i) + 5] >= F(0.99) else F(0.0)
            counts[i] = F(1.0) if usable[begin + i] * own[(begin + i) * k] > F(0.0) else F(0.0)
            light[i], spread[i] = F(LOG_FLOOR), F(0.0)
        for c in range(3):
            out, scale = planes[7 + c], F(BRIGHTNESS[c])
            for i in range(size):
                logs[i] = values[SIZE * (begin + i) + 2 + c]
                deviation[i] = log_noise(logs[i], table, first, steps)
            for i in range(size):
                brightness, square = scale * exponential(logs[i]), deviation[i] * deviation[i]
                light[i] += brightness
                spread[i] += square * brightness * brightness
                # The blur reduces noise, but not the bias that the logarithm's curvature makes of it.
                out[i] = keep * square + F(0.25) * square * square if usable_logs[i] > F(0.0) else F(UNKNOWN)
        for i in range(size):
            x, y = values[SIZE * (begin + i)], values[SIZE * (begin + i) + 1]
            rest = F(1.0) - x * x - y * y
            rest = rest if rest > F(0.0) else F(0.0)
            of_slope, bend = slope * spread[i] * rest / (light[i] * light[i]), F(1.0) + rest
            across, down = of_slope * (F(1.0) - x * x * bend), of_slope * (F(1.0) - y * y * bend)
            planes[5, i], planes[6, i] = across if across < most else most, down if down < most else most
        by_noise, squared = logs, deviation  # the logarithms are no longer needed: use their room
        for r in range(k):
            count = squares = beyond = F(0.0)
            by_x, by_y, by_red = metric[SIZE * r] ** 2, metric[SIZE * r + 1] ** 2, metric[SIZE * r + 2] ** 2
            by_green, by_blue = metric[SIZE * r + 3] ** 2, metric[SIZE * r + 4] ** 2
            for i in range(size):
                by_gradient = by_x * planes[5, i] + by_y * planes[6, i]
                by_noise[i] = by_gradient + by_red * planes[7, i] + by_green * planes[8, i] + by_blue * planes[9, i]
                squared[i] = residual[(begin + i) * k + r] * residual[(begin + i) * k + r]
            for i in range(size):
                counted = counts[i] if by_noise[i] < F(0.5 * UNKNOWN) else F(0.0)
                count += counted
                squares += counted * squared[i]
                beyond += counted * (squared[i] - by_noise[i])
            for i in range(size):
                variance[(begin + i) * k + r] = by_noise[i]
            sums[r, 0] += count
            sums[r, 1] += squares
            sums[r, 2] += beyond


@compiled
def unexplained_by(work: Work) -> float:
    """Compute the unexplained variance of both groups of rows from ``work.row_sums``; return the number of residuals.

    It is the residual's variance minus that of noise, one number for the gradient's rows and one for the invariant.
    Under the light of training the invariant gets the larger weight. Under another light, or with JPEG's errors of
    colour, the gradient does. The result is written to the second row of ``work.unexplained``.
    """
    sums, out = work.row_sums, work.unexplained
    counted = 0.0
    for group in range(2):
        count, squares, beyond = 0.0, 0.0, 0.0
        for r in range(len(sums)):
            if (r >= 2) == (group == COLOUR):
                count, squares, beyond = count + sums[r, 0], squares + sums[r, 1], beyond + sums[r, 2]
        counted += count
        count = count if count > 1.0 else 1.0
        least = LEAST_UNEXPLAINED * squares / count + 1e-9
        out[1, group] = beyond / count if beyond / count > least else least
    return counted


@compiled
def changed(work: Work) -> bool:
    """Return whether the unexplained variance or the set of pixels with usable colour has changed."""
    known, before, unexplained = work.known_now, work.known, work.unexplained
    for group in range(2):
        change = np.log(unexplained[1, group] / unexplained[0, group])
        if not (change < ALIKE and change > -ALIKE):  # NaN is not alike
            return True
    count = 0
    for i in range(len(known)):
        count += 1 if known[i] != before[i] else 0
    return count > CHANGED * len(known)


@compiled
def root_by_rows(template: Template, picture: Picture, work: Work) -> float:
    """Compute square roots of inverse variances (noise plus model), scaled to mean weight 1 over the pixels that count.

    Writes ``work.weighed``, adds the model's variance and the correlation to ``work.variance``, and returns the
    variance at weight 1.
    """
    variance, unexplained, own, usable, out = work.variance, work.unexplained, template.own, work.usable, work.weighed
    correlated = picture.correlated
    n, mass, count = len(usable), 0.0, 0
    k = len(own) // n
    for r in range(k):
        group = COLOUR if r >= 2 else GRADIENTS
        tied, by_model = F(correlated), F(correlated * CORRELATED[group] * unexplained[1, group])
        precision = F(0.0)
        for i in range(n):
            e = i * k + r
            variance[e] = tied * variance[e] + by_model
            counts = usable[i] * own[i * k] > F(0.0)
            precision += F(1.0) / variance[e] if counts else F(0.0)
            count += 1 if counts else 0
        mass += precision
    unit = float(count / mass) if count else 1.0
    for e in range(len(own)):
        out[e] = own[e] * np.sqrt(F(unit) / variance[e])
    return unit


@compiled
def weigh_by_noise(template: Template, picture: Picture, _row: Row, work: Work) -> bool:
    """Compute variances due to noise and due to the model's errors, the latter scaled by its most likely factor.

    The image's first three channels are logarithms. Writes ``work.noise``, ``by_model``, ``variance`` and the variance
    at weight 1, all that does not depend on theta_2; returns False if no pixel is usable.
    """
    if not any_of(work.usable):
        return False
    copy(template.own, work.weighed)
    values, residual, usable, own, metric = work.values, work.residual, work.usable, template.own, work.metric
    table, span, kept, errors = picture.noise, picture.span, picture.kept, template.errors
    noise, by_model, variance = work.noise, work.by_model, work.variance
    n = len(usable)
    k, steps = len(residual) // n, (len(table) - 1) / (span[1] - span[0])
    for i in range(n):
        for c in range(3):
            square = log_noise(values[SIZE * i + c], table, F(span[0]), F(steps)) ** 2
            # The blur reduces noise, but not the bias due to the logarithm's curvature: E log(rho + n) is below
            # log(rho) by half the relative variance.
            noise[SIZE * i + c] = kept[0] * kept[0] * square + 0.25 * square * square
        for r in range(k):
            variance[i * k + r] = F(0.0)
            for c in range(3):
                variance[i * k + r] += metric[SIZE * r + c] ** 2 * noise[SIZE * i + c]
    best, factor = np.inf, 0.0
    for candidate in FACTORS:
        cost = 0.0
        for i in range(n):
            if usable[i] * own[i * k] > F(0.0):
                squares, by_noise = 0.0, 0.0
                for e in range(i * k, i * k + k):
                    squares, by_noise = squares + residual[e] ** 2 / k, by_noise + variance[e] / k
                expected = by_noise + candidate * errors[i] + 1e-300
                cost += np.log(expected) + squares / expected
        if cost < best:
            best, factor = cost, candidate
    precision, count = 0.0, 0
    for i in range(n):
        by_model[i], mean = factor * errors[i], 0.0
        for e in range(i * k, i * k + k):
            variance[e] += F(by_model[i])
            mean += variance[e] / k
        if usable[i] * own[i * k] > F(0.0):
            precision, count = precision + 1.0 / mean, count + 1
    work.scales[UNIT] = count / precision if count else 1.0
    return True


@compiled
def whiten(work: Work) -> None:
    """Compute the square root of noise weights at theta_2 and its relative derivative (empty to skip).

    The derivative of the weights is part of eq 10 here, because var L(theta) depends on the angle. With weights fixed
    at the last angle, the sum of squares is biased towards angles of low noise.
    """
    weighed, metric, slope, noise, by_model = work.weighed, work.metric, work.slope, work.noise, work.by_model
    unit, own, own_derivative = work.scales[UNIT], work.own, work.own_derivative
    k = len(metric) // SIZE
    for i in range(len(by_model)):
        for r in range(k):
            variance, change = by_model[i], 0.0
            for c in range(SIZE):
                scale, by_noise = metric[SIZE * r + c], noise[SIZE * i + c]
                variance += scale * scale * by_noise
                change += 2.0 * scale * slope[SIZE * r + c] * by_noise
            own[i * k + r] = weighed[i * k + r] * np.sqrt(unit / variance)
            if len(own_derivative):
                own_derivative[i * k + r] = -0.5 * change / variance


@compiled
def loss_weight(loss: int, u: float) -> float:
    """Return the weight of a residual of u standard deviations, for a loss of :data:`liaam.fitting.losses.LOSSES`."""
    if loss == 0:  # huber
        return 1.345 / u if u > 1.345 else 1.0
    if loss == 1:  # l1: below a tenth of a standard deviation the weight stops growing
        return 0.1 / u if u > 0.1 else 1.0
    if loss == 2:  # cauchy
        return 1.0 / (1.0 + (u / 2.385) ** 2)
    if loss == 3:  # geman-mcclure
        return 1.0 / (1.0 + (u / 3.65) ** 2) ** 2
    if loss == 4:  # tukey
        return (1.0 - (u / 4.685) ** 2) ** 2 if u < 4.685 else 0.0
    return np.exp(-0.5 * u * u)  # learnt


@compiled
def median(numbers: Double1) -> float:
    """Return the (upper) median of finite numbers (n,) and reorder them; 0 if there are none."""
    low, high, middle = 0, len(numbers) - 1, len(numbers) // 2
    while low < high:
        pivot, i, j = numbers[(low + high) // 2], low, high
        while i <= j:
            while numbers[i] < pivot:
                i += 1
            while numbers[j] > pivot:
                j -= 1
            if i <= j:
                numbers[i], numbers[j] = numbers[j], numbers[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return numbers[middle] if len(numbers) else 0.0


@compiled
def weigh_by_loss(template: Template, row: Row, work: Work) -> None:
    """Multiply square roots of weights, in place, by those of a robust loss."""
    loss, gaussian_median, residual, usable, own = row.loss, row.median, work.residual, work.usable, template.own
    variance, errors, weighed = work.variance, template.errors, work.weighed
    n, count, learnt, room, sizes = len(usable), 0, loss == LEARNT, work.sizes[1], work.sizes[0]
    k = len(residual) // n
    for i in range(n):
        square = 0.0
        for e in range(i * k, i * k + k):
            by = errors[i] + 1e-12 if learnt else np.float64(variance[e]) if len(variance) else 1.0
            square += np.float64(residual[e]) ** 2 / by
        sizes[i] = np.sqrt(square / k)
        if usable[i] * own[i * k] > F(0.0) and np.isfinite(sizes[i]):
            room[count], count = sizes[i], count + 1
    # The scale is robust: a change of light raises all residuals, and the median pixel still counts.
    scale, least = median(room[:count]) / gaussian_median, 1.0 if learnt else 1e-9
    scale, mean = scale if scale > least else least, 0.0
    for i in range(n):
        sizes[i] = loss_weight(loss, sizes[i] / scale) if np.isfinite(sizes[i]) else 0.0
        if learnt:
            sizes[i] /= np.sqrt(errors[i] + 1e-12)
            mean += sizes[i] / count if usable[i] * own[i * k] > F(0.0) else 0.0
    for i in range(n):
        factor = np.sqrt(sizes[i] / mean if learnt and mean > 0.0 else sizes[i])
        for e in range(i * k, i * k + k):
            weighed[e] *= F(factor)


@compiled
def normalisation(template: Template, work: Work) -> None:
    """Write to ``scales`` the gain and offset that match mean and deviation of the mean appearance (the first row)."""
    rows, values, metric, usable, own = work.rows, work.values, work.metric, work.usable, template.own
    k, mean = len(metric) // SIZE, rows[0]
    centre, middle, spread, deviation, count = 0.0, 0.0, 0.0, 0.0, 0
    for about_mean in range(2):  # two passes, to limit rounding errors
        for e in range(len(mean)):
            i, r, seen = e // k, e % k, 0.0
            if usable[i] * own[i * k] == F(0.0):
                continue
            for c in range(SIZE - 1):
                seen += metric[SIZE * r + c] * values[SIZE * i + c]
            if about_mean:
                spread, deviation = spread + (mean[e] - centre) ** 2, deviation + (seen - middle) ** 2
            else:
                centre, middle, count = centre + mean[e], middle + seen, count + 1
        if not about_mean:
            centre, middle = centre / count if count else 0.0, middle / count if count else 0.0
    spread, deviation = (np.sqrt(spread / count), np.sqrt(deviation / count)) if count else (0.0, 0.0)
    gain = spread / deviation if deviation > 1e-6 else 1.0
    work.scales[GAIN], work.scales[OFFSET] = gain, centre - gain * middle


@compiled
def any_of(usable: Single1) -> bool:
    """Return whether any pixel is usable."""
    for i in range(len(usable)):  # noqa: SIM110 (compiled)
        if usable[i] > F(0.0):
            return True
    return False


@compiled
def weigh_by_model(template: Template, _picture: Picture, row: Row, work: Work) -> bool:
    """Use the model's weights and, if asked, normalise the samples; return False if no pixel is usable."""
    if not any_of(work.usable):
        return False
    copy(template.own, work.weighed)
    if row.normalise:
        normalisation(template, work)
    return True


@compiled
def weigh_by_rows(template: Template, picture: Picture, row: Row, work: Work) -> bool:
    """Weigh each row by noise and by the current unexplained variance; return whether the weights changed."""
    row_variances(template, picture, work)
    counted = unexplained_by(work)
    if not counted > 0.0 or not (row.loss >= 0 or changed(work)):
        return False
    unexplained = work.unexplained
    unexplained[0, 0], unexplained[0, 1] = unexplained[1, 0], unexplained[1, 1]
    copy(work.known_now, work.known)
    work.scales[UNIT] = root_by_rows(template, picture, work)
    return True
