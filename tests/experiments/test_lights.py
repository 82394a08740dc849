"""Lights laid over pictures: what they leave, what they depend on, and what they are for."""

import numpy as np
import pytest

from experiments.lights import DAPPLE, LIGHTS, SHADOW, cast_shadow, dapples, hard_light, smooth_light
from liaam.photometry import linear_to_srgb, srgb_to_linear

CHANGING = tuple(name for name in LIGHTS if name != "none")
MIDDLE = np.array([80.0, 60.0])


@pytest.fixture
def plain():
    """Give a picture of one colour, and landmarks on a circle in its middle."""
    image = np.full((120, 160, 3), (180, 150, 130), dtype=np.uint8)
    angles = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    return image, MIDDLE + 30 * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def linear(image):
    return srgb_to_linear(image / 255)


@pytest.mark.parametrize("name", LIGHTS)
def test_what_is_drawn_depends_on_the_generator_only(plain, name):
    image, shape = plain
    kept = image.copy()
    first, again, other = (LIGHTS[name](image, shape, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.dtype == np.uint8
    assert first.shape == image.shape
    assert np.array_equal(first, again)
    assert np.array_equal(image, kept)
    assert np.array_equal(first, other) == (name == "none")
    assert np.array_equal(first, image) == (name == "none")


@pytest.mark.parametrize("draw", range(3))
@pytest.mark.parametrize(("light", "left"), [(cast_shadow, SHADOW), (dapples, DAPPLE)])
def test_shadows_leave_their_share_of_each_channel(plain, light, left, draw):
    image, landmarks = plain
    share = linear(light(image, landmarks, np.random.default_rng(draw))) / linear(image)
    assert share.max(axis=(0, 1)) == pytest.approx(1, abs=0.02)
    assert share.min(axis=(0, 1)) == pytest.approx(left, abs=0.02)
    # Nothing but both and the edges between them, so all channels go together.
    mask = (1 - share) / (1 - np.array(left))
    assert np.ptp(mask, axis=2).max() < 0.05


@pytest.mark.parametrize("draw", range(3))
def test_a_cast_shadow_has_a_straight_edge_about_the_middle(plain, draw):
    image, landmarks = plain
    dark = linear(cast_shadow(image, landmarks, np.random.default_rng(draw)))[..., 0] < 0.6 * linear(image)[0, 0, 0]
    edges = np.argwhere(np.diff(dark, axis=0)), np.argwhere(np.diff(dark, axis=1))
    edge = max(edges, key=len)[:, ::-1].astype(float)  # across the axis that it crosses more often
    normal = np.linalg.svd(edge - edge.mean(axis=0))[2][1]
    assert len(edge) > 50
    assert np.abs((edge - edge.mean(axis=0)) @ normal).max() < 1.5
    assert abs((MIDDLE - edge.mean(axis=0)) @ normal) < 0.3 * 60


@pytest.mark.parametrize("draw", range(4))
def test_hard_light_leaves_one_side_to_the_ambient_light(plain, draw):
    image, landmarks = plain
    lit = linear(hard_light(image, landmarks, np.random.default_rng(draw))) / linear(image)
    sides = np.array([lit[60, 55], lit[60, 105]])  # within the head, left and right of its middle
    dark, bright = sides[np.argsort(sides.mean(axis=1))]
    assert bright.mean() > 1.8 * dark.mean()
    assert lit.min() > 0.05


def test_hard_light_comes_from_both_sides_in_colours_of_its_own(plain):
    image, landmarks = plain
    lit = [hard_light(image, landmarks, np.random.default_rng(draw)).astype(float) for draw in range(12)]
    from_left = [picture[60, 55].mean() > picture[60, 105].mean() for picture in lit]
    assert 0 < sum(from_left) < len(from_left)
    # Lamp and ambient light differ in colour, so both sides of the head do.
    assert max(np.ptp(linear(picture[60, 55]) / linear(picture[60, 105])) for picture in lit) > 0.05


@pytest.mark.parametrize("draw", range(3))
def test_smooth_light_has_no_edges_and_changes_each_channel_by_itself(plain, draw):
    image, landmarks = plain
    changed = smooth_light(image, landmarks, np.random.default_rng(draw)).astype(float)
    for axis in (0, 1):
        assert np.abs(np.diff(changed, axis=axis)).max() < 30
    inside = ((changed > 0) & (changed < 255)).all(axis=2)
    ratios = (changed / image)[inside]
    assert not np.allclose(ratios, ratios[:, :1], atol=0.02)


def test_linear_light_is_rounded_once(plain):
    image, landmarks = plain
    shaded = cast_shadow(image, landmarks, np.random.default_rng(0))
    whole = np.rint(255 * linear_to_srgb(linear(image[0, 0]) * np.array(SHADOW)))
    assert (shaded.reshape(-1, 3) == whole).all(axis=1).sum() > 1000
