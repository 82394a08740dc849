"""The invariant image does not see the light, and says where it sees nothing."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.calibration.chart import chart_patches, theta_from_chart
from liaam.calibration.comparison import agreement, averaged
from liaam.calibration.scatter import theta_from_scene
from liaam.errors import ImageError
from liaam.io import read_image
from liaam.photometry import CameraModel
from liaam.photometry.projection import invariant_image
from scenes import narrow_band_camera, photograph, poster, uneven_light

SIZE = (120, 160)
CAMERA = replace(narrow_band_camera(response="srgb"), bits=8)
KNOWN = CameraModel(theta=CAMERA.theta("wien"))


def pictures(seeds=(1, 2)):
    return [photograph(poster(SIZE, 3), uneven_light(SIZE, seed), CAMERA, seed=seed) for seed in seeds]


def test_light_does_not_move_the_invariant_image():
    a, b = (invariant_image(picture, KNOWN) for picture in pictures())
    both = np.isfinite(a) & np.isfinite(b)
    assert both.mean() > 0.8
    assert np.abs(a - b)[both].mean() < 0.05 * np.nanstd(a)


def test_pixels_that_say_nothing_are_nan():
    picture = pictures()[0]
    picture[:10], picture[10:20, :, 0], picture[20:30] = 0, 255, 120
    values = invariant_image(picture, KNOWN)
    assert values.dtype == np.float32
    assert np.isnan(values[:20]).all() and np.isfinite(values[20:30]).all()


def test_invariant_images_agree_where_grey_ones_do_not():
    (found,) = agreement(averaged(pictures(), KNOWN))
    assert (found.first, found.second) == (0, 1)
    assert found.invariant > 0.99
    assert found.log_grey < found.invariant
    (wrong,) = agreement(averaged(pictures(), CameraModel(theta=np.deg2rad(40.0))))
    assert wrong.invariant < found.invariant


def test_only_pixels_of_the_mask_count():
    a, b = pictures()
    b[:60] = b[::-1][:60]
    mask = np.zeros(SIZE, dtype=bool)
    mask[60:] = True
    (whole,), (half,) = (agreement(averaged([a, b], KNOWN, mask=m)) for m in (None, mask))
    assert half.invariant > 0.99 > whole.invariant
    assert half.share > 0.8


def test_nothing_left_is_said():
    black = np.zeros((40, 40, 3), np.uint8)
    black[..., 0] = 1
    (found,) = agreement(averaged([black, black]))
    assert np.isnan(found.invariant) and found.share == 0


@pytest.mark.parametrize("images", [[], [np.zeros((40, 40, 3), np.uint8)]])
def test_one_picture_agrees_with_nothing(images):
    with pytest.raises(ImageError, match="two or more"):
        averaged(images)


def test_grey_pictures_have_no_invariant():
    grey = np.full((40, 40, 3), 100, np.uint8)
    with pytest.raises(ImageError, match=r"photo.png.*grey"):
        invariant_image(grey, name="photo.png")
    with pytest.raises(ImageError, match="grey"):
        averaged([grey, grey])


def test_a_mask_of_another_size_is_refused():
    with pytest.raises(ImageError, match="mask is 3×3"):
        averaged(pictures(), mask=np.ones((3, 3), dtype=bool))


ILLUMINANTS = ("solux-4100", "solux-4700+3202", "syl-50MR16Q")
LINEAR = CameraModel(response="linear")
CHART_CORNERS = np.array([[120, 118], [517.6, 118], [517.6, 351.4], [120, 351.4]])
"""Centres of the corner patches of the Macbeth chart in ../shared/data/illuminants, pixels."""


def under_each_illuminant(data, name):
    return [read_image(data / "illuminants" / f"{name}_{light}.png") for light in ILLUMINANTS]


def test_the_charts_angle_makes_real_scenes_agree_under_three_illuminants(shared_data):
    chart = theta_from_chart(under_each_illuminant(shared_data, "macbeth"), [chart_patches(CHART_CORNERS)] * 3, LINEAR)
    assert chart.observable
    camera = replace(LINEAR, theta=chart.theta)
    for name in ("blocks1", "apples2"):
        # Values count to 40 of 255 here: two steps of averaged linear light are as dark as eight of sRGB.
        for found in agreement(averaged(under_each_illuminant(shared_data, name), camera, block=4, dark=2 / 255)):
            assert found.invariant >= 0.9, (name, found)
            assert found.invariant > found.log_grey, (name, found)


def test_chart_and_scenes_of_one_camera_tell_one_angle(shared_data):
    lights = [0, 2]  # the third leaves hardly a pixel bright enough
    chart = theta_from_chart(
        [under_each_illuminant(shared_data, "macbeth")[i] for i in lights], [chart_patches(CHART_CORNERS)] * 2, LINEAR
    )
    for name in ("blocks1", "apples2", "ball"):
        scene = theta_from_scene([under_each_illuminant(shared_data, name)[i] for i in lights], LINEAR)
        assert abs(scene.theta - chart.theta) < np.deg2rad(1.5), name


@pytest.mark.parametrize("name", ["cat", "owl", "rock"])
def test_real_objects_agree_under_twelve_directions_of_light(shared_data, name):
    folder = shared_data / "light-directions" / name
    images = [read_image(folder / f"{name}.{i}.png") for i in range(12)]
    mask = read_image(folder / f"{name}.mask.png")[..., 0] > 127
    found = agreement(averaged(images, block=2, mask=mask))
    assert np.median([pair.invariant for pair in found]) >= 0.9
    assert np.median([pair.log_grey for pair in found]) < np.median([pair.invariant for pair in found])
