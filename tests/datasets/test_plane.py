"""Flat scenes: the paper's theory holds on them."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.photometry import invariant
from scenes import colour_chart, even_light, narrow_band_camera, photograph, poster, uneven_light


def test_the_chart_has_24_patches_of_one_colour_each():
    reflectance, boxes = colour_chart()
    assert boxes.shape == (24, 4)
    for x0, y0, x1, y1 in boxes:
        assert np.ptp(reflectance[y0:y1, x0:x1], axis=(0, 1)).max() == 0


def test_light_moves_a_line_camera_along_one_direction():
    sheet, camera = poster((60, 80), 2), narrow_band_camera()
    pictures = [photograph(sheet, uneven_light((60, 80), seed), camera, exposure=0.5) for seed in (1, 2)]
    logs = np.log(np.stack(pictures))
    kept = [invariant(log, camera.theta("wien")) for log in logs]
    assert np.abs(logs[0] - logs[1]).max() > 0.5
    np.testing.assert_allclose(kept[0] - kept[0].mean(), kept[1] - kept[1].mean(), atol=1e-4)


def test_the_same_seed_gives_the_same_picture():
    sheet, light = poster((40, 50), 3), even_light((40, 50))
    assert np.array_equal(photograph(sheet, light, seed=1), photograph(sheet, light, seed=1))
    assert not np.array_equal(photograph(sheet, light, seed=1), photograph(sheet, light, seed=2))


def test_a_homography_moves_the_picture():
    sheet = poster((40, 50), 3)
    shift = np.array([[1, 0, 7], [0, 1, 0], [0, 0, 1.0]])
    moved, still = (
        photograph(sheet, even_light((40, 50)), narrow_band_camera(), exposure=0.5, homography=h) for h in (shift, None)
    )
    np.testing.assert_allclose(moved[5:-5, 20:-5], still[5:-5, 13:-12], atol=1e-5)


@pytest.mark.parametrize("wrong", [{"lamp_K": 100.0}, {"sky_K": 1e6}, {"shadow": 1.0}])
def test_light_that_cannot_be_is_refused(wrong):
    with pytest.raises(LiaamError, match=next(iter(wrong))):
        uneven_light((40, 50), **wrong)


def test_a_plane_of_no_size_is_refused():
    with pytest.raises(LiaamError, match="size"):
        poster((4, 50))
