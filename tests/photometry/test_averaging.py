"""Block means are areas: of any size, starting anywhere, cutting through pixels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
    found = averaging.stored_means(image, TABLE, (20, 240), (x, y), size, shape)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert found.dtype == np.float32


@given(blocks=blocks, seed=st.integers(0, 99))
def test_means_of_values_are_those_of_stored_pixels(blocks, seed):
    x, y, size = blocks
    shape = int((HEIGHT - y) / size), int((WIDTH - x) / size)
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    stored = averaging.stored_means(image, TABLE, (0, 255), (x, y), size, shape)
    np.testing.assert_allclose(averaging.value_means(TABLE[image], (x, y), size, shape), stored[..., :3], atol=2e-6)


def test_blocks_of_one_pixel_are_the_picture(rng):
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    found = averaging.stored_means(image, TABLE, (0, 255), (0.0, 0.0), 1.0, (HEIGHT, WIDTH))
    np.testing.assert_array_equal(found[..., :3], TABLE[image])
