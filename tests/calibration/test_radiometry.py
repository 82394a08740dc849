"""Response, vignetting and exposures: found again in simulated pictures, or said to be out of sight."""

import re
from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from finite_differences import assert_jacobian
from liaam.calibration.radiometry import (
    RadiometricEstimate,
    calibrate_response,
    vignetting_from_flat_field,
)
from liaam.calibration.response_blocks import MeasuredBlocks
from liaam.calibration.response_fit import ResponseProblem, ResponseTable, increments
from liaam.errors import CameraError
from liaam.photometry import CameraModel, ResponseCurve, log_slope, noise_deviation, to_linear
from liaam.photometry.camera import falloff_at
from scenes.camera import narrow_band_camera
from scenes.plane import photograph, poster, uneven_light

SIZE = (240, 320)
VIGNETTING = (-0.30, 0.08, -0.06)
USABLE = np.arange(8, 251) / 255
LIGHT = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 20_000)])


def s_shaped(x):
    """A gamma of 2.2 mixed with an s-shaped tone curve."""
    tone = x ** (1 / 2.2)
    return 0.6 * tone + 0.4 * tone**2 * (3 - 2 * tone)


def film(x):
    """Toe and shoulder: Narkowicz's fit of the ACES film curve, then a gamma of 2.2."""

    def curve(y):
        return (y * (2.51 * y + 0.03) / (y * (2.43 * y + 0.59) + 0.14)) ** (1 / 2.2)

    return curve(1.6 * x) / curve(1.6)


def logarithmic(x):
    """Like the log formats of video: strongly compressed."""
    return np.log1p(200 * x) / np.log1p(200)


CURVES = (s_shaped, film, logarithmic)


def log_light(curve, stored):
    """The true log f of stored values."""
    return np.log(np.interp(stored, curve(LIGHT), LIGHT))


def stored(linear, curve, seed, *, sigma=1.5, vignetting=VIGNETTING, dtype=np.uint8):
    """Take a picture of linear light: vignetting, response, noise of sigma / 255, rounding."""
    share = CameraModel(vignetting=vignetting).falloff(*linear.shape[:2])[..., None]
    noise = np.random.default_rng([seed, 0xF0]).standard_normal(linear.shape) * sigma / 255
    values = np.clip(curve(np.clip(linear * share, 0, 1)) + noise, 0, 1)
    if dtype == np.float32:
        return values.astype(np.float32)
    return np.round(values * np.iinfo(dtype).max).astype(dtype)


@lru_cache(maxsize=16)
def scene(seed, size=SIZE, lamp_K=3600.0, sky_K=8000.0, sheet_seed=None, shadow=0.9):
    """A poster under uneven light as linear values, the brightest hundredth 1."""
    sheet = poster(size, seed if sheet_seed is None else sheet_seed)
    light = uneven_light(size, seed, lamp_K=lamp_K, sky_K=sky_K, shadow=shadow)
    linear = np.maximum(photograph(sheet, light, narrow_band_camera(), exposure=1.0), 0).astype(float)
    return linear / np.percentile(linear.max(axis=-1), 99)


def series(curve, seed, exposures, **options):
    """Pictures from a tripod, the brightest of which is somewhat overexposed."""
    gains = 1.3 * np.array(exposures) / max(exposures)
    return [stored(scene(seed) * gain, curve, 10 * seed + i, **options) for i, gain in enumerate(gains)]


def overlapping(curve, seed, exposures, *, noise=0, moved=0, **options):
    """Parts of a larger poster, seen in turn, and their maps to the first; a thing of some pixels moves over it."""
    rng = np.random.default_rng([seed, 0x0FF])
    (height, width), large = SIZE, (int(1.9 * SIZE[0]), int(1.9 * SIZE[1]))
    pictures, to_picture = [], []
    for i, gain in enumerate(1.3 * np.array(exposures) / max(exposures)):
        angle = 2 * np.pi * i / len(exposures) + rng.uniform(0, 0.5)
        shift = 0.45 * np.array([width, height]) + 0.3 * np.array([width * np.cos(angle), height * np.sin(angle)])
        H = np.array([[1, 0.02 * rng.normal(), -shift[0]], [0.02 * rng.normal(), 1, -shift[1]], [0, 0, 1]])
        linear = cv2.warpPerspective(scene(seed, large), H, (width, height), flags=cv2.INTER_CUBIC)
        if moved:
            x, y = rng.integers(0, width - moved), rng.integers(0, height - moved)
            linear[y : y + moved, x : x + moved] = rng.uniform(0.02, 0.3, 3)
        pictures.append(stored(np.maximum(linear, 0) * gain, curve, 100 * noise + 10 * seed + i, **options))
        to_picture.append(H)
    return pictures, [to_picture[0] @ np.linalg.inv(H) for H in to_picture]


def response_error(response, curve, power=False):
    """Root mean square error of log light over the usable range, but for a common factor (and a power)."""
    found, truth = np.log(to_linear(USABLE, response)), log_light(curve, USABLE)
    found, truth = found - found.mean(), truth - truth.mean()
    g = found @ truth / (found @ found) if power else 1.0
    return np.sqrt(np.mean(np.square(g * found - truth))), g


def falloff_error(coefficients, vignetting=VIGNETTING, power=1.0):
    radius2 = np.square(np.linspace(0, 1, 100))
    wrong = power * np.log(falloff_at(radius2, coefficients)) - np.log(falloff_at(radius2, vignetting))
    return np.sqrt(np.mean(np.square(wrong)))


def theta_error(pair, response):
    """Find the angle as that of least robust difference of two lights, in degrees off; a tiny estimator."""
    logs, variances, usable = [], [], np.array(True)
    for image in pair:
        blocks = (image / 255.0).reshape(SIZE[0] // 8, 8, SIZE[1] // 8, 8, 3)
        mean, noise = blocks.mean(axis=(1, 3)), noise_deviation(image)
        usable = usable & (mean > 8 / 255) & (mean < 250 / 255) & (blocks.std(axis=(1, 3)) < 0.05 * mean + noise)
        mean = np.maximum(mean, 4 / 255)
        logs.append(np.log(to_linear(mean, response)))
        variances.append(np.square(log_slope(mean, response) * noise / 8))
    usable = usable.all(axis=-1)
    theta = np.deg2rad(np.arange(0, 180, 0.1))
    rows = np.stack([np.cos(theta), np.sin(theta), -np.cos(theta) - np.sin(theta)])
    rows /= np.linalg.norm(rows, axis=0)
    squares = np.square((logs[0] - logs[1])[usable] @ rows)
    cost = np.log1p(squares / (9 * (np.sum(variances, axis=0)[usable] @ rows**2 + 0.005**2))).sum(axis=0)
    wrong = np.rad2deg(theta[np.argmin(cost)] - narrow_band_camera().theta())
    return abs((wrong + 90) % 180 - 90)


def two_lights(curve, seed):
    lit = [
        scene(2 * seed + i + 1000, SIZE, lamp, sky, seed, 0.8)
        for i, (lamp, sky) in enumerate([(3600, 8000), (5200, 9000)])
    ]
    return [stored(0.9 * linear, curve, seed + 500 * i) for i, linear in enumerate(lit)]


# --- exposure series ---


@pytest.mark.parametrize("exposures", [(1, 4), (1, 2, 4), (1, 2, 4, 8)], ids=str)
@pytest.mark.parametrize("curve", CURVES)
def test_a_series_of_known_exposures_tells_the_response(curve, exposures):
    for seed in range(2):
        estimate = calibrate_response(series(curve, seed, exposures, sigma=2.0), exposures=exposures)
        assert estimate.observable
        assert estimate.power_known
        assert response_error(estimate.response, curve)[0] < 0.012  # the bar is 0.02; in 32 scenes at most 0.0097
        assert to_linear(np.array(1.0), estimate.response) == pytest.approx(1.0)


@pytest.mark.parametrize("curve", CURVES)
def test_what_two_close_exposures_hold_is_told_well_and_the_rest_has_wide_errors(curve):
    estimate = calibrate_response(series(curve, 1, (1, 2)), exposures=(1, 2))
    low, high = estimate.stored_range
    held = (low <= USABLE) & (high >= USABLE)
    wrong = np.log(to_linear(USABLE, estimate.response)) - log_light(curve, USABLE)
    wrong -= wrong[held].mean()
    assert np.sqrt(np.mean(np.square(wrong[held]))) < 0.003
    assert response_error(estimate.response, curve)[0] < 0.02
    assert isinstance(estimate.response, ResponseCurve)
    assert np.argmax(estimate.response_errors) == 0  # in the dark, which the pictures do not hold


@pytest.mark.parametrize("curve", CURVES)
def test_without_known_ratios_the_response_is_told_up_to_a_power(curve):
    estimate = calibrate_response(series(curve, 0, (1, 2, 4)))
    error, power = response_error(estimate.response, curve, power=True)
    assert error < 0.01
    assert not estimate.power_known
    assert "common power" in estimate.message
    assert "to about 15 %" in estimate.message
    assert abs(power - 1) < 0.15
    np.testing.assert_allclose(power * np.array(estimate.log_exposures), np.log([1, 2, 4]), atol=0.01)


@pytest.mark.parametrize("curve", CURVES)
def test_the_angle_is_right_after_correction_and_wrong_without(curve):
    corrected, as_srgb = [], []
    for seed in range(2):
        for exposures in [(1, 4), None]:  # a common power does not turn the angle
            response = calibrate_response(series(curve, seed, (1, 4)), exposures=exposures).response
            corrected.append(theta_error(two_lights(curve, seed), response))
        as_srgb.append(theta_error(two_lights(curve, seed), "srgb"))
    assert max(corrected) < 0.5  # degrees; the bar is 1
    assert min(as_srgb) > max(corrected)


@pytest.mark.parametrize("power", [0.8, 1.25])
def test_a_power_of_the_exposures_is_a_power_of_the_response(power):
    """Pictures tell (log f, log e) up to a common factor: whoever gives e^g gets f^g."""
    images = series(s_shaped, 0, (1, 2, 4))
    right, wrong = (calibrate_response(images, exposures=[1, 2**g, 4**g]) for g in (1, power))
    low, high = right.stored_range
    held = USABLE[(low <= USABLE) & (high >= USABLE)]
    ratio = np.log(to_linear(held, wrong.response)) - power * np.log(to_linear(held, right.response))
    assert np.ptp(ratio) < 0.01
    assert wrong.rms == pytest.approx(power * right.rms, rel=0.1)


def test_a_tripod_cannot_tell_vignetting():
    estimate = calibrate_response(series(film, 0, (1, 4)), exposures=(1, 4))
    assert not estimate.vignetting.observable
    assert estimate.vignetting.coefficients == ()
    assert "same distance from the centre" in estimate.vignetting.message


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_other_types_of_pixels_serve_as_well(dtype):
    estimate = calibrate_response(series(film, 0, (1, 4), dtype=dtype, sigma=0.5), exposures=(1, 4))
    assert response_error(estimate.response, film)[0] < 0.01


def test_grey_pictures_serve_too():
    images = [image[..., 1] for image in series(s_shaped, 0, (1, 4))]
    assert response_error(calibrate_response(images, exposures=(1, 4)).response, s_shaped)[0] < 0.01


def test_jpeg_does_little_harm():
    images = series(s_shaped, 0, (1, 2, 4))
    coded = [cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 75])[1] for image in images]
    packed = [np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR)) for code in coded]
    assert response_error(calibrate_response(packed, exposures=(1, 2, 4)).response, s_shaped)[0] < 0.03


def test_a_drifting_white_balance_does_no_harm():
    drifting = np.array([[1.0, 1.0, 1.0], [1.06, 0.99, 0.95]])
    images = [
        stored(scene(0) * gain * balance, film, i)
        for i, (gain, balance) in enumerate(zip((0.3, 1.2), drifting, strict=True))
    ]
    estimate = calibrate_response(images, exposures=(1, 4))
    assert response_error(estimate.response, film)[0] < 0.01


# --- overlapping pictures ---


@pytest.mark.parametrize("curve", CURVES)
def test_overlapping_pictures_tell_response_vignetting_and_exposures(curve):
    exposures = (1, 2, 4, 8)
    pictures, maps = overlapping(curve, 0, exposures)
    estimate = calibrate_response(pictures, exposures=exposures, homographies=maps)
    assert response_error(estimate.response, curve)[0] < 0.01
    assert falloff_error(estimate.vignetting.coefficients) < 0.003
    assert abs(estimate.vignetting.corner - (1 + sum(VIGNETTING))) < 4 * estimate.vignetting.corner_error

    unknown = calibrate_response(pictures, homographies=maps)
    error, power = response_error(unknown.response, curve, power=True)
    assert error < 0.01
    assert falloff_error(unknown.vignetting.coefficients, power=power) < 0.005
    np.testing.assert_allclose(power * np.array(unknown.log_exposures), np.log(exposures), atol=0.01)


def test_standard_errors_of_vignetting_are_honest():
    misses = []
    for seed in range(8):
        pictures, maps = overlapping(s_shaped, seed % 2, (1, 2, 4), noise=seed)
        lens = calibrate_response(pictures, exposures=(1, 2, 4), homographies=maps).vignetting
        misses.append((lens.corner - 1 - sum(VIGNETTING)) / lens.corner_error)
    assert 0.4 < np.sqrt(np.mean(np.square(misses))) < 2.0


def test_what_moves_does_not_matter():
    pictures, maps = overlapping(s_shaped, 1, (1, 2, 4), moved=60)
    estimate = calibrate_response(pictures, exposures=(1, 2, 4), homographies=maps)
    assert response_error(estimate.response, s_shaped)[0] < 0.03
    assert falloff_error(estimate.vignetting.coefficients) < 0.005


def test_vignetting_alone_where_the_response_is_known():
    curve = ResponseCurve(tuple(USABLE), tuple(np.exp(log_light(film, USABLE))))
    pictures, maps = overlapping(film, 0, (1, 1, 1))
    estimate = calibrate_response(pictures, homographies=maps, response=curve)
    assert estimate.response == curve
    assert estimate.power_known
    assert falloff_error(estimate.vignetting.coefficients) < 0.003
    np.testing.assert_allclose(estimate.log_exposures, 0, atol=5 * max(estimate.log_exposure_errors))


# --- a flat field ---


def wall(curve, seed, vignetting=VIGNETTING):
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    linear = 0.5 * np.exp(0.2 * x - 0.1 * y)[..., None] * np.array([1.0, 0.9, 0.8])
    linear[30:60, 40:90] *= 0.6  # a picture on the wall
    return stored(linear, curve, seed, vignetting=vignetting)


@pytest.mark.parametrize("vignetting", [VIGNETTING, (-0.6, 0.2, -0.1), (0.0,)], ids=str)
def test_a_wall_tells_the_vignetting(vignetting):
    curve = ResponseCurve(tuple(USABLE), tuple(np.exp(log_light(film, USABLE))))
    lens = vignetting_from_flat_field(wall(film, 3, vignetting), curve)
    assert lens.observable
    assert falloff_error(lens.coefficients, vignetting) < 0.003
    assert abs(lens.corner - 1 - sum(vignetting)) < 4 * lens.corner_error


@pytest.mark.parametrize("is_black", [False, True])
def test_what_is_no_wall_tells_nothing(is_black):
    image = np.zeros((64, 64, 3), np.uint8) if is_black else series(film, 0, (1, 4))[1]
    lens = vignetting_from_flat_field(image)
    assert not lens.observable
    assert lens.coefficients == ()
    assert "cannot be estimated" in lens.message


# --- what cannot be told ---


def unobservable(images, **options) -> RadiometricEstimate:
    estimate = calibrate_response(images, **options)
    assert not estimate.observable
    assert estimate.response == "srgb"
    assert not estimate.power_known
    return estimate


@pytest.mark.parametrize("exposures", [None, (1, 1.04)])
def test_exposures_that_hardly_differ_tell_no_response(exposures):
    assert "hardly differ" in unobservable(series(film, 0, (1, 1.04)), exposures=exposures).message


@pytest.mark.parametrize("value", [0, 255, np.nan])
def test_black_white_and_missing_pictures_tell_nothing(value):
    image = np.full((64, 64, 3), value, np.float32 if np.isnan(value) else np.uint8)
    estimate = unobservable([image, image])
    assert "image 1 has 0 blocks" in estimate.message
    assert np.isnan(estimate.log_exposures[1])


def test_one_grey_level_tells_no_response():
    greys = [np.full((64, 64, 3), v, np.uint8) for v in (100, 150)]
    assert "log light has a standard error of" in unobservable(greys).message


def test_two_lights_are_no_exposures():
    assert "one light" in unobservable(two_lights(s_shaped, 0), exposures=(1, 4)).message


def test_a_wrong_response_is_noticed():
    pictures, maps = overlapping(film, 0, (1, 4))
    estimate = calibrate_response(pictures, exposures=(1, 4), homographies=maps, response="srgb")
    assert not estimate.observable
    assert not estimate.vignetting.observable
    assert "exposures or response are correct" in estimate.message


def test_a_picture_that_nothing_links_to_the_first_is_named():
    left = (np.arange(SIZE[1]) < SIZE[1] // 2)[:, None]
    dark, bright = series(s_shaped, 0, (1, 2))
    images = [np.where(side, image, 0).astype(np.uint8) for side in (left, ~left) for image in (dark, bright)]
    assert re.search("nothing links image [34] to the first", unobservable(images).message)


def test_a_camera_that_hardly_turned_tells_no_vignetting():
    images = series(film, 0, (1, 4))
    maps = [np.eye(3), np.array([[1, 0, 1.0], [0, 1, 0], [0, 0, 1]])]
    assert not calibrate_response(images, exposures=(1, 4), homographies=maps).vignetting.observable


PAIR = [np.full((32, 32, 3), v, np.uint8) for v in (60, 90)]


@pytest.mark.parametrize(
    ("images", "options", "message"),
    [
        (PAIR[:1], {}, "needs two or more"),
        ([PAIR[0], PAIR[1][:16]], {}, "differ in size"),
        (PAIR, {"exposures": (1,)}, "one positive number for each of the 2"),
        (PAIR, {"exposures": (1, 0)}, "one positive number for each of the 2"),
        (PAIR, {"exposures": (1, np.nan)}, "one positive number for each of the 2"),
        (PAIR, {"homographies": [np.eye(3)]}, "one 3×3 homography for each of the 2"),
        (PAIR, {"homographies": [np.eye(3), np.eye(2)]}, "one 3×3 homography for each of the 2"),
        (PAIR, {"homographies": [np.eye(3), np.zeros((3, 3))]}, "cannot be inverted"),
        (PAIR, {"homographies": [np.diag([2.0, 1, 1]), np.eye(3)]}, "must be the identity"),
    ],
)
def test_what_does_not_fit_together_is_refused(images, options, message):
    with pytest.raises(CameraError, match=message):
        calibrate_response(images, **options)


# --- the mathematics ---

INCREMENTS = st.lists(st.floats(1e-3, 1.0), min_size=18, max_size=18).map(np.array)


@given(steps=INCREMENTS)
def test_positive_increments_are_a_rising_curve_that_inverts(steps):
    curve = ResponseTable.of(steps)
    assert (np.diff(curve.light) > 0).all()
    np.testing.assert_allclose(curve.stored_of(curve.log_light(USABLE)), USABLE, atol=1e-6)
    np.testing.assert_allclose(curve.log_light(USABLE), increments(USABLE) @ steps, atol=1e-3)


def few_blocks(rng) -> MeasuredBlocks:
    shape, channel = (3, 24), np.arange(24) % 3
    return MeasuredBlocks(
        stored=rng.uniform(0.05, 0.95, shape),
        deviation=np.full(shape, 0.002),
        usable=np.ones(shape, bool),
        radius2=rng.uniform(0, 1, shape),
        offset=np.zeros((24, 2)),
        channel=channel,
        block=np.arange(24) // 3,
    )


def test_the_derivative_of_the_exposure(rng):
    problem = ResponseProblem(few_blocks(rng), None, None, 3)
    z = problem.start()
    z[-9:] = rng.normal(0, 0.05, 9)
    rest, free = np.split(z, [-9])  # the curve has no part in it
    derivative = problem.exposure(z)[1][..., -9:].reshape(-1, 9)

    def exposure(at: np.ndarray) -> np.ndarray:
        return problem.exposure(np.concatenate([rest, at]))[0].ravel()

    assert_jacobian(exposure, derivative, free, steps=1e-5, tolerance=1e-8)
