"""Encodings: every kind of image gets one defined answer."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from liaam.encoding_constants import LOG_FLOOR, SOFTNESS
from liaam.errors import ImageError, MethodError
from liaam.photometry import ENCODINGS, encode, encoding, exposure_faults, invariant, is_grey, srgb_to_linear
from liaam.photometry.encoding import as_colour, refuse_unscaled, value_luminance
from liaam.training import sample_appearance


@pytest.fixture
def picture(rng) -> np.ndarray:
    return rng.integers(0, 256, (24, 20, 3), dtype=np.uint8)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("response", ["srgb", "linear", 2.2])
def test_depth_does_not_matter(picture, encoding, response):
    eight = encode(picture, encoding, response)
    sixteen = encode(picture.astype(np.uint16) * 257, encoding, response)
    floats = encode(picture.astype(np.float32) / 255, encoding, response)
    np.testing.assert_allclose(sixteen, eight, atol=1e-6)
    np.testing.assert_allclose(floats, eight, atol=1e-5)
    assert np.array_equal(floats[..., -1], eight[..., -1])


def test_value_of_srgb_pictures_is_the_stored_value(picture):
    np.testing.assert_allclose(encode(picture, "value")[..., :3], picture / 255, atol=1e-6)


def test_log_is_the_logarithm_of_linear_light(picture):
    encoded = encode(picture, "log")
    usable = encoded[..., 3] == 1
    expected = np.log(srgb_to_linear(picture[usable] / 255))
    np.testing.assert_allclose(encoded[usable][:, :3], expected, atol=1e-5)


@example(7, 0)
@example(8, 1)
@example(250, 2)
@example(251, 0)
@given(value=st.integers(0, 255), channel=st.integers(0, 2))
def test_dark_and_saturated_channels_cost_the_log_its_trust(value, channel):
    image = np.full((8, 8, 3), 128, np.uint8)
    image[4, 4, channel] = value
    usable = encode(image, "log")[..., 3]
    assert usable[4, 4] == (8 <= value <= 250)
    assert usable.sum() == 63 + (8 <= value <= 250)
    assert exposure_faults(image[4:5, 4]) == (value < 8, value > 250)
    assert encode(image, "value")[..., 3].all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -5.0, 1e30])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_strange_floats_stay_finite(bad, encoding):
    image = np.full((16, 16, 3), 0.5, np.float32)
    image[3, 5, 1] = bad
    for blur in (0.0, 1.0):
        encoded = encode(image, encoding, blur=blur)
        assert np.isfinite(encoded).all()
        if encoding == "log" or not np.isfinite(bad):
            assert encoded[3, 5, -1] == 0
        assert encoded[..., -1].sum() >= 255


def test_soft_gradients_are_those_of_log_brightness_normalised_softly(rng):
    y, x = np.mgrid[:20, :24]
    slope = rng.uniform(-0.2, 0.2, 2)
    image = np.repeat(np.exp(slope[0] * (x - 12) + slope[1] * (y - 10) - 1.5)[..., None], 3, axis=2)
    encoded = encode((image - LOG_FLOOR).astype(np.float32), "soft", "linear", pixel=2.0)
    per_pixel = slope / 2.0  # in pixels of the object's frame, which are half as large
    expected = per_pixel / np.hypot(np.linalg.norm(per_pixel), SOFTNESS)
    np.testing.assert_allclose(encoded[2:-2, 2:-2, :2], np.broadcast_to(expected, (16, 20, 2)), atol=1e-3)


@given(gain=st.floats(0.5, 1.6))
def test_soft_gradients_hardly_see_a_gain(gain):
    picture = np.random.default_rng(3).uniform(0.2, 0.6, (16, 16, 3)).astype(np.float32)
    plain, brighter = (encode(image, "soft", "linear", blur=1.0) for image in (picture, np.float32(gain) * picture))
    np.testing.assert_allclose(brighter[..., :2], plain[..., :2], atol=0.02)
    np.testing.assert_allclose(invariant(brighter[..., 2:5], 2.1), invariant(plain[..., 2:5], 2.1), atol=1e-5)


def test_soft_directions_work_where_the_log_says_nothing():
    ramp = np.linspace(0, 255, 64)[:, None] * [1.0, 0.95, 0.98]
    image = np.tile(ramp.astype(np.uint8)[None], (16, 1, 1))
    encoded = encode(image, "soft")
    assert encoded[..., -1].all()
    assert not encoded[:, 0, 5].any()
    assert not encoded[:, -1, 5].any()
    assert encoded[:, 20, 5].all()
    assert (encoded[:, 1, 0] > 0.3).all()


def test_grey_pictures_have_no_invariant_to_know(picture):
    grey = np.repeat(picture[..., :1], 3, axis=2)
    assert not encode(grey, "soft")[..., 5].any()
    holed = np.where(np.arange(20)[None, :, None] == 7, np.nan, grey / 255).astype(np.float32)
    assert is_grey(holed)
    assert not is_grey(np.full_like(holed, np.nan))
    assert not encode(holed, "soft")[..., 5].any()


def test_blurring_the_log_blurs_the_invariant(rng):
    image = rng.uniform(0.1, 0.9, (30, 30, 3)).astype(np.float32)
    blurred = invariant(encode(image, "log", "linear", blur=1.5)[..., :3], 2.0)
    shaded = image * np.linspace(0.5, 1.0, 30, dtype=np.float32)[:, None, None]
    again = invariant(encode(shaded, "log", "linear", blur=1.5)[..., :3], 2.0)
    np.testing.assert_allclose(again[5:-5, 5:-5], blurred[5:-5, 5:-5], atol=2e-5)


def test_unusable_pixels_hardly_leak_through_a_blur():
    image = np.full((21, 21, 3), 0.5, np.float32)
    image[10, 10] = 0.0
    leaked = encode(image, "log", "linear", blur=1.0)[10, 11, 0]
    assert leaked == pytest.approx(np.log(0.5), abs=0.01)


def test_reduction_averages_linear_light_and_drops_the_rest():
    image = np.full((17, 19, 3), 0.2, np.float32)
    image[::2] = 0.6
    reduced = encode(image, "log", "linear", reduce=2)
    assert reduced.shape == (8, 9, 4)
    np.testing.assert_allclose(reduced[..., :3], np.log(0.4), atol=1e-6)
    assert reduced[..., 3].all()


def test_a_block_with_one_unusable_pixel_is_unusable():
    image = np.full((16, 16, 3), 0.5, np.float32)
    image[0, 0, 0] = np.nan
    assert encode(image, "log", "linear", reduce=4)[..., 3].sum() == 15


def test_grey_is_told_from_colour_by_one_pixel():
    image = np.full((200, 300, 3), 90, np.uint8)
    assert is_grey(image)
    image[101, 77, 2] = 91
    assert not is_grey(image)


@pytest.mark.parametrize("shape", [(12, 10), (12, 10, 1)])
def test_a_grey_array_gets_three_equal_channels(rng, shape):
    grey = rng.integers(0, 256, shape, dtype=np.uint8)
    colour = as_colour(grey)
    assert colour.shape == (12, 10, 3)
    assert np.array_equal(colour[..., 1], grey.reshape(12, 10))
    assert is_grey(colour)


def test_alpha_is_dropped(rng):
    image = rng.integers(0, 256, (9, 9, 4), dtype=np.uint8)
    assert np.array_equal(as_colour(image), image[..., :3])


@pytest.mark.parametrize(
    ("array", "match"),
    [
        (np.zeros((1, 1, 3), np.uint8), "1×1 pixels, too small"),
        (np.zeros((7, 300, 3), np.uint8), "300×7 pixels, too small"),
        (np.zeros((9, 9, 2), np.uint8), r"\(9, 9, 2\) is not an image"),
        (np.zeros(9, np.uint8), "is not an image"),
        (np.zeros((2, 9, 9, 3), np.uint8), "is not an image"),
        (np.zeros((9, 9, 3), np.int64), "int64 are not supported"),
        (np.zeros((9, 9, 3), np.uint32), "uint32 are not supported"),
        (np.zeros((9, 9, 3), bool), "bool are not supported"),
        (np.zeros((9, 9, 3), complex), "complex128 are not supported"),
    ],
)
def test_what_is_no_image_is_refused_by_name(array, match):
    with pytest.raises(ImageError, match=f"portrait.*{match}"):
        as_colour(array, "portrait")


def test_an_unknown_encoding_lists_those_that_exist():
    with pytest.raises(MethodError, match="'hsv'; choose from value, log"):
        encode(np.zeros((9, 9, 3), np.uint8), "hsv")


@pytest.mark.parametrize("response", ["srgb", "linear", 1.8, 2.2, 3.0])
def test_no_usable_level_lies_on_the_floor_of_the_logarithm(response):
    levels = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    encoded = encode(np.repeat(levels, 8, axis=1), "log", response)[:, 0]
    usable = encoded[:, -1] > 0
    assert usable.sum() > 200
    assert (np.diff(encoded[usable, 0]) > 0).all()


@pytest.mark.parametrize(
    ("largest", "remedy"),
    [(200, "convert 8-bit values to uint8"), (1023, "multiply 12-bit values by 16"), (4095, "the response to linear")],
)
def test_16_bit_values_that_are_not_scaled_are_refused(rng, largest, remedy):
    image = rng.integers(0, largest, (300, 20, 3), dtype=np.uint16)
    image[7, 7, 1] = largest
    with pytest.raises(ImageError, match=f"cat: its 16-bit values reach only {largest} of 65535.*{remedy}"):
        refuse_unscaled(image, "cat", 2.2)
    if largest > 255:
        refuse_unscaled(image, "cat", "linear")
    image[11, 11, 1] = 4096
    for other in (image, image // 4096 * 0, image.astype(np.float32) / 65535, (image // 257).astype(np.uint8)):
        refuse_unscaled(other, "cat", "srgb")


def test_a_path_is_told_to_be_read():
    with pytest.raises(ImageError, match=r"cat: 'a\.png' is a path, not an image; give liaam\.read_image\(path\)"):
        as_colour(Path("a.png"), "cat")  # type: ignore[arg-type]


def test_floats_that_count_to_255_are_refused():
    with pytest.raises(ImageError, match="cat: its float values reach 200, but float images range from 0 to 1"):
        as_colour(np.full((16, 16, 3), 200.0), "cat")
    highlights = np.full((16, 16, 3), 0.5)
    highlights[0, :5] = 7.0
    assert as_colour(highlights).dtype == np.float32


def test_big_endian_pixels_are_read_as_what_they_are():
    image = np.full((8, 8, 3), 30_000, np.uint16)
    assert np.array_equal(as_colour(image.astype(">u2")), image)


@pytest.mark.parametrize("dtype", [">u2", ">f4", ">f8"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_byte_order_of_pixels_does_not_matter(picture, encoding, dtype):
    image = picture.astype(np.uint16) * 257 if dtype == ">u2" else picture / 255
    image = image.astype(np.dtype(dtype).newbyteorder("="))
    np.testing.assert_array_equal(encode(image.astype(dtype), encoding), encode(image, encoding))
    np.testing.assert_array_equal(value_luminance(image.astype(dtype)), value_luminance(image))


@pytest.mark.parametrize("dtype", [np.uint32, np.uint64, np.int16, np.int64, bool, complex, object])
def test_pixels_of_another_type_are_refused_by_every_encoder(picture, dtype):
    complaint = r"image: pixels of type .* are not supported; use uint8, uint16 or float"
    for encoder in (lambda image: encode(image, "value"), lambda image: encode(image, "soft"), value_luminance):
        with pytest.raises(ImageError, match=complaint):
            encoder(picture.astype(dtype))


@pytest.mark.parametrize("shape", [(9, 9), (9, 9, 4), (9, 9, 1), (9,)])
def test_arrays_of_another_shape_are_refused_by_every_encoder(shape):
    for encoder in (lambda image: encode(image, "value"), value_luminance):
        with pytest.raises(ImageError, match=r"cannot be encoded; give \(height, width, 3\)"):
            encoder(np.zeros(shape, np.uint8))


# Orientation of gradients


def hills(size: tuple[int, int] = (40, 50)) -> np.ndarray:
    """A smooth grey picture whose slopes point everywhere."""
    y, x = np.indices(size)
    values = 0.45 + 0.2 * np.sin(x / 6.0) * np.cos(y / 7.0 + 0.5) + 0.002 * x
    return np.repeat(values.astype(np.float32)[..., None], 3, axis=2)


def directions(image: np.ndarray, **options) -> np.ndarray:
    return encode(image, "orientation", **options)[..., :2]


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, -2.5, np.pi / 2])
def test_a_slope_has_the_direction_in_which_it_rises(angle):
    y, x = np.indices((20, 30))
    slope = 0.5 + 0.01 * ((x - 15) * np.cos(angle) + (y - 10) * np.sin(angle))
    encoded = encode(np.repeat(slope[..., None], 3, axis=2).astype(np.float32), "orientation")
    np.testing.assert_allclose(encoded[..., 0], np.cos(angle), atol=1e-3)
    np.testing.assert_allclose(encoded[..., 1], np.sin(angle), atol=1e-3)
    assert (encoded[..., 2] == 0).all()
    assert (encoded[..., 3] == 1).all()


def test_orientations_are_unit_vectors_where_there_is_a_gradient(picture):
    lengths = np.linalg.norm(directions(picture, blur=1.0), axis=2)
    assert np.median(lengths) == pytest.approx(1, abs=1e-3)
    assert lengths.max() <= 1 + 1e-6
    assert (encode(picture, "orientation")[..., 2] == 0).all()


@pytest.mark.parametrize("value", [0, 1, 128, 255])
@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_flat_areas_have_no_orientation(value, blur):
    image = np.full((20, 20, 3), value, np.uint8)
    np.testing.assert_allclose(directions(image, blur=blur), 0, atol=1e-3)
    image[:, 14:] = 255 - value
    assert (np.abs(directions(image, blur=blur)[:, :6]) < 1e-2).all()
    assert directions(image, blur=blur)[10, 13, 0] == pytest.approx(1 if value < 128 else -1, abs=1e-2)


def test_orientations_fade_where_a_gradient_does():
    ramps = [directions(np.full((9, 9, 3), 0.5) + np.arange(9)[None, :, None] * slope) for slope in (1e-6, 1e-4, 1e-2)]
    assert [ramp[4, 4, 0] for ramp in ramps] == pytest.approx([0.01, np.sqrt(0.5), 1.0], abs=5e-3)


@pytest.mark.parametrize("fault", [0.0, 1.0, np.nan, np.inf])
@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_orientations_are_numbers_whatever_the_picture_holds(rng, fault, blur):
    image = rng.random((24, 24, 3)).astype(np.float32)
    image[8:16, 8:16] = fault
    encoded = encode(image, "orientation", blur=blur)
    assert np.isfinite(encoded).all()
    assert (np.linalg.norm(encoded[..., :2], axis=2) <= 1 + 1e-6).all()
    assert encoded[12, 12, 3] == np.isfinite(fault)


@given(gain=st.floats(0.2, 1.5), offset=st.floats(0, 0.2))
def test_orientations_do_not_see_gain_and_offset(gain, offset):
    image = hills()
    steep = np.hypot(*np.gradient(image[..., 0])) > 5e-3
    assert steep.mean() > 0.8
    changed = directions(image * np.float32(gain) + np.float32(offset))
    np.testing.assert_allclose(changed[steep], directions(image)[steep], atol=1e-2)


@pytest.mark.parametrize("gamma", [0.5, 1.5, 2.2])
def test_orientations_hardly_see_the_gamma_of_a_grey_picture(gamma):
    ours, theirs = directions(hills()), directions(hills() ** np.float32(gamma))
    cosines = (ours * theirs).sum(axis=2)
    # Differences of neighbours are no derivatives; on a summit the direction is anyone's.
    assert np.quantile(cosines, 0.05) > 0.99
    assert np.median(cosines) > 0.999
    assert (ours * directions(1 - hills())).sum(axis=2).max() < 0.01  # but a negative turns them round


def test_directions_are_given_in_turned_axes(picture):
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    np.testing.assert_allclose(directions(picture, turn=turn), directions(picture) @ turn.T, atol=1e-5)
    assert np.array_equal(encode(picture, "value", turn=turn), encode(picture, "value"))


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_picture_has_the_same_orientations_on_the_object(fine_model, scenes, quarters):
    image, shape, blur = scenes[3].image, scenes[3].landmarks, 0.5
    upright = sample_appearance(image, shape, fine_model.warp, "orientation", "linear", blur)
    for _ in range(quarters):
        image, shape = np.rot90(image), np.column_stack([shape[:, 1], image.shape[1] - 1 - shape[:, 0]])
    turned = sample_appearance(np.ascontiguousarray(image), shape, fine_model.warp, "orientation", "linear", blur)
    np.testing.assert_allclose(turned[0], upright[0], atol=1e-2)
    assert np.abs(turned[0] - upright[0]).mean() < 1e-4
    assert np.array_equal(turned[1], upright[1])
    # The axes of the picture did turn.
    assert np.abs(upright[0][:, 0]).mean() > 0.2


def test_soft_gradients_are_as_sure_as_all_three_channels_make_them(rng):
    y, x = np.mgrid[:40, :40]
    clean = np.repeat((0.3 + 0.004 * x + 0.002 * y)[..., None], 3, axis=2)
    true = encode(clean.astype(np.float32), "soft", "linear")[2:-2, 2:-2, :2]
    errors = []
    for channels in (slice(0, 1), slice(0, 3)):
        noisy = clean.copy()
        noise = 0.002 * rng.standard_normal(clean[..., channels].shape)
        noisy[..., channels] += noise
        noisy[...] = noisy[..., channels].mean(axis=2, keepdims=True) if channels.stop == 1 else noisy
        errors.append(encode(noisy.astype(np.float32), "soft", "linear")[2:-2, 2:-2, :2] - true)
    alone, together = (np.sqrt(np.square(error).mean()) for error in errors)
    # Independent noise of three channels averages out; a channel that counts for most would leave 0.75 of it.
    assert together == pytest.approx(alone / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize("size", [1.0, 1.7, 4.0])
@pytest.mark.parametrize("start", [(0.0, 0.0), (2.0, 3.0), (0.4, 1.3)])
def test_floats_are_averaged_the_same_strip_by_strip(rng, monkeypatch, size, start):
    image = rng.random((83, 40, 3), dtype=np.float32)
    image[60:65, 7] = np.nan
    whole = encoding.block_means(image, "soft", "srgb", size, start)
    monkeypatch.setattr(encoding, "FLOATS_AT_ONCE", 500)
    strips = encoding.block_means(image, "soft", "srgb", size, start)
    np.testing.assert_allclose(strips.light, whole.light, atol=2e-6)
    np.testing.assert_allclose(strips.finite, whole.finite, atol=2e-6)
    assert strips.grey == whole.grey


def test_large_pictures_of_floats_take_little_memory(rng):
    image = rng.random((4000, 3000, 3), dtype=np.float32)
    encoding.block_means(image[:99], "log", "srgb", 8.0)  # compiles
    tracemalloc.start()
    encoding.block_means(image, "log", "srgb", 8.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * image.nbytes
