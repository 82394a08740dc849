"""Lamps and their light on a surface."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.relighting.lamp import DARKEST, DIRECTIONS, Lamp, check_strength, direction_named, light_of, lit

FACING = np.linspace(-1.0, 1.0, 401, dtype=np.float32)
NORMALS = np.stack([np.sqrt(1.0 - FACING**2), 0.0 * FACING, FACING], axis=1)
FRONT = (0.0, 0.0, 1.0)


def test_a_point_lamp_obeys_lamberts_law():
    light = light_of([Lamp((0.0, 0.0, 3.0))], NORMALS, 0.25)
    assert light.shape == (len(FACING), 1)
    np.testing.assert_allclose(light[:, 0], 0.25 + 0.75 * np.maximum(FACING, 0.0), rtol=1e-6)


@pytest.mark.parametrize("softness", [0.2, 1.0])
def test_a_large_lamp_has_the_mean_light_of_many_lamps(softness):
    """The horizons of the many are spread evenly over the softness."""
    shifts = np.linspace(-softness, softness, 2001)
    expected = np.maximum(FACING[:, None] + shifts, 0.0).mean(axis=1)
    np.testing.assert_allclose(lit(FACING, softness), expected, atol=2e-3)


def test_lamps_add_up_in_their_colours_and_strengths():
    red, blue = Lamp(FRONT, (1.0, 0.0, 0.0), 0.5), Lamp((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 2.0)
    light = light_of([red, blue], NORMALS, 0.0)
    expected = np.stack([0.5 * np.maximum(FACING, 0), 0 * FACING, 2.0 * np.maximum(-FACING, 0)], axis=1)
    np.testing.assert_allclose(light, np.maximum(expected, DARKEST), rtol=1e-6)


def test_without_lamps_there_is_ambient_light_only():
    np.testing.assert_array_equal(light_of([], NORMALS, 0.5), 0.5)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"direction": (0.0, 0.0, 0.0)}, "direction 0,0,0"),
        ({"direction": (0.0, np.nan, 1.0)}, "direction 0,nan,1"),
        ({"colour": (1.0, 1.0)}, "colour"),
        ({"colour": (1.0, 1.0, 1.5)}, "colour"),
        ({"strength": -1.0}, "strength -1"),
        ({"strength": np.inf}, "strength inf"),
        ({"softness": np.nan}, "softness nan"),
    ],
)
def test_impossible_lamps_are_refused(changes, fault):
    with pytest.raises(LiaamError, match=fault):
        Lamp(**{"direction": FRONT, **changes})


def test_lamps_have_names():
    for name, direction in DIRECTIONS.items():
        assert direction_named(name) == direction
    assert DIRECTIONS["left"][0] < 0 < DIRECTIONS["right"][0]
    assert DIRECTIONS["above"][1] < 0 < DIRECTIONS["below"][1]
    with pytest.raises(LiaamError, match=r"light 'north': give a direction .* or one of left, right"):
        direction_named("north")


@pytest.mark.parametrize("strength", [-0.1, 1.1, np.nan])
def test_a_strength_out_of_range_is_refused(strength):
    with pytest.raises(LiaamError, match="give a share of the change"):
        check_strength(strength)
