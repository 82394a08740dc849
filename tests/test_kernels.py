"""Kernels: the fast one does what the reference says; the reference says what bilinear means."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from finite_differences import assert_jacobian
from liaam.errors import MethodError
from liaam.kernels import KERNELS, fast, get_kernel, reference
from liaam.kernels.layout import PAIRS, Carried, MeshPixels, pack

HEIGHT, WIDTH = 9, 12

coordinates = st.one_of(
    st.floats(-2.0, 13.0),
    st.sampled_from(
        [0.0, -0.0, 8.0, 11.0, 8.0000001, 11.0000001, 7.9999999, -1e-12, 4.0, np.nan, np.inf, -np.inf, 1e300]
    ),
)


def channels_of(rng: np.random.Generator, n: int = 3) -> np.ndarray:
    channels = rng.normal(-2, 2, (HEIGHT, WIDTH, n + 1)).astype(np.float32)
    channels[..., n] = rng.random((HEIGHT, WIDTH)) > 0.1
    return channels


@settings(max_examples=200)
@given(
    points=st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=12),
    metric=st.one_of(
        st.tuples(st.integers(1, 3), st.integers(1, 6)).map(np.ones), st.sampled_from([np.ones((1, 3)), fast.SOFT])
    ),
    seed=st.integers(0, 999),
)
def test_fast_samples_as_reference_says(points, metric, seed):
    rng = np.random.default_rng(seed)
    arguments = (
        channels_of(rng, metric.shape[1]),
        np.array(points),
        rng.normal(size=(2, 2)),
        metric * rng.normal(size=metric.shape),
    )
    expected, found = reference.steepest(*arguments), fast.steepest(*arguments)
    for ours, theirs in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        assert ours.dtype == theirs.dtype == np.float32
    np.testing.assert_array_equal(found[3], expected[3])


@pytest.mark.parametrize("n", [0, 1, 255, 256, 257, 259, 600])
@pytest.mark.parametrize("metric", [np.ones((1, 3)), fast.SOFT * 1.0], ids=["one", "soft"])
@pytest.mark.parametrize("size", [(2, 2), (HEIGHT, WIDTH)])
def test_any_number_of_points_is_sampled(rng, size, metric, n):
    channels = rng.random((*size, metric.shape[1] + 1))
    points = rng.uniform(-1, np.array(size[::-1]), (n, 2))
    for ours, theirs in zip(
        fast.steepest(channels, points, np.eye(2), metric),
        reference.steepest(channels, points, np.eye(2), metric),
        strict=True,
    ):
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, atol=1e-5)


def mesh_of(rng: np.random.Generator, sizes: list[int], n_vertices: int = 5, n_p: int = 4) -> MeshPixels:
    beta = rng.random((sum(sizes), 3))
    return MeshPixels(
        (beta / beta.sum(axis=1, keepdims=True)).astype(np.float32),
        np.concatenate([[0], np.cumsum(sizes)]),
        np.array([rng.permutation(n_vertices)[:3] for _ in sizes]),
        rng.normal(size=(2 * n_vertices, n_p)),
    )


@given(
    sizes=st.lists(st.sampled_from([0, 1, 3, 100, 255, 300]), min_size=1, max_size=6),
    metric=st.sampled_from([np.ones((1, 3)), fast.SOFT * 1.0, np.eye(3)]),
    lost=st.sampled_from([None, np.nan, np.inf, 1e300]),
    seed=st.integers(0, 999),
)
def test_a_mesh_is_sampled_where_its_pixels_lie(sizes, metric, lost, seed):
    rng = np.random.default_rng(seed)
    channels, turn = channels_of(rng, metric.shape[1]), rng.normal(size=(2, 2))
    places = Carried(rng.uniform(-2, 14, (5, 2)), mesh_of(rng, sizes))
    if lost is not None:
        places.vertices[0, 0] = lost
    assert len(places) == len(places.points) == sum(sizes)
    arguments = turn, metric
    found = fast.steepest(channels, places, *arguments)
    for ours, theirs in zip(found, reference.steepest(channels, places, *arguments), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-4)
    for ours, theirs in zip(found, fast.steepest(channels, places.points, *arguments), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-4)


@given(
    n=st.integers(1, 9),
    rank=st.integers(0, 9),
    damping=st.sampled_from([0.0, 1e-3, 10.0]),
    free=st.lists(st.booleans(), min_size=9, max_size=9),
    seed=st.integers(0, 999),
)
def test_fast_steps_as_reference_does(n, rank, damping, free, seed):
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(n, min(rank, n)))
    arguments = half @ half.T, rng.normal(size=n), rng.random(n), np.array(free[:n]), damping
    found, expected = fast.damped_step(*arguments), reference.damped_step(*arguments)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert not found[~arguments[3]].any()


@pytest.mark.parametrize("kernel", [fast, reference])
def test_a_system_without_a_solution_gives_no_step(kernel):
    nothing = np.zeros((2, 2)), np.ones(2), np.zeros(2), np.ones(2, bool), 0.0
    assert kernel.damped_step(*nothing) is None
    lost = np.full((2, 2), np.nan), np.ones(2), np.ones(2), np.ones(2, bool), 0.0
    step = kernel.damped_step(*lost)
    assert step is None or not np.isfinite(step).any()


def floats(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape).astype(np.float32)


@given(
    sizes=st.lists(st.integers(0, 5), min_size=1, max_size=4),
    rows=st.integers(1, 4),
    n_modes=st.sampled_from([0, 1, 7, 8, 9, 16, 20, 24, 40]),
    n_right=st.integers(1, 3),
    expects=st.booleans(),
    seed=st.integers(0, 999),
)
def test_fast_multiplies_as_reference_says(sizes, rows, n_modes, n_right, expects, seed):
    rng = np.random.default_rng(seed)
    mesh, n = mesh_of(rng, sizes), sum(sizes)
    arguments = (
        floats(rng, n, rows, 2),
        rng.random((n, rows)).astype(np.float32),
        pack(floats(rng, n_modes, n * rows)),
        floats(rng, n_right, n * rows),
        mesh,
        floats(rng, n, rows, 2) if expects else None,
    )
    for ours, theirs in zip(fast.mesh_products(*arguments), reference.mesh_products(*arguments), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        assert ours.dtype == np.float64


@given(n_modes=st.integers(0, 9), n=st.integers(0, 40), seed=st.integers(0, 999))
def test_packed_numbers_are_near_those_given(n_modes, n, seed):
    rng = np.random.default_rng(seed)
    rows = floats(rng, n_modes, n) * rng.choice([0.0, 1e-6, 1.0, 1e6], (n_modes, 1)).astype(np.float32)
    packed = pack(rows)
    assert packed.steps.dtype == np.int16 and packed.rows.dtype == np.float32
    error = np.abs(packed.rows - rows).max(axis=1, initial=0.0)
    assert (error <= 0.51 / 32767 * np.abs(rows).max(axis=1, initial=0.0)).all()
    np.testing.assert_array_equal(pack(packed.rows).steps, packed.steps)
    np.testing.assert_array_equal(packed.lines[:, :n_modes], packed.steps.T)
    assert packed.lines.shape[1] % 8 == 0 and not packed.lines[:, n_modes:].any()


def test_rows_that_are_no_numbers_stay_so():
    rows = np.ones((4, 3), np.float32)
    rows[1, 2], rows[2, 0], rows[3] = np.nan, np.inf, 1e-43
    packed = pack(rows)
    assert np.isnan(packed.rows[1:3]).all()
    np.testing.assert_array_equal(packed.rows[[0, 3]], [[1, 1, 1], [0, 0, 0]])
    assert np.isnan(fast.less(np.zeros(3, np.float32), packed, np.ones(4))).all()


@pytest.mark.parametrize("kernel", [fast, reference])
def test_rows_are_taken_off_whatever_lies_where(rng, kernel):
    values, packed = floats(rng, 5, 4), pack(floats(rng, 3, 20))
    expected = reference.less(values, packed, np.arange(3))
    np.testing.assert_allclose(kernel.less(np.asfortranarray(values), packed, np.arange(3)), expected, atol=1e-5)
    assert not np.isfinite(kernel.less(values, packed, np.full(3, 1e300))).any()


def test_edges_of_a_mesh_are_those_of_its_triangles():
    mesh = MeshPixels(np.empty((0, 3)), np.zeros(3, int), np.array([[0, 2, 1], [1, 2, 3]]), np.empty((8, 0)))
    pairs = [[sorted((t[a], t[b])) for a, b in PAIRS] for t in mesh.triangles.tolist()]
    assert mesh.edges[mesh.sides].tolist() == pairs
    assert len(mesh.edges) == 4 + 5  # vertices, and sides of which one is shared


@given(n=st.integers(3, 12), grid=st.booleans(), seed=st.integers(0, 999))
def test_fast_finds_pixels_in_triangles_as_reference_says(n, grid, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 18, (n, 2))
    points = np.rint(points) if grid else points  # vertices and edges on pixels, triangles of no area
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    (owner, weights), (ours, own) = (kernel.raster(points, triangles, 20, 19) for kernel in (reference, fast))
    np.testing.assert_array_equal(ours, owner)
    np.testing.assert_allclose(own, weights, atol=1e-12)
    assert ours.dtype == owner.dtype == np.int32 and own.shape == (19, 20, 3)


def test_products_are_the_same_however_numbers_are_stored(rng):
    mesh, packed = mesh_of(rng, [4, 3]), pack(floats(rng, 3, 14))
    plain = floats(rng, 7, 2, 2), floats(rng, 7, 2), floats(rng, 1, 14)
    strange = [np.asfortranarray(array.astype(np.float64)) for array in plain]
    expected = fast.mesh_products(plain[0], plain[1], packed, plain[2], mesh)
    found = fast.mesh_products(strange[0], strange[1], packed, strange[2], mesh)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_residual_that_has_blown_up_spoils_no_other_product(rng):
    mesh = mesh_of(rng, [8])
    left = floats(rng, 8, 3, 2), floats(rng, 8, 3), pack(floats(rng, 5, 24))
    right = np.zeros((1, 24), np.float32)
    calm, blown = (fast.mesh_products(*left, right + number, mesh) for number in (1.0, np.inf))
    for ours, theirs in zip(blown[:2], calm[:2], strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.isfinite(blown[2]).any()


@given(
    n=st.integers(0, 700),
    rows=st.integers(1, 3),
    n_modes=st.integers(0, 9),
    b=st.integers(1, 3),
    seed=st.integers(0, 999),
)
def test_fast_weighs_as_reference_says(n, rows, n_modes, b, seed):
    rng = np.random.default_rng(seed)
    modes = floats(rng, n_modes, n * rows)
    residual, own = floats(rng, 2, n, rows)
    found, expected = (kernel.weighted_gram(modes, own) for kernel in (fast, reference))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)
    assert found.dtype == np.float64
    packed = pack(modes)
    weights = np.rint(rng.random(n)).astype(np.float32)
    for values, factors in ((None, None), (residual, None), (residual, rng.normal(size=n_modes))):
        ours, theirs = np.tile(floats(rng, b, n * rows), (2, 1, 1))
        found = fast.column_sums(ours, packed, own, weights, values, factors)
        expected = reference.column_sums(theirs, packed, own, weights, values, factors)
        for mine, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-4)
    arguments = residual, packed, rng.normal(size=n_modes)
    given = residual.copy()
    left, expected = fast.less(*arguments), reference.less(*arguments)
    np.testing.assert_allclose(left, expected, rtol=1e-5, atol=1e-4)
    assert left.dtype == np.float32 and left.shape == residual.shape
    np.testing.assert_array_equal(residual, given)
    np.testing.assert_allclose(fast.combined(*arguments[1:]), reference.combined(*arguments[1:]), rtol=1e-5, atol=1e-4)


@given(seed=st.integers(0, 99))
def test_fast_carries_and_pulls_as_reference_says(seed):
    rng = np.random.default_rng(seed)
    positions, corners, beta = rng.normal(size=(6, 2)), rng.integers(0, 6, (9, 3), dtype=np.int32), rng.random((9, 3))
    arguments = positions, corners, beta
    np.testing.assert_allclose(fast.carry(*arguments), reference.carry(*arguments), rtol=1e-12, atol=1e-12)
    slopes = rng.normal(size=(9, 2, 3)).astype(np.float32)
    arguments = slopes, rng.normal(size=(4, 2, 2)), rng.integers(0, 4, 9, dtype=np.int32)
    np.testing.assert_allclose(fast.pull(*arguments), reference.pull(*arguments), rtol=1e-5, atol=1e-5)
    points, shape = rng.normal(size=(2, 6, 2))
    shape[1] = shape[0] + 1e-3 * rng.normal(size=2)  # triangles with both are flat
    arguments = points, shape, np.array([rng.permutation(6)[:3] for _ in range(20)])
    found, expected = (kernel.inverse_affinities(*arguments) for kernel in (fast, reference))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@given(seed=st.integers(0, 99), colours=st.booleans())
def test_fast_knows_the_noise_that_reference_says(seed, colours):
    rng = np.random.default_rng(seed)
    weights = np.rint(rng.random(20)).astype(np.float32)
    angle, length = rng.uniform(0, 6.3, 20), rng.uniform(0, 1, 20)
    values = np.column_stack(
        [length * np.cos(angle), length * np.sin(angle), rng.uniform(-8, 1, (20, 3)), rng.random(20)]
    )
    values[::3, 5] = 1.0
    residual = np.where(weights[:, None] > 0, rng.normal(size=(20, 3)), np.nan).astype(np.float32)
    squared = np.square(rng.normal(size=(3, 6)))
    squared[:2, 2:] = 0.0
    seen = values.astype(np.float32), residual, weights, squared
    settings = (rng.uniform(0.01, 0.5, 40), (-7.0, 0.5), (0.3, 0.1), 0.1, 0.004, np.array([0.2, 0.7, 0.1]), 1e5, 0.5)
    found, expected = (kernel.soft_variances(*seen, *settings, colours) for kernel in (fast, reference))
    for ours, theirs in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-7)
        assert ours.dtype == theirs.dtype == np.float32
    np.testing.assert_allclose(found[2], expected[2], rtol=1e-4, atol=1e-4)


@given(n=st.integers(0, 600), seed=st.integers(0, 99))
def test_fast_weighs_softly_as_reference_says(n, seed):
    rng = np.random.default_rng(seed)
    by_noise, own = rng.random((n, 3)).astype(np.float32), rng.random((n, 3)).astype(np.float32)
    arguments = by_noise, rng.random(3), 4.0, own, np.rint(rng.random(n)).astype(np.float32)
    (found, unit), (expected, other) = (kernel.soft_roots(*arguments) for kernel in (fast, reference))
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_allclose(unit, other, rtol=1e-6)


@pytest.mark.parametrize("name", KERNELS)
@given(size=st.tuples(st.integers(2, 12), st.integers(3, 12)), seed=st.integers(0, 99))
def test_packed_spectra_are_correlated_as_pictures_are(name, size, seed):
    left, right = np.random.default_rng(seed).normal(size=(2, 2, *size)).astype(np.float32)
    packed = (np.stack([cv2.dft(channel) for channel in channels]) for channels in (left, right))
    found = get_kernel(name).correlate(*packed, np.empty(size, np.float32))
    shifts = np.ndindex(*size)
    expected = [(left * np.roll(right, shift, axis=(1, 2))).sum() for shift in shifts]
    np.testing.assert_allclose(cv2.idft(found, flags=cv2.DFT_SCALE).ravel(), expected, atol=1e-4)


@given(
    size=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    digits=st.integers(0, 2),
    count=st.integers(1, 9),
    reach=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_fast_finds_the_peaks_that_reference_does(size, digits, count, reach, seed):
    picture = np.random.default_rng(seed).random(size).round(digits).astype(np.float32)  # some are equal
    arguments = picture, count, 0.4, reach
    for found, expected in zip(fast.best_peaks(*arguments), reference.best_peaks(*arguments), strict=True):
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype


@pytest.mark.parametrize("name", KERNELS)
def test_peaks_are_the_largest_around_and_come_in_order(name):
    picture = np.zeros((9, 12), np.float32)
    picture[2, 3], picture[2, 5], picture[7, 11], picture[0, 9], picture[6, 2] = 5, 6, 3, 4, 0.5
    places, values = get_kernel(name).best_peaks(picture, 9, 1.0, 2)
    assert places.tolist() == [[2, 5], [0, 9], [7, 11]] and values.tolist() == [6, 4, 3]
    assert len(get_kernel(name).best_peaks(picture, 2, 1.0, 2)[1]) == 2


@pytest.mark.parametrize("name", KERNELS)
@given(seed=st.integers(0, 99), on_line=st.booleans())
def test_linear_ramps_are_sampled_exactly(name, seed, on_line):
    rng = np.random.default_rng(seed)
    slopes, base = rng.integers(-8, 8, (2, 3)), rng.integers(-8, 8, 3)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    channels = np.ones((HEIGHT, WIDTH, 4), np.float32)
    channels[..., :3] = x[..., None] * slopes[0] + y[..., None] * slopes[1] + base
    points = rng.integers(0, [8 * (WIDTH - 1), 8 * (HEIGHT - 1)], (20, 2), endpoint=True) / 8
    points = np.round(points) if on_line else points
    points[0] = [WIDTH - 1, HEIGHT - 1]
    values, projected, steep, weights = get_kernel(name).steepest(channels, points, np.eye(2), np.eye(3))
    np.testing.assert_array_equal(values, points @ slopes + base)
    np.testing.assert_array_equal(projected, values)
    np.testing.assert_array_equal(steep, np.broadcast_to(slopes.T, (20, 3, 2)))
    assert weights.all()


@pytest.mark.parametrize("name", KERNELS)
def test_gradient_is_the_derivative_of_the_bilinear_samples(name, rng):
    channels = channels_of(rng)
    point = np.array([4.3, 5.6])

    def sample(at):
        _, projected, steep, _ = get_kernel(name).steepest(channels, at[None], np.eye(2), np.eye(3))
        return projected[0].astype(float), steep[0]

    channels[..., 3] = 1
    # Bilinear: linear along x and along y, so that even a long step is exact.
    assert_jacobian(lambda at: sample(at)[0], sample(point)[1], point, steps=0.25, tolerance=1e-5)


@pytest.mark.parametrize("name", KERNELS)
def test_one_unusable_corner_costs_a_sample_its_weight(name):
    channels = np.ones((HEIGHT, WIDTH, 4), np.float32)
    channels[4, 5, 3] = 0
    points = np.array([[5.0, 4.0], [4.5, 3.5], [5.5, 4.5], [3.9, 4.0], [6.0, 4.0], [5.0, 5.0], [5.0, 3.0]])
    weights = get_kernel(name).steepest(channels, points, np.eye(2), np.ones((1, 3)))[3]
    assert weights.tolist() == [0, 0, 0, 1, 1, 1, 0]


def test_an_unknown_kernel_lists_those_that_exist():
    with pytest.raises(MethodError, match="kernel 'cuda' does not exist; there are fast, reference"):
        get_kernel("cuda")
