"""Calibrations that need the engine: angles pooled over fits, pictures aligned whatever the light."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from liaam.calibration import align_pictures, theta_from_fits, theta_from_scene
from liaam.errors import CameraError
from liaam.fitting import FitStatus, get_method
from liaam.photometry import CameraModel
from scenes import narrow_band_camera, photograph, poster, uneven_light

SIZE = (120, 160)


def fits(angles_deg, status=FitStatus.CONVERGED, method="li-pcs"):
    return [SimpleNamespace(theta=np.deg2rad(a), status=status, method=get_method(method)) for a in angles_deg]


def test_angles_of_fits_are_pooled_and_a_lost_fit_does_no_harm():
    angles = 121.0 + 0.5 * norm.ppf((np.arange(30) + 0.5) / 30)
    found = theta_from_fits(fits([*angles, 95.0, 150.0]))
    assert found.observable and found.physical and found.n == 32
    assert np.rad2deg(found.theta) == pytest.approx(121.0, abs=0.3)
    assert np.rad2deg(found.standard_error) == pytest.approx(0.5 / np.sqrt(30), rel=0.5)


def test_the_error_of_pooled_angles_is_that_of_the_errors(rng):
    truth, z = np.deg2rad(120.0), []
    for _ in range(200):
        found = theta_from_fits(fits(120.0 + rng.normal(0, 1.0, 12)))
        z.append((found.theta - truth) / found.standard_error)
        assert found.interval[0] < found.theta < found.interval[1]
    assert 0.85 < np.std(z) < 1.35


def test_fits_that_disagree_tell_no_angle(rng):
    found = theta_from_fits(fits(rng.uniform(0, 180, 8)))
    assert not found.observable and "standard error is too large; fit more images" in found.message


def test_equal_angles_are_no_proof_of_precision():
    assert theta_from_fits(fits([121, 121, 121, 124, 118])).standard_error > np.deg2rad(0.1)


def test_an_angle_is_an_axis():
    found = theta_from_fits(fits([121, 301, 120.5, 300.5, 121.5, 121.2]))
    assert np.rad2deg(found.theta) == pytest.approx(121, abs=0.3)


def test_fits_that_saw_no_change_of_light_do_not_count():
    found = theta_from_fits(fits([121] * 4) + fits([122] * 6, FitStatus.LIGHT_UNOBSERVABLE))
    assert not found.observable
    assert "4 of 10 fits give an angle (6 of the others see no change of light), and at least 5 must" in found.message


def test_methods_without_a_free_angle_are_refused():
    with pytest.raises(CameraError, match="li-pcs"):
        theta_from_fits(fits([121] * 6, method="li"))


MOVED = np.array([[1, 0.01, 2.4], [-0.01, 1, -1.7], [0, 0, 1.0]])


def pictures():
    camera, sheet = narrow_band_camera(response="srgb"), poster(SIZE, 3)
    lights = [uneven_light(SIZE, seed, lamp_K=kelvin) for seed, kelvin in ((1, 3600), (2, 5500))]
    return [photograph(sheet, light, camera, homography=h) for light, h in zip(lights, (None, MOVED), strict=True)]


def test_pictures_are_aligned_whatever_the_light():
    moved = pictures()
    aligned = align_pictures(moved)
    assert aligned.moved[0] == 0 and aligned.moved[1] > 1
    assert aligned.masks[1].mean() > 0.9
    truth = narrow_band_camera().theta("wien")
    found = theta_from_scene(aligned.pictures, masks=aligned.masks)
    assert abs(found.theta - truth) < np.deg2rad(1.0)
    (_, back) = aligned.homographies
    np.testing.assert_allclose(back @ MOVED / (back @ MOVED)[2, 2], np.eye(3), atol=0.3)


def test_pictures_that_are_aligned_stay_as_they_are():
    first = pictures()[0]
    aligned = align_pictures([first, first.copy()])
    assert aligned.pictures[1] is not first
    np.testing.assert_array_equal(aligned.pictures[1], first)
    assert aligned.moved[1] < 0.05


def test_pictures_of_different_things_are_not_aligned(rng):
    first = pictures()[0]
    other = rng.uniform(0.1, 0.9, first.shape).astype(np.float32)
    with pytest.raises(CameraError, match=r"noise\.png could not be aligned with poster\.png"):
        align_pictures([first, other], CameraModel(), names=["poster.png", "noise.png"])
