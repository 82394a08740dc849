"""Block means are areas: of any size, starting anywhere, cutting through pixels."""

import numpy as np
from hypothesis import given, strategies as st
from scipy.ndimage import gaussian_filter

from liaam.photometry import averaging

HEIGHT, WIDTH = 13, 17
TABLE = np.linspace(0, 1, 256, dtype=np.float32) ** 2


def overlap(n: int, start: float, size: float, count: int) -> np.ndarray:
    """Share of each of n pixels in each of count blocks, (count, n)."""
    low = start + size * np.arange(count)[:, None]
    pixel = np.arange(n)
    return np.clip(np.minimum(pixel + 1, low + size) - np.maximum(pixel, low), 0, 1) / size


blocks = st.tuples(st.floats(0, 2), st.floats(0, 2), st.floats(1, 5))


@given(blocks=blocks, seed=st.integers(0, 99))
def test_stored_means_are_means_of_areas(blocks, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    rows, columns = overlap(HEIGHT, y, size, shape[0]), overlap(WIDTH, x, size, shape[1])
    usable = ((image >= 20) & (image <= 240)).all(axis=2, keepdims=True)
    expected = np.einsum("ry,cx,yxk->rck", rows, columns, np.concatenate([TABLE[image], usable], axis=2))
    found = averaging.stored_means(image, averaging.light_tables(TABLE, (20, 240)), (x, y), size, shape)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert found.dtype == np.float32


@given(blocks=blocks, seed=st.integers(0, 99))
def test_means_of_values_are_those_of_stored_pixels(blocks, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    stored = averaging.stored_means(image, averaging.light_tables(TABLE, (20, 240)), (x, y), size, shape)
    usable = ((image >= 20) & (image <= 240)).all(axis=2, keepdims=True)
    values = np.concatenate([TABLE[image], usable], axis=2, dtype=np.float32)
    np.testing.assert_allclose(averaging.value_means(values, (x, y), size, shape), stored, atol=2e-6)


def test_blocks_of_one_pixel_are_the_picture(rng):
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    found = averaging.stored_means(image, averaging.light_tables(TABLE, (0, 255)), (0.0, 0.0), 1.0, (HEIGHT, WIDTH))
    np.testing.assert_array_equal(found[..., :3], TABLE[image])


@given(rows=st.integers(1, HEIGHT), columns=st.integers(1, WIDTH), seed=st.integers(0, 99))
def test_area_means_are_means_of_the_blocks_that_tile_a_picture(rows, columns, seed):
    picture = np.random.default_rng(seed).random((HEIGHT, WIDTH), np.float32)
    shares = overlap(HEIGHT, 0.0, HEIGHT / rows, rows), overlap(WIDTH, 0.0, WIDTH / columns, columns)
    found = averaging.area_means(picture, (rows, columns))
    np.testing.assert_allclose(found, shares[0] @ picture @ shares[1].T, atol=2e-6)


@given(turn=st.floats(-3.0, 3.0), softness=st.sampled_from([1e-3, 0.1, 1.0]), seed=st.integers(0, 99))
def test_soft_directions_are_gradients_over_a_root(turn, softness, seed):
    picture = np.random.default_rng(seed).random((HEIGHT, WIDTH), np.float32)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    gradient = np.stack(np.gradient(picture)[::-1], axis=-1) @ matrix.T
    expected = gradient / np.sqrt(np.square(gradient).sum(axis=-1, keepdims=True) + softness**2)
    np.testing.assert_allclose(averaging.soft_directions(picture, matrix, softness), expected, atol=2e-5)


def test_stored_luminance_is_that_of_the_table(rng):
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    weights = np.array([0.2, 0.7, 0.1])
    np.testing.assert_allclose(averaging.stored_luminance(image, TABLE, weights), TABLE[image] @ weights, atol=1e-6)


@given(sigma=st.floats(0.2, 4.0), seed=st.integers(0, 99))
def test_planes_are_blurred_by_a_gaussian_whose_border_goes_on(sigma, seed):
    planes = np.random.default_rng(seed).random((2, HEIGHT, WIDTH), np.float32)
    blurred = averaging.blur_planes(planes, sigma)
    expected = gaussian_filter(planes, (0, sigma, sigma), mode="nearest", truncate=8.0)
    np.testing.assert_allclose(blurred, expected, atol=3e-3)  # what lies beyond three standard deviations is left out
    flat = np.full_like(planes, 0.7)
    np.testing.assert_allclose(averaging.blur_planes(flat, sigma), flat, rtol=1e-6)
