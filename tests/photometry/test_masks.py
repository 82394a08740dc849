"""Masks: the limits are those of the encodings, and highlights are found where they were added."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

from liaam.datasets.scenes import Camera, colour_chart, even_light, photograph, poster, uneven_light
from liaam.errors import CameraError, ImageError
from liaam.photometry import encode
from liaam.photometry.masks import dark_pixels, saturated_pixels, specular_pixels, usable_pixels

PAINTS = ((0.6, 0.2, 0.1), (0.15, 0.45, 0.2), (0.1, 0.2, 0.5), (0.7, 0.55, 0.1), (0.5, 0.3, 0.25), (0.4, 0.15, 0.4))
CAMERAS = {
    "8 bits": Camera(),
    "noisy": Camera(read_noise=0.008, shot_noise=4e-4),
    "linear, 16 bits": Camera(response="linear", bits=16),
    "gamma": Camera(response=2.2),
}


def spheres(paints, strength: float = 0.5, exponent: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Matt light (h, w, 3) of six spheres under a lamp, and the white Phong lobe (h, w, 1) of their gloss."""
    lamp = np.array([-0.4, -0.5, 1.0]) / np.linalg.norm([-0.4, -0.5, 1.0])
    half = lamp + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    y, x = np.mgrid[-1:1:80j, -1:1:80j] / 0.9
    inside = x**2 + y**2 < 1
    normals = np.dstack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))])
    shading = np.where(inside, 0.12 + 0.88 * np.maximum(normals @ lamp, 0), 0)
    lobe = np.where(inside & (normals @ lamp > 0), strength * np.maximum(normals @ half, 0) ** exponent, 0)
    balls = [np.where(inside[..., None], shading[..., None] * np.array(paint), 0.08) for paint in paints]
    grid = np.block([[[balls[3 * row + column]] for column in range(3)] for row in range(2)])
    return 0.9 * grid, 0.9 * np.tile(lobe, (2, 3))[..., None]


def scores(image: np.ndarray, matt: np.ndarray, gloss: np.ndarray, **options) -> tuple[float, float]:
    """Precision and recall: a fifth of the strongest channel is a highlight, a twentieth is none."""
    share = gloss.mean(axis=2) / (matt + gloss).max(axis=2)
    marked = specular_pixels(image, **options)
    found, invented = (marked & (share > 0.2)).sum(), (marked & (share < 0.05)).sum()
    return found / max(found + invented, 1), found / max((share > 0.2).sum(), 1)


# Dark and saturated -----------------------------------------------------------------------------------


@given(
    arrays.arrays(np.uint16, (8, 8, 3), elements=st.integers(0, 65535) | st.sampled_from([2055, 2056, 64250, 64251]))
)
def test_usable_pixels_are_those_of_the_logarithm(image):
    for picture in (image, (image >> 8).astype(np.uint8), (image / 65535).astype(np.float32)):
        np.testing.assert_array_equal(usable_pixels(picture), encode(picture, "log")[..., 3] == 1)


def test_one_channel_is_enough(rng):
    image = np.full((8, 9, 3), 128, np.uint8)
    image[2, 3, 1], image[4, 5, 2] = 7, 251
    assert np.argwhere(dark_pixels(image)).tolist() == [[2, 3]]
    assert np.argwhere(saturated_pixels(image)).tolist() == [[4, 5]]
    assert usable_pixels(image).sum() == 70


def test_what_is_no_number_is_dark():
    image = np.full((8, 8, 3), 0.5, np.float32)
    image[1, 1, 0], image[2, 2, 1], image[3, 3, 2] = np.nan, np.inf, -np.inf
    assert np.argwhere(dark_pixels(image)).tolist() == [[1, 1], [2, 2], [3, 3]]
    assert not usable_pixels(image)[[1, 2, 3], [1, 2, 3]].any()


@pytest.mark.parametrize("find", [dark_pixels, saturated_pixels, usable_pixels, specular_pixels])
def test_what_is_no_image_is_refused(find):
    with pytest.raises(ImageError, match="is not an image"):
        find(np.zeros((9, 9, 2), np.uint8))


# Highlights ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("strength", "exponent"), [(0.5, 30), (0.25, 10), (1.2, 60)])
def test_highlights_on_glossy_spheres_are_found(name, strength, exponent, rng):
    matt, gloss = spheres(PAINTS, strength, exponent)
    camera = CAMERAS[name]
    image = camera.expose(matt + gloss, rng)
    precision, recall = scores(image, matt, gloss, response=camera.response)
    assert precision >= 0.98
    assert recall >= (0.75 if name == "noisy" else 0.9)  # noise of 3 % tears surfaces apart


@pytest.mark.parametrize("name", CAMERAS)
def test_matt_spheres_do_not_shine(name, rng):
    camera = CAMERAS[name]
    matt, _ = spheres(PAINTS)
    assert specular_pixels(camera.expose(matt, rng), camera.response).mean() < 1e-3


def test_a_coloured_lamp_has_to_be_told(rng):
    matt, gloss = spheres(PAINTS)
    lamp = (1.0, 0.8, 0.55)
    image = Camera().expose((matt + gloss) * lamp, rng)
    told, taken_for_white = (scores(image, matt, gloss, light=light) for light in (lamp, (1.0, 1.0, 1.0)))
    assert min(told) >= 0.95
    assert taken_for_white[0] >= 0.95  # missed rather than invented
    np.testing.assert_array_equal(specular_pixels(image, light=lamp), specular_pixels(image, light=(10.0, 8.0, 5.5)))


def test_a_spot_on_a_painted_wall_is_found_however_small(rng):
    y, x = np.mgrid[-1:1:120j, -1:1:160j]
    matt = np.ones((120, 160, 1)) * np.array([0.5, 0.25, 0.15])
    for width in (0.002, 0.05):
        gloss = 0.5 * np.exp(-(x**2 + y**2) / width)[..., None]
        assert min(scores(Camera().expose(matt + gloss, rng), matt, gloss)) >= 0.9


def test_a_clipped_middle_belongs_to_its_highlight(rng):
    y, x = np.mgrid[-1:1:120j, -1:1:160j]
    gloss = 3.0 * np.exp(-(x**2 + y**2) / 0.05)[..., None]
    image = Camera().expose(np.ones((120, 160, 1)) * np.array([0.5, 0.25, 0.15]) + gloss, rng)
    assert saturated_pixels(image).mean() > 0.02
    assert specular_pixels(image)[saturated_pixels(image)].all()


@pytest.mark.parametrize("value", [0, 7, 90, 200, 251, 255])
def test_even_grey_black_and_white_pictures_do_not_shine(value):
    assert not specular_pixels(np.full((40, 50, 3), value, np.uint8)).any()


def test_grey_and_white_matt_surfaces_are_not_marked(rng):
    greys = ((0.5, 0.5, 0.5), (0.9, 0.9, 0.9), (0.2, 0.2, 0.2), (0.52, 0.5, 0.48), (0.9, 0.88, 0.86), (0.3, 0.3, 0.31))
    matt, gloss = spheres(greys)
    assert not specular_pixels(Camera().expose(matt, rng)).any()
    assert (
        specular_pixels(Camera().expose(matt + gloss, rng)).mean() < 1e-3
    )  # grey tells nothing: said in the docstring


def test_a_white_sheet_beside_paint_is_not_marked(rng):
    linear = np.full((80, 120, 3), 0.8)
    linear[:, :60] = (0.5, 0.25, 0.15)
    assert specular_pixels(Camera().expose(linear * np.linspace(0.5, 1, 120)[:, None], rng)).mean() < 1e-3


def test_paler_paint_of_the_same_hue_is_not_marked(rng):
    linear = np.ones((80, 120, 1)) * np.array([0.5, 0.2, 0.1])
    linear[20:60, 40:80] += 0.2  # as a reflection would add, but with an edge
    assert specular_pixels(Camera().expose(linear, rng)).mean() < 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_posters_and_charts_hardly_shine(seed):
    sheet = poster((160, 200), seed)
    for light in (even_light((160, 200)), uneven_light((160, 200), seed)):
        assert specular_pixels(photograph(sheet, light, seed=seed)).mean() < 0.02
    chart, _ = colour_chart(24)
    assert specular_pixels(photograph(chart, uneven_light(chart.shape[:2], seed), seed=seed)).mean() < 0.005


def test_portraits_without_gloss_hardly_shine(scenes, lit_scene):
    for scene in (*scenes[:2], lit_scene):
        assert specular_pixels(scene.image, "linear").mean() < 0.02


def test_a_spot_on_a_forehead_is_found(scenes, rng):
    matt, marks = 0.7 * scenes[0].linear.astype(float), scenes[0].landmarks
    y, x = np.mgrid[: matt.shape[0], : matt.shape[1]]
    centre = marks.mean(axis=0) - [0, 0.45 * np.ptp(marks[:, 1])]
    gloss = 0.3 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 80)[..., None]
    precision, recall = scores(Camera().expose(matt + gloss, rng), matt, gloss)
    assert precision >= 0.9
    assert recall >= 0.5


def test_large_pictures_are_reduced_and_the_mask_is_not(rng, monkeypatch):
    matt, gloss = spheres(PAINTS)
    image = Camera().expose(matt + gloss, rng)
    full = specular_pixels(image)
    monkeypatch.setattr("liaam.photometry.masks.MOST_PIXELS", 10_000)
    reduced = specular_pixels(image[:-1, :-3])  # no multiple of the factor
    assert reduced.shape == (159, 237)
    overlap = (full[:-1, :-3] & reduced).sum() / (full[:-1, :-3] | reduced).sum()
    assert overlap > 0.8


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, -5.0])
def test_strange_floats_are_not_marked(bad, rng):
    matt, gloss = spheres(PAINTS)
    image = (matt + gloss).astype(np.float32)
    image[10:20, 10:20, 1] = bad
    marked = specular_pixels(image, "linear")
    assert not marked[11:19, 11:19].any()
    assert marked.any()


@given(arrays.arrays(np.uint8, (12, 9, 3)))
def test_any_picture_has_an_answer(image):
    assert specular_pixels(image).shape == (12, 9)


@pytest.mark.parametrize("light", [(1.0, 1.0), (1.0, 0.0, 1.0), (1.0, np.nan, 1.0), (1.0, -1.0, 1.0), 3.0])
def test_a_light_that_cannot_be_is_refused(light):
    with pytest.raises(CameraError, match="three positive numbers"):
        specular_pixels(np.zeros((9, 9, 3), np.uint8), light=light)
