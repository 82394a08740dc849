"""Noise: the line sigma^2 = slope * rho + offset is found from flats, pairs and single pictures, or said to be unknown.

Studies of 200 seeds are too long for a test; their figures are in the docstrings of the bars below.
"""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from liaam.calibration.noise import NoiseEstimate, noise_from_flat, noise_from_image, noise_from_pair
from liaam.errors import CameraError, ImageError
from liaam.photometry import NoiseModel, ResponseCurve
from liaam.photometry.noise import noise_deviation
from scenes import (
    Camera,
    Head,
    colour_chart,
    even_light,
    lateral,
    narrow_band_camera,
    photograph,
    poster,
    render,
    uneven_light,
)

SIZE = (160, 200)
BRIGHTNESSES = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
CAMERAS = {
    "srgb, 8 bits": Camera(),
    "linear, 8 bits": Camera(response="linear", read_noise=0.004, shot_noise=4e-4),
    "gamma, 16 bits": Camera(response=2.2, bits=16),
    "srgb, 16 bits, quiet": Camera(bits=16, read_noise=3e-4, shot_noise=3e-5),
    "srgb, 8 bits, all in the dark": Camera(read_noise=0.01, shot_noise=0.0),
    "linear, floats": Camera(response="linear", bits=None),
}


def truth(camera: Camera) -> NoiseModel:
    return NoiseModel(camera.shot_noise, camera.read_noise**2)


def off(noise: NoiseModel, true: NoiseModel, light: np.ndarray = BRIGHTNESSES) -> float:
    """Greatest relative error of the deviation over a range of brightness."""
    return float(np.abs(np.sqrt(noise.variance(light) / true.variance(light)) - 1).max())


@lru_cache(maxsize=12)
def sheet(seed: int) -> np.ndarray:
    return poster(SIZE, seed)


def picture(camera: Camera, seed: int, scene: int = 3, **options) -> np.ndarray:
    return photograph(sheet(scene), uneven_light(SIZE, scene), camera, seed=seed, **options)


def from_pair(camera: Camera, seed: int) -> NoiseEstimate:
    return noise_from_pair(picture(camera, 2 * seed), picture(camera, 2 * seed + 1), camera.response)


def from_chart(camera: Camera, seed: int) -> NoiseEstimate:
    chart, boxes = colour_chart()
    return noise_from_flat(photograph(chart, even_light(chart.shape[:2]), camera, seed=seed), boxes, camera.response)


def from_exposures(camera: Camera, seed: int) -> NoiseEstimate:
    wall, light = np.full((64, 96, 3), 0.7), uneven_light((64, 96), 4, shadow=0.0)
    exposures = enumerate((0.07, 0.2, 0.5, 1.0))
    pictures = [photograph(wall, light, camera, seed=10 * seed + i, exposure=gain) for i, gain in exposures]
    return noise_from_flat(pictures, None, camera.response)


def from_one(camera: Camera, seed: int) -> NoiseEstimate:
    return noise_from_image(picture(camera, seed, scene=seed % 5), camera.response)


@lru_cache(maxsize=1)
def portrait() -> np.ndarray:
    return render(Head(3), lights=lateral("left")).linear.astype(float)


CONTROLLED = {"pair": from_pair, "chart": from_chart, "exposures": from_exposures}


def jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    import cv2

    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


# Accuracy --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", CONTROLLED)
@pytest.mark.parametrize("name", CAMERAS)
def test_pairs_and_flats_tell_the_deviation_to_5_percent(name, source):
    """Measured over 200 seeds: 1 % at most on average (root mean square), 3 % at worst."""
    camera = CAMERAS[name]
    estimate = CONTROLLED[source](camera, 0)
    assert estimate.observable
    assert off(estimate.noise, truth(camera)) < 0.05


@pytest.mark.parametrize("name", CAMERAS)
def test_one_picture_tells_the_deviation_to_25_percent(name):
    """Measured over 200 seeds: 2 to 5 % on average (root mean square), 19 % at worst."""
    camera = CAMERAS[name]
    for seed in range(3):
        estimate = from_one(camera, seed)
        assert off(estimate.noise, truth(camera)) < 0.25


@pytest.mark.parametrize("name", ["srgb, 8 bits", "linear, 8 bits", "srgb, 8 bits, all in the dark"])
def test_a_portrait_tells_the_deviation_where_it_is_smooth(name):
    """Measured over 200 exposures of 24 heads: at 0.05, where only hair is, 17, 10 and 2 %; at 0.2, 4, 3 and 2 %."""
    camera = CAMERAS[name]
    image = camera.expose(portrait(), np.random.default_rng(0))
    estimate = noise_from_image(image, camera.response)
    assert off(estimate.noise, truth(camera), np.array([0.2, 0.4])) < 0.15


@pytest.mark.parametrize("source", [*CONTROLLED, "one"])
def test_stated_errors_are_honest(source):
    """95 % intervals hold the truth in 91 to 99 % of 200 seeds, those of one picture in 97 to 100 %."""
    make, camera = (CONTROLLED | {"one": from_one})[source], CAMERAS["srgb, 8 bits"]
    estimates = [make(camera, seed) for seed in range(20)]
    true = truth(camera)
    slopes = [abs(e.noise.slope - true.slope) < 1.96 * e.slope_error for e in estimates]
    offsets = [abs(e.noise.offset - true.offset) < 1.96 * e.offset_error for e in estimates]
    assert min(np.mean(slopes), np.mean(offsets)) >= 0.85
    errors = np.array([[e.slope_error / true.slope, e.offset_error / true.offset] for e in estimates])
    assert (errors.mean(axis=0) < (0.2, 0.7)).all()  # and they are not honest by being large


@settings(max_examples=8)
@given(gain=st.floats(0.3, 3.0), seed=st.integers(0, 99))
def test_brighter_light_with_the_same_photons_only_scales_the_line(gain, seed):
    rng = np.random.default_rng(seed)
    light = np.broadcast_to(np.linspace(0.1, 0.3, 96)[None, :, None], (96, 96, 3))
    image = light + np.sqrt(1e-4 * light + 1e-6) * rng.standard_normal(light.shape)
    ours, theirs = (noise_from_flat(x.astype(np.float32), None, "linear").noise for x in (image, gain * image))
    assert theirs.slope == pytest.approx(gain * ours.slope, rel=1e-3)
    assert theirs.offset == pytest.approx(gain**2 * ours.offset, rel=1e-3, abs=1e-9)


def test_a_measured_response_counts_light_on_its_own_scale():
    stored = np.linspace(0.02, 1, 20)
    curve = ResponseCurve(tuple(stored), tuple(3 * stored**2.2))
    camera = Camera(response=2.2)
    noise = noise_from_pair(picture(camera, 0), picture(camera, 1), curve).noise
    assert off(noise, NoiseModel(3 * camera.shot_noise, 9 * camera.read_noise**2), 3 * BRIGHTNESSES) < 0.05


def test_depth_and_grey_pictures():
    camera = Camera()
    first, second = picture(camera, 0), picture(camera, 1)
    eight = noise_from_pair(first, second).noise
    floats = noise_from_pair((first / 255).astype(np.float32), (second / 255).astype(np.float32)).noise
    assert off(floats, eight) < 0.1  # the rounding counts as noise when nothing tells of it
    assert floats.variance(np.array(0.2)) > eight.variance(np.array(0.2))
    grey = noise_from_pair(first[..., 1], second[..., 1])
    assert off(grey.noise, truth(camera)) < 0.05
    assert grey.slope_error > 1.2 * noise_from_pair(first, second).slope_error  # three equal channels tell no more


def test_a_large_picture_is_thinned_out(monkeypatch):
    camera = Camera()
    full = from_pair(camera, 0)
    monkeypatch.setattr("liaam.calibration.noise.ENOUGH_BLOCKS", 150)
    thinned = from_pair(camera, 0)
    assert thinned.n < 0.3 * full.n
    assert off(thinned.noise, truth(camera)) < 0.1


def woven(camera: Camera, seed: int, smooth: np.ndarray, contrast: float, blur: float) -> np.ndarray:
    """Four stripes of cloth, the darkest left; its weave is as fine as noise, but for the smooth pixels (160, 256)."""
    import cv2

    rng = np.random.default_rng([seed, 7])
    light = np.ones((160, 1, 3)) * np.repeat([0.06, 0.15, 0.35, 0.7], 64)[:, None]
    weave = cv2.GaussianBlur(rng.standard_normal((160, 256)), (0, 0), blur)
    weave = np.where(smooth, 0.0, contrast * weave / weave.std())
    return camera.expose(light * np.exp(weave)[..., None], rng)


@pytest.mark.parametrize(("rows", "contrast", "blur"), [(16, 0.05, 0.5), (48, 0.08, 0.7), (24, 0.1, 0.6)])
def test_a_few_smooth_places_among_texture_are_enough(rows, contrast, blur):
    camera, smooth = Camera(bits=16), np.arange(160)[:, None] < rows
    ratios = [
        noise_from_image(woven(camera, seed, smooth, contrast, blur)).noise.variance(BRIGHTNESSES) for seed in range(5)
    ]
    off_by = np.sqrt(np.mean(ratios, axis=0) / truth(camera).variance(BRIGHTNESSES)) - 1
    assert np.abs(off_by).max() < 0.12


def test_errors_hold_what_texture_adds():
    """Where the dark is nothing but texture the offset is too large; intervals hold it in 75 % of 20 seeds.

    With the errors of chance alone they do in 5 %.
    """
    camera, smooth = Camera(bits=16), (np.arange(160)[:, None] < 48) & (np.arange(256) >= 64)
    estimates = [noise_from_image(woven(camera, seed, smooth, 0.08, 0.7)) for seed in range(8)]
    deviations = [abs(e.noise.offset - truth(camera).offset) / e.offset_error for e in estimates]
    assert np.mean(np.array(deviations) < 1.96) >= 0.6


# What disturbs ---------------------------------------------------------------------------------------


def test_motion_in_part_of_a_pair_is_forgiven_and_in_most_is_told():
    first, second = picture(Camera(), 0), picture(Camera(), 1)
    part = second.copy()
    part[:40] = np.roll(second, 9, axis=1)[:40]
    estimate = noise_from_pair(first, part)
    assert estimate.observable
    assert off(estimate.noise, truth(Camera())) < 0.25
    shaken = noise_from_pair(first, np.roll(second, 2, axis=1))
    assert not shaken.observable
    assert "use a tripod" in shaken.message


def test_a_flicker_is_taken_out_and_another_exposure_refused():
    first, *others = (picture(Camera(), i, exposure=gain) for i, gain in enumerate((0.6, 0.63, 0.8)))
    assert off(noise_from_pair(first, others[0]).noise, truth(Camera())) < 0.05
    with pytest.raises(CameraError, match=r"differ in brightness by 3\d%: take both with one exposure"):
        noise_from_pair(first, others[1])


def test_dust_edges_and_shading_in_a_box_do_not_count():
    camera, light = Camera(bits=16), uneven_light((64, 96), 4, shadow=0.0)
    wall = np.full((64, 96, 3), 0.7)
    wall[20:22] = 0.1
    wall[::16, ::16] = 0.05
    dirty = noise_from_flat(
        [photograph(wall, light, camera, seed=i, exposure=g) for i, g in enumerate((0.1, 0.4, 1.0))]
    )
    assert off(dirty.noise, truth(camera)) < 0.15


def test_clipped_and_dark_parts_are_left_out():
    pair = [picture(Camera(), i, exposure=1.8) for i in range(2)]
    assert (pair[0] > 250).any(axis=2).mean() > 0.05
    assert off(noise_from_pair(pair[0], pair[1]).noise, truth(Camera())) < 0.05
    for image in pair:
        image[:, :120] = 0
    assert off(noise_from_pair(pair[0], pair[1]).noise, truth(Camera())) < 0.1


def test_broken_pixels_spoil_their_block_only():
    pair = [(picture(Camera(bits=16), i) / 65535).astype(np.float32) for i in range(2)]
    pair[0][:40, :40], pair[1][100, 100], pair[0][120, 9], pair[0][130, 9] = np.nan, np.inf, -np.inf, 1e30
    assert off(noise_from_pair(pair[0], pair[1]).noise, truth(Camera())) < 0.05
    assert off(noise_from_image(pair[0]).noise, truth(Camera())) < 0.25


def test_a_painted_ground_is_not_taken_for_silence():
    image = picture(Camera(), 0)
    image[:, :120] = 200
    assert off(noise_from_image(image).noise, truth(Camera())) < 0.25


# What cannot be told ---------------------------------------------------------------------------------


def test_one_brightness_is_put_down_to_photons():
    camera = Camera(bits=16)
    wall = np.full((64, 64, 3), 0.5)
    estimate = noise_from_flat(photograph(wall, even_light((64, 64)), camera, seed=1, exposure=0.8))
    assert not estimate.observable
    assert np.isinf([estimate.slope_error, estimate.offset_error]).all()
    assert "one brightness does not separate photon noise from noise in the dark" in estimate.message
    assert estimate.noise.offset == 0
    assert off(estimate.noise, truth(camera), np.array([0.4])) < 0.05


@pytest.mark.parametrize("source", [*CONTROLLED, "one"])
def test_noise_below_the_rounding_is_bounded_not_guessed(source):
    quiet = Camera(read_noise=2e-4, shot_noise=1e-6)
    estimate = (CONTROLLED | {"one": from_one})[source](quiet, 0)
    assert not estimate.observable
    assert "beyond the rounding of stored values" in estimate.message
    light = np.array([0.2])
    assert truth(quiet).variance(light) < estimate.noise.variance(light) < 1e-4


def test_jpeg_is_told():
    first, second = picture(Camera(), 0), picture(Camera(), 1)
    assert "JPEG" in noise_from_pair(jpeg(first, 90), jpeg(second, 90)).message
    assert "JPEG" not in noise_from_pair(first, second).message
    alone = noise_from_image(jpeg(first, 90))
    assert not alone.observable
    assert "JPEG" in alone.message
    assert "JPEG" not in noise_from_image(first).message


def test_texture_everywhere_is_told(rng):
    image = (0.4 * np.exp(0.2 * rng.standard_normal((*SIZE, 1))) * np.ones(3)).astype(np.float32)
    image = np.clip((image + np.roll(image, 1, 0) + np.roll(image, 1, 1)) / 3, 0, 0.95)
    assert not noise_from_image(image, "linear").observable


def test_a_computed_picture_has_no_noise():
    ramp = np.broadcast_to(np.linspace(0.2, 0.6, 64)[None, :, None], (64, 64, 3))
    estimate = noise_from_flat(ramp, None, "linear")
    assert not estimate.observable
    assert "computed, not taken" in estimate.message
    assert estimate.noise == NoiseModel(0.0, 0.0)
    scene = photograph(sheet(1), uneven_light(SIZE, 1), narrow_band_camera(), seed=1)
    assert not noise_from_image(scene, "linear").observable


# Bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_pictures_are_refused(value):
    with pytest.raises(CameraError, match="only 0 blocks of 8×8 pixels"):
        noise_from_image(np.full((64, 64, 3), value, np.uint8))


def test_pictures_of_nothing_are_refused():
    with pytest.raises(CameraError, match="only 0 blocks"):
        noise_from_flat(np.full((64, 64, 3), np.nan, np.float32))
    with pytest.raises(ImageError, match="image 2: the image is 64×7 pixels"):
        noise_from_flat([np.full((64, 64, 3), 100, np.uint8), np.full((7, 64, 3), 100, np.uint8)])
    with pytest.raises(CameraError, match="no image or no box"):
        noise_from_flat([])


def test_noise_that_fills_the_range_is_refused(rng):
    with pytest.raises(CameraError, match="clipped by noise"):
        noise_from_image(rng.integers(0, 256, (96, 96, 3), dtype=np.uint8))


def test_pairs_that_are_none_are_refused():
    image = picture(Camera(), 0)
    with pytest.raises(CameraError, match="the pair's images are identical"):
        noise_from_pair(image, image)
    with pytest.raises(CameraError, match="200×160 pixels of uint8 and 200×159 pixels of uint8"):
        noise_from_pair(image, image[:-1])
    with pytest.raises(CameraError, match="pixels of uint8 and 200×160 pixels of uint16"):
        noise_from_pair(image, image.astype(np.uint16))


@pytest.mark.parametrize(
    ("boxes", "words"),
    [
        ([[0, 0, 201, 20]], "box 0, 0, 201, 20: give x0, y0, x1, y1 of at least 8×8 pixels inside image 1"),
        ([[0, -1, 20, 20]], "box 0, -1, 20, 20"),
        ([[0, 0, 7, 20]], "box 0, 0, 7, 20"),
        ([[20, 20, 0, 0]], "box 20, 20, 0, 0"),
        ([[0.0, 0.0, 20.5, 20.0]], "give integers"),
        ([0, 0, 20, 20], "give integers"),
        ([[0, 0, 8, 8]], "only 3 blocks"),
        (np.zeros((0, 4), int), "no image or no box"),
    ],
)
def test_boxes_that_cannot_be_are_refused(boxes, words):
    with pytest.raises(CameraError, match=words):
        noise_from_flat(picture(Camera(), 0), boxes)


@given(st.integers(0, 2**32 - 1), st.sampled_from([np.uint8, np.uint16, np.float32]), st.floats(0.001, 1.0))
@settings(max_examples=25)
def test_any_picture_has_an_estimate_or_a_reason(seed, dtype, contrast):
    rng = np.random.default_rng(seed)
    values = np.clip(0.5 + contrast * (rng.random((40, 40, 3)) - 0.5), 0, 1)
    image = values.astype(dtype) if dtype == np.float32 else np.round(values * np.iinfo(dtype).max).astype(dtype)
    try:
        estimate = noise_from_image(image)
    except CameraError:
        return
    assert estimate.message
    assert min(estimate.noise.slope, estimate.noise.offset) >= 0
    assert not np.isnan([estimate.slope_error, estimate.offset_error]).any()


@pytest.mark.parametrize("size", [(400, 800), (600, 600), (480, 640)])
def test_rows_of_all_phases_of_jpeg_are_looked_at(size, rng, monkeypatch):
    import cv2

    smooth = cv2.GaussianBlur(rng.normal(size=(*size, 3)).astype(np.float32), (0, 0), 3.0)
    picture = np.clip(128 + 300 * smooth + rng.normal(0, 8, (*size, 3)), 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    some = noise_deviation(decoded)
    monkeypatch.setattr("liaam.photometry.noise.SPARSE", 10**9)
    assert some == pytest.approx(noise_deviation(decoded), rel=0.12)


def test_bytes_that_are_counted_say_what_is_said_by_sorting(rng):
    for size in ((3, 3), (4, 5), (60, 41), (700, 500)):
        picture = rng.normal(100, 20, (*size, 3)).clip(0, 255).astype(np.uint8)
        assert noise_deviation(picture) == pytest.approx(noise_deviation(257 * picture.astype(np.uint16)), rel=1e-12)
