"""Least entropy: the curves, the angle of one picture with shadows, and the verdict on it."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from liaam.calibration.entropy import MOST_PIXELS, entropy_curve, theta_from_image
from liaam.errors import CameraError, LiaamError
from liaam.io import read_image
from liaam.photometry import CHROMATICITY, from_linear, invariant_row, temperature_direction
from scenes import (
    Camera,
    Head,
    even_light,
    lateral,
    narrow_band_camera,
    photograph,
    poster,
    render,
    uneven_light,
)

SIZE = (240, 320)
KINDS = ("quadratic", "shannon")


def degrees_apart(theta, other):
    return abs((np.rad2deg(theta - other) + 90) % 180 - 90)


def lines(theta, seed, n=4000, surfaces=6, noise=0.005):
    """Surfaces whose light differs along d(theta): parallel lines in log-chromaticity, (n, 3)."""
    rng = np.random.default_rng(seed)
    colours = rng.normal(0, 0.6, (surfaces, 3))
    light = rng.uniform(-0.5, 0.5, n)[:, None] * temperature_direction(theta)
    return colours[rng.integers(0, surfaces, n)] + light + rng.uniform(-1, 1, n)[:, None] + rng.normal(0, noise, (n, 3))


@settings(max_examples=20)
@given(theta=st.floats(0, np.pi, exclude_max=True), seed=st.integers(0, 99), kind=st.sampled_from(KINDS))
def test_entropy_is_least_where_each_surface_falls_on_one_value(theta, seed, kind):
    thetas, entropies = entropy_curve(lines(theta, seed), kind)
    assert degrees_apart(thetas[entropies.argmin()], theta) <= 2.0


@settings(max_examples=10)
@given(seed=st.integers(0, 99), gains=st.tuples(*[st.floats(-2, 2)] * 3), kind=st.sampled_from(KINDS))
def test_white_balance_and_intensity_do_not_change_the_curve(seed, gains, kind):
    log_rgb = lines(2.0, seed)
    brighter = log_rgb + np.array(gains) + np.random.default_rng(seed).normal(0, 1, (len(log_rgb), 1))
    before, after = (entropy_curve(pixels, kind)[1] for pixels in (log_rgb, brighter))
    np.testing.assert_allclose(after, before, atol=0.02)  # cells are counted in float32


@pytest.mark.parametrize("kind", KINDS)
def test_the_curve_of_colours_without_direction_is_flat(rng, kind):
    # Were the projection onto L(theta) itself, whose length varies, it would rise and fall by 0.8 bits.
    _, entropies = entropy_curve(rng.normal(size=(200_000, 2)) @ CHROMATICITY, kind)
    assert np.ptp(entropies) < 0.05


def test_shannon_counts_bits(rng):
    log_rgb = lines(2.0, 3, n=8000, surfaces=1, noise=0.0)
    where = rng.permutation(8000) % 4
    log_rgb += 3.0 * where[:, None] * invariant_row(2.0)[0]
    thetas, entropies = entropy_curve(log_rgb, "shannon", keep=1.0)
    at = np.abs(thetas - 2.0).argmin()
    assert entropies.min() == pytest.approx(2.0, abs=0.5)  # four surfaces, some of them on a border of bins
    assert entropies.argmin() in (at - 1, at, at + 1)


def test_the_quadratic_entropy_is_that_of_the_information_potential():
    log_rgb = lines(2.0, 5, n=1500)
    thetas, entropies = entropy_curve(log_rgb, "quadratic", keep=1.0)
    chroma = log_rgb @ CHROMATICITY.T
    rows = np.stack([CHROMATICITY @ invariant_row(theta)[0] for theta in thetas])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    scott = 3.5 * np.median((chroma @ rows[::15].T).std(axis=0)) * len(chroma) ** (-1 / 3)
    sigma = 0.5 * 0.25 * scott  # half of a quarter of Scott's width
    exact = []
    for row in rows[::20]:
        values = chroma @ row
        exact.append(-np.log2(np.mean(np.exp(-np.square(values[:, None] - values) / (4 * sigma**2)))))
    difference = entropies[::20] - np.array(exact)
    assert np.ptp(difference) < 0.1  # but for a constant; a cell is as wide as the kernel


@pytest.mark.parametrize("kind", KINDS)
def test_outliers_are_left_out(rng, kind):
    log_rgb = lines(2.0, 7)
    wild = rng.permutation(len(log_rgb))[:60]
    log_rgb[wild] += rng.normal(0, 20, (60, 3))
    thetas, entropies = entropy_curve(log_rgb, kind)
    assert degrees_apart(thetas[entropies.argmin()], 2.0) <= 2.0


@pytest.fixture(scope="module")
def shadowed():
    """Give a poster under uneven light with shadows, by a camera with broad sensors: (picture, camera)."""
    camera = Camera()
    return photograph(poster(SIZE, 3), uneven_light(SIZE, 3), camera, seed=1), camera


def test_a_picture_with_shadows_gives_an_angle_to_trust(shadowed):
    picture, camera = shadowed
    found = theta_from_image(picture)
    assert found.observable
    assert degrees_apart(found.theta, camera.theta()) < 2.0
    assert found.interval[0] < camera.theta() < found.interval[1]
    assert np.rad2deg(found.standard_error) < 3.0
    assert found.light_change > 0.3
    assert found.n > 60_000
    assert "bluer where they are darker" in found.message


def test_the_bootstrap_gives_the_same_estimate_again(shadowed):
    assert theta_from_image(shadowed[0]) == theta_from_image(shadowed[0])


def test_depth_of_the_file_does_not_matter(shadowed):
    picture, _ = shadowed
    deep = picture.astype(np.uint16) * 257
    real = picture.astype(np.float64) / 255
    angles = [theta_from_image(p).theta for p in (picture, deep, real, np.dstack([picture, picture[..., :1]]))]
    assert max(degrees_apart(angle, angles[0]) for angle in angles) < 0.5


def test_the_response_is_undone(shadowed):
    picture, camera = shadowed
    linear = from_linear(camera.decode(picture / 255.0), "linear").astype(np.float32)
    assert degrees_apart(theta_from_image(linear, "linear").theta, theta_from_image(picture).theta) < 2.0


def test_dark_saturated_and_missing_pixels_are_left_out(shadowed):
    picture, camera = shadowed
    spoilt = picture.astype(np.float32) / 255
    spoilt[:40] = [0.9, 0.001, 0.5]
    spoilt[-40:] = [1.0, 0.4, 0.2]
    spoilt[100:120, 50:90] = np.nan
    found = theta_from_image(spoilt)
    assert degrees_apart(found.theta, camera.theta()) < 2.0
    assert found.n <= (240 - 80) * 320 - 20 * 40


def test_without_a_change_of_light_nothing_is_trusted():
    pictures = [photograph(poster(SIZE, seed), even_light(SIZE), Camera(), seed=seed) for seed in range(2)]
    for found in map(theta_from_image, pictures):
        assert not found.observable
        assert found.standard_error == np.inf
        assert found.interval == (0.0, np.pi)
        assert "which is not reliable" in found.message
        assert np.isfinite([found.theta, found.light_change]).all()


def test_portraits_are_not_trusted_because_skin_lies_on_a_line():
    found = theta_from_image(render(Head(0), lights=lateral("left"), camera=Camera()).image)
    assert not found.observable
    assert "lie on a line" in found.message


@pytest.mark.slow
def test_nine_tenths_of_the_trusted_angles_are_right():
    # The whole study has 1,260 pictures: 98 % of the trusted are right to 5 degrees, and 55 % of the posters'.
    cases = [(seed, Camera(peaks_nm=(590 + 3 * seed, 540, 450 + 2 * seed))) for seed in range(7)]
    cases += [(seed, narrow_band_camera((590 + 3.0 * seed, 540, 450 + 2.0 * seed))) for seed in range(7, 10)]
    trusted = []
    for seed, camera in cases:
        picture = photograph(poster(SIZE, seed), uneven_light(SIZE, seed), camera, seed=seed)
        found = theta_from_image(picture, camera.response)
        if found.observable:
            trusted.append(degrees_apart(found.theta, camera.theta()))
    assert len(trusted) >= 4
    assert np.mean(np.array(trusted) <= 5.0) >= 0.9


def test_large_pictures_are_reduced(shadowed):
    found = theta_from_image(np.kron(shadowed[0], np.ones((3, 3, 1), np.uint8)))
    assert found.n <= MOST_PIXELS
    assert degrees_apart(found.theta, Camera().theta()) < 2.0


NOISE = np.random.default_rng(0).integers(60, 200, (60, 60, 3), dtype=np.uint8)
REFUSED = {
    "grey": (np.repeat(NOISE[..., :1], 3, axis=2), "is grey"),
    "grey of one channel": (NOISE[..., 0], "is grey"),
    "one colour": (np.full((60, 60, 3), (90, 120, 60), np.uint8), "one colour only"),
    "dark": (NOISE // 30, "only 0 of the image's 3600 pixels are well exposed"),
    "saturated": (np.full((60, 60, 3), (255, 120, 60), np.uint8), "neither dark nor overexposed"),
    "missing": (np.full((60, 60, 3), np.nan), "well exposed"),
    "small": (NOISE[:20, :20], "1000 are needed"),
    "tiny": (NOISE[:4, :4], "too small"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_angle_is_refused(name):
    picture, message = REFUSED[name]
    with pytest.raises(LiaamError, match=message):
        theta_from_image(picture)


def test_values_that_have_no_curve_are_refused():
    with pytest.raises(CameraError, match="there are 50"):
        entropy_curve(np.zeros((50, 3)))
    with pytest.raises(CameraError, match="all finite"):
        entropy_curve(np.full((200, 3), -np.inf))
    with pytest.raises(CameraError, match="one colour only"):
        entropy_curve(np.zeros((200, 3)))
    with pytest.raises(CameraError, match=r"keep is 0\.2"):
        entropy_curve(np.zeros((200, 3)), keep=0.2)
    with pytest.raises(CameraError, match="entropy 'renyi' is unknown: give one of quadratic, shannon"):
        entropy_curve(np.zeros((200, 3)), "renyi")


@settings(max_examples=15)
@given(
    picture=arrays.arrays(np.uint8, (8, 8, 3)),
    contrast=st.sampled_from([1, 16, 255]),
    dtype=st.sampled_from([np.uint8, np.uint16, np.float32]),
)
def test_any_picture_has_a_defined_answer(picture, contrast, dtype):
    coarse = np.kron(picture // contrast, np.ones((6, 6, 1), np.uint8)).astype(dtype)
    coarse = coarse / 255 if dtype == np.float32 else coarse
    try:
        found = theta_from_image(coarse)
    except LiaamError as error:
        assert len(str(error)) > 20
    else:
        assert 0 <= found.theta < np.pi
        assert found.observable == np.isfinite(found.standard_error)


def test_real_portraits_under_a_spot_light_are_not_trusted(shared_data):
    for name in ("imm/12-5f.jpg", "one-person/107_0764.png"):
        assert not theta_from_image(read_image(shared_data / name)).observable


def test_real_scenes_of_one_lamp_are_not_trusted(shared_data):
    # Their angle is 121.5 degrees by pairs of lights; the minima of single pictures lie from 90 to 133.
    for path in sorted((shared_data / "illuminants").glob("[bm]*4100.png")):
        assert not theta_from_image(read_image(path), "linear").observable
