"""Relit pictures: near the truth, without a seam, and under lights from where they are said to come."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import liaam
from experiments.relit import LIGHTS, flat_error, lit_pairs, mesh_mask, seam, train_on_flat_light
from liaam.errors import LiaamError, MethodError
from liaam.fitting import Fitter
from liaam.io import write_image
from liaam.model.mesh import ReferenceFrame, delaunay
from liaam.relighting import Lamp, Relighter
from liaam.relighting.extrapolation import Surroundings, carried
from liaam.relighting.highlights import spared
from liaam.relighting.lamp import normals_of
from liaam.relighting.painting import Region, eight_bits, log_light
from liaam.relighting.relighter import lamps_of
from liaam.relighting.shading import without_marks, without_pairs
from scenes import Head

SIZE = (240, 180)

BAR, SEAM = 0.16, 2.0
"""What is reached with a small model of ten pictures; ``python -m benchmarks relight`` measures larger ones. The light
is smooth: at the edge of a hard shadow it is a little beside it."""


@pytest.fixture(scope="module")
def head():
    """Model of a person, and a picture under hard light with its truth."""
    model = train_on_flat_light(Head(5), 6, SIZE, leave_out=False, diagonal=110.0)
    (pair,) = lit_pairs(Head(5), {"right": LIGHTS["right"]}, SIZE)
    return model, pair


@pytest.fixture(scope="module")
def taken_apart(head):
    model, pair = head
    fitter = Fitter(model)
    result = fitter.fit(pair.lit.image)
    return Relighter.of(fitter, pair.lit.image, result)


# The bars


def test_the_flat_picture_is_near_the_truth(head, taken_apart):
    model, pair = head
    made = log_light(taken_apart.picture, "srgb")
    before = flat_error(model, made, taken_apart.shape, pair.flat)
    made[taken_apart.region.box] = taken_apart.log_flat
    assert flat_error(model, made, taken_apart.shape, pair.flat) < BAR < 0.8 < before
    truth = np.log(np.maximum(pair.flat.linear, 1e-4))
    assert flat_error(model, truth, taken_apart.shape, pair.flat) < 0.02  # the measure's own


def test_what_is_kept_is_in_single_precision(taken_apart):
    assert taken_apart.log_flat.dtype == taken_apart.log_own.dtype == taken_apart._grain.dtype == np.float32


def fine(log: np.ndarray, inside: np.ndarray, scale: float) -> np.ndarray:
    """Detail of log luminance within a mask, finer than a Gaussian."""
    from scipy.ndimage import gaussian_filter

    mean = gaussian_filter(log * inside, scale) / np.maximum(gaussian_filter(inside.astype(float), scale), 1e-6)
    return (log - mean)[inside]


def test_an_object_between_pixels_is_left_as_it_is(head, taken_apart):
    model, pair = head
    fitter, points = Fitter(model), taken_apart.shape
    tiny = 0.6 * (points - points.mean(axis=0)) / np.ptp(points) + 60.5
    relighter = Relighter.of(fitter, pair.lit.image, replace(fitter.fit(pair.lit.image), landmarks=tiny))
    assert relighter.certain == 0.0
    np.testing.assert_array_equal(relighter.flat(), relighter.picture)
    np.testing.assert_array_equal(relighter.under((1, 0, 1)), relighter.picture)


def test_a_toned_photograph_keeps_its_tone(head):
    """In black and white, nothing tells the colour of the light from the tone of the paper."""
    model, pair = head
    tone = np.float32([0.06, 0.0, -0.05])
    grey = log_light(pair.lit.image, "srgb").mean(axis=2, keepdims=True)
    relighter = Relighter.of(Fitter(model), eight_bits(grey + tone, "srgb"), Fitter(model).fit(pair.lit.image))
    shading = relighter.shading()[~np.isnan(relighter.certainty())]
    assert np.abs(shading).mean() > 0.1
    np.testing.assert_allclose(shading, np.repeat(shading[:, :1], 3, axis=1), atol=1e-4)


def test_detail_is_kept(taken_apart):
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    before, after = (log_light(each, "srgb").mean(axis=2) for each in (taken_apart.picture, taken_apart.flat()))
    assert np.corrcoef(fine(before, inside, 2.0), fine(after, inside, 2.0))[0, 1] > 0.97


def test_painted_marks_keep_their_contrast():
    """A moustache, moles and a letter, in the colours of hair and ink, on a real face under light from the side."""
    import cv2

    image, fitter = liaam.datasets.load_face().read_image(), Fitter(liaam.load_model("face"))
    result, mark = fitter.fit(image), np.zeros(image.shape[:2], np.uint8)
    light = 1.2 * (np.arange(image.shape[1]) - result.landmarks[:, 0].mean())[None, :, None] / image.shape[1]
    image = eight_bits(log_light(image, "srgb") - 0.6 + light, "srgb")
    centre, size = result.landmarks.mean(axis=0), np.ptp(result.landmarks, axis=0)
    for at, radius in (((-0.25, 0.05), 2), ((0.25, 0.1), 3), ((0.0, -0.35), 3)):
        cv2.circle(mark, tuple(int(v) for v in centre + size * at), radius, 1, -1)
    cv2.ellipse(mark, tuple(int(v) for v in centre + size * (0, 0.15)), (30, 6), 0, 0, 360, 1, -1)
    cv2.putText(mark, "A", tuple(int(v) for v in centre + size * (0.22, 0.25)), 0, 0.8, 1, 2)
    image[mark > 0] = (0.35 * image[mark > 0] * [0.8, 1.0, 1.25]).astype(np.uint8)
    relighter = Relighter.of(fitter, image, result)
    assert np.abs(relighter.shading()).max() > 0.3  # some light was taken off
    beside = cv2.dilate(mark, np.ones((9, 9), np.uint8)) > cv2.dilate(mark, np.ones((3, 3), np.uint8))
    before, after = (log_light(each, "srgb").mean(axis=2) for each in (image, relighter.flat()))
    contrast = [each[beside].mean() - each[mark > 0].mean() for each in (before, after)]
    assert contrast[1] > 0.85 * contrast[0]


def test_what_both_halves_share_is_no_light_from_a_side():
    """A beard is the object's own, a shadow on one cheek is not, and under light from above it is less certain."""
    model = liaam.load_model("face")
    x, y = (model.frame.pixels[:, ::-1] + model.frame.origin).T / model.diagonal
    beard, cheek = (y > 0.2) & (np.abs(x) < 0.12), (y > 0.0) & (y < 0.15) & (x > 0.1)

    def left_for_light(region, light):
        left = np.repeat(np.where(region, np.float32(-0.6), np.float32(0.0))[:, None], 3, axis=1)
        return without_pairs(model, left, light)[region].mean() / -0.6

    assert left_for_light(beard, 2.0 * x) < 0.7
    assert left_for_light(cheek, 2.0 * x) > 0.95
    assert left_for_light(beard, np.where(beard, -1.2, 0.0)) > 0.85


def test_a_picture_in_the_training_light_stays_as_it_is(head):
    model, pair = head
    fitter = Fitter(model)
    relighter = Relighter.of(fitter, pair.flat.image, fitter.fit(pair.flat.image, pair.flat.landmarks))
    assert np.abs(relighter.shading()).mean() < 0.03


def test_a_smooth_light_is_taken_off(head):
    model, pair = head
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    light = (-0.8 * (x / SIZE[1]) - 0.3 * (y / SIZE[0]))[..., None]
    image = eight_bits(log_light(pair.flat.image, "srgb") + light, "srgb")
    fitter = Fitter(model)
    relighter = Relighter.of(fitter, image, fitter.fit(pair.flat.image, pair.flat.landmarks))
    made = log_light(image, "srgb")
    before = flat_error(model, made, relighter.shape, pair.flat)
    made[relighter.region.box] = relighter.log_flat
    assert flat_error(model, made, relighter.shape, pair.flat) < 0.2 * before


def test_noise_in_the_dark_is_not_amplified_more_than_three_times(head, taken_apart, rng):
    model, pair = head
    dark = eight_bits(log_light(pair.lit.image, "srgb") - 2.5, "srgb").astype(float)
    fitter = Fitter(model)
    result = fitter.fit(pair.lit.image)
    images = [np.clip(dark + rng.normal(0, 1.5, dark.shape), 0, 255).astype(np.uint8) for _ in range(6)]
    relighters = [Relighter.of(fitter, image, result) for image in images]
    inside = relighters[0].shading().any(axis=2)
    before, after = (np.std(np.array(each, float), axis=0)[inside] for each in (images, [r.flat() for r in relighters]))
    assert np.median(after / np.maximum(before, 0.5)) < 3.5
    assert relighters[0].certain < taken_apart.certain


def test_clipped_highlights_stay(head, taken_apart):
    model, pair = head
    image, (x, y) = pair.lit.image.copy(), taken_apart.shape.mean(axis=0).astype(int)
    image[y - 6 : y + 7, x - 6 : x + 7] = 255
    fitter = Fitter(model)
    flat = Relighter.of(fitter, image, fitter.fit(pair.lit.image)).flat()
    assert flat[y - 3 : y + 4, x - 3 : x + 4].min() > 250


def test_how_certain_the_light_is(taken_apart):
    certainty = taken_apart.certainty()
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    assert np.isnan(certainty[~inside]).all()
    assert 0 <= np.nanmin(certainty) <= np.nanmax(certainty) <= 1
    assert taken_apart.certain == pytest.approx(np.nanmean(certainty))


def test_what_is_dark_in_two_channels_keeps_its_colour(head, taken_apart):
    """In a nostril only red is left; red detail without green and blue would make it cyan."""
    model, pair = head
    image, (x, y) = pair.lit.image.copy(), taken_apart.shape.mean(axis=0).astype(int)
    image[y - 3 : y + 4, x - 3 : x + 4] = [20, 0, 2]
    fitter = Fitter(model)
    relighter = Relighter.of(fitter, image, fitter.fit(pair.lit.image))
    red, green, blue = np.moveaxis(relighter.flat()[y - 2 : y + 3, x - 2 : x + 3].astype(int), 2, 0)
    assert (red >= green).all()
    assert (red >= blue).all()


def model_alone(relighter):
    from liaam.relighting import paint

    return paint(relighter.picture, relighter.shape, relighter.model, relighter.appearance.log_rgb)


def test_no_seam_shows(head, taken_apart):
    model, pair = head
    inside = mesh_mask(model, taken_apart.picture, taken_apart.shape)
    pasted = np.where(inside[..., None], taken_apart.flat(), taken_apart.picture)
    measured = [seam(model, picture, taken_apart.shape, pair.flat) for picture in (pasted, taken_apart.flat())]
    assert measured[1] < SEAM < 5.0 < measured[0]


# Lights


def test_a_light_in_front_changes_nothing(taken_apart):
    np.testing.assert_array_equal(taken_apart.under((0, 0, 2.5)), taken_apart.flat())
    np.testing.assert_array_equal(taken_apart.under((1, 0, 0), ambient=1.0), taken_apart.flat())


@pytest.mark.parametrize("direction", [(1, 0, 0.3), (-1, 0, 0.3), (0, 1, 0.3), (0, -1, 0.3)])
def test_light_comes_from_where_it_is_said_to(taken_apart, direction):
    flat, relit = (
        log_light(picture, "srgb").mean(axis=2) for picture in (taken_apart.flat(), taken_apart.under(direction))
    )
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    y, x = np.nonzero(inside)
    towards = np.column_stack([x, y]) @ np.array(direction[:2])
    near = towards > np.median(towards)
    change = (relit - flat)[y, x]
    assert change[near].mean() > change[~near].mean() + 0.2


def test_two_lamps_light_both_sides_in_their_colours(taken_apart):
    red, blue = Lamp((-1, 0, 0.3), (1.0, 0.2, 0.2)), Lamp((1, 0, 0.3), (0.2, 0.2, 1.0))
    made = log_light(taken_apart.under([red, blue], 0.1), "srgb") - log_light(taken_apart.flat(), "srgb")
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    y, x = np.nonzero(inside)
    redder = made[y, x, 0] - made[y, x, 2]
    left = x < np.median(x)
    assert redder[left].mean() > 0.3
    assert redder[~left].mean() < -0.3


def test_a_soft_lamp_from_the_side_lights_the_other_side_more(taken_apart):
    hard, soft = (taken_apart.under([Lamp((1, 0, 0.2), softness=s)], 0.05).astype(int) for s in (0.0, 1.0))
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    y, x = np.nonzero(inside)
    left = x < np.percentile(x, 25)
    assert soft[y[left], x[left]].mean() > 1.2 * hard[y[left], x[left]].mean()


def test_far_from_the_object_nothing_changes(taken_apart):
    from scipy.ndimage import binary_dilation

    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    far = np.logical_not(binary_dilation(inside, iterations=45))
    assert far.mean() > 0.2
    for picture in (taken_apart.flat(), taken_apart.under((1, 0, 0)), taken_apart.like(taken_apart)):
        np.testing.assert_array_equal(picture[far], taken_apart.picture[far])


def test_under_its_own_light_it_is_as_before(taken_apart):
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    back, flat = (
        np.abs(log_light(made, "srgb") - log_light(taken_apart.picture, "srgb"))[inside].mean()
        for made in (taken_apart.like(taken_apart), taken_apart.flat())
    )
    assert back < 0.15 * flat


def test_the_shading_is_what_is_between(taken_apart):
    shading = taken_apart.shading()
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    assert not shading[~inside].any()
    made = eight_bits(log_light(taken_apart.picture, "srgb") - shading, "srgb")
    np.testing.assert_array_equal(made[inside], taken_apart.flat()[inside])


@pytest.mark.parametrize("direction", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 1), (0, 1), "sideways"])
def test_lights_from_nowhere_are_refused(taken_apart, direction):
    with pytest.raises(LiaamError, match=r"three numbers|one of left, right, above, below, front"):
        taken_apart.under(direction)


@pytest.mark.parametrize("ambient", [-0.1, 1.1, np.nan])
def test_ambient_light_is_a_share(taken_apart, ambient):
    with pytest.raises(LiaamError, match="from 0"):
        taken_apart.under((0, 0, 1), ambient)


@pytest.mark.parametrize("direction", [(1e-300, 0, 0), (0, 0, -1), (1e300, -1e300, 0)])
def test_any_other_direction_will_do(taken_apart, direction):
    for ambient in (0.0, 0.5):
        assert taken_apart.under(direction, ambient).shape == taken_apart.picture.shape


# Input


def test_other_models_are_refused(taken_apart):
    with pytest.raises(LiaamError, match="different models"):
        taken_apart.like(replace(taken_apart, model=replace(taken_apart.model)))


def test_grey_is_refused(head, taken_apart):
    model, pair = head
    fitter = Fitter(model)
    result = fitter.fit(pair.lit.image, taken_apart.shape)
    with pytest.raises(MethodError, match=r"grey.*colour image"):
        Relighter.of(fitter, np.full_like(pair.lit.image, 90), result)


def test_a_shape_that_has_blown_up_leaves_the_picture(head, taken_apart):
    model, pair = head
    fitter = Fitter(model)
    result = fitter.fit(pair.lit.image, taken_apart.shape)
    for shape in (result.landmarks + 9000, result.landmarks * np.nan, result.landmarks * 1e6):
        relighter = Relighter.of(fitter, pair.lit.image, replace(result, landmarks=shape))
        for picture in (relighter.flat(), relighter.under((1, 0, 0)), relighter.like(relighter)):
            np.testing.assert_array_equal(picture, pair.lit.image)
        assert not relighter.shading().any()


@pytest.mark.parametrize("kind", ["uint16", "float", "holes", "black"])
def test_pictures_of_all_kinds(head, taken_apart, kind, rng):
    model, pair = head
    image = pair.lit.image
    other = {
        "uint16": image.astype(np.uint16) * 257,
        "float": image.astype(np.float32) / 255,
        "holes": np.where(rng.random(image.shape[:2])[..., None] < 0.02, np.nan, image / 255).astype(np.float32),
        "black": np.zeros_like(image) + np.array([0, 0, 1], np.uint8),
    }[kind]
    fitter = Fitter(model)
    relighter = Relighter.of(fitter, other, fitter.fit(other, taken_apart.shape))
    assert relighter.flat().dtype == np.uint8
    assert np.isfinite(relighter.log_flat).all()
    if kind in ("uint16", "float"):
        assert np.abs(relighter.flat().astype(int) - taken_apart.flat()).mean() < 2


def test_a_picture_may_be_a_file(head, taken_apart, tmp_path):
    model, pair = head
    write_image(tmp_path / "face.png", pair.lit.image)
    fitter = Fitter(model)
    result = fitter.fit(tmp_path / "face.png", taken_apart.shape)
    relighter = Relighter.of(fitter, tmp_path / "face.png", result)
    np.testing.assert_array_equal(relighter.flat(), Relighter.of(fitter, pair.lit.image, result).flat())
    write_image(tmp_path / "grey.png", pair.lit.image[..., :1].repeat(3, axis=2))
    with pytest.raises(MethodError, match=r"^grey\.png"):
        Relighter.of(fitter, tmp_path / "grey.png", result)


# Parts


def square(n: int = 40) -> ReferenceFrame:
    points = np.array([[0, 0], [n, 0], [n, n], [0, n], [0.3 * n, 0.6 * n]], float) - n / 2
    return ReferenceFrame(points, delaunay(points))


def test_normals_point_outwards_and_have_no_ridges(model):
    for frame in (square(), model.frame):
        normals = normals_of(frame)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        from_centre = frame.pixels[:, ::-1] - frame.pixels[:, ::-1].mean(axis=0)
        far = np.linalg.norm(from_centre, axis=1) > 0.25 * max(frame.size)
        assert (np.einsum("nk,nk->n", normals[:, :2], from_centre)[far] > 0).mean() > 0.95
        assert np.linalg.norm(normals[:, :2].mean(axis=0)) < 0.1
        picture = frame.picture(normals, np.nan)
        steps = [np.linalg.norm(np.diff(picture, axis=axis), axis=2) for axis in (0, 1)]
        assert max(np.nanmax(step) for step in steps) < 0.15


def known_in(shape: tuple[int, int], rows: slice, columns: slice) -> np.ndarray:
    inside = np.zeros(shape, bool)
    inside[rows, columns] = True
    return inside


def test_values_are_carried_on_as_far_as_things_look_alike():
    inside = known_in((160, 200), slice(40, 140), slice(40, 150))
    own = np.zeros((160, 200, 3), np.float32)
    own[:, 154:] = [1.5, 0.0, -1.0]  # a wall on the right
    around = Surroundings.of(inside, own, 6.0)
    share, belongs = around.share, around.belongs
    light = around.spread(np.full((160, 200, 3), 2.0, np.float32), np.zeros((160, 200, 3), np.float32))
    np.testing.assert_allclose(light, np.broadcast_to(2.0 * share, light.shape), atol=1e-3)
    assert share[90, 38] > 0.8 > share[90, 20] > 0.05
    assert share[90, 160:].max() < 0.01
    assert share[:, :14].max() == 0.0
    assert (belongs[inside] == 1).all()


@pytest.mark.parametrize("size", [1, 6])
def test_a_shadow_that_goes_on_takes_the_shadows_change(size):
    inside = known_in((60 * size, 80 * size), slice(20 * size, 40 * size), slice(0, 80 * size))
    values, own = np.zeros((60 * size, 80 * size, 1), np.float32), np.zeros((60 * size, 80 * size, 3), np.float32)
    own[:, 50 * size :] = values[:, 50 * size :] = -1.5  # in the shadow
    values[~inside] = 7.0  # not known there
    around = Surroundings.of(inside, own, 5.0 * size)
    nearby, share = carried(values, inside, around.seen, around.reach), around.share
    row = 44 * size
    np.testing.assert_allclose(nearby[row, 45 * size], 0.0, atol=0.2)
    np.testing.assert_allclose(nearby[row, 55 * size], -1.5, atol=0.2)
    assert share[row, 45 * size] > 0.3


def test_a_wall_that_edges_cut_off_gets_no_halo():
    """Behind a cheek in shadow, a wall somewhere looks like the cheek: a new light on it would be a halo."""
    inside = known_in((80, 160), slice(20, 60), slice(20, 60))
    own = np.full((80, 160, 3), -2.0, np.float32)
    own[:, 66:72] = [0.0, 0.5, 1.0]  # its bright rim
    belongs = Surroundings.of(inside, own, 5.0).belongs
    assert belongs[40, 62] > 0.9
    assert belongs[40, 76:].max() < 0.1


def test_a_wall_of_nearly_the_colour_of_skin_gets_no_halo():
    """The rest of the wall tells its colour, and the object its own."""
    inside = known_in((160, 160), slice(60, 100), slice(60, 100))
    own = np.full((160, 160, 3), [-1.98, -2.06, -1.96], np.float32)
    own[60:140, 60:100] = [-1.75, -2.05, -2.2]  # the object, and its neck below the mesh
    belongs = Surroundings.of(inside, cv2.GaussianBlur(own, (0, 0), 3.0), 5.0).belongs  # without a sharp edge
    assert belongs[80, 105:].max() < 0.06
    assert belongs[105:120, 80].min() > 0.2


@pytest.mark.parametrize("colour", [(0.4, -0.1, -0.3), (0.0, 0.0, 0.0)])
def test_what_is_bright_and_pale_beside_the_object_keeps_its_light(colour):
    """Such as a white wall behind a dark face; a grey object has no colour."""
    inside, pale = known_in((80, 90), slice(20, 60), slice(20, 60)), known_in((80, 90), slice(0, 80), slice(60, 68))
    own = np.full((80, 90, 3), -2.0, np.float32) + np.array(colour, np.float32)
    beside = {}
    for level in (-2.0, -1.75):  # as bright as the object, and brighter
        own[pale] = level + 0.3 * np.array(colour)
        beside[level] = Surroundings.of(inside, own, 5.0).belongs[30:50, 62:65].mean()
    assert beside[-2.0] > 0.8
    assert beside[-1.75] < 0.3 if any(colour) else beside[-1.75] > 0.6


def test_gloss_that_the_object_surrounds_belongs_to_it_and_is_not_darkened():
    """A wall keeps its light; gloss on a forehead beyond the mesh takes that of a lamp."""
    y, x = np.mgrid[:160, :160]
    inside = known_in((160, 160), slice(64, 120), slice(40, 120))
    shine = np.exp(-(np.square(x - 77) + np.square(y - 56)) / 12.0)[..., None].astype(np.float32)
    colour = np.array((0.4, -0.1, -0.3), np.float32)
    own = -2.0 + 0.7 * shine + (1.0 - 0.6 * shine) * colour
    own[100:] += 0.5 * colour  # or it would be black and white
    own[:42] = own[:, :20] = own[:, 140:] = (-3.0, -1.0, -2.0)  # the background
    around = Surroundings.of(inside, own, 4.0)
    region = Region((slice(0, 160),) * 2, (160, 160), (160, 160), np.zeros((1, 2)))
    assert around.belongs[53:60, 74:81].min() > 0.8
    assert around.gloss[56, 77] > 0.9
    assert not around.gloss[inside].any()
    assert not around.gloss[:42].any()
    for removed, kept in ((0.4, 0.0), (-0.4, -0.4)):
        light, _ = spared(own, own, np.full(own.shape, removed, np.float32) + 0.1 * colour, around, region)
        np.testing.assert_allclose(light[56, 77], kept, atol=0.03)
        np.testing.assert_allclose(light[90, 80], removed + 0.1 * colour, atol=1e-6)


def test_a_strip_that_is_thinner_than_the_reduced_pixels_has_its_values():
    y, x = np.mgrid[:200, :150]
    inside = np.abs(x - 0.3 * y - 40) < 1.5  # slanted, so that reduced pixels hold various parts of it
    values = inside[..., None] * (y / 200)[..., None].astype(np.float32)
    own = np.full((200, 150, 3), -1.0, np.float32)
    around = Surroundings.of(inside, own, 130.0)
    found, share = carried(values, inside, around.seen, around.reach), around.share
    assert share[inside].min() > 0.9
    assert np.abs(found - values)[inside].mean() < 0.25


def test_one_call_does_it_all(head, taken_apart):
    model, pair = head
    picture = liaam.relight(model, pair.lit.image, (1, 0, 0.5), ambient=0.1)
    np.testing.assert_array_equal(picture, taken_apart.under((1, 0, 0.5), 0.1))
    start = {"init": pair.lit.landmarks, "like_init": pair.lit.landmarks, "max_iterations": 0}
    with pytest.warns(UserWarning) as said:
        unlit = liaam.relight(model, pair.lit.image, like=pair.lit.image, **start)
    assert [str(each.message).partition(": The fit")[0] for each in said] == [
        "like: max iterations",
        "image: max iterations",
    ]
    assert np.abs(unlit.astype(float) - pair.lit.image).mean() < 1  # in its own light


def test_lights_are_directions_and_lamps():
    lamp = Lamp((1, 0, 0.5), strength=0.5)
    assert lamps_of(lamp) == lamps_of((lamp,)) == [lamp]
    assert lamps_of(np.array([1.0, 0.0, 0.5])) == [Lamp([1.0, 0.0, 0.5])]


def test_a_result_in_the_place_of_a_light_is_refused_with_what_to_give(head):
    model, pair = head
    result = liaam.fit(model, pair.lit.image, pair.lit.landmarks)
    with pytest.raises(LiaamError, match=r"the light is the result of a fit; .*init=result\.landmarks"):
        liaam.relight(model, pair.lit.image, result)


def test_one_call_refuses_what_cannot_be(head):
    model, pair = head
    for wrong, words in (
        ({"light": (0, 0, 1), "like": pair.lit.image}, "light and like cannot be combined"),
        ({"light": (0, 0, 0)}, "direction"),
        ({"ambient": 2.0}, "ambient"),
    ):
        with pytest.raises(LiaamError, match=words):
            liaam.relight(model, pair.lit.image, **wrong)
    with pytest.raises(LiaamError, match="trained on grey images, and estimating shading needs colour"):
        liaam.relight(replace(model, is_colour=False), pair.lit.image)


# Clipped and dark pictures


def test_clipped_channels_continue_in_the_colour_around_them():
    """A cheek whose red is clipped, and its middle in all channels: darkened, it has the skin's colour, not grey."""
    y, x = np.mgrid[:120, :120]
    skin = np.array([-0.5, -0.9, -1.3], np.float32)
    true = skin + 1.6 * np.exp(-(np.square(x - 60) + np.square(y - 60)) / 900.0)[..., None]
    own = np.minimum(true, 0.0).astype(np.float32)
    region, belongs = (
        Region.of(np.array([[20, 20], [90, 90.0]]), (slice(0, 120), slice(0, 120))),
        np.ones((120, 120, 1)),
    )
    around = Surroundings(belongs[..., 0] > 0, belongs, 0.0 * belongs, belongs, own, 1.0)
    light, whole = spared(own, own, np.full(own.shape, 0.5, np.float32), around, region)
    assert region.small == (120, 120)
    hue, expected = whole - whole.mean(axis=2, keepdims=True), skin - skin.mean()
    assert np.abs(hue - expected).max() < 0.1
    assert light[60, 60].max() == pytest.approx(0.0, abs=1e-3)  # how bright it was is not known
    assert light[2, 2].min() > 0.45
    assert np.abs(np.diff(light, axis=0)).max() < 0.2  # over a few pixels, as a reach is four here


def test_a_dark_picture_gets_no_glow_around_the_object():
    """Edges are relative to the light: thirty times darker, a wall of another colour is still a wall."""
    inside, own = np.zeros((120, 160), bool), np.zeros((120, 160, 3), np.float32)
    inside[40:80, 60:100] = True
    own[:] = (-1.5, -0.8, -1.0)
    own[35:120, 55:105] = (-0.5, -0.9, -1.3)
    for darker in (0.0, np.log(30.0)):
        belongs = Surroundings.of(inside, own - np.float32(darker), 5.0).belongs
        assert belongs[60, 60:100].min() > 0.95
        assert belongs[40:80, 110:150].max() < 0.1


def test_background_inside_the_border_of_the_mesh_gets_no_light():
    inside, own = np.zeros((120, 160), bool), np.full((120, 160, 3), -0.6, np.float32)
    inside[40:80, 60:100] = True
    own[:, 96:] = (-2.6, -0.6, -1.6)  # a wall, which the mesh covers by four pixels
    belongs = Surroundings.of(inside, own, 5.0).belongs
    assert belongs[50:70, 98:].max() < 0.25
    assert belongs[50:70, 60:94].min() > 0.95


def test_large_objects_are_relit_as_small_ones(head, taken_apart):
    """Light is computed at a lower resolution; edges stay where they are."""
    import cv2

    model, pair = head
    large = cv2.resize(pair.lit.image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    fitter = Fitter(model)
    result = fitter.fit(large, 3.0 * (taken_apart.shape + 0.5) - 0.5)
    relighter = Relighter.of(fitter, large, replace(result, landmarks=3.0 * (taken_apart.shape + 0.5) - 0.5))
    assert max(relighter.region.small) < 0.7 * max(relighter.region.size)
    small = cv2.resize(relighter.flat(), taken_apart.picture.shape[1::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(small.astype(int) - taken_apart.flat()).mean() < 3.0


def test_small_marks_are_not_light(model):
    """A spot and a line get the light of their surroundings, and the edge of a shadow is kept."""
    frame = model.frame
    y, x = (frame.pixels - frame.pixels.mean(axis=0)).T / model.diagonal
    shadow = np.where(x > 0.15, -0.8, 0.0)
    marks = -1.2 * ((np.hypot(x + 0.1, y) < 0.018) | (np.abs(y + 0.1) < 0.01))
    left = np.repeat((shadow + marks)[:, None], 3, axis=1).astype(np.float32)
    found = without_marks(model, left, np.ones(frame.n_pixels), np.full(frame.n_pixels, 0.2))
    clear = (np.abs(x - 0.15) > 0.03) & (np.abs(x) < 0.2) & (np.abs(y) < 0.15)
    assert np.abs(found.mean(axis=1) - shadow)[clear].max() < 0.25
