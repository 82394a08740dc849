"""Finding the object without a start: by the model's own directions of gradients, in generated scenes."""

import pickle
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

import liaam
from liaam.errors import ImageError, MethodError, StartError
from liaam.fitting import Detection, Finder, FitStatus, Fitter, find
from liaam.fitting.loop.levels import LinearImage
from liaam.fitting.search import finder as search, responses
from liaam.fitting.search.finder import (
    DOUBTFUL,
    LARGEST,
    LEAST_PIXELS,
    MOST_PIXELS,
    SMALLEST,
    STEP,
    search_sizes,
)
from liaam.fitting.search.responses import SPECTRA_KEPT, TILES, Bank
from liaam.fitting.search.templates import TEMPLATE, Field, OrientationTemplate, channels_of, turned_channels
from liaam.model import AAM, MESH, Level
from liaam.model.shape import diagonal_of, rotation
from liaam.workers import one_thread
from scenes import DIFFUSE, Head, Pose, lateral, narrow_band_camera, render
from setups import model_pixels, train_on

WIDE = (240, 316)


@pytest.fixture(scope="module")
def finder(model) -> Finder:
    return Finder(model)


@lru_cache
def photograph(pose: Pose, lights=DIFFUSE, size=WIDE):
    return render(Head(7), pose, lights=lights, camera=narrow_band_camera(), size=size, mixing="planckian")


def error(candidate: Detection, truth: np.ndarray) -> float:
    """Mean distance from the truth as a share of the object's diagonal."""
    return float(np.linalg.norm(candidate.landmarks - truth, axis=1).mean()) / diagonal_of(truth)


@pytest.mark.parametrize(
    ("pose", "lights"),
    [
        (Pose(scale=0.9), lateral("right")),
        (Pose(scale=0.35, x=82, y=-52), DIFFUSE),
        (Pose(scale=0.35, x=82, y=-52), lateral("left")),
        (Pose(scale=0.5, x=-68, y=22, roll=np.deg2rad(15)), lateral("right")),
        (Pose(scale=0.6, roll=np.deg2rad(-15)), lateral("left")),
    ],
    ids=["large", "small", "small, lit", "clockwise", "anticlockwise"],
)
def test_the_object_is_found_under_any_light(finder, lights, pose):
    scene = photograph(pose, lights)
    (best,) = finder.find(scene.image)
    assert error(best, scene.landmarks) < 0.06
    assert best.rotation == pytest.approx(pose.roll, abs=np.deg2rad(6))
    assert best.scale * finder.model.diagonal == pytest.approx(diagonal_of(scene.landmarks), rel=0.15)
    assert not best.doubtful


def test_two_objects_in_one_picture(finder):
    left = photograph(Pose(scale=0.8), lateral("left"), size=(240, 200))
    right = photograph(Pose(scale=0.6, roll=np.deg2rad(10)), size=(240, 200))
    picture = np.concatenate([left.image, right.image], axis=1)
    truths = [left.landmarks, right.landmarks + np.array([200, 0])]
    found = finder.find(picture, limit=None, least=DOUBTFUL)
    assert len(found) == 2
    assert [candidate.score for candidate in found] == sorted((c.score for c in found), reverse=True)
    for truth in truths:
        assert min(error(candidate, truth) for candidate in found) < 0.06
    (best,) = finder.find(picture, limit=1)
    (other,) = best.others
    assert min(error(other, truth) for truth in truths) < 0.06
    assert finder.find(left.image)[0].others == ()
    assert all(candidate.others == () for candidate in found)


def fits_counted(finder, monkeypatch, image, **options):
    """What is found, and at how many places the small model was fitted."""
    fit, places = Finder._fit_place, []

    def counted(self, linear, place):
        places.append((*place.centre, place.scale, id(place.template)))
        return fit(self, linear, place)

    monkeypatch.setattr(Finder, "_fit_place", counted)
    found = finder.find(image, **options)
    monkeypatch.setattr(Finder, "_fit_place", fit)
    assert len(set(places)) == len(places)
    return found, len(places)


@pytest.fixture
def limits(monkeypatch):
    """Give the function that changes limits of the search with templates."""

    def change(**changes) -> None:
        monkeypatch.setattr(search, "OF_TEMPLATES", replace(search.OF_TEMPLATES, **changes))

    return change


def test_a_single_object_is_not_sought_where_it_cannot_be(finder, monkeypatch, limits):
    """No place is fitted after one that leaves no doubt, nor one that responds far less: the answer is the same."""
    image = photograph(Pose(scale=0.7)).image
    limits(clear=np.inf, sure=np.inf, worth=0.0)  # without the places of further objects
    (every,), all_places = fits_counted(finder, monkeypatch, image)
    limits(sure=every.score + 0.5)
    (surely,), few_places = fits_counted(finder, monkeypatch, image)
    limits(sure=np.inf, worth=0.999)
    (strongest,), one_place = fits_counted(finder, monkeypatch, image)
    assert all_places > few_places >= one_place == 1
    for found in (surely, strongest):
        np.testing.assert_array_equal(found.landmarks, every.landmarks)
    assert fits_counted(finder, monkeypatch, image, limit=2)[1] > all_places  # of several, all places count


@pytest.mark.parametrize("scale, small_are_sought", [(0.7, False), (0.2, True)])
def test_small_objects_are_sought_where_no_large_one_is_sure(finder, monkeypatch, scale, small_are_sought):
    """The answer is that of a search at all sizes."""
    picture = photograph(Pose(scale=scale)).image
    shorter, field, sizes = min(picture.shape[:2]), search.Grey.field, []
    monkeypatch.setattr(search.Grey, "field", lambda self, size, small: sizes.append(size) or field(self, size, small))
    (found,) = finder.find(picture)
    assert sorted(sizes) == [
        size for size in search.search_sizes(picture.shape[:2], TEMPLATE) if small_are_sought or size >= 0.3 * shorter
    ]
    monkeypatch.setattr(search, "LARGE", 0.0)
    (of_all,) = finder.find(picture)
    np.testing.assert_array_equal(found.landmarks, of_all.landmarks)


def test_no_place_is_fitted_twice(finder, monkeypatch, limits):
    """Places of large objects, which were fitted first, count again beside those of small ones."""
    limits(sure=np.inf, worth=0.0)
    image = photograph(Pose(scale=0.7)).image
    (found,), in_two = fits_counted(finder, monkeypatch, image)
    monkeypatch.setattr(search, "LARGE", 0.0)
    (of_all,), in_one = fits_counted(finder, monkeypatch, image)
    assert 2 <= in_one <= in_two <= in_one + search.OF_TEMPLATES.n_large
    assert found.score == of_all.score


def test_a_place_that_scores_too_little_ends_no_search(finder, monkeypatch, limits):
    """However strongly it responds: neither one below what is asked for nor a doubtful one is sure."""
    limits(clear=np.inf, sure=0.0, worth=0.0)  # without the places of further objects
    image = photograph(Pose(scale=0.7)).image
    (found,), at_once = fits_counted(finder, monkeypatch, image)
    assert (at_once, found.score > DOUBTFUL) == (1, True)
    none, tried = fits_counted(finder, monkeypatch, image, least=found.score + 0.01)
    assert (none, tried > 1) == ([], True)
    limits(least_score=found.score + 0.01)
    assert fits_counted(finder, monkeypatch, image)[1] == tried


def test_weaker_places_are_looked_at_where_the_best_lie_outside(scenes, monkeypatch, limits):
    # A model of the pictures as they are: mirrored copies let the search see a little of the head anywhere.
    finder = Finder(train_on(scenes, diagonal=80.0, copies=0))
    image, asked, is_inside = photograph(Pose(scale=0.7)).image, [], search.is_inside
    limits(worth=1.0)  # a single place, which is the object

    def anywhere_but_there(shape, picture):
        asked.append(shape)
        return is_inside(shape, picture) and bool(np.abs(shape - asked[0]).max() > 5)

    monkeypatch.setattr(search, "is_inside", anywhere_but_there)
    (found,) = finder.find(image)
    assert len(asked) > 1
    assert 0 < found.score < DOUBTFUL


def test_a_picture_that_shows_nothing_is_looked_at_once(finder, monkeypatch):
    field, sizes = search.Grey.field, []
    monkeypatch.setattr(search.Grey, "field", lambda self, size, small: sizes.append(size) or field(self, size, small))
    (found,) = finder.find(np.zeros((240, 320, 3), np.uint8))
    assert found.score == 0
    assert len(set(sizes)) == len(sizes)


def test_one_thread_finds_what_several_find(finder):
    image = photograph(Pose(scale=0.7)).image
    with one_thread():
        (alone,) = finder.find(image)
    np.testing.assert_array_equal(finder.find(image)[0].landmarks, alone.landmarks)


def test_a_large_picture(finder):
    scene = photograph(Pose(scale=0.6, x=-30, y=15))
    large = np.repeat(np.repeat(scene.image, 9, axis=0), 9, axis=1)
    (found,) = finder.find(large)
    truth = 9 * (scene.landmarks + 0.5) - 0.5
    assert error(found, truth) < 0.06


def smooth_noise(rng: np.random.Generator, size: tuple[int, int], blur: float) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.normal(size=(*size, 3)), (0, 0), blur)
    return (0.5 + 0.15 * noise / noise.std()).clip(0.05, 0.95).astype(np.float32)


GRID = np.stack(np.meshgrid(np.linspace(5, 114, 4), np.linspace(5, 84, 4)), axis=-1).reshape(-1, 2)


def pattern_picture(rng: np.random.Generator, pattern: np.ndarray, scale: float, turn: float, light: np.ndarray):
    """A patterned cloth, a little stretched, on another, and its landmarks."""
    stretch = np.eye(2) + rng.normal(0, 0.02, (2, 2))
    matrix = scale * rotation(np.deg2rad(turn)) @ stretch
    offset = rng.uniform([140, 110], [180, 130]) - matrix @ [60, 45]
    whole = np.column_stack([matrix, offset])
    cloth = cv2.warpAffine(pattern, whole, (320, 240), flags=cv2.INTER_AREA)
    mask = cv2.warpAffine(np.ones(pattern.shape[:2], np.float32), whole, (320, 240))[..., None]
    ramp = np.linspace(0, 1, 320, dtype=np.float32)[None, :, None] * (light[1] - light[0]) + light[0]
    picture = (mask * cloth + (1 - mask) * smooth_noise(rng, (240, 320), 4.0)) * ramp
    return picture.astype(np.float32), GRID @ matrix.T + offset


def test_the_object_need_not_be_a_face(rng):
    pattern, light = smooth_noise(rng, (90, 120), 4.0), np.array([[1.0, 1.0, 1.0], [1.0, 0.95, 0.9]])
    model = liaam.train(
        [pattern_picture(rng, pattern, 1.2, rng.normal(0, 3), light) for _ in range(6)], diagonal=80.0, leave_out=False
    )
    other = np.array([[0.15, 0.2, 0.3], [1.0, 0.9, 0.7]])
    for scale, turn in ((0.6, -12.0), (1.6, 8.0)):
        picture, truth = pattern_picture(rng, pattern, scale, turn, other)
        (found,) = find(model, picture)
        assert error(found, truth) < 0.03
        assert not found.doubtful


@pytest.mark.parametrize("method", ["li", "igo", "grey"])
def test_a_fit_without_a_start_searches(model, same_light_scene, method):
    result = liaam.fit(model, same_light_scene.image, method=method)
    assert result.status.ok
    assert model_pixels(model, result.landmarks, same_light_scene.landmarks) < 1.0
    assert result.found is not None
    assert result.found.score > DOUBTFUL
    np.testing.assert_allclose(result.start, result.found.landmarks, atol=0.5)  # of other modes


def test_a_fit_under_lateral_light_searches(model, lit_scene):
    result = Fitter(model, "li").fit(lit_scene.image)
    assert result.status == FitStatus.CONVERGED
    assert model_pixels(model, result.landmarks, lit_scene.landmarks) < 1.0


def test_a_candidate_is_a_start(model, lit_scene):
    fitter = Fitter(model, "li")
    (candidate,) = fitter.find(lit_scene.image)
    result = fitter.fit(lit_scene.image, candidate)
    assert result.found is candidate
    given = fitter.fit(lit_scene.image, candidate.landmarks)
    assert given.found is None
    np.testing.assert_array_equal(result.landmarks, given.landmarks)


def random_field(rng: np.random.Generator, *size: int) -> np.ndarray:
    return (rng.normal(size=size) + 1j * rng.normal(size=size)).astype(np.complex64)


def template_of(field: np.ndarray) -> OrientationTemplate:
    return OrientationTemplate(channels_of(field, 2), np.zeros(2), 0.0, np.zeros(4))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_responses_are_mean_cosines_of_orientations(rng, n):
    """At each place where all fit in, the sum of the real parts, by definition; templates have different sizes."""
    values, parts = random_field(rng, 9, 11), [random_field(rng, 3 + i, 5 - i) for i in range(n)]
    bank = Bank([template_of(part) for part in parts], pad=0)
    peaks = bank.peaks(Field(values, np.ones(2)), 0, count=1, worth=0.0)
    height, width = np.max([part.shape for part in parts], axis=0)
    for number, part in enumerate(parts):
        windows = np.lib.stride_tricks.sliding_window_view(values, part.shape)[: 10 - height, : 12 - width]
        responses = (windows * part.conj()).real.sum(axis=(2, 3)) / np.abs(part).sum()
        (at,) = np.flatnonzero(peaks.templates == number)
        assert peaks.responses[at] == pytest.approx(responses.max(), abs=1e-6)
        place = np.array(np.unravel_index(responses.argmax(), responses.shape))
        np.testing.assert_allclose(peaks.centres[at], place[::-1], atol=1e-9)


def test_what_was_searched_before_makes_no_difference(model):
    used, pictures = Finder(model), [photograph(Pose(scale=0.8), size=size).image for size in (WIDE, (90, 800), WIDE)]
    for picture in pictures:
        seen, fresh = used.find(picture)[0], Finder(model).find(picture)[0]
        assert seen.score == fresh.score
        assert np.array_equal(seen.landmarks, fresh.landmarks)
    assert 0 < sum(height * width for height, width in used.templates._spectra) <= SPECTRA_KEPT
    again = pickle.loads(pickle.dumps(used))  # as one that is sent to another process
    assert not again.templates._spectra
    assert again.find(pictures[0])[0].score == used.find(pictures[0])[0].score


def test_types_of_picture_make_no_difference(finder):
    scene = photograph(Pose(scale=0.5))
    stored = np.clip(scene.image, 0, 1)
    (reference,) = finder.find(stored)
    for dtype in (np.uint8, np.uint16):
        (found,) = finder.find(np.round(stored * np.iinfo(dtype).max).astype(dtype))
        assert np.abs(found.landmarks - reference.landmarks).max() < 0.5
    (grey,) = finder.find(stored.mean(axis=2))
    assert error(grey, scene.landmarks) < 0.06


def test_exposure_makes_no_difference(finder):
    scene = photograph(Pose(scale=0.5))
    (dark,) = finder.find(0.1 * scene.image)
    assert error(dark, scene.landmarks) < 0.06
    assert not dark.doubtful


def test_holes_do_not_hurt(finder):
    scene = photograph(Pose(scale=0.6))
    image = scene.image.copy()
    image[:60, :60] = np.nan
    image[-40:, -40:] = np.inf
    (found,) = finder.find(image)
    assert error(found, scene.landmarks) < 0.06


def test_a_model_of_grey_pictures_is_found(grey_model):
    scene = photograph(Pose(scale=0.5), lateral("left"))
    assert error(find(grey_model, scene.image)[0], scene.landmarks) < 0.06


FLAT = {
    "black": np.zeros((120, 160, 3), np.uint8),
    "white": np.full((120, 160, 3), 65535, np.uint16),
    "plain": np.full((120, 160), 0.4, np.float32),
    "nothing": np.full((120, 160, 3), np.nan, np.float32),
    "tiny": np.zeros((8, 8, 3), np.uint8),
    "strip": np.zeros((8, 900, 3), np.uint8),
}


@pytest.mark.parametrize("image", FLAT.values(), ids=FLAT)
def test_a_picture_without_anything_gives_the_middle_and_score_0(finder, image):
    (found,) = finder.find(image)
    assert found.score == 0
    assert found.doubtful
    middle = 0.5 * (np.array(image.shape[1::-1]) - 1)
    assert np.abs(found.landmarks.mean(axis=0) - middle).max() < 0.05 * diagonal_of(found.landmarks)
    assert finder.find(image, limit=None, least=DOUBTFUL) == []


def test_noise_is_doubtful(finder, rng):
    for shape in [(8, 8, 3), (40, 300, 3), (160, 200, 3)]:
        (found,) = finder.find(rng.integers(0, 256, shape, dtype=np.uint8))
        assert np.isfinite(found.landmarks).all()
        assert found.doubtful


def test_a_flat_picture_fails_with_a_status(model):
    result = Fitter(model, "grey").fit(FLAT["plain"])
    assert result.status == FitStatus.NO_TEXTURE
    assert result.found is not None
    assert result.found.score == 0


def test_finding_all_of_nothing_is_an_error(model):
    with pytest.raises(StartError, match=r"wall\.png: no object was found .*0\.00.*give a start"):
        Fitter(model, "grey").find_all(FLAT["plain"], name="wall.png")


def test_a_file_is_a_picture(model, tmp_path):
    scene = photograph(Pose(scale=0.5))
    path = tmp_path / "portrait.png"
    liaam.write_image(path, np.round(255 * scene.image.clip(0, 1)).astype(np.uint8))
    assert error(find(model, path)[0], scene.landmarks) < 0.06
    with pytest.raises(ImageError, match=r"missing\.png"):
        find(model, tmp_path / "missing.png")


def test_bad_input_is_refused(model, finder):
    with pytest.raises(ImageError, match="too small"):
        finder.find(np.zeros((7, 30), np.uint8))
    with pytest.raises(MethodError, match="limit 0 is too small; give 1 or more"):
        finder.find(FLAT["black"], limit=0)
    with pytest.raises(MethodError, match=r"train it again, or give a start \(--init\)"):
        find(without_orientations(model), FLAT["black"])


def without_orientations(model: AAM) -> AAM:
    levels = tuple(
        Level(level.blur, {name: kept for name, kept in level.appearances.items() if name != "search"})
        for level in model.levels
    )
    return model.with_view(MESH, levels=levels)


def test_sizes_cover_the_range():
    sizes = search_sizes((480, 640), TEMPLATE)
    assert sizes[0] == pytest.approx(SMALLEST * 480)
    assert LARGEST * 480 / STEP < sizes[-1] <= LARGEST * 480 * 1.001
    assert search_sizes((40, 40), TEMPLATE)[0] == LEAST_PIXELS
    np.testing.assert_allclose(search_sizes((8, 8), TEMPLATE), [8 * LARGEST])


def test_an_elongated_object_in_a_box_is_searched_for_at_its_size():
    # The surroundings of a box of 300 x 60 pixels, whose diagonal is 306
    around = (96, 480)
    assert search_sizes(around, TEMPLATE)[-1] < 200
    sizes = search_sizes(around, TEMPLATE, known=306.0)
    assert sizes[-1] > 306.0
    np.testing.assert_array_equal(sizes[: len(search_sizes(around, TEMPLATE))], search_sizes(around, TEMPLATE))
    # Of other boxes nothing changes.
    np.testing.assert_array_equal(search_sizes((160, 160), TEMPLATE, known=141.0), search_sizes((160, 160), TEMPLATE))


# Images that are many times as long as high.


def field_pixels(size, sizes) -> float:
    """Pixels of all fields, without what surrounds them."""
    return sum(np.prod(np.maximum(np.array(size) * TEMPLATE / each, 8)) for each in sizes)


@pytest.mark.parametrize("ratio", [1, 3, 11])
@pytest.mark.parametrize("shorter", [16, 100, 300, 3000])
def test_panoramas_are_searched_at_the_sizes_of_a_square(shorter, ratio):
    np.testing.assert_array_equal(
        search_sizes((shorter, ratio * shorter), TEMPLATE), search_sizes((shorter, shorter), TEMPLATE)
    )


@pytest.mark.parametrize("size", [(8, 200_000), (64, 40_000), (200_000, 8), (100, 5_000_000), (8, 60_000_000)])
def test_the_fields_of_a_strip_are_bounded(size):
    """In a longer strip fewer sizes are searched, of which the largest objects are the last to be left out."""
    sizes = search_sizes(size, TEMPLATE)
    assert len(sizes) >= 1
    assert field_pixels(size, sizes) <= MOST_PIXELS
    assert sizes[-1] > LARGEST * min(size) / STEP


def test_responses_of_all_channels_are_summed(rng):
    values, template = random_field(rng, 9, 11), rng.normal(size=(5, 4, 3)).astype(np.float32)
    bank = Bank([OrientationTemplate(template, np.zeros(2), 0.0, np.zeros(4))], pad=0, normalised=True)
    peaks = bank.peaks(Field(values, np.ones(2)), 0, count=1, worth=0.0)
    windows = np.lib.stride_tricks.sliding_window_view(channels_of(values, 5), (4, 3), axis=(1, 2))
    responses = np.einsum("cyxij,cij->yx", windows, template)
    assert peaks.responses[0] == pytest.approx(responses.max(), rel=1e-5)
    place = np.unravel_index(responses.argmax(), responses.shape)
    np.testing.assert_allclose(peaks.centres[0], place[::-1], atol=1e-9)


def test_the_doubled_angle_does_not_tell_the_brighter_side(rng):
    directions = random_field(rng, 4, 5)
    np.testing.assert_allclose(channels_of(-directions, 5)[2:], channels_of(directions, 5)[2:], atol=1e-6)
    np.testing.assert_allclose(channels_of(-directions, 2), -channels_of(directions, 2), atol=1e-6)
    turned = turned_channels(channels_of(directions, 5), 0.7)
    np.testing.assert_allclose(turned, channels_of(directions * np.exp(0.7j).astype(np.complex64), 5), atol=1e-5)


@pytest.mark.parametrize("size", [(9, 900), (900, 9), (70, 80)])
def test_fields_are_compared_by_tiles(rng, monkeypatch, size):
    """What they find is the same as in one tile, and they are hardly larger together than the field."""
    parts = [random_field(rng, 5, 7), random_field(rng, 7, 4), random_field(rng, 6, 6)]
    templates = [template_of(part) for part in parts]
    field = Field(random_field(rng, *size), np.ones(2))
    transformed, spectra = [], responses.spectra
    monkeypatch.setattr(responses, "spectra", lambda *about: transformed.append(about[2]) or spectra(*about))
    tiled = Bank(templates, pad=3).peaks(field, 0, count=50, worth=0.0)
    assert max(side for sides in transformed for side in sides) <= max(TILES) * 7 + 3
    assert sum(height * width for height, width in transformed) < 2.2 * (size[0] + 6) * (size[1] + 6)
    monkeypatch.setattr(responses, "TILES", (150.0,))
    whole = Bank(templates, pad=3).peaks(field, 0, count=50, worth=0.0)
    np.testing.assert_array_equal(tiled.templates, whole.templates)
    np.testing.assert_allclose(tiled.responses, whole.responses, atol=1e-6)
    np.testing.assert_allclose(tiled.centres, whole.centres, atol=1e-9)


@pytest.mark.parametrize("across", [True, False])
def test_fields_are_sampled_beyond_the_sides_that_opencv_can_take(rng, across):
    values = random_field(rng, 12, 40_000)
    points = rng.uniform((39_000, 2), (39_900, 9), (50, 2))
    expected = Field(values[:, 38_900:], np.ones(2)).strength(points - (38_900, 0))
    field, at = (Field(values, np.ones(2)), points) if across else (Field(values.T, np.ones(2)), points[:, ::-1])
    np.testing.assert_allclose(field.strength(at), expected, atol=0.05)
    np.testing.assert_array_equal(field.strength(at + 50_000), 0.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_object_is_found_in_a_long_strip(finder, axis):
    """In one with a field that is longer than OpenCV can sample, near its far end, on a ground that grows brighter."""
    scene, size, part = photograph(Pose(), size=(240, 200)), 0.35, np.s_[16:72, 7:63]
    reduced = cv2.resize(np.float32(np.clip(scene.image, 0, 1)), None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    picture, points = reduced[part], size * (scene.landmarks + 0.5) - 0.5 - (part[1].start, part[0].start)
    side, length, first = len(picture), 60_000, 58_000
    ground = np.linspace(0.0, 1.0, length, dtype=np.float32)
    strip = np.tile(ground[None, :, None] if axis else ground[:, None, None], (side, 1, 3) if axis else (1, side, 3))
    strip[np.s_[:, first : first + side] if axis else np.s_[first : first + side]] = picture
    truth = points + first * np.eye(2)[1 - axis]
    assert diagonal_of(truth) < 0.95 * side
    (best,) = finder.find(strip)
    assert error(best, truth) < 0.1
    assert not best.doubtful


# Objects that lie in any way.


@pytest.fixture(scope="module")
def turning(model) -> Fitter:
    return Fitter(model, rotations="all")


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turned_objects_are_found_where_that_is_asked_for(turning, quarters):
    scene = photograph(Pose(scale=0.8))
    image, points = scene.image, scene.landmarks
    for _ in range(quarters):
        image = np.ascontiguousarray(np.rot90(image))
        points = np.column_stack([points[:, 1], image.shape[0] - 1 - points[:, 0]])
    result = turning.fit(image)
    assert model_pixels(turning.model, result.landmarks, points) < 2.0
    turned = np.exp(1j * (result.found.rotation + quarters * np.pi / 2))
    assert abs(np.angle(turned)) < np.deg2rad(15)


def test_an_upright_object_is_the_same_among_all_rotations(turning, finder):
    image = photograph(Pose(scale=0.7)).image
    (upright,), (found,) = finder.find(image), turning.find(image)
    np.testing.assert_allclose(found.landmarks, upright.landmarks, atol=1.0)


def test_objects_that_fill_the_frame_are_tried_in_four_ways(turning, finder):
    linear = LinearImage(photograph(Pose(scale=1.0)).image, "srgb")
    filled = [search._Search(each, linear, 10, each.templates) for each in (finder, turning.finder)]
    for each in filled:
        each.for_all()
    assert [len(each.filling()) for each in filled] == [2, 8]


def test_rotations_that_do_not_exist_are_refused(model):
    with pytest.raises(MethodError, match="unknown rotations 'sideways'; choose from upright, all"):
        Fitter(model, rotations="sideways")
