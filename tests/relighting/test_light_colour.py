"""The colour of the light of a picture: what was multiplied is found, and corrected in the whole picture alike."""

import re
from dataclasses import replace

import numpy as np
import pytest

import liaam
from liaam.datasets import load_face
from liaam.errors import LiaamError
from liaam.fitting import FitStatus, Fitter
from liaam.io import read_image, write_image
from liaam.model import load_model
from liaam.photometry import linear_to_srgb, srgb_to_linear
from liaam.photometry.invariant import CHROMATICITY, LUMINANCE
from liaam.relighting import LightColour, Relighter
from liaam.relighting.light_colour import balanced_picture, colour_around
from liaam.relighting.painting import log_light

TINTS = {
    "warm": (0.35, 0.0, -0.7),
    "cold": (-0.3, 0.0, 0.4),
    "green": (-0.25, 0.3, -0.3),
    "a little warm": (0.12, 0.0, -0.2),
    "a little cold": (-0.1, 0.0, 0.12),
    "a little green": (-0.1, 0.12, -0.1),
}
"""Logarithms of gains of red, green and blue."""

NAMES = {"warm": "orange", "cold": "blue", "green": "green"}
WALL = np.s_[:60, :100]
"""A part of the photograph behind the head."""

TOLERANCE = 0.06
"""Largest error of the estimated log-chromaticity: 6 % of a ratio of channels."""


def tinted(image: np.ndarray, log_gains) -> np.ndarray:
    """Multiply a picture by gains in linear light."""
    light = np.clip(srgb_to_linear(image / 255.0) * np.exp(log_gains), 0.0, 1.0)
    return np.rint(255 * linear_to_srgb(light)).astype(np.uint8)


@pytest.fixture(scope="module")
def fitter():
    return Fitter(load_model("face"))


@pytest.fixture(scope="module")
def photograph():
    return read_image(load_face().image)


@pytest.fixture(scope="module")
def relit(fitter, photograph):
    """The photograph under each tint, and as it is ("")."""
    pictures = {"": photograph} | {name: tinted(photograph, tint) for name, tint in TINTS.items()}
    return {name: Relighter.of(fitter, picture, fitter.fit(picture)) for name, picture in pictures.items()}


def colour_on(picture: np.ndarray, part) -> np.ndarray:
    return CHROMATICITY @ log_light(picture, "srgb")[part].reshape(-1, 3).mean(axis=0)


def of_face(relighter: Relighter) -> np.ndarray:
    return ~np.isnan(relighter.certainty())


@pytest.mark.parametrize("name", TINTS)
def test_the_gains_that_were_multiplied_are_found(relit, name):
    found = relit[name].colour.chromaticity - relit[""].colour.chromaticity
    np.testing.assert_allclose(found, CHROMATICITY @ TINTS[name], atol=TOLERANCE)


@pytest.mark.parametrize("name", NAMES)
def test_a_strong_tint_has_a_name(relit, name):
    assert relit[name].colour.is_found
    assert relit[name].colour.name == NAMES[name]
    assert str(relit[name].colour).startswith(f"{NAMES[name]} (red ")


def test_a_weak_tint_is_said_to_be_nothing(relit):
    for name in ("", "a little warm", "a little green"):
        colour = relit[name].colour
        assert not colour.is_found
        assert (colour.name, str(colour)) == ("", "as in training")
        np.testing.assert_array_equal(colour.gains, 1.0)
        assert not colour.correction().any()


@pytest.mark.parametrize("name", NAMES)
def test_the_whole_picture_is_corrected(relit, photograph, name):
    """Wall, hair and clothes are as in the photograph, but for its own tint, which is below the limit."""
    relighter = relit[name]
    truth = tinted(photograph, -CHROMATICITY.T @ relit[""].colour.chromaticity)
    for mask in (WALL, of_face(relighter)):
        was, now = (
            np.abs(colour_on(each, mask) - colour_on(truth, mask)).max()
            for each in (relighter.picture, relighter.flat())
        )
        assert now < 0.12
        assert was > 0.25
    for made in (relighter.under("left"), relighter.like(relit[""])):
        np.testing.assert_allclose(colour_on(made, WALL), colour_on(relighter.flat(), WALL), atol=0.06)


@pytest.mark.parametrize("name", NAMES)
def test_kept_colour_is_kept_on_the_face_as_well(relit, name):
    relighter = relit[name]
    for made in (relighter.flat(balance=False), relighter.under("left", balance=False)):
        assert np.abs(made[WALL].astype(int) - relighter.picture[WALL]).max() <= 1
        face = of_face(relighter)
        np.testing.assert_allclose(colour_on(made, face), colour_on(relighter.picture, face), atol=0.1)


def test_a_picture_takes_the_colour_of_the_light_of_another(relit):
    made = relit[""].like(relit["cold"])
    change = colour_on(made, WALL) - colour_on(relit[""].picture, WALL)
    np.testing.assert_allclose(change, relit["cold"].colour.chromaticity, atol=0.05)


def test_strength_takes_a_part_of_the_colour(relit):
    relighter = relit["warm"]
    np.testing.assert_array_equal(relighter.flat(0.0), relighter.picture)
    own, half, whole = (colour_on(each, WALL) for each in (relighter.picture, relighter.flat(0.5), relighter.flat()))
    np.testing.assert_allclose(half, 0.5 * (own + whole), atol=0.03)


def test_the_colour_alone_is_corrected(relit, fitter, photograph):
    relighter = relit["warm"]
    made, flat = relighter.colour_corrected(), relighter.flat()
    np.testing.assert_array_equal(made[WALL], flat[WALL])  # which keeps its light but for the colour
    brightness = [each.astype(float) @ LUMINANCE[0] for each in (relighter.picture, made, flat)]
    kept, changed = (np.corrcoef(brightness[0].ravel(), each.ravel())[0, 1] for each in brightness[1:])
    assert kept > 0.999 > changed  # the shading stays
    np.testing.assert_array_equal(relighter.colour_corrected(0.0), relighter.picture)
    np.testing.assert_array_equal(relit[""].colour_corrected(), relit[""].picture)  # its tint is below the limit
    warm = tinted(photograph, TINTS["warm"])
    np.testing.assert_array_equal(liaam.relight(fitter.model, warm, "own"), made)
    with pytest.raises(LiaamError, match="balance=False keeps it"):
        liaam.relight(fitter.model, warm, "own", balance=False)


def test_a_tone_and_a_doubtful_fit_have_no_colour_of_light(fitter, photograph, relit):
    grey = srgb_to_linear(photograph / 255.0) @ LUMINANCE[0]
    sepia = np.rint(255 * linear_to_srgb(grey[..., None] * (1.0, 0.8, 0.55))).astype(np.uint8)
    assert not Relighter.of(fitter, sepia, fitter.fit(sepia)).colour.is_found
    warm = relit["warm"].picture
    result = replace(fitter.fit(warm), status=FitStatus.DOUBTFUL)
    relighter = Relighter.of(fitter, warm, result)
    assert not relighter.colour.is_found
    np.testing.assert_array_equal(relighter.flat()[:20], warm[:20])


# Single estimates


def test_what_may_be_the_colour_of_the_object_needs_its_surroundings():
    """Skin is reddish and yellowish; so is warm light."""
    own = np.array([0.4, 0.4])
    warm = LightColour(np.array([0.3, 0.6]), 0.01 * np.eye(2))
    assert np.abs(warm.shared_with(np.zeros(2), own).chromaticity).max() < 0.2
    np.testing.assert_allclose(warm.shared_with(np.array([0.3, 0.6]), own).chromaticity, warm.chromaticity)
    np.testing.assert_allclose(warm.shared_with(None, own).chromaticity, warm.chromaticity)
    cold = LightColour(np.array([-0.2, -0.5]), 0.01 * np.eye(2))
    np.testing.assert_allclose(cold.shared_with(np.array([0.1, 0.1]), own).chromaticity, cold.chromaticity)
    nothing = LightColour.unknown()
    np.testing.assert_array_equal(nothing.shared_with(np.ones(2), own).chromaticity, 0.0)


def test_bright_surroundings_have_the_colour_of_light():
    shape = np.array([(40.0, 40.0), (60.0, 40.0), (50.0, 60.0)])
    image = np.full((100, 100, 3), 180, np.uint8)
    image[:30] = (90, 60, 40)
    tint = (0.3, 0.0, -0.5)
    found = colour_around(tinted(image, tint), shape, "srgb")
    np.testing.assert_allclose(found, CHROMATICITY @ tint, atol=0.02)
    assert colour_around(np.full((100, 100, 3), 255, np.uint8), shape, "srgb") is None
    assert colour_around(np.zeros((100, 100, 3), np.uint8), shape, "srgb") is None
    assert (
        colour_around(image, np.array([(-10.0, -10.0), (120.0, -10.0), (120.0, 120.0), (-10.0, 120.0)]), "srgb") is None
    )


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((1, 0.3, -1), "orange"),
        ((-0.5, 0, 1), "blue"),
        ((-1, 1, -1), "green"),
        ((1, -1, 1), "magenta"),
        ((1, 0, 0), "red"),
    ],
)
def test_names_are_those_of_the_nearest_colours(rgb, name):
    colour = LightColour(0.3 * CHROMATICITY @ np.array(rgb, float), 0.001 * np.eye(2))
    assert colour.name == name
    assert LUMINANCE[0] @ colour.gains == pytest.approx(1.0)
    assert colour.to_dict()["name"] == name


def test_an_estimate_between_nothing_and_found_counts_by_degrees():
    shares = [LightColour(np.array([distance, 0.0]), np.eye(2)).share for distance in (2.9, 3.1, 3.3, 3.6)]
    assert shares[0] == 0.0 < shares[1] < shares[2] < shares[3] == 1.0


# Pictures


def warm_light() -> LightColour:
    return LightColour(CHROMATICITY @ np.array(TINTS["warm"]), 0.001 * np.eye(2))


def test_a_grey_keeps_its_luminance():
    greys = np.repeat(np.arange(30, 140, dtype=np.uint8), 3).reshape(1, -1, 3)
    under_warm = tinted(greys, np.log(warm_light().gains))
    corrected = balanced_picture(under_warm, warm_light().correction(), "srgb")
    np.testing.assert_allclose(corrected.astype(int), greys.astype(int), atol=2)


def test_what_is_clipped_takes_no_false_colour():
    greys = np.repeat(np.arange(60, 256, dtype=np.uint8), 3).reshape(1, -1, 3)
    bright = tinted(greys, np.log(1.8 * warm_light().gains))
    assert (bright[0, -20:, 0] == 255).all()
    corrected = balanced_picture(bright, warm_light().correction(), "srgb").astype(int)[0]
    assert np.ptp(corrected, axis=1).max() < 30
    assert corrected[-1].min() > 240
    assert (np.diff(corrected.max(axis=1)) >= -1).all()  # and no step is darker than the one before
    white = np.full((1, 1, 3), 255, np.uint8)
    np.testing.assert_array_equal(balanced_picture(white, warm_light().correction(), "srgb"), white)
    red = np.array([[[255, 40, 40]]], np.uint8)
    made = balanced_picture(red, warm_light().correction(), "srgb")[0, 0].astype(int)
    assert made[0] > 2.5 * made[1:].max()


def test_the_command_says_what_it_found(run, photograph, tmp_path):
    write_image(tmp_path / "usual.png", photograph)
    code, _, err = run("relight", tmp_path / "usual.png", "--light", "own", "-o", tmp_path / "own.png")
    assert code == 0 and "no clear colour" in err
    np.testing.assert_array_equal(read_image(tmp_path / "own.png"), photograph)
    write_image(tmp_path / "cold.png", tinted(photograph, TINTS["cold"]))
    pictures = {}
    for options, done in (((), "corrected in the whole image"), (("--no-balance",), "kept")):
        code, _, err = run("relight", tmp_path / "cold.png", *options, "-o", tmp_path / "flat.png")
        assert code == 0
        assert re.search(
            rf"cold.png: the light is blue \(red 0.\d\d, .* the light of training\): {done}", " ".join(err.split())
        )
        pictures[done] = read_image(tmp_path / "flat.png")
    kept, corrected = (
        picture[WALL].mean(axis=(0, 1)) for picture in (pictures["kept"], pictures["corrected in the whole image"])
    )
    assert corrected[2] < 0.85 * kept[2]
