import numpy as np
import pytest

from liaam.model.rounding import LARGEST, decoded, encoded, rounded, steps_of


def modes(rng, scale: float) -> np.ndarray:
    return (scale * rng.normal(size=(5, 40, 3))).astype(np.float32)


@pytest.mark.parametrize("scale", [1e-20, 0.01, 1.0, 1e20])
def test_numbers_move_by_half_a_step_at_most(rng, scale):
    given = modes(rng, scale)
    steps = steps_of(given)
    assert rounded(given).dtype == np.float32
    assert (np.abs(rounded(given) - given) <= 0.5001 * steps[:, None, None]).all()
    np.testing.assert_allclose(steps, np.abs(given).max(axis=(1, 2)) / LARGEST, rtol=1e-4)


@pytest.mark.parametrize("scale", [1e-20, 0.01, 1.0, 1e20])
def test_rounding_again_changes_nothing(rng, scale):
    given = rounded(modes(rng, scale))
    np.testing.assert_array_equal(rounded(given), given)


def test_rounded_modes_are_codes_and_steps(rng):
    given = modes(rng, 0.01)
    assert encoded(given) is None
    codes, steps = encoded(rounded(given))
    assert codes.dtype == np.int8 and np.abs(codes).max() == LARGEST
    np.testing.assert_array_equal(decoded(codes, steps), rounded(given))


def test_modes_of_zeros_and_no_modes_are_kept(rng):
    given = modes(rng, 1.0)
    given[2] = 0.0
    assert not rounded(given)[2].any()
    assert rounded(given[:0]).shape == (0, 40, 3)
