"""Kernels: the fast one does what the reference says; the reference says what bilinear means."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from finite_differences import assert_jacobian
from liaam.errors import MethodError
from liaam.kernels import KERNELS, fast, get_kernel, reference

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
    n_channels=st.integers(1, 6),
    rows=st.integers(1, 3),
    n_p=st.integers(1, 6),
    extra=st.integers(0, 2),
    seed=st.integers(0, 999),
)
def test_fast_does_what_reference_says(points, n_channels, rows, n_p, extra, seed):
    rng = np.random.default_rng(seed)
    n = len(points)
    arguments = (
        channels_of(rng, n_channels),
        np.array(points),
        rng.normal(size=(n, 2, n_p)).astype(np.float32),
        rng.normal(size=(2, 2)),
        rng.normal(size=(rows, n_channels)),
        rng.random((n, rows)).astype(np.float32),
    )
    columns = [np.full((n * rows, n_p + extra), 77.0, np.float32) for _ in range(2)]
    expected = reference.linearise(*arguments, columns[0])
    found = fast.linearise(*arguments, columns[1])
    for ours, theirs in zip((*found[:2], columns[1]), (*expected[:2], columns[0]), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5)
        assert ours.dtype == theirs.dtype == np.float32
    np.testing.assert_array_equal(found[2], expected[2])
    assert (columns[1][:, n_p:] == 77.0).all()


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
    columns = np.empty((60, 2), np.float32)
    eye = np.broadcast_to(np.eye(2, dtype=np.float32), (20, 2, 2)).copy()
    values, projected, weights = get_kernel(name).linearise(
        channels, points, eye, np.eye(2), np.eye(3), np.ones((20, 3), np.float32), columns
    )
    np.testing.assert_array_equal(values, points @ slopes + base)
    np.testing.assert_array_equal(projected, values)
    np.testing.assert_array_equal(columns.reshape(20, 3, 2), np.broadcast_to(slopes.T, (20, 3, 2)))
    assert weights.all()


@pytest.mark.parametrize("name", KERNELS)
def test_gradient_is_the_derivative_of_the_bilinear_samples(name, rng):
    channels = channels_of(rng)
    point = np.array([4.3, 5.6])

    def sample(at):
        columns = np.empty((3, 2), np.float32)
        jacobian = np.eye(2, dtype=np.float32)[None].copy()
        out = get_kernel(name).linearise(
            channels, at[None], jacobian, np.eye(2), np.eye(3), np.ones((1, 3), np.float32), columns
        )
        return out[1][0].astype(float), columns

    channels[..., 3] = 1
    # Bilinear: linear along x and along y, so that even a long step is exact.
    assert_jacobian(lambda at: sample(at)[0], sample(point)[1], point, steps=0.25, tolerance=1e-5)


@pytest.mark.parametrize("name", KERNELS)
def test_one_unusable_corner_costs_a_sample_its_weight(name):
    channels = np.ones((HEIGHT, WIDTH, 4), np.float32)
    channels[4, 5, 3] = 0
    points = np.array([[5.0, 4.0], [4.5, 3.5], [5.5, 4.5], [3.9, 4.0], [6.0, 4.0], [5.0, 5.0], [5.0, 3.0]])
    columns = np.empty((len(points), 1), np.float32)
    jacobian = np.ones((len(points), 2, 1), np.float32)
    root = np.ones((len(points), 1), np.float32)
    weights = get_kernel(name).linearise(channels, points, jacobian, np.eye(2), np.ones((1, 3)), root, columns)[2]
    assert weights.tolist() == [0, 0, 0, 1, 1, 1, 0]
    assert not columns[weights == 0].any()


def test_an_unknown_kernel_lists_those_that_exist():
    with pytest.raises(MethodError, match="kernel 'cuda' does not exist; there are fast, reference"):
        get_kernel("cuda")
