"""The arrays of a fit, whose annotations declare their shapes."""

from liaam.fitting.level import BLOCK, ROTATIONS, Work, work_shapes
from liaam.kernels.fields import layout

SIZES = {"n": 7, "n_noise": 0, "n_turned": 0, "n_known": 7, "n_expected": 7, "k": 3, "v": 5}
SIZES |= {"n_p": 6, "n_free": 1, "n_q": 7, "m": 9, "w_p": 8, "w_m": 16}


def test_shapes_are_sums_of_products():
    shapes = work_shapes(SIZES)
    assert shapes["before"] == ("float64", (6 + 2 + 9,))
    assert shapes["fours"] == ("float32", (4 * 7 * 3 + 8,))
    assert shapes["squares"] == ("float64", (2 * 5, 8 + 8))
    assert shapes["block"] == ("float32", (9, BLOCK))
    assert shapes["rotations"] == ("float64", (ROTATIONS * 7 * 7, 3))
    assert shapes["own_derivative"] == ("float32", (0,))


def test_shapes_have_as_many_axes_as_their_arrays():
    shapes = work_shapes(SIZES)
    assert set(Work._fields) - set(shapes) == {"rows", "lines", "slopes", "costs", "path", "turns"}
    for name, (dtype, shape) in shapes.items():
        kind, _ = layout(Work)[name]
        assert (kind.dtype, kind.ndim) == (dtype, len(shape))
