"""Distances from the border of a mask: exact, and the same bits wherever they lie in memory."""

import numpy as np
from scipy.ndimage import distance_transform_edt

from liaam.distance_transform import distance_transform


def blob(shape=(61, 47)) -> np.ndarray:
    y, x = np.indices(shape)
    return np.sin(0.3 * x) + np.cos(0.2 * y) > 0.1


def test_distances_are_those_to_the_nearest_pixel_outside():
    np.testing.assert_allclose(distance_transform(blob()), distance_transform_edt(blob()), rtol=1e-6)


def test_bits_do_not_depend_on_where_the_result_lies(rng):
    first = distance_transform(blob())
    held = []  # so that later results lie elsewhere
    for n_bytes in rng.integers(1, 9999, 40):
        held.append((np.empty(n_bytes, np.uint8), distance_transform(blob())))
    assert all(np.array_equal(first, other) for _, other in held)
