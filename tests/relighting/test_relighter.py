"""Relit pictures: near the truth, without a seam, and under lights from where they are said to come."""

from dataclasses import replace

import numpy as np
import pytest

import liaam
from experiments.relit import LIGHTS, flat_error, lit_pairs, mesh_mask, seam, train_on_flat_light
from liaam.errors import LiaamError, MethodError
from liaam.fitting import Fitter
from liaam.io import write_image
from liaam.model.mesh import ReferenceFrame, delaunay
from liaam.relighting import Lamp, Relighter, extrapolation
from liaam.relighting.extrapolation import around, continued
from liaam.relighting.one_call import lamps_of
from liaam.relighting.painting import eight_bits, log_light
from liaam.relighting.relief import normals_of
from liaam.relighting.shading import piecewise_smooth
from scenes import Head

SIZE = (240, 180)

BAR, SEAM = 0.065, 2.0
"""What is reached with a small model of ten pictures; ``python -m benchmarks relight`` measures larger ones."""


@pytest.fixture(scope="module")
def head():
    """Model of a person, and a picture under hard light with its truth."""
    model = train_on_flat_light(Head(5), 10, SIZE, leave_out=False, diagonal=110.0)
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
    made[taken_apart.box] = taken_apart.log_flat
    assert flat_error(model, made, taken_apart.shape, pair.flat) < BAR < 0.8 < before
    truth = np.log(np.maximum(pair.flat.linear, 1e-4))
    assert flat_error(model, truth, taken_apart.shape, pair.flat) < 0.02  # the measure's own


def test_what_is_kept_is_in_single_precision(taken_apart):
    assert taken_apart.log_flat.dtype == taken_apart.log_shading.dtype == np.float32


def test_detail_is_kept(head, taken_apart):
    model, pair = head
    log_model, _ = model_alone(taken_apart)
    made = log_light(taken_apart.picture, "srgb")
    made[taken_apart.box] = taken_apart.log_flat
    errors = [flat_error(model, log, taken_apart.shape, pair.flat) for log in (log_model, made)]
    assert errors[1] < 0.95 * errors[0]


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
    made = log_light(taken_apart.under_lamps([red, blue], 0.1), "srgb") - log_light(taken_apart.flat(), "srgb")
    inside = mesh_mask(taken_apart.model, taken_apart.picture, taken_apart.shape)
    y, x = np.nonzero(inside)
    redder = made[y, x, 0] - made[y, x, 2]
    left = x < np.median(x)
    assert redder[left].mean() > 0.3
    assert redder[~left].mean() < -0.3


def test_a_soft_lamp_from_the_side_lights_the_other_side_more(taken_apart):
    hard, soft = (taken_apart.under_lamps([Lamp((1, 0, 0.2), softness=s)], 0.05).astype(int) for s in (0.0, 1.0))
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


@pytest.mark.parametrize("direction", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 1), (0, 1), "left"])
def test_lights_from_nowhere_are_refused(taken_apart, direction):
    with pytest.raises(LiaamError, match="three numbers"):
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


def test_jumps_stay_and_noise_goes(rng):
    frame = square()
    truth = np.where(frame.pixels[:, 1:] < 20, -1.5, 0.0) * np.ones(3)
    weights = np.ones(len(truth))
    noisy = truth + rng.normal(0, 0.1, truth.shape)
    holes = (np.abs(frame.pixels - [10, 10]) < 3).all(axis=1)
    noisy[holes], weights[holes] = 7.0, 0.0
    smooth = piecewise_smooth(frame, noisy, weights)
    assert np.sqrt(np.mean((smooth - truth) ** 2)) < 0.07
    assert np.abs(smooth - truth)[holes].max() < 0.15


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


def test_values_are_carried_on_as_far_as_things_look_alike():
    values, weights = np.full((60, 80, 1), 2.0, np.float32), np.zeros((60, 80, 1), np.float32)
    weights[20:40, 30:50] = 1.0
    own = np.zeros((60, 80, 3), np.float32)
    own[:, 52:] = [1.5, 0.0, -1.0]  # a wall on the right
    carried, share = around(values, weights, own, 5.0)
    np.testing.assert_allclose(carried[share > 0], 2.0, rtol=1e-4)
    assert share[30, 28] > 0.9 > share[30, 22] > 0.05
    assert share[30, 54:].max() < 0.01
    assert share[:, :10].max() == 0.0


@pytest.mark.parametrize("size", [1, 6])
def test_a_shadow_that_goes_on_takes_the_shadows_change(size):
    values, weights = np.zeros((60 * size, 80 * size, 1), np.float32), np.zeros((60 * size, 80 * size, 1), np.float32)
    weights[20 * size : 40 * size] = 1.0
    own = np.zeros((60 * size, 80 * size, 3), np.float32)
    own[:, 50 * size :] = values[:, 50 * size :] = -1.5  # in the shadow
    values[weights == 0] = 7.0  # not known there
    carried, share = around(values, weights, own, 5.0 * size)
    row = 44 * size
    np.testing.assert_allclose(carried[row, 45 * size], 0.0, atol=0.2)
    np.testing.assert_allclose(carried[row, 55 * size], -1.5, atol=0.2)
    assert share[row, 45 * size] > 0.3
    np.testing.assert_allclose(share[row, 55 * size], share[row, 45 * size], rtol=0.05)


def test_a_wall_that_edges_cut_off_gets_no_halo():
    """Behind a cheek in shadow, a wall somewhere looks like the cheek: a new light on it would be a halo."""
    values, weights = np.ones((80, 160, 1), np.float32), np.zeros((80, 160, 1), np.float32)
    weights[20:60, 20:60] = 1.0
    own = np.full((80, 160, 3), -2.0, np.float32)
    own[:, 66:72] = [0.0, 0.5, 1.0]  # its bright rim
    _, share = around(values, weights, own, 8.0)
    assert share[40, 62] > 0.9
    assert share[40, 73:].max() < 0.1
    own[:, 66:72] = -2.0
    assert around(values, weights, own, 8.0)[1][40, 74] > 0.5


def test_light_is_added_to_dark_hair_but_not_taken_from_it():
    values, weights = np.ones((60, 80, 1), np.float32), np.zeros((60, 80, 1), np.float32)
    weights[20:40, 20:50] = 1.0
    own = np.zeros((60, 80, 3), np.float32)
    own[:, 53:] = -1.2
    taken, added = (around(values, weights, own, 10.0, lightened=light)[1][30, 54, 0] for light in (False, True))
    assert taken < 0.4
    assert added > 0.9


def ridge(rng, noise=0.0):
    """Log light of hair and skin, whose border the mesh follows, and the shadow that lies along it; the mesh."""
    height, width = 80, 120
    down, right = np.mgrid[:height, :width].astype(np.float32)
    edge = 38.0 + 5.0 * np.sin(right / 7.0)
    shadow = -0.9 / (1.0 + np.exp((edge - down) / 1.5))[..., None] * [0.8, 1.0, 1.2]
    hair = ((down % 24 < 9) & (right % 40 < 25))[..., None]
    paint = np.where(hair, [-2.2, -2.3, -2.2], [-0.8, -1.3, -1.6])
    own = paint + shadow + rng.normal(0, noise, paint.shape)
    return own.astype(np.float32), shadow.astype(np.float32), down > 38


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_shadows_edge_along_the_border_is_told_from_paint(rng, noise):
    own, shadow, inside = ridge(rng, noise)
    change = np.where(inside[..., None], shadow, 7.0).astype(np.float32)  # not known outside
    found = continued(change, inside, own, 8.0)
    next_to_it = np.zeros_like(inside)
    next_to_it[31:39] = True
    off = np.abs(found - shadow)[next_to_it]
    carried, _ = around(change, inside[..., None].astype(np.float32), own, 8.0)
    before = np.abs(carried - shadow)[next_to_it]
    assert before.mean() > 0.2
    assert off.mean() < 0.5 * before.mean()
    np.testing.assert_array_equal(found <= shadow[inside].max(axis=0) + 1e-6, True)


@pytest.mark.parametrize("reach", [1.0, 3.0, 40.0, 70.0, 200.0])
def test_a_change_that_is_the_same_everywhere_goes_on_as_it_is(rng, reach):
    inside = np.zeros((90, 70), bool)
    inside[30:60, 20:50] = True
    own = rng.normal(-1, 0.5, (90, 70, 3)).astype(np.float32)
    change = np.where(inside[..., None], np.float32([0.3, -0.2, 0.1]), np.float32(9))
    near = np.zeros_like(inside)
    near[29:61, 19:51] = True
    found = continued(change, inside, own, reach)
    np.testing.assert_allclose(found[near], np.broadcast_to([0.3, -0.2, 0.1], found[near].shape), atol=1e-5)


def test_large_objects_are_extrapolated_at_a_lower_resolution(rng, monkeypatch):
    y, x = np.mgrid[:300, :240]
    inside = (np.square(x - 120) + np.square(y - 150) < 70**2)[..., None].astype(np.float32)
    values = inside * np.dstack([x / 240, y / 300, 1 + 0 * x]).astype(np.float32)
    own = np.where(x[..., None] < 200, -1.0, -2.5) + rng.normal(0, 0.02, (300, 240, 3))  # a wall beside the object
    few, share_of_few = around(values, inside, own.astype(np.float32), 60.0)
    monkeypatch.setattr(extrapolation, "LARGEST", np.inf)
    found, share = around(values, inside, own.astype(np.float32), 60.0)
    assert 0.05 < share[..., 0].mean() < 0.95 and share[150, 230] < 0.05
    assert np.abs(share_of_few - share).mean() < 0.01
    assert np.abs(share * (few - found)).mean() < 0.005


def test_a_strip_that_is_thinner_than_the_reduced_pixels_has_its_share():
    inside = np.zeros((200, 150, 1), np.float32)
    y, x = np.mgrid[:200, :150]
    inside[np.abs(x - 0.3 * y - 40) < 1.5] = 1.0  # slanted, so that reduced pixels hold various parts of it
    values = inside * (y / 200)[..., None].astype(np.float32)
    found, share = around(values, inside, np.full((200, 150, 3), -1.0, np.float32), 130.0)
    own = inside[..., 0] > 0
    assert share[own].min() > 0.9
    assert np.abs(found - values)[own].mean() < 0.25


def test_nothing_inside_changes_nothing():
    none = np.zeros((9, 8), bool)
    assert not continued(np.ones((9, 8, 3), np.float32), none, np.ones((9, 8, 3), np.float32), 2.0).any()
    own = np.full((9, 8, 3), -5.0, np.float32)  # one colour: nothing to tell by
    change = np.full((9, 8, 3), 0.4, np.float32)
    np.testing.assert_allclose(continued(change, ~none, own, 2.0), 0.4, atol=1e-5)


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
