"""The angle from surfaces under several lights: right, with an honest error, on scenes with known sensors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from liaam.calibration.chart import chart_patches, patch_labels, theta_from_chart
from liaam.calibration.scatter import Surfaces, block_labels, theta_from_scene, theta_of_least_scatter
from liaam.errors import CameraError, ImageError
from liaam.photometry import CameraModel, NoiseModel, invariant_row, temperature_direction
from scenes import colour_chart, even_light, narrow_band_camera, photograph, poster, uneven_light

CAMERA = replace(narrow_band_camera(response="srgb"), bits=8)
TRUTH = CAMERA.theta("wien")
SIZE = (120, 160)
LAMPS_K = (3600.0, 5500.0, 3000.0, 4500.0)


def noisy(image, sigma, rng):
    return np.clip(np.rint(image + rng.normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)


def scene(seed, sigma, lights=2, camera=CAMERA):
    rng, sheet = np.random.default_rng([seed, 1]), poster(SIZE, seed)
    lit = [uneven_light(SIZE, 7 * seed + i, lamp_K=LAMPS_K[i]) for i in range(lights)]
    return [noisy(photograph(sheet, light, camera, seed=seed), sigma, rng) for light in lit]


def chart(seed, sigma):
    rng = np.random.default_rng([seed, 2])
    reflectance, boxes = colour_chart()
    kelvins = rng.uniform(2800, 4200), rng.uniform(5500, 8000)
    lit = [even_light(reflectance.shape[:2], kelvin) for kelvin in kelvins]
    pictures = [noisy(photograph(reflectance, light, CAMERA, seed=seed), sigma, rng) for light in lit]
    return pictures, [boxes + np.array([3, 3, -3, -3])] * 2


def estimate(kind, seed, sigma):
    if kind == "chart":
        return theta_from_chart(*chart(seed, sigma))
    return theta_from_scene(scene(seed, sigma, {"pair": 2, "scene": 4}[kind]))


@pytest.mark.parametrize("kind", ["pair", "scene", "chart"])
@pytest.mark.parametrize(("sigma", "limit"), [(2.0, 0.5), (8.0, 1.5)])
def test_the_angle_is_found_through_noise_and_its_interval_holds_it(kind, sigma, limit):
    found = [estimate(kind, seed, sigma) for seed in range(20 if kind == "chart" else 3)]
    errors = np.rad2deg([abs(e.theta - TRUTH) for e in found])
    assert errors.max() < limit
    assert all(e.observable and e.physical for e in found)
    # 95 % in the long run; of a few, a fifth may be out by chance.
    assert np.mean([e.interval[0] <= TRUTH <= e.interval[1] for e in found]) >= 0.8
    assert all(e.light_change > 0.3 for e in found)


@pytest.mark.slow
def test_the_standard_error_is_that_of_the_errors():
    found = [estimate("pair", seed, 8.0) for seed in range(25)]
    errors = np.array([e.theta - TRUTH for e in found])
    claimed = np.array([e.standard_error for e in found])
    # On the wide side: it makes allowance for how few regions and colours it rests on.
    assert 0.4 < np.sqrt(np.mean(np.square(errors / claimed))) < 1.2


def test_another_exposure_is_no_change_of_light():
    sheet, light = poster(SIZE, 1), uneven_light(SIZE, 1)
    rng = np.random.default_rng(3)
    pictures = [noisy(photograph(sheet, light, CAMERA, exposure=e), 2.0, rng) for e in (0.4, 0.6)]
    found = theta_from_scene(pictures)
    assert not found.observable
    assert found.standard_error == np.inf
    assert found.interval == (0.0, np.pi)
    assert "hardly differ" in found.message


def test_a_white_balance_that_differs_is_seen_through_when_allowed():
    pictures = scene(2, 0.5, camera=replace(CAMERA, response=2.2))
    tinted = [pictures[0], np.rint(pictures[1] * np.array([0.8, 1.0, 0.9]) ** (1 / 2.2)).astype(np.uint8)]
    strict, free = (theta_from_scene(tinted, CameraModel(response=2.2), free_balance=f) for f in (False, True))
    assert abs(strict.theta - TRUTH) > np.deg2rad(3.0)
    assert abs(free.theta - TRUTH) < np.deg2rad(0.5)


@pytest.mark.parametrize("seed", range(3))
def test_even_light_tells_nothing_once_white_balance_is_free(seed):
    found = theta_from_chart(*chart(seed, 2.0), free_balance=True)
    assert not found.observable
    assert "place to place" in found.message


def test_few_colours_tell_too_little_and_it_is_said():
    sheet = np.full((*SIZE, 3), 0.4)
    sheet[:, 80:] = (0.5, 0.3, 0.2)
    rng = np.random.default_rng(1)
    exact = replace(CAMERA, bits=None)  # rounding to 8 bits before the noise would be alike all over a surface
    pictures = [noisy(255 * photograph(sheet, even_light(SIZE, k), exact), 2.0, rng) for k in (3000, 7000)]
    found = theta_from_scene(pictures)
    assert not found.observable or found.interval[0] <= TRUTH <= found.interval[1]


def test_masks_of_another_size_are_refused():
    with pytest.raises(CameraError, match="masks"):
        theta_from_scene(scene(1, 1.0), masks=[np.ones((3, 3), bool)])


def test_a_tenth_of_the_picture_that_moved_does_no_harm():
    pictures = scene(4, 1.0)
    pictures[1][:40, :50] = pictures[1][60:100, 90:140]
    assert abs(theta_from_scene(pictures).theta - TRUTH) < np.deg2rad(0.5)


def test_masks_leave_pixels_out():
    pictures = scene(4, 1.0)
    pictures[1][:, :80] = pictures[1][:, 80:]
    mask = np.zeros(SIZE, dtype=bool)
    mask[:, 80:] = True
    assert abs(theta_from_scene(pictures, masks=[mask, mask]).theta - TRUTH) < np.deg2rad(0.5)


def test_vignetting_and_a_noise_model_are_taken_from_the_camera():
    camera = replace(CAMERA, vignetting=0.6, response="linear", read_noise=0.004, shot_noise=0.0004)
    known = CameraModel(response="linear", vignetting=(-0.6,), noise=NoiseModel(0.0004, 0.004**2))
    assert abs(theta_from_scene(scene(5, 0.0, camera=camera), known).theta - TRUTH) < np.deg2rad(0.5)


@settings(max_examples=30, deadline=None)
@given(theta=st.floats(np.deg2rad(92), np.deg2rad(133)), seed=st.integers(0, 999))
def test_any_angle_is_found_where_surfaces_obey_it(theta, seed):
    rng = np.random.default_rng(seed)
    n = 60
    surfaces = rng.normal(-1.5, 0.6, (n, 1, 3))
    brightness, temperature = rng.normal(0, 0.5, (n, 3, 1)), rng.normal(0, 0.4, (n, 3, 1))
    log_rgb = surfaces + brightness + temperature * temperature_direction(theta)
    assert np.ptp(log_rgb @ invariant_row(theta)[0], axis=1).max() < 1e-9
    seen = np.ones((n, 3), dtype=bool)
    found = theta_of_least_scatter(Surfaces(log_rgb, np.full((n, 3, 3), 1e-6), seen, np.arange(n)))
    assert found.theta == pytest.approx(theta, abs=np.deg2rad(0.01))


def test_patches_of_a_chart_are_found_from_its_corners():
    _, boxes = colour_chart(patch=30, gap=6)
    centres = (boxes[:, :2] + boxes[:, 2:] - 1) / 2.0
    quads = chart_patches(centres[[0, 5, 23, 18]])
    np.testing.assert_allclose(quads.mean(axis=1), centres, atol=1e-3)
    sides = quads[:, 1] - quads[:, 0]
    np.testing.assert_allclose(sides, np.tile([18.0, 0.0], (24, 1)), atol=1e-3)
    labels = patch_labels(quads, (150, 222))
    for i, (x0, y0, x1, y1) in enumerate(boxes):
        y, x = np.nonzero(labels == i)
        assert x.min() >= x0 and x.max() < x1 and y.min() >= y0 and y.max() < y1


@pytest.mark.parametrize(
    ("pictures", "fault"),
    [
        ([np.full((40, 40, 3), 100, np.uint8)], "two or more"),
        ([np.full((40, 40, 3), 100, np.uint8)] * 2, "grey"),
        ([np.zeros((40, 40, 3), np.uint8) + np.arange(3, dtype=np.uint8)] * 2, "well exposed"),
        ([np.full((40, 40, 3), 252, np.uint8) + np.arange(3, dtype=np.uint8)] * 2, "well exposed"),
        ([np.full((40, 40, 3), np.nan, np.float32)] * 2, "well exposed"),
    ],
)
def test_pictures_that_tell_nothing_are_refused(pictures, fault):
    with pytest.raises(CameraError, match=fault):
        theta_from_scene(pictures)


def test_pictures_of_different_size_are_refused():
    a, b = scene(1, 1.0)
    with pytest.raises(CameraError, match="160×120, 160×100"):
        theta_from_scene([a, b[:100]])
    with pytest.raises(ImageError, match="too small"):
        theta_from_scene([a[:4], b[:4]])


@pytest.mark.parametrize(
    ("patches", "fault"),
    [
        ([np.array([[0, 0, 9, 9.0]])], "as many lists"),
        ([np.array([[0, 0, 9, 9.0]]), np.array([[0, 0, 9, 9.0], [9, 9, 20, 20]])], "as many lists"),
        ([np.array([[150, 0, 170, 9.0]])] * 2, "outside"),
        ([np.array([[5, 5, 6, 6.0]])] * 2, "4 or more"),
        ([np.array([[5, 5, 6.0]])] * 2, "boxes"),
    ],
)
def test_patches_that_do_not_fit_are_refused(patches, fault):
    with pytest.raises(CameraError, match=fault):
        theta_from_chart(scene(1, 1.0), patches)


@pytest.mark.parametrize(
    "corners", [[[0, 0], [9, 0], [0, 9], [9, 9]], [[0, 0], [9, 0]], [[0, 0], [9, 0], [9, 9], [0, np.nan]]]
)
def test_corners_that_make_no_chart_are_refused(corners):
    with pytest.raises(CameraError, match="corner patches"):
        chart_patches(np.array(corners))


def test_blocks_cover_the_picture_row_by_row():
    labels, grid = block_labels(7, 9, 2)
    assert grid == (4, 5)
    assert labels[0].tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4]
    assert labels[:, 0].tolist() == [0, 0, 5, 5, 10, 10, 15]
    for block in (0, 3):
        with pytest.raises(CameraError, match=f"blocks of {block} pixels: give 1 to 2"):
            block_labels(7, 9, block)
