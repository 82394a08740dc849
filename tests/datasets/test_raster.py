"""Triangles are drawn as a loop over triangles and pixels draws them, and shadows follow from comparisons of depth."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from scenes.raster import depth_map, draw, splat_map, transform, visibility

HEIGHT, WIDTH = 15, 14


def weights_of(corners: np.ndarray) -> np.ndarray | None:
    """Barycentric weights (h, w, 3) of all pixels in a triangle (3, 3), or None for triangles without area."""
    system = np.array([corners[:, 0], corners[:, 1], np.ones(3)])
    if abs(np.linalg.det(system)) < 1e-9:
        return None
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.linalg.solve(system, np.stack([x, y, np.ones_like(x)]).reshape(3, -1)).T.reshape(HEIGHT, WIDTH, 3)


def plain_draw(points, triangles, attributes):
    """Nearness (m, h, w) of every triangle at every pixel, -inf where it is not, and its attributes there."""
    nearness = np.full((len(triangles), HEIGHT, WIDTH), -np.inf)
    values = np.zeros((*nearness.shape, attributes.shape[1]))
    for t, corners in enumerate(triangles):
        weights = weights_of(points[corners])
        if weights is not None:
            inside = weights.min(axis=-1) > -1e-9
            nearness[t][inside] = weights[inside] @ points[corners, 2]
            values[t][inside] = weights[inside] @ attributes[corners]
    return nearness, values


@given(n=st.integers(3, 12), grid=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_triangles_are_drawn_as_by_a_loop(n, grid, seed):
    rng = np.random.default_rng(seed)
    points, attributes = rng.uniform(-3, 18, (n, 3)), rng.normal(size=(n, 2))
    points[:, :2] = np.rint(points[:, :2]) if grid else points[:, :2]  # sides go through pixels, and some are level
    triangles = np.array([rng.permutation(n)[:3] for _ in range(2 * n)], dtype=np.int32)
    image, mask = draw(points, triangles, attributes, HEIGHT, WIDTH)
    nearness, values = plain_draw(points, triangles, attributes)
    nearest = nearness.argmax(axis=0)[None]
    np.testing.assert_array_equal(mask, nearness.max(axis=0) > -np.inf)
    second, first = np.sort(np.maximum(nearness, -1e9), axis=0)[-2:]
    clear = first - second > 1e-6  # where two triangles meet, rounding decides
    expected = np.take_along_axis(values, nearest[..., None], axis=0)[0]
    np.testing.assert_allclose(image[clear], expected[clear], atol=1e-5)
    assert not image[~mask].any()
    square = depth_map(points, triangles, HEIGHT)[:, :WIDTH]
    np.testing.assert_allclose(square, first, atol=1e-5)


def test_of_equally_near_triangles_the_first_is_drawn():
    points = np.array([[0, 0, 1], [8, 0, 1], [0, 8, 1]] * 2, float)
    triangles = np.array([[3, 4, 5], [0, 1, 2]], np.int32)
    image, mask = draw(points, triangles, np.repeat([[1.0], [2.0]], 3, axis=0), HEIGHT, WIDTH)
    assert (image[mask] == 2).all()
    assert mask.sum() == 45  # the sides included


@pytest.mark.parametrize(
    "points",
    [
        [[20, 0, 1], [30, 0, 1], [20, 10, 1]],
        [[0, -9, 1], [9, -9, 1], [0, -1, 1]],
        [[1, 1, 1], [5, 5, 1], [9, 9, 1]],
        [[1.2, 1.2, 1], [1.8, 1.2, 1], [1.2, 1.8, 1]],
    ],
    ids=["right of the image", "above it", "no area", "between pixels"],
)
def test_triangles_without_pixels_draw_nothing(points):
    image, mask = draw(np.array(points, float), np.array([[0, 1, 2]]), np.ones((3, 1)), HEIGHT, WIDTH)
    assert not mask.any() and not image.any()


def test_no_pixel_between_triangles_is_missed(rng):
    column, row = np.meshgrid(np.linspace(-1, WIDTH, 9), np.linspace(-1, HEIGHT, 9))
    points = np.stack([column, row, rng.normal(size=column.shape)], axis=-1)
    points[1:-1, 1:-1, :2] += rng.uniform(-0.5, 0.5, (7, 7, 2))
    index = np.arange(81).reshape(9, 9)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])
    assert draw(points.reshape(-1, 3), triangles, np.ones((81, 1)), HEIGHT, WIDTH)[1].all()


def test_points_are_mapped_as_by_a_product(rng):
    points, frame = rng.normal(size=(9, 3)), rng.normal(size=(3, 4))
    # Sums of four numbers, in another order: three roundings of products and three of sums, on either side.
    rounding = 12 * np.finfo(float).eps * (np.abs(points) @ np.abs(frame[:, :3]).T + np.abs(frame[:, 3])).max()
    expected = points @ frame[:, :3].T + frame[:, 3]
    np.testing.assert_allclose(transform(points, frame), expected, rtol=0, atol=rounding)


def test_light_is_interpolated_between_four_comparisons():
    depth = np.zeros((3, 3), np.float32)
    depth[0, 1] = 5  # hides what is behind it
    points = np.array([[0.25, 0.5, 1], [0.25, 0.5, 6], [1.5, 1.5, 1], [-0.1, 1, 1], [2, 1, -9]])
    np.testing.assert_allclose(visibility(points.T, depth, 0.0), [1 - 0.25 * 0.5, 1, 1, 1, 1])


def test_points_are_drawn_as_single_pixels():
    points = np.array([[0.4, 1.6, 2], [0.4, 1.6, 3], [0.6, 0, 1], [5, 0, 9], [0, -0.6, 9]])
    depth = splat_map(points.T, 3)
    assert (depth[2, 0], depth[0, 1]) == (3, 1)
    assert (depth > -1e9).sum() == 2
