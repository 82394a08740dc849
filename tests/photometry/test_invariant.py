"""The facts of the light-invariant projection on which everything else is built."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from finite_differences import assert_jacobian
from liaam.photometry import (
    CHROMATICITY,
    LUMINANCE,
    THETA_DEFAULT,
    invariant,
    invariant_row,
    invariant_row_derivative,
    temperature_direction,
    wien_theta,
)

angles = st.floats(-10.0, 10.0)
ROUNDING = 16 * np.finfo(float).eps
"""Limit of what is zero but for rounding: a row has numbers up to 1.5, and a sum of three products some eight roundings
of half a unit in the last place each, those of its numbers included. Twice as much, for other libraries."""
k2_nm = 1.438776877e7  # second radiation constant, nm K


@given(theta=angles)
def test_the_row_is_blind_to_intensity(theta):
    assert abs(invariant_row(theta).sum()) < ROUNDING


@given(theta=angles)
def test_the_row_is_blind_to_colour_temperature(theta):
    d = temperature_direction(theta)
    assert abs(invariant_row(theta)[0] @ d) < ROUNDING
    assert abs(d.sum()) < ROUNDING
    assert np.linalg.norm(d) == pytest.approx(1.0)


@given(theta=st.floats(np.pi / 2, 3 * np.pi / 4))
def test_blue_rises_along_the_temperature_direction_of_physical_cameras(theta):
    d = temperature_direction(theta)
    assert d[2] > 0 > d[0]


@given(theta=angles, strength=st.floats(-3, 3), temperature=st.floats(-3, 3), seed=st.integers(0, 99))
def test_the_invariant_does_not_move_with_the_light(theta, strength, temperature, seed):
    log_rgb = np.random.default_rng(seed).uniform(-5, 0, (7, 3))
    moved = log_rgb + strength + temperature * temperature_direction(theta)
    largest = np.abs([log_rgb, moved]).max()
    np.testing.assert_allclose(invariant(moved, theta), invariant(log_rgb, theta), rtol=0, atol=2 * ROUNDING * largest)


def test_the_invariant_does_move_with_the_reflectance(rng):
    theta = rng.uniform(0, np.pi)
    assert invariant(invariant_row(theta)[0], theta) > 0.9


def test_derivative_of_the_row(rng):
    theta = rng.uniform(-np.pi, np.pi, 1)
    assert_jacobian(
        lambda t: invariant_row(t[0])[0], invariant_row_derivative(theta[0]).T, theta, steps=1e-5, tolerance=1e-9
    )


def test_half_a_turn_negates_the_row():
    # The angle 1 + pi is rounded, too.
    np.testing.assert_allclose(invariant_row(1.0 + np.pi), -invariant_row(1.0), rtol=0, atol=ROUNDING)


peaks = st.tuples(st.floats(565, 650), st.floats(500, 560), st.floats(400, 495))


@given(peaks=peaks)
def test_ordinary_cameras_lie_between_90_and_135_degrees(peaks):
    assert 90.0 < np.rad2deg(wien_theta(peaks)) < 135.0


@given(peaks=peaks, cold=st.floats(2000, 4000), hot=st.floats(4500, 12000))
def test_wien_theta_cancels_simulated_wien_radiation(peaks, cold, hot):
    wavelengths = np.array(peaks)
    radiation = [-5 * np.log(wavelengths) - k2_nm / (wavelengths * kelvin) for kelvin in (cold, hot)]
    theta = wien_theta(peaks)
    assert invariant(radiation[0], theta) == pytest.approx(invariant(radiation[1], theta), abs=1e-9)
    shift = radiation[1] - radiation[0]
    chromatic = shift - shift.mean()
    np.testing.assert_allclose(chromatic / np.linalg.norm(chromatic), temperature_direction(theta), atol=1e-9)


def test_wien_theta_of_the_simulated_camera():
    from scenes import narrow_band_camera

    assert wien_theta((610, 540, 450)) == pytest.approx(narrow_band_camera((610, 540, 450)).theta("wien"))


def planckian_locus(kelvin: float) -> np.ndarray:
    """CIE x, y of a black body (Kim et al., US patent 7024034: cubic splines in 1/T and in x)."""
    t = 1e3 / kelvin
    x_of_t = (
        [-0.2661239, -0.2343589, 0.8776956, 0.179910]
        if kelvin <= 4000
        else [-3.0258469, 2.1070379, 0.2226347, 0.240390]
    )
    x = np.polyval(x_of_t, t)
    y_of_x = (
        [-0.9549476, -1.37418593, 2.09137015, -0.16748867]
        if kelvin <= 4000
        else [3.0817580, -5.87338670, 3.75112997, -0.37001483]
    )
    return np.array([x, np.polyval(y_of_x, x)])


def linear_srgb(xy: np.ndarray) -> np.ndarray:
    """Linear sRGB of a chromaticity at Y = 1."""
    x, y = xy
    to_rgb = [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    return np.array(to_rgb) @ [x / y, 1.0, (1 - x - y) / y]


def test_the_default_angle_is_that_of_the_planckian_locus_in_linear_srgb():
    assert planckian_locus(6504) == pytest.approx([0.3135, 0.3237], abs=5e-4)  # known point of the locus
    log_rgb = np.log([linear_srgb(planckian_locus(1e6 / mired)) for mired in np.linspace(125, 1e3 / 3, 50)])
    chromatic = log_rgb - log_rgb.mean(axis=1, keepdims=True)
    d = np.linalg.svd(chromatic - chromatic.mean(axis=0))[2][0]
    d *= np.sign(d[2])
    theta = np.arctan2(d[0] - d[2], d[2] - d[1]) % np.pi  # L(theta) . d = 0
    assert np.rad2deg(theta) == pytest.approx(np.rad2deg(THETA_DEFAULT), abs=1.0)


def test_metrics_of_the_other_methods():
    assert LUMINANCE.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(CHROMATICITY @ CHROMATICITY.T, np.eye(2), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(CHROMATICITY.sum(axis=1), 0, atol=ROUNDING)
