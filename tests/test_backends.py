"""The reference kernel on every array library: batches give what single images give, and libraries agree."""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from liaam.errors import MethodError
from liaam.kernels import backends, fast, reference
from liaam.kernels.backends import BACKENDS, get_backend
from test_kernels import HEIGHT, WIDTH, channels_of, coordinates

LIBRARIES = (*BACKENDS, "array_api_strict")
numbers = coordinates.filter(lambda value: value == 0 or not abs(value) < 1e-300)
"""JAX takes denormal numbers for 0."""


@pytest.fixture(scope="module", params=LIBRARIES)
def library(request):
    """Give a function that puts an array into a library, one that fetches it, a context, and one that compiles."""
    if request.param == "array_api_strict":
        strict = pytest.importorskip("array_api_strict", reason="array-api-strict checks what other libraries may lack")
        return strict.asarray, np.asarray, nullcontext, lambda function: function
    pytest.importorskip(request.param, reason=f"{BACKENDS[request.param]} is an extra")
    backend = get_backend(request.param, "cpu")
    return backend.put, backend.fetch, backend.working, backend.compiled


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    points=st.lists(st.tuples(numbers, numbers), min_size=6, max_size=6),
    sizes=st.sampled_from([(1, 1, 1), (2, 3, 1), (3, 6, 3)]),  # few, since JAX compiles for each
    own=st.booleans(),
    dtype=st.sampled_from([np.float64, np.float32]),
    seed=st.integers(0, 999),
)
def test_a_batch_gives_what_its_images_give_one_by_one(library, points, sizes, own, dtype, seed):
    rng = np.random.default_rng(seed)
    batch, n_channels, rows = sizes
    channels = np.stack([channels_of(rng, n_channels) for _ in range(batch)])
    with np.errstate(over="ignore"):
        at = (np.array(points) + 0.25 * np.arange(batch)[:, None, None]).astype(dtype)
    count = batch if own else 1
    turn = rng.normal(size=(count, 2, 2)).astype(np.float32)
    metric = rng.normal(size=(count, rows, n_channels)).astype(np.float32)
    put, fetch, working, compiled = library
    with working(), np.errstate(invalid="ignore"):
        arguments = (put(array) for array in (channels, at, turn, metric))
        found = [fetch(array) for array in compiled(reference.steepest_batch)(*arguments)]
    for i in range(batch):
        j = i if own else 0
        expected = reference.steepest(channels[i], at[i], turn[j], metric[j])
        for ours, theirs in zip(found, expected, strict=True):
            assert ours.dtype == np.float32
            np.testing.assert_allclose(ours[i], theirs, rtol=1e-4, atol=1e-4)
        np.testing.assert_array_equal(found[3][i], expected[3])


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(points=st.lists(st.tuples(numbers, numbers), min_size=8, max_size=8), seed=st.integers(0, 99))
def test_padding_a_smaller_image_changes_nothing(library, points, seed):
    rng = np.random.default_rng(seed)
    channels, at = channels_of(rng), np.array(points)
    padded = np.zeros((1, HEIGHT + 3, WIDTH + 5, 4), np.float32)
    padded[0, :HEIGHT, :WIDTH] = channels
    put, fetch, working, compiled = library
    with working(), np.errstate(invalid="ignore"):
        found = compiled(reference.sample_batch)(put(padded), put(at[None]), put(np.array([[WIDTH, HEIGHT]])))
        found = [fetch(array) for array in found]
        expected = reference.sample_batch(channels[None], at[None])
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_batch_is_pulled_and_weighed_as_its_images_one_by_one(library, rng, dtype):
    put, fetch, working, _ = library
    slopes, inverse = rng.normal(size=(2, 9, 2, 3)).astype(np.float32), rng.normal(size=(2, 4, 2, 2)).astype(dtype)
    owners = rng.integers(0, 4, 9)
    values = rng.uniform(-0.7, 0.7, (2, 9, 6)).astype(np.float32)
    values[..., 2:5] = 5.0 * values[..., 2:5] - 3.0
    values[:, ::2, 5] = 1.0
    relative, left = rng.uniform(0.01, 0.5, (2, 40)).astype(dtype), rng.uniform(0.1, 0.4, (2, 2)).astype(dtype)
    known = (-6.0, 0.2), 0.1, 0.004, np.array([0.2, 0.7, 0.1]), 1e5, 0.5
    residual, squared = rng.normal(size=(2, 9, 3)).astype(np.float32), np.square(rng.normal(size=(3, 6)))
    usable = rng.random((2, 9)) > 0.3
    with working():
        pulled = fetch(reference.pull_batch(put(slopes), put(inverse), put(owners)))
        noise = fetch(reference.soft_noise_batch(put(values), put(relative), known[0], put(left), *known[1:]))
        by_noise = (noise @ squared.T).astype(np.float32)
        beyond = fetch(reference.beyond_noise_batch(put(residual), put(by_noise), put(usable), 0.5 * known[-2]))
    for i in range(2):
        np.testing.assert_allclose(pulled[i], fast.pull(slopes[i], inverse[i], owners), rtol=1e-4, atol=1e-5)
        seen = values[i], residual[i], usable[i].astype(np.float32), squared
        expected = fast.soft_variances(*seen, relative[i], known[0], tuple(left[i]), *known[1:], True)
        np.testing.assert_allclose(noise[i], expected[0], rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(beyond[i], expected[2], rtol=1e-3, atol=1e-5)
    assert pulled.dtype == noise.dtype == np.float32


def test_an_unknown_backend_lists_those_that_exist():
    with pytest.raises(MethodError, match="backend 'cupy' does not exist; there are numpy, torch, jax"):
        get_backend("cupy")


def test_a_library_that_is_not_installed_is_named_with_its_extra(monkeypatch):
    monkeypatch.setattr(backends, "find_spec", lambda name: None)
    with pytest.raises(
        MethodError, match=r"backend 'torch': PyTorch is not installed; say 'pip install \"liaam\[torch\]"
    ):
        get_backend("torch")


@pytest.mark.parametrize(
    ("name", "device"),
    [("numpy", "cuda"), ("torch", "cuda:99"), ("torch", "nonsense"), ("jax", "tpu"), ("jax", "cpu:99")],
)
def test_a_device_that_is_not_there_is_named(name, device):
    pytest.importorskip(name, reason=f"{BACKENDS[name]} is an extra")
    with pytest.raises(MethodError, match=f"device '{device}': {BACKENDS[name]} cannot use it .*say 'cpu'"):
        get_backend(name, device)
