"""The loops over images, compiled and in NumPy: each does what its definition says."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, map_coordinates

from liaam import _core, image_reference
from liaam.encoding_constants import SOFTNESS

HEIGHT, WIDTH = 13, 17
LIGHT = np.linspace(0, 1, 256, dtype=np.float32) ** 2
TABLE = np.ones((3, 256, 4), np.float32)
TABLE[range(3), :, range(3)] = LIGHT
TABLE[:, :20, 3] = TABLE[:, 241:, 3] = 0.0

seeds = st.integers(0, 999)


@pytest.fixture(
    scope="module", params=[_core, image_reference] if _core.BUILT else [image_reference], ids=lambda m: m.__name__
)
def module(request):
    return request.param


def overlap(n: int, start: float, size: float, count: int) -> np.ndarray:
    """Share of each of n pixels in each of count blocks, (count, n)."""
    low = start + size * np.arange(count)[:, None]
    pixel = np.arange(n)
    return np.clip(np.minimum(pixel + 1, low + size) - np.maximum(pixel, low), 0, 1) / size


blocks = st.tuples(st.floats(0, 2), st.floats(0, 2), st.floats(1, 5))


@given(blocks=blocks, kind=st.sampled_from(["plain", "strided", "mirrored", "read only"]), seed=seeds)
def test_stored_means_are_means_of_areas(module, blocks, kind, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    rows, columns = overlap(HEIGHT, y, size, shape[0]), overlap(WIDTH, x, size, shape[1])
    usable = ((image >= 20) & (image <= 240)).all(axis=2, keepdims=True)
    expected = np.einsum("ry,cx,yxk->rck", rows, columns, np.concatenate([LIGHT[image], usable], axis=2))
    given = {
        "strided": np.concatenate([image, image], axis=2)[..., :3],
        "mirrored": np.ascontiguousarray(image[..., ::-1])[..., ::-1],
    }.get(kind, image)
    given.flags.writeable = kind != "read only"
    found = module.stored_means(given, TABLE, x, y, size, *shape)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert found.dtype == np.float32


@given(blocks=blocks, depth=st.integers(1, 5), seed=seeds)
def test_means_of_values_are_means_of_areas(module, blocks, depth, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    values = np.random.default_rng(seed).random((HEIGHT, WIDTH, depth), np.float32)
    rows, columns = overlap(HEIGHT, y, size, shape[0]), overlap(WIDTH, x, size, shape[1])
    expected = np.einsum("ry,cx,yxk->rck", rows, columns, values)
    np.testing.assert_allclose(module.value_means(values, x, y, size, *shape), expected, atol=2e-6)


@given(rows=st.integers(1, HEIGHT), columns=st.integers(1, WIDTH), seed=seeds)
def test_area_means_are_means_of_the_blocks_that_tile_an_image(module, rows, columns, seed):
    image = np.random.default_rng(seed).random((HEIGHT, WIDTH), np.float32)
    shares = overlap(HEIGHT, 0.0, HEIGHT / rows, rows), overlap(WIDTH, 0.0, WIDTH / columns, columns)
    np.testing.assert_allclose(module.area_means(image, rows, columns), shares[0] @ image @ shares[1].T, atol=2e-6)


@given(blocks=blocks, dtype=st.sampled_from([np.uint8, np.uint16]), mirrored=st.booleans(), seed=seeds)
def test_means_of_brightness_are_those_of_the_tables(module, blocks, dtype, mirrored, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    rng = np.random.default_rng(seed)
    n = np.iinfo(dtype).max + 1
    image, tables = rng.integers(0, n, (HEIGHT, WIDTH, 3)).astype(dtype), rng.random((3, n)).astype(np.float32)
    image = image[..., ::-1] if mirrored else image
    rows, columns = overlap(HEIGHT, y, size, shape[0]), overlap(WIDTH, x, size, shape[1])
    expected = rows @ sum(tables[c][image[..., c]] for c in range(3)) @ columns.T
    np.testing.assert_allclose(module.stored_brightness(image, tables, x, y, size, *shape), expected, atol=4e-6)
    of_first = rows @ tables[2][image[..., 0]] @ columns.T
    np.testing.assert_allclose(module.stored_brightness(image, tables[2:], x, y, size, *shape), of_first, atol=2e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_stored_luminance_is_that_of_the_tables(module, dtype, rng):
    n = np.iinfo(dtype).max + 1
    image, tables = rng.integers(0, n, (HEIGHT, WIDTH, 3)).astype(dtype), rng.random((3, n)).astype(np.float32)
    expected = sum(tables[c][image[..., c]] for c in range(3))
    np.testing.assert_allclose(module.stored_luminance(image, tables), expected, atol=1e-6)


@given(turn=st.floats(-3.0, 3.0), softness=st.sampled_from([1e-3, 0.1, 1.0]), seed=seeds)
def test_soft_directions_are_gradients_over_a_root(module, turn, softness, seed):
    image = np.random.default_rng(seed).random((HEIGHT, WIDTH), np.float32)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    gradient = np.stack(np.gradient(image)[::-1], axis=-1) @ matrix.T
    expected = gradient / np.sqrt(np.square(gradient).sum(axis=-1, keepdims=True) + softness**2)
    found = module.soft_directions(image, tuple(matrix.ravel().tolist()), softness)
    np.testing.assert_allclose(found, expected, atol=2e-5)


@given(sigma=st.floats(0.2, 4.0), seed=seeds)
def test_planes_are_blurred_by_a_gaussian_whose_border_goes_on(module, sigma, seed):
    planes = np.random.default_rng(seed).random((2, HEIGHT, WIDTH), np.float32)
    expected = gaussian_filter(planes, (0, sigma, sigma), mode="nearest", truncate=8.0)
    # What lies beyond three standard deviations is left out.
    np.testing.assert_allclose(module.blur_planes(planes, sigma), expected, atol=3e-3)
    flat = np.full_like(planes, 0.7)
    np.testing.assert_allclose(module.blur_planes(flat, sigma), flat, rtol=1e-6)


@given(
    encoding=st.integers(0, 3),
    blur=st.sampled_from([0.0, 0.4, 2.0]),
    kind=st.sampled_from(["whole", "some unusable", "not finite", "grey"]),
    size=st.tuples(st.integers(1, 20), st.integers(1, 40)),
    seed=seeds,
)
def test_both_encode_alike(encoding, blur, kind, size, seed):
    if not _core.BUILT:
        pytest.skip("the core is not built")
    rng = np.random.default_rng(seed)
    light = rng.uniform(0.0, 1.2, (*size, 4)).astype(np.float32) ** 2
    light[..., 3] = rng.choice([1.0, 0.5], size) if kind != "whole" else 1.0
    finite = rng.choice([1.0, 0.2], size).astype(np.float32) if kind == "not finite" else None
    turn = (np.cos(0.3), -np.sin(0.3), np.sin(0.3), np.cos(0.3))
    arguments = light, finite, kind == "grey", encoding, 1e-3, blur, turn, 0.8
    found, expected = (each.encode(*arguments) for each in (_core, image_reference))
    # Directions of flat places are those of rounding errors.
    np.testing.assert_allclose(found, expected, atol=2e-3 if encoding == 2 else 2e-4)
    np.testing.assert_array_equal(found[..., -1], expected[..., -1])
    assert np.isfinite(found).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_channels_are_equal_unless_one_value_differs(module, dtype, channel, rng):
    grey = rng.integers(0, 200, (HEIGHT, WIDTH, 1)).astype(dtype).repeat(3, axis=2)
    for view in (grey, grey[..., ::-1], grey[::2, ::-3]):
        assert module.has_equal_channels(view)
    grey[6, 9, channel] += 1
    assert not module.has_equal_channels(grey)
    assert not module.has_equal_channels(grey[::2, ::3])
    assert module.has_equal_channels(grey[:6])


def brightness_along(angle: float) -> np.ndarray:
    """Brightness whose logarithm rises along an angle, as far as the floor of logarithms is negligible."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.exp(0.05 * (np.cos(angle) * x + np.sin(angle) * y)).astype(np.float32)


@given(number=st.floats(0.0, 8.0), turn=st.floats(-3.0, 3.0), pixel=st.floats(0.5, 2.0))
def test_a_gradient_counts_for_the_two_nearest_orientations(module, number, turn, pixel):
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    brightness = brightness_along(number * np.pi / 4 - turn)
    counts = module.count_orientations(brightness, None, 0.8, tuple(matrix.ravel().tolist()), pixel)
    away = np.abs((number - np.arange(8) + 4) % 8 - 4)
    length = 0.05 / np.hypot(0.05, SOFTNESS * pixel)
    expected = np.broadcast_to(length * np.maximum(0.0, 1.0 - away), (5, 9, 8))
    np.testing.assert_allclose(counts[4:9, 4:13], expected, atol=4e-3)  # the floor


@given(
    blur=st.sampled_from([0.0, 0.4, 2.0]),
    not_finite=st.booleans(),
    size=st.tuples(st.integers(1, 20), st.integers(1, 40)),
    seed=seeds,
)
def test_both_count_orientations_alike(blur, not_finite, size, seed):
    if not _core.BUILT:
        pytest.skip("the core is not built")
    rng = np.random.default_rng(seed)
    brightness = rng.uniform(0.0, 1.2, size).astype(np.float32) ** 2
    finite = rng.choice([1.0, 0.2], size).astype(np.float32) if not_finite else None
    arguments = brightness, finite, blur, (np.cos(0.3), -np.sin(0.3), np.sin(0.3), np.cos(0.3)), 0.8
    found, expected = (each.count_orientations(*arguments) for each in (_core, image_reference))
    np.testing.assert_allclose(found, expected, atol=2e-5)


@given(
    sigma=st.floats(0.2, 4.0), n=st.integers(0, 9), size=st.tuples(st.integers(2, 20), st.integers(2, 20)), seed=seeds
)
def test_counts_are_blurred_and_interpolated_at_points(module, sigma, n, size, seed):
    rng = np.random.default_rng(seed)
    counts = rng.random((*size, 8)).astype(np.float32)
    points = rng.uniform(-3.0, 23.0, (n, 2))  # some beyond the border
    blurred = np.moveaxis(image_reference.blur_planes(np.moveaxis(counts, 2, 0), sigma), 0, 2)
    inside = np.clip(points, 0.0, [size[1] - 1.0, size[0] - 1.0])
    expected = map_coordinates(
        blurred, [*(inside.T[::-1, :, None] + np.zeros(8)), np.tile(np.arange(8.0), (n, 1))], order=1
    )
    np.testing.assert_allclose(module.blurred_at(counts, points, sigma), expected, atol=2e-6)


@pytest.mark.skipif(not _core.BUILT, reason="the core is not built")
def test_points_that_are_no_numbers_are_taken_for_the_corner():
    counts = np.random.default_rng(1).random((4, 5, 8)).astype(np.float32)
    nowhere = _core.blurred_at(counts, np.array([[np.nan, np.nan], [1e300, -np.inf]]), 0.0)
    np.testing.assert_array_equal(nowhere, counts[[0, 0], [0, 4]])


@given(seed=seeds)
def test_elementary_functions_are_good_to_two_units_in_the_last_place(seed):
    if not _core.BUILT:
        pytest.skip("the core is not built")
    numbers = np.random.default_rng(seed).uniform(-80.0, 80.0, 1000).astype(np.float32)
    positive = np.exp(numbers.astype(np.float64)).astype(np.float32)
    np.testing.assert_allclose(_core.exp(numbers), np.exp(numbers.astype(np.float64)), rtol=2.5e-7)
    np.testing.assert_allclose(_core.log(positive), np.log(positive.astype(np.float64)), rtol=2.5e-7, atol=1e-7)
    linear = np.abs(np.sin(numbers))
    np.testing.assert_allclose(_core.srgb(linear), image_reference.srgb(linear.astype(np.float64)), atol=1e-6)


def test_exponentials_of_anything_are_defined():
    if not _core.BUILT:
        pytest.skip("the core is not built")
    found = _core.exp(np.array([np.nan, np.inf, -np.inf, 1e30, -1e30], np.float32))
    assert np.isfinite(found).all() and found[1] == found[3] > 1e38 and found[2] < 1e-37


@given(n=st.integers(0, 30), depth=st.integers(1, 9), seed=seeds)
def test_channels_are_sampled_bilinearly(module, n, depth, seed):
    rng = np.random.default_rng(seed)
    channels = rng.random((6, 7, depth), np.float32)
    channels[..., -1] = rng.choice([0.0, 1.0], (6, 7))
    points = rng.uniform(-1.0, 7.0, (n, 2))
    points[: n // 4] = rng.choice([np.nan, np.inf, -1e300, 1e300, 2.0], (n // 4, 2))
    values, usable = module.sample_channels(channels, points)
    expected, _, weights = image_reference.sample(channels, points)
    np.testing.assert_allclose(values, expected[:, :-1], atol=1e-6)
    np.testing.assert_array_equal(usable, weights)


def barycentric(pixels: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b, c = corners
    matrix = np.column_stack([b - a, c - a])
    if np.linalg.det(matrix) == 0:
        return np.full((len(pixels), 3), -1.0)
    v, w = np.linalg.solve(matrix, (pixels - a).T)
    return np.column_stack([1.0 - v - w, v, w])


@given(n=st.integers(3, 12), grid=st.booleans(), seed=seeds)
def test_values_of_vertices_are_carried_to_the_first_triangle_of_a_pixel(module, n, grid, seed):
    rng = np.random.default_rng(seed)
    points, values = rng.uniform(0, 18, (n, 2)), rng.normal(size=(n, 2))
    points = np.rint(points) if grid else points  # vertices and edges on pixels, triangles of no area
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    flat = np.pad(points, ((0, 0), (0, 1)))
    owner, carried = module.draw_triangles(flat, triangles, values, 19, 20)
    y, x = np.mgrid[:19, :20].reshape(2, -1)
    pixels = np.column_stack([x, y]).astype(float)
    weights = np.array([barycentric(pixels, points[triangle]) for triangle in triangles])
    inside = (weights >= -1e-9).all(axis=2)
    expected = np.where(inside.any(axis=0), inside.argmax(axis=0), -1)
    np.testing.assert_array_equal(owner.ravel(), expected)
    own = np.einsum("pv,pvc->pc", weights[expected, range(len(pixels))], values[triangles[expected]])
    np.testing.assert_allclose(carried.reshape(-1, 2), np.where(expected[:, None] >= 0, own, 0.0), atol=1e-7)
    cut, inner = module.draw_triangles(flat - (6, 5, 0), triangles, values, 8, 7)  # some vertices are outside
    np.testing.assert_array_equal(cut, owner[5:13, 6:13])
    np.testing.assert_allclose(inner, carried[5:13, 6:13], atol=1e-9)


@given(size=st.tuples(st.integers(1, 40), st.integers(1, 40)), n_channels=st.integers(1, 5), seed=seeds)
def test_products_of_spectra_are_summed(module, size, n_channels, seed):
    left, right = np.random.default_rng(seed).normal(size=(2, n_channels, 2, *size)).astype(np.float32)
    found = np.empty((*size, 2), np.float32)
    module.correlate(left, right, found)
    a, b = (spectra[:, 0] + 1j * spectra[:, 1] for spectra in (left, right))
    np.testing.assert_allclose(found.view(np.complex64)[..., 0], (a * b.conj()).sum(axis=0), atol=1e-4)


def plain_peaks(image, count, least, reach):
    """The definition: pixels above a limit and not below their neighbours, the largest first."""
    found = []
    for y, x in np.argwhere(image > np.float32(least)):
        around = image[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
        if image[y, x] >= around.max():
            found.append((y, x))
    places = np.array(found).reshape(-1, 2)
    values = image[places[:, 0], places[:, 1]] if len(places) else np.zeros(0, np.float32)
    order = np.argsort(-values, kind="stable")[:count]
    return places[order], values[order]


@given(
    size=st.tuples(st.integers(1, 20), st.integers(1, 100)),
    digits=st.integers(0, 2),
    count=st.integers(1, 9),
    reach=st.integers(1, 3),
    seed=seeds,
)
def test_peaks_are_those_of_the_definition(module, size, digits, count, reach, seed):
    image = np.random.default_rng(seed).random(size).round(digits).astype(np.float32)  # some are equal
    arguments = image, count, 0.4, reach
    for found, expected in zip(module.best_peaks(*arguments), plain_peaks(*arguments), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_peaks_of_a_part_are_those_of_its_copy(module, rng):
    image = rng.random((30, 40)).astype(np.float32)
    for part in (image[3:20, 5:31], image[3:20, 5:31:2]):
        for found, expected in zip(
            module.best_peaks(part, 5, 0.1, 2), module.best_peaks(part.copy(), 5, 0.1, 2), strict=True
        ):
            np.testing.assert_array_equal(found, expected)


@given(n=st.integers(3, 12), grid=st.booleans(), seed=seeds)
def test_the_nearest_triangle_is_drawn(module, n, grid, seed):
    rng = np.random.default_rng(seed)
    points, values = rng.uniform(-3, 18, (n, 3)), rng.normal(size=(n, 2))
    points = np.rint(points) if grid else points
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    owner, image = module.draw_triangles(points, triangles, np.column_stack([values, points[:, 2]]), 15, 14)
    y, x = np.mgrid[:15, :14].reshape(2, -1)
    weights = np.array([barycentric(np.column_stack([x, y]).astype(float), points[t, :2]) for t in triangles])
    inside = (weights >= -1e-9).all(axis=2)
    depth = np.where(inside, np.einsum("tpv,tv->tp", weights, points[triangles, 2]), -1e9)
    np.testing.assert_array_equal(owner.ravel() >= 0, inside.any(axis=0))
    nearness = np.where(owner >= 0, image[..., 2], -1e9)
    np.testing.assert_allclose(nearness.ravel(), depth.max(axis=0), atol=1e-7)
    shown = np.einsum("tpv,tvk->tpk", weights, values[triangles])
    nearest = inside & (depth >= depth.max(axis=0) - 1e-7)
    off = np.abs(shown - image[..., :2].reshape(-1, 2)).max(axis=2)
    assert (np.where(nearest, off, np.inf).min(axis=0)[inside.any(axis=0)] < 1e-5).all()
    assert not image[owner < 0].any()


@given(size=st.tuples(st.integers(1, 9), st.integers(1, 9)), depth=st.integers(1, 4), seed=seeds)
def test_recursive_filters_are_alike(size, depth, seed):
    if not _core.BUILT:
        pytest.skip("the core is not built")
    rng, (height, width) = np.random.default_rng(seed), size
    layers = rng.random((height, width, depth), np.float32)
    across, down = rng.random((height, width - 1), np.float32), rng.random((height - 1, width), np.float32)
    found, expected = layers.copy(), layers.copy()
    _core.filter_rows_and_columns(found, across, down)
    image_reference.filter_rows_and_columns(expected, across, down)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@given(height=st.integers(1, 9), width=st.integers(1, 9), reach=st.integers(0, 12), seed=seeds)
def test_the_mean_field_is_that_of_the_reference(height, width, reach, seed):
    rng = np.random.default_rng(seed)
    own = rng.normal(0.0, 4.0, (height, width)).astype(np.float32)
    sampled = rng.integers(0, 2, (height, width)).astype(np.float32)
    taps = np.exp(-np.square(np.arange(reach + 1)) / 8.0).astype(np.float32)
    taps /= 2.0 * taps.sum() - taps[0]
    for rounds in (0, 3):
        found = _core.mean_field(own, sampled, taps, 3.0, rounds)
        expected = image_reference.mean_field(own, sampled, taps, 3.0, rounds)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a, b, atol=2e-5)


@given(length=st.integers(1, 30), n_columns=st.integers(0, 3), seed=seeds)
def test_slopes_are_those_of_clamped_cubic_splines(module, length, n_columns, seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(length).astype(np.int32)
    joined = rng.random(length) < 0.8
    joined[-1] = False
    values = rng.normal(size=(length, n_columns))
    slopes = module.spline_slopes(values, order, joined.astype(np.uint8))
    expected = np.zeros_like(values)
    for run in np.split(order, np.flatnonzero(~joined)[:-1] + 1):
        if len(run) > 1 and n_columns:
            ends = values[run[1]] - values[run[0]], values[run[-1]] - values[run[-2]]
            spline = CubicSpline(np.arange(len(run)), values[run], bc_type=((1, ends[0]), (1, ends[1])))
            expected[run] = spline(np.arange(len(run)), 1)
    np.testing.assert_allclose(slopes, expected, atol=1e-12)


REFUSED = {
    "blocks beyond the image": lambda: _core.stored_means(np.zeros((9, 9, 3), np.uint8), TABLE, 0.0, 0.0, 2.0, 9, 2),
    "blocks of values below the image": lambda: _core.value_means(
        np.zeros((9, 20, 1), np.float32), 0.0, 0.0, 2.0, 9, 2
    ),
    "blocks of values beside it": lambda: _core.value_means(np.zeros((20, 9, 1), np.float32), 0.0, 0.0, 2.0, 2, 9),
    "a start before it": lambda: _core.value_means(np.zeros((9, 9, 1), np.float32), -1.0, 0.0, 1.0, 1, 1),
    "a table that is too short": lambda: _core.stored_means(
        np.zeros((9, 9, 3), np.uint8), TABLE[:, :9].copy(), 0.0, 0.0, 1.0, 1, 1
    ),
    "a vertex that does not exist": lambda: _core.draw_triangles(
        np.zeros((3, 3)), np.array([[0, 1, 3]], np.int32), np.zeros((3, 1)), 4, 4
    ),
    "an image of one row": lambda: _core.sample_channels(np.zeros((1, 5, 2), np.float32), np.zeros((1, 2))),
    "tables that are too short": lambda: _core.stored_brightness(
        np.zeros((9, 9, 3), np.uint8), TABLE[:, :9, 0].copy(), 0.0, 0.0, 1.0, 1, 1
    ),
    "two tables": lambda: _core.stored_brightness(
        np.zeros((9, 9, 3), np.uint8), TABLE[:2, :, 0].copy(), 0.0, 0.0, 1.0, 1, 1
    ),
    "brightness of no pixels": lambda: _core.count_orientations(
        np.zeros((0, 4), np.float32), None, 1.0, (1.0, 0.0, 0.0, 1.0), 1.0
    ),
    "shares of other pixels": lambda: _core.count_orientations(
        np.zeros((3, 4), np.float32), np.ones((4, 3), np.float32), 1.0, (1.0, 0.0, 0.0, 1.0), 1.0
    ),
    "counts of one row": lambda: _core.blurred_at(np.zeros((1, 5, 8), np.float32), np.zeros((1, 2)), 1.0),
    "counts of seven orientations": lambda: _core.blurred_at(np.zeros((5, 5, 7), np.float32), np.zeros((1, 2)), 1.0),
    "a mean field of other pixels": lambda: _core.mean_field(
        np.zeros((3, 4), np.float32), np.zeros((4, 3), np.float32), np.ones(1, np.float32), 3.0, 1
    ),
    "spectra of other sizes": lambda: _core.correlate(
        np.zeros((5, 2, 4, 4), np.float32), np.zeros((5, 2, 4, 5), np.float32), np.zeros((4, 4, 2), np.float32)
    ),
    "feedback of another size": lambda: _core.filter_rows_and_columns(
        np.zeros((3, 3, 1), np.float32), np.zeros((3, 3), np.float32), np.zeros((2, 3), np.float32)
    ),
    "a pixel that does not exist": lambda: _core.spline_slopes(
        np.zeros((2, 1)), np.array([0, 2], np.int32), np.zeros(2, np.uint8)
    ),
    "a negative pixel": lambda: _core.spline_slopes(
        np.zeros((2, 1)), np.array([0, -1], np.int32), np.zeros(2, np.uint8)
    ),
    "an order of other pixels": lambda: _core.spline_slopes(
        np.zeros((3, 1)), np.array([0, 1], np.int32), np.zeros(3, np.uint8)
    ),
    "larger blocks than pixels": lambda: _core.area_means(np.zeros((3, 3), np.float32), 4, 1),
}


@pytest.mark.skipif(not _core.BUILT, reason="the core is not built")
@pytest.mark.parametrize("case", REFUSED)
def test_sizes_that_do_not_match_are_refused(case):
    with pytest.raises(ValueError):
        REFUSED[case]()
