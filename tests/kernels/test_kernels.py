"""Kernels: compiled loops do what the reference says; the reference says what bilinear means."""

import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from finite_differences import assert_jacobian
from liaam.errors import MethodError
from liaam.fitting import METHODS, Fitter, SolverOptions, get_method
from liaam.fitting.kernel import KERNELS, get_kernel
from liaam.fitting.level import BLOCK, PLANE, Picture, Row, Template, Work
from liaam.fitting.losses import LOSSES, gaussian_median
from liaam.fitting.objective import Objective, State
from liaam.fitting.problem import LOGS, FitProblem
from liaam.kernels import fast, reference
from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.mesh import barycentric
from liaam.model.sampling import Patch
from liaam.model.shape import Similarity
from liaam.model.warp import FLAT, Mesh, padded
from setups import Kernel, differentiate, disturb, look_again, model_pixels, stands_light

HEIGHT, WIDTH = 9, 12
seeds = st.integers(0, 999)
compiled, plain = Kernel("fast"), Kernel("reference")

# Sampling.

coordinates = st.one_of(
    st.floats(-2.0, 13.0),
    st.sampled_from(
        [0.0, -0.0, 8.0, 11.0, 8.0000001, 11.0000001, 7.9999999, -1e-12, 4.0, np.nan, np.inf, -np.inf, 1e300]
    ),
)


def channels_of(rng: np.random.Generator, size: tuple[int, int] = (HEIGHT, WIDTH)) -> np.ndarray:
    channels = rng.normal(-2, 2, (*size, 8)).astype(np.float32)
    channels[..., 7] = rng.random(size) > 0.1
    return channels


def single(*shape: int) -> np.ndarray:
    return np.full(shape, np.nan, np.float32)


def sampled(channels: np.ndarray, points: np.ndarray, similarity: np.ndarray, metric: np.ndarray):
    """What the compiled loops see at points (n, 2) of the model: values, P values, their derivatives and weights."""
    n, k, size = len(points), len(metric), channels.shape[:2]
    # Each pixel lies at the first corner of a triangle of its own.
    beta = np.tile(np.array([1.0, 0.0, 0.0], np.float32), (n, 1))
    triangles, corner, between = np.repeat(np.arange(n), 3).reshape(n, 3), np.zeros(n, np.int32), single(3 * n)
    mesh = Mesh(beta, np.arange(n + 1), triangles, np.zeros((0, 2)), np.zeros((0, 0)), 0.0)
    seen = {"values": single(8 * n), "residual": single(n * k), "image_slopes": single(2 * n * k), "usable": single(n)}
    at = {"points": points, "corner": corner, "between": between, "metric": metric.astype(np.float32).ravel()}
    template, work = compiled.record(Template, warp=mesh), compiled.record(Work, **at, **seen)
    shown = {"pixels": channels.ravel(), "height": size[0], "width": size[1], "similarity": similarity}
    picture = compiled.record(Picture, **shown)
    compiled.place(template, picture, work)
    compiled.sample(picture, work)
    values, projected, image_slopes, usable = seen.values()
    return values.reshape(n, 8), projected.reshape(n, k), image_slopes.reshape(n, k, 2), usable


def sampled_plainly(channels: np.ndarray, points: np.ndarray, similarity: np.ndarray, metric: np.ndarray):
    """The same as :mod:`liaam.kernels.reference` says."""
    matrix, metric = similarity[:, :2], metric.astype(np.float32).astype(np.float64)
    with np.errstate(invalid="ignore"):  # points of a diverging fit need not be numbers
        points = points @ matrix.T + similarity[:, 2]
    values, gradients, usable = reference.sample(channels, points)
    return values, values @ metric.T, np.einsum("nac,kc,ab->nkb", gradients, metric, matrix), usable


STILL = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@settings(max_examples=200)
@given(points=st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=12), k=st.integers(1, 3), seed=seeds)
def test_samples_are_what_the_reference_says(points, k, seed):
    rng = np.random.default_rng(seed)
    channels, metric = channels_of(rng), rng.normal(size=(k, 8))
    found, expected = (sample(channels, np.array(points), STILL, metric) for sample in (sampled, sampled_plainly))
    for ours, theirs in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(found[3], expected[3])


@given(n=st.integers(0, 20), size=st.sampled_from([(2, 2), (2, 9), (HEIGHT, WIDTH)]), seed=seeds)
def test_samples_under_a_similarity(n, size, seed):
    rng = np.random.default_rng(seed)
    channels, points = channels_of(rng, size), rng.uniform(-1, np.array(size[::-1]), (n, 2))
    similarity = np.column_stack([rng.normal(0, 0.3, (2, 2)) + np.eye(2), rng.normal(size=2)])
    arguments = channels, points, similarity, rng.normal(size=(3, 8))
    for ours, theirs in zip(sampled(*arguments), sampled_plainly(*arguments), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


samplers = pytest.mark.parametrize("sample", [sampled, sampled_plainly], ids=KERNELS)


@samplers
@given(seed=st.integers(0, 99), on_line=st.booleans())
def test_linear_ramps_are_sampled_exactly(sample, seed, on_line):
    rng = np.random.default_rng(seed)
    slopes, base = rng.integers(-8, 8, (2, 3)), rng.integers(-8, 8, 3)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    channels = np.ones((HEIGHT, WIDTH, 8), np.float32)
    channels[..., :3] = x[..., None] * slopes[0] + y[..., None] * slopes[1] + base
    points = rng.integers(0, [8 * (WIDTH - 1), 8 * (HEIGHT - 1)], (20, 2), endpoint=True) / 8
    points = np.round(points) if on_line else points
    points[0] = [WIDTH - 1, HEIGHT - 1]
    values, projected, image_slopes, weights = sample(channels, points, STILL, np.eye(3, 8))
    np.testing.assert_array_equal(values[:, :3], points @ slopes + base)
    np.testing.assert_array_equal(projected, values[:, :3])
    np.testing.assert_array_equal(image_slopes, np.broadcast_to(slopes.T, (20, 3, 2)))
    assert weights.all()


@samplers
def test_gradient_is_the_derivative_of_the_bilinear_samples(sample, rng):
    channels, point, metric = channels_of(rng), np.array([4.3, 5.6]), np.eye(3, 8)

    def projected(at):
        return sample(channels, at[None], STILL, metric)[1][0].astype(float)

    # Bilinear: linear along x and along y, so that even a long step is exact.
    image_slopes = sample(channels, point[None], STILL, metric)[2][0]
    assert_jacobian(projected, image_slopes, point, steps=0.25, tolerance=1e-5)


@samplers
def test_one_unusable_corner_costs_a_sample_its_weight(sample):
    channels = np.ones((HEIGHT, WIDTH, 8), np.float32)
    channels[4, 5, 7] = 0
    points = np.array([[5.0, 4.0], [4.5, 3.5], [5.5, 4.5], [3.9, 4.0], [6.0, 4.0], [5.0, 5.0], [5.0, 3.0]])
    assert sample(channels, points, STILL, np.ones((1, 8)))[3].tolist() == [0, 0, 0, 1, 1, 1, 0]


# What a level's loop is made of.


def floats(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape).astype(np.float32)


def both(name: str, *arguments, written=(), rtol: float = 1e-4, atol: float = 1e-4):
    """Call a function of both kernels, and compare what it returns and what it has written, by their places."""
    made = []
    for kernel in (compiled, plain):
        own = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]
        returned = getattr(kernel, name)(*own)
        numbers = () if returned is None else returned
        made.append([np.atleast_1d(np.asarray(numbers, np.float64)), *(own[i].astype(np.float64) for i in written)])
    return compared(name, made, rtol, atol)


def both_of(name: str, *given, written: tuple[str, ...], rtol: float = 1e-4, atol: float = 1e-4):
    """Call a function of both kernels with records of given fields, the last of which it writes to, then numbers."""
    given, rest = [each for each in given if isinstance(each, tuple)], [n for n in given if not isinstance(n, tuple)]
    made = []
    for kernel in (compiled, plain):
        own = [{k: v.copy() if isinstance(v, np.ndarray) else v for k, v in fields.items()} for _, fields in given]
        records = [kernel.record(kind, **fields) for (kind, _), fields in zip(given, own, strict=True)]
        returned = getattr(kernel, name)(*records, *rest)
        numbers = () if returned is None else returned
        made.append([np.atleast_1d(np.asarray(numbers, np.float64)), *(own[-1][n].astype(np.float64) for n in written)])
    return compared(name, made, rtol, atol)


def compared(name: str, made: list[list[np.ndarray]], rtol: float, atol: float) -> list[np.ndarray]:
    for found, expected in zip(*made, strict=True):
        assert np.isfinite(expected).all()
        scale = max(1.0, np.abs(expected).max(initial=0.0))
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol * scale, err_msg=name)
    return made[0]


PLACES = (1, 2, 7, 255, PLANE - 1, PLANE, PLANE + 1, BLOCK, 2 * BLOCK + 3)


@given(n=st.sampled_from(PLACES), k=st.integers(1, 3), m=st.sampled_from([0, 1, 7, 8, 9, 20]), seed=seeds)
def test_appearances_are_weighed_and_taken_off_as_the_reference_says(n, k, m, seed):
    rng = np.random.default_rng(seed)
    e, wide = n * k, -(-m // 8) * 8
    rows, residual, own = floats(rng, 1 + m, e), floats(rng, e), rng.random(e).astype(np.float32)
    usable = (rng.random(n) > 0.3).astype(np.float32)
    _, root = both("mask", own, usable, single(e), written=[2])
    root, line, block = root.astype(np.float32), single(BLOCK), single(m, BLOCK)
    both("with_modes", rows, root, residual, line, np.full(m, np.nan), written=[4])
    lam = np.where(rng.random(m) < 0.3, 0.0, rng.normal(size=m))
    work = {"residual": residual, "rows": rows, "lam": lam, "lam_step": lam, "root": root, "sums": np.full(2, np.nan)}
    both_of("take_off", (Work, work), written=("residual",))
    both_of("subtract", (Work, work), written=("residual", "sums"))
    gram = both("weighted_gram", rows, own, block, np.full((m, m), np.nan), written=[3])[1]
    if m < e:  # else only rounding and the ridge hold it up
        lines = np.zeros((e, wide), np.float32)
        lines[:, :m] = rows[1:].T
        found = np.full((m, m), np.nan)
        unseen = int((usable == 0).sum())
        ridge = rng.uniform(1e-6, 1e-2, m)
        work = {"gram": gram, "lines": lines.ravel(), "own": own, "usable": usable, "factor": found}
        compiled.factorise(compiled.record(Template, ridge=ridge), compiled.record(Work, **work), unseen)
        lower = np.tril(found)
        seen = rows[1:].astype(np.float64) * root
        exact = seen @ seen.T + np.diag(ridge)
        np.testing.assert_allclose(lower @ lower.T, exact, atol=1e-5 * np.abs(gram).max(initial=0.0))


@pytest.mark.parametrize("method", METHODS)
def test_metrics_are_those_of_the_row(method):
    row = METHODS[method]
    parts, theta, step = row.metric_parts.astype(np.float32).reshape(3, -1), 1.9, 1e-4
    metric, slope = single(8 * row.n_rows), single(8 * row.n_rows)
    work = compiled.record(Work, angles=np.array([0.0, theta]), metric=metric, slope=slope)
    compiled.set_metric(compiled.record(Row, metric=parts), work)
    expected, ahead, behind = (row.image_metric(theta + by) for by in (0.0, step, -step))
    c = expected.shape[1]
    np.testing.assert_allclose(metric.reshape(-1, 8)[:, :c], expected, atol=1e-6)
    np.testing.assert_allclose(slope.reshape(-1, 8)[:, :c], (ahead - behind) / (2 * step), atol=1e-6)
    assert not metric.reshape(-1, 8)[:, c:].any() and not slope.reshape(-1, 8)[:, c:].any()


@given(b=st.integers(1, 9), e=st.sampled_from([1, 6, 77]), theta=st.floats(-7.0, 7.0), seed=seeds)
def test_rows_turn_and_are_transposed_as_the_reference_says(b, e, theta, seed):
    rng = np.random.default_rng(seed)
    rows = both("turn", floats(rng, 3, b, e), theta, single(b, e), written=[2], atol=1e-6)[1].astype(np.float32)
    wide = -(-(b - 1) // 8) * 8
    lines = both("transpose", rows, np.zeros(e * wide, np.float32), written=[1])[1].reshape(e, wide)
    np.testing.assert_array_equal(lines[:, : b - 1], rows[1:].T)
    assert not lines[:, b - 1 :].any()


@given(
    n=st.integers(1, 40), k=st.integers(1, 3), free=st.booleans(), grows=st.booleans(), m=st.integers(0, 5), seed=seeds
)
def test_columns_of_angles_are_what_the_reference_says(n, k, free, grows, m, seed):
    rng = np.random.default_rng(seed)
    own_derivative = floats(rng, n * k) if grows else single(0)
    parts = floats(rng, 3, 1 + m, n * k) if free else np.zeros((0, 0, 0), np.float32)
    work = {"slope": floats(rng, 8 * k), "values": floats(rng, 8 * n), "own_derivative": own_derivative}
    work |= {"residual": floats(rng, n * k), "angles": np.array([1.3, 0.0]), "lam": rng.normal(size=m)}
    work["columns"], row = single(1, n * k), {"directions": np.array([[0.7], [-0.4]])}
    both_of("angle_column", (Template, {"parts": parts}), (Row, row), (Work, work), 0, written=("columns",), atol=1e-5)


@given(n=st.integers(1, 40), k=st.integers(1, 3), seed=seeds)
def test_samples_are_normalised_as_the_reference_says(n, k, seed):
    rng = np.random.default_rng(seed)
    rows, values, metric = floats(rng, 2, n * k), floats(rng, 8 * n), floats(rng, 8 * k)
    metric[7::8] = 0.0
    usable, own = (rng.random(n) > 0.3).astype(np.float32), floats(rng, n * k) + 5
    usable[0] = 1.0
    scales = np.array([0.0, 1.0, 0.0, 0.5, 1.0])  # of derivatives that have a gain of a half
    work = {"rows": rows, "values": values, "metric": metric, "usable": usable, "scales": scales}
    _, scales = both_of("normalisation", (Template, {"own": own}), (Work, work), written=("scales",))
    image_slopes = floats(rng, 2 * n * k)
    work |= {"scales": scales, "residual": single(n * k), "image_slopes": image_slopes}
    _, scales, projected, steeper = both_of("project", (Work, work), written=("scales", "residual", "image_slopes"))
    np.testing.assert_allclose(steeper, 2 * scales[1] * image_slopes, rtol=1e-4, atol=1e-5)
    assert scales[3] == scales[1]
    shown = values.reshape(n, 8) @ metric.reshape(k, 8).T
    expected = scales[1] * shown + scales[2] * metric.reshape(k, 8).sum(axis=1)
    np.testing.assert_allclose(projected, expected.ravel(), rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("kernel", [compiled, plain], ids=repr)
def test_normalised_samples_have_the_mean_and_deviation_of_the_model(kernel, rng):
    rows, values = floats(rng, 1, 500), rng.uniform(2.0, 3.0, (500, 8)).astype(np.float32)
    metric, usable = np.zeros(8, np.float32), (rng.random(500) > 0.3).astype(np.float32)
    metric[:3] = [0.2, 0.7, 0.1]  # luminance: constants pass
    scales, seen, ones = np.array([np.nan, 1.0, 0.0, 1.0, 1.0]), usable > 0, np.ones(500, np.float32)
    projected, template = single(500), kernel.record(Template, own=ones)
    work = {"rows": rows, "values": values.ravel(), "metric": metric, "usable": usable, "scales": scales}
    work |= {"residual": projected, "image_slopes": np.zeros(1000, np.float32)}
    kernel.normalisation(template, kernel.record(Work, **work))
    kernel.project(kernel.record(Work, **work))
    assert projected[seen].mean() == pytest.approx(rows[0, seen].mean(), abs=1e-5)
    assert projected[seen].std() == pytest.approx(rows[0, seen].std(), rel=1e-4)
    # A flat picture has no deviation to be brought to another one.
    work["values"] = np.full(8 * 500, 0.25, np.float32)
    kernel.normalisation(template, kernel.record(Work, **work))
    np.testing.assert_allclose(scales[1:3], [1.0, rows[0, seen].mean() - 0.25], atol=1e-5)


@given(n_free=st.integers(1, 2), n_p=st.integers(1, 4), e=st.sampled_from([1, 7, 300]), m=st.integers(0, 9), seed=seeds)
def test_products_of_the_angles_columns(n_free, n_p, e, m, seed):
    rng = np.random.default_rng(seed)
    columns, residual, root = floats(rng, n_free, e), floats(rng, e), rng.random(e).astype(np.float32)
    hessian, gradient = np.zeros((n_p + n_free, n_p + n_free)), np.zeros(n_p + n_free)
    work = {"columns": columns, "residual": residual, "root": root, "hessian": hessian, "gradient": gradient}
    for f in range(n_free):
        compiled.dots(compiled.record(Work, **work), f)
    weighted = columns.astype(np.float64) * root
    np.testing.assert_allclose(hessian[n_p:, n_p:], weighted @ weighted.T, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(gradient[n_p:], weighted @ (root * residual), rtol=1e-5, atol=1e-5)
    assert not hessian[:n_p].any() and not gradient[:n_p].any()


# Weights.


@given(seed=seeds)
def test_noise_is_read_off_a_table(seed):
    rng = np.random.default_rng(seed)
    table, span = rng.random(40).astype(np.float32), np.array(LOGS)
    logs = np.concatenate([rng.uniform(-9, 2, 50), [*LOGS, np.nan, -1e30, 1e30, -np.inf, np.inf]]).astype(np.float32)
    first, steps = np.float32(span[0]), np.float32(39 / np.ptp(span))
    found = [compiled.log_noise(log, table, first, steps) for log in logs]
    np.testing.assert_allclose(found, plain.log_noise(logs, table, span), atol=2e-5)


def test_exponentials_are_good_to_a_few_millionths():
    x = np.linspace(-8, 8, 1001, dtype=np.float32)
    found = np.array([compiled.exponential(each) for each in x])
    np.testing.assert_allclose(found, np.exp(x.astype(np.float64)), rtol=8e-6)
    ends = [compiled.exponential(np.float32(each)) for each in (-1e30, -np.inf, np.nan, np.inf, 1e30)]
    assert np.isfinite(ends).all()


class Pixels:
    """Pixels as weights see them: samples, residuals, weights and noise, some of them dark, blind or without weight."""

    def __init__(self, rng: np.random.Generator, n: int, k: int, encoding: str = "log") -> None:
        values = floats(rng, n, 8)
        if encoding == "soft":
            angle, length = rng.uniform(0, 6.3, n), rng.uniform(0, 1, n)
            values[:, 0], values[:, 1] = length * np.cos(angle), length * np.sin(angle)
            values[:, 2:5] = rng.uniform(-8, 1, (n, 3))
            values[:, 5] = np.where(rng.random(n) < 0.7, 1.0, rng.random(n))
        else:
            values[:, :3] = rng.uniform(-8, 1, (n, 3))
        self.values, self.residual = values.ravel(), floats(rng, n * k)
        self.usable, self.own = (rng.random(n) > 0.3).astype(np.float32), rng.random(n * k).astype(np.float32)
        if n > 1:
            self.own.reshape(n, k)[rng.integers(n)] = 0.0
        self.usable[0] = self.own[:k] = 1.0
        metric = floats(rng, k, 8)
        if encoding == "soft":
            metric[:2, 2:], metric[2:, :2] = 0.0, 0.0
        metric[:, 7] = 0.0
        self.metric, self.table = metric.ravel(), rng.uniform(0.01, 0.5, 40).astype(np.float32)
        self.span, self.kept, self.errors = np.array(LOGS), np.array([0.3, 0.1]), rng.uniform(0.0, 2.0, n)

    @property
    def work(self) -> dict:
        return {"values": self.values, "residual": self.residual, "usable": self.usable, "metric": self.metric}

    @property
    def picture(self) -> dict:
        return {"noise": self.table, "span": self.span, "kept": self.kept, "correlated": 4.0}


counts = st.sampled_from([1, 2, 30, PLANE - 1, PLANE, PLANE + 1, 2 * PLANE + 1])


@given(n=counts, k=st.integers(1, 3), rows=st.integers(1, 3), seed=seeds)
def test_squares_are_summed_as_the_reference_says(n, k, rows, seed):
    given = Pixels(np.random.default_rng(seed), n, k)
    made, scales = [], np.full(7, 1.7)
    for kernel in (compiled, plain):
        sums = np.full((min(rows, k), 4), np.nan)
        kernel.sum_squares(kernel.record(Work, **given.work, scales=scales), given.own, sums)
        made.append([sums])
    compared("sum_squares", made, 1e-4, 1e-4)


@given(n=counts, k=st.integers(1, 3), colours=st.booleans(), seed=seeds)
def test_variances_of_rows_are_what_the_reference_says(n, k, colours, seed):
    rng = np.random.default_rng(seed)
    given = Pixels(rng, n, k, "soft")
    template, picture = (Template, {"own": given.own, "colours": colours}), (Picture, given.picture)
    work = given.work | {"planes": single(10, PLANE), "variance": single(n * k), "known_now": single(n)}
    work["row_sums"], names = np.full((k, 3), np.nan), ("variance", "known_now", "row_sums")
    _, variance, known, sums = both_of(
        "row_variances", template, picture, (Work, work), written=names, rtol=2e-4, atol=2e-7
    )
    assert (variance >= 0).all()
    assert known.any() <= colours
    # Rows of directions know nothing of colours.
    if k > 2:
        assert sums[0, 0] == ((given.usable * given.own.reshape(n, k)[:, 0]) > 0).sum()
    work |= {"row_sums": sums, "unexplained": np.ones((2, 2))}
    unexplained = both_of("unexplained_by", (Work, work), written=("unexplained",))[1]
    np.testing.assert_array_equal(unexplained[0], 1.0)  # what was before
    work |= {"variance": variance.astype(np.float32), "unexplained": unexplained, "weighed": single(n * k)}
    unit, weighed = both_of("root_by_rows", template, picture, (Work, work), written=("weighed",))
    counted = given.usable * given.own[::k] > 0
    shares = weighed.reshape(n, k)[counted] / given.own.reshape(n, k)[counted]
    assert np.square(shares).mean() == pytest.approx(1.0, rel=1e-3)
    assert unit > 0


@given(n=st.sampled_from([1, 2, 30, 200]), k=st.integers(1, 2), free=st.booleans(), learnt=st.booleans(), seed=seeds)
def test_weights_by_noise_are_what_the_reference_says(n, k, free, learnt, seed):
    rng = np.random.default_rng(seed)
    given = Pixels(rng, n, k)
    errors = given.errors if learnt else np.zeros(n)
    work = given.work | {"noise": np.zeros(8 * n, np.float32), "by_model": np.full(n, np.nan)}
    work |= {"variance": single(n * k), "weighed": single(n * k), "scales": np.ones(7)}
    records = (Template, {"own": given.own, "errors": errors}), (Picture, given.picture), (Row, {}), (Work, work)
    names = ("noise", "by_model", "variance", "weighed", "scales")
    weighs, noise, by_model, _, weighed, scales = both_of(
        "weigh_by_noise", *records, written=names, rtol=2e-4, atol=1e-7
    )
    assert weighs
    np.testing.assert_array_equal(weighed, given.own)
    work |= {"noise": noise.astype(np.float32), "by_model": by_model, "weighed": given.own, "scales": scales}
    work |= {"slope": floats(rng, 8 * k), "own": single(n * k), "own_derivative": single(n * k if free else 0)}
    both_of("whiten", (Work, work), written=("own", "own_derivative"), rtol=2e-4, atol=1e-6)
    assert learnt or not by_model.any()


@given(
    n=st.sampled_from([1, 2, 3, 30, 500]), k=st.integers(1, 3), loss=st.integers(0, 5), varies=st.booleans(), seed=seeds
)
def test_robust_weights_are_what_the_reference_says(n, k, loss, varies, seed):
    rng = np.random.default_rng(seed)
    given = Pixels(rng, n, k)
    given.residual[rng.random(n * k) < 0.1] *= 1e4
    variance = rng.uniform(0.5, 2.0, n * k).astype(np.float32) if varies and LOSSES[loss] != "learnt" else single(0)
    template, row = {"own": given.own, "errors": given.errors}, {"loss": loss, "median": gaussian_median(k)}
    work = given.work | {"variance": variance, "sizes": np.empty((2, n)), "weighed": given.own}
    both_of("weigh_by_loss", (Template, template), (Row, row), (Work, work), written=("weighed",), atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_residuals_that_are_no_numbers_weigh_nothing_and_harm_no_others(rng, bad):
    given = Pixels(rng, 30, 1)
    given.residual[3] = bad
    template, row = {"own": given.own, "errors": given.errors}, {"loss": 0, "median": gaussian_median(1)}
    work = given.work | {"sizes": np.empty((2, 30)), "weighed": np.ones(30, np.float32)}
    weighed = both_of("weigh_by_loss", (Template, template), (Row, row), (Work, work), written=("weighed",))[1]
    assert weighed[3] == 0
    assert (weighed[[i for i in range(30) if i != 3]] > 0).all()


# A mesh of any triangles, seen through any method.


@dataclass(frozen=True, eq=False)
class AnyMesh:
    """A piecewise-affine warp whose pixels lie anywhere in its triangles, written as dense as can be."""

    beta: np.ndarray
    starts: np.ndarray
    triangles: np.ndarray
    rest: np.ndarray
    basis: np.ndarray
    differences: np.ndarray

    @classmethod
    def of(cls, rng: np.random.Generator, sizes: list[int], n_vertices: int = 6, n_p: int = 4) -> "AnyMesh":
        n = sum(sizes)
        beta = rng.dirichlet(np.ones(3), n).astype(np.float32)
        beta[: min(n, 2)] = np.eye(3)[: min(n, 2)]  # at a vertex
        return cls(
            beta,
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
            np.array([rng.permutation(n_vertices)[:3] for _ in sizes]).astype(np.int64),
            rng.uniform(1.0, 8.0, (n_vertices, 2)),
            rng.normal(size=(2 * n_vertices, n_p)),
            rng.normal(size=(2, n, n)),
        )

    @property
    def n_parameters(self) -> int:
        return self.basis.shape[1]

    @cached_property
    def owners(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.triangles)), np.diff(self.starts))

    def mesh(self) -> Mesh:
        basis = np.pad(self.basis, ((0, 0), (0, padded(self.n_parameters) - self.n_parameters)))
        return Mesh(self.beta, self.starts, self.triangles, self.rest, basis, 0.5)

    def vertices(self, p: np.ndarray) -> np.ndarray:
        return self.rest + (self.basis @ p).reshape(-1, 2)

    def points(self, p: np.ndarray) -> np.ndarray:
        return np.einsum("nv,nva->na", self.beta.astype(np.float64), self.vertices(p)[self.triangles[self.owners]])

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        modes = self.basis.reshape(-1, 2, self.n_parameters)[self.triangles[self.owners]]
        return np.einsum("nv,nvaj->naj", self.beta.astype(np.float64), modes)

    def slopes(self, values: np.ndarray) -> np.ndarray:
        return np.einsum("anm,mk->nak", self.differences, values.astype(np.float64))

    def pulled(self, slopes: np.ndarray, p: np.ndarray) -> np.ndarray:
        out, now = np.zeros((len(slopes), slopes.shape[2], 2)), self.vertices(p)
        for i, (a, b, c) in enumerate(self.triangles[self.owners]):
            after, before = (np.column_stack([at[b] - at[a], at[c] - at[a]]) for at in (now, self.rest))
            if abs(np.linalg.det(after)) > FLAT * abs(np.linalg.det(before)):
                out[i] = (np.linalg.inv(after @ np.linalg.inv(before)).T @ slopes[i]).T
        return out

    def movement(self, step: np.ndarray) -> float:
        return 0.5 * float(np.linalg.norm(step))


class Scene:
    """Any mesh, appearance, picture and state, as both kernels see them."""

    def __init__(self, rng: np.random.Generator, method, sizes: list[int], n_modes: int, lost: float | None = None):
        method = get_method(method)
        warp, n, c = AnyMesh.of(rng, sizes), sum(sizes), CHANNELS[method.appearance]
        half = 0.1 * rng.normal(size=(n, c, c))
        usable = np.where(rng.random(n) < 0.8, rng.uniform(0.2, 1.0, n), 0.0).astype(np.float32)
        usable[0] = 1.0
        self.appearance = AppearanceModel(
            floats(rng, n, c), floats(rng, n_modes, n, c), np.ones(n_modes), usable, half @ half.transpose(0, 2, 1)
        )
        light = AppearanceModel(self.appearance.mean, floats(rng, 2, n, c), np.ones(2), usable)
        self.objectives = [
            Objective(method, warp, self.appearance, 0.4, np.array([1.0, 1.0, 0.0, 0.0]), kernel, light, freedom=5.0)
            for kernel in KERNELS
        ]
        channels = channels_of(rng)
        channels[..., :2] /= 6.0
        channels[..., 5] = rng.random((HEIGHT, WIDTH)) > 0.02
        pose = Similarity(np.array([[1.1, -0.2], [0.2, 1.1]]), np.array([0.3, -0.5]))
        patch = Patch(channels, Similarity(np.eye(2), np.zeros(2)), 3)
        self.problem = FitProblem(patch, pose, noise=0.02, noise_left=0.6, slope_left=0.3, blur=0.5)
        lam = rng.normal(size=self.objectives[0].n_lambda)
        self.state = State(0.1 * rng.normal(size=4), np.array([0.4, 0.6]), lam)
        if lost is not None:
            self.state.p[0] = lost

    def seen(self, *, weigh: int = 0, solves: bool = False) -> list[Work]:
        """What both kernels see after weighing so many times, with lambda as it is or at its best."""
        works = [objective.evaluate(self.problem, self.state, weigh) for objective in self.objectives]
        if solves:
            works = [look_again(*each, True) for each in zip(self.objectives, [self.problem] * 2, works, strict=True)]
        return works

    def differentiated(self, works: list[Work], expects: bool = False) -> list[Work]:
        return [differentiate(*each, expects) for each in zip(self.objectives, works, strict=True)]


TURNED = ("metric", "slope", "rows", "lines", "slopes")
SEEN = ("values", "residual", "image_slopes", "usable")
WEIGHED = ("weighed", "own", "own_derivative", "root", "noise", "by_model", "scales")
WRITTEN = (*TURNED, *SEEN, *WEIGHED, "gram", "ar", "lam", "sums")
DIFFERENTIATED = ("hessian", "gradient", "aj")


def assert_alike(works: list[Work], names, rtol: float = 1e-3) -> None:
    for name in names:
        found, expected = (getattr(work, name).astype(np.float64) for work in works)
        scale = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol * scale + 1e-9, err_msg=name)


VARIANTS = (*METHODS, "li+noise", "li-pc+noise+huber", "chroma+noise", "soft-li+cauchy", "rgb+learnt", "grey-norm+l1")
SIZES = st.lists(st.sampled_from([0, 1, 3, 9, 20]), min_size=1, max_size=6).filter(lambda sizes: sum(sizes) > 0)


@settings(max_examples=300)
@given(method=st.sampled_from(VARIANTS), sizes=SIZES, n_modes=st.sampled_from([0, 1, 5, 8, 11]), seed=seeds)
def test_both_kernels_see_the_same_through_any_method(method, sizes, n_modes, seed):
    scene = Scene(np.random.default_rng(seed), method, sizes, n_modes)
    seen = scene.seen()
    assert_alike(seen, WRITTEN)
    if seen[0].sums[1] == 0:
        return
    weighed = scene.seen(weigh=1)
    assert_alike(weighed, WRITTEN)
    # Lambda and the step are told apart where there are more pixels than unknowns only.
    row, told = scene.objectives[0], seen[0].usable.sum() * scene.objectives[0].method.n_rows
    if told > 4 * (row.n_lambda + 6):
        assert_alike(scene.seen(solves=True), WRITTEN, rtol=1e-2)
        for expects in sorted({False, row.method.expects}):
            names = (*DIFFERENTIATED, "columns", *(["expected"] if expects else []))
            assert_alike(scene.differentiated(scene.seen(weigh=1), expects), names, rtol=5e-3)


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf, 1e300, 1e6])
@pytest.mark.parametrize("method", ["soft-li", "li", "li+noise", "rgb", "grey-norm"])
def test_both_kernels_see_nothing_where_a_fit_has_run_off(rng, method, lost):
    scene = Scene(rng, method, [9, 0, 20], 3, lost)
    with np.errstate(invalid="ignore", over="ignore"):
        works = scene.seen(weigh=1, solves=True)
    for work in works:
        assert not work.usable.any()
        assert not work.sums.any()
        assert not work.lam.any()
    assert_alike(works, ("values", "image_slopes", "weighed", "root"))


def amid(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A copy of an array that lies amid numbers which nobody may read or write, and all of it."""
    nothing = np.nan if array.dtype.kind == "f" else 2**30 if array.dtype.itemsize > 1 else 1
    whole = np.full(array.size + 64, nothing, array.dtype)
    inner = whole[32 : 32 + array.size].reshape(array.shape)
    inner[...] = array
    return inner, whole


def fenced(fields, fences: list):
    """The same named tuple with all of its arrays fenced in."""
    made = {}
    for name, value in fields._asdict().items():
        if isinstance(value, np.ndarray):
            value, whole = amid(value)
            fences.append((name, value.size, whole, whole.copy()))
        made[name] = fenced(value, fences) if isinstance(value, Mesh) else value
    return type(fields)(**made)


@given(method=st.sampled_from(VARIANTS), sizes=SIZES, n_modes=st.sampled_from([0, 1, 8, 11]), seed=seeds)
def test_nothing_is_read_or_written_beyond_an_array(method, sizes, n_modes, seed):
    """Vectors of eight are loaded and stored without a check of bounds."""
    scene, ends = Scene(np.random.default_rng(seed), method, sizes, n_modes), []
    objective, fences = scene.objectives[0], []
    options = SolverOptions(max_iterations=3, tolerance=0.0, relative_tolerance=0.0)
    controls = options.controls(objective.method.step == "expected", objective.method.reweighs, True)
    for fence in (False, True):
        own = [objective.template, objective.picture(scene.problem), objective.row, objective.work(scene.state, 9)]
        if fence:
            own = [fenced(each, fences) for each in own]
        template, picture, row, asked, record = map(compiled.by_reference, (*own[:3], controls, own[3]))
        compiled.solve_level(template, picture, row, asked, record)
        ends.append(own[-1])
    for name, size, whole, before in fences:
        for part in (slice(0, 32), slice(32 + size, None)):
            np.testing.assert_array_equal(whole[part], before[part], err_msg=name)
    for name in ("p", "lam", "angles", "residual", "image_slopes", "weighed", "hessian", "gradient", "sums"):
        np.testing.assert_array_equal(getattr(ends[1], name), getattr(ends[0], name), err_msg=name)


FITTED = (*METHODS, "li+noise", "grey+tukey", "li-pc+noise+huber", "soft-li+huber")


@pytest.mark.parametrize("method", FITTED)
def test_whole_fits_end_at_the_same_place(model, lit_scene, same_light_scene, method):
    scene = lit_scene if stands_light(method) else same_light_scene
    options = SolverOptions(tolerance=1e-3, relative_tolerance=0.0)
    found, expected = (
        Fitter(model, method, options, kernel=kernel).fit(scene.image, disturb(scene.landmarks)) for kernel in KERNELS
    )
    assert found.status == expected.status
    assert model_pixels(model, found.landmarks, expected.landmarks) < 1e-2
    assert found.cost == pytest.approx(expected.cost, rel=1e-2)
    np.testing.assert_allclose(found.theta, expected.theta, atol=1e-3)


def test_an_unknown_kernel_lists_those_that_exist():
    with pytest.raises(MethodError, match="kernel 'cuda' does not exist; there are fast, reference"):
        get_kernel("cuda")


def test_the_reference_is_the_same_loop_over_plain_numpy():
    assert plain.solve_level.__code__ is compiled.solve_level.py_func.__code__
    used = plain.solve_level.__globals__["evaluate_residual"].__globals__
    assert used["sample_picture"].__code__.co_filename.endswith("reference.py")


def test_the_reference_works_where_nothing_has_run_before():
    """NumPy imports parts of itself from within its functions, in the name of whoever calls."""
    code = "import numpy as np, liaam.fitting.kernel as of; a = np.ones(3); of.get_kernel('reference').mask(a, a, +a)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_index_out_of_bounds_is_an_error_where_bounds_are_checked(tmp_path):
    code = """
import numpy as np
from liaam.fitting.residual import mask
one = np.zeros(1, np.float32)
try:
    mask(np.zeros(4, np.float32), np.ones(2, np.float32), one)
except IndexError as error:
    print(error)
"""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    assert "an index is out of bounds" in run.stdout


def test_an_array_of_another_kind_is_refused():
    with pytest.raises(TypeError, match="not a C-contiguous span"):
        compiled.mask(np.zeros(4), np.ones(4, np.float32), np.zeros(4, np.float32))
    with pytest.raises(TypeError, match="not a C-contiguous span"):
        compiled.mask(np.zeros(8, np.float32)[::2], np.ones(4, np.float32), np.zeros(4, np.float32))


def test_a_record_of_something_else_is_refused():
    with pytest.raises(TypeError, match="takes a Work, not a Controls"):
        compiled.whiten(compiled.by_reference(SolverOptions().controls(False, False, False)))


# Pictures.


@given(n=st.integers(3, 12), grid=st.booleans(), seed=seeds)
def test_a_pixel_belongs_to_the_first_triangle_that_it_lies_in(n, grid, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 18, (n, 2))
    points = np.rint(points) if grid else points  # vertices and edges on pixels, triangles of no area
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    owner, weights = reference.raster(points, triangles, 20, 19)
    y, x = np.mgrid[:19, :20].reshape(2, -1)
    pixels = np.column_stack([x, y]).astype(float)
    inside = np.array([(barycentric(pixels, points[triangle]) >= -1e-9).all(axis=1) for triangle in triangles])
    expected = np.where(inside.any(axis=0), inside.argmax(axis=0), -1)
    np.testing.assert_array_equal(owner.ravel(), expected)
    own = owner[y, x] >= 0
    at = np.einsum("nv,nva->na", weights[y, x][own], points[triangles[owner[y, x][own]]])
    np.testing.assert_allclose(at, pixels[own], atol=1e-7)
    assert not weights[owner < 0].any()
    assert owner.dtype == np.int32 and weights.shape == (19, 20, 3)


@given(n=st.integers(3, 12), seed=seeds)
def test_values_of_vertices_are_carried_to_pixels(n, seed):
    rng = np.random.default_rng(seed)
    points, values = rng.uniform(0, 18, (n, 2)), rng.normal(size=(n, 2))
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    owner, weights = reference.raster(points, triangles, 20, 19)
    same, carried = fast.carry(points, triangles, values, 20, 19)
    np.testing.assert_array_equal(same, owner)
    expected = np.einsum("yxv,yxvc->yxc", weights, values[triangles[np.maximum(owner, 0)]])
    np.testing.assert_allclose(carried, expected, atol=1e-9)
    cut, inner = fast.carry(points - (6, 5), triangles, values, 7, 8)  # some vertices are outside
    np.testing.assert_array_equal(cut, owner[5:13, 6:13])
    np.testing.assert_allclose(inner, carried[5:13, 6:13], atol=1e-9)


@given(size=st.tuples(st.integers(2, 12), st.integers(3, 12)), seed=st.integers(0, 99))
def test_packed_spectra_are_correlated_as_pictures_are(size, seed):
    left, right = np.random.default_rng(seed).normal(size=(2, 2, *size)).astype(np.float32)
    packed = (np.stack([cv2.dft(channel) for channel in channels]) for channels in (left, right))
    found = np.empty(size, np.float32)
    fast.correlate(*packed, found)
    shifts = np.ndindex(*size)
    expected = [(left * np.roll(right, shift, axis=(1, 2))).sum() for shift in shifts]
    np.testing.assert_allclose(cv2.idft(found, flags=cv2.DFT_SCALE).ravel(), expected, atol=1e-4)


def plain_peaks(picture, count, least, reach):
    """The definition: pixels above a limit and not below their neighbours, the largest first."""
    around = cv2.dilate(picture, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    places = np.argwhere((picture >= around) & (picture > np.float32(least)))
    values = picture[places[:, 0], places[:, 1]]
    order = np.argsort(-values, kind="stable")[:count]
    return places[order], values[order]


@given(
    size=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    digits=st.integers(0, 2),
    count=st.integers(1, 9),
    reach=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_peaks_are_those_of_the_definition(size, digits, count, reach, seed):
    picture = np.random.default_rng(seed).random(size).round(digits).astype(np.float32)  # some are equal
    arguments = picture, count, 0.4, reach
    for found, expected in zip(fast.best_peaks(*arguments), plain_peaks(*arguments), strict=True):
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype


def test_peaks_are_the_largest_around_and_come_in_order():
    picture = np.zeros((9, 12), np.float32)
    picture[2, 3], picture[2, 5], picture[7, 11], picture[0, 9], picture[6, 2] = 5, 6, 3, 4, 0.5
    places, values = fast.best_peaks(picture, 9, 1.0, 2)
    assert places.tolist() == [[2, 5], [0, 9], [7, 11]] and values.tolist() == [6, 4, 3]
    assert len(fast.best_peaks(picture, 2, 1.0, 2)[1]) == 2
