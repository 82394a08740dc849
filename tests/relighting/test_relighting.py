"""Shadow-free appearance: what was laid over a picture is taken off again, and what cannot be seen is not made up."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.subjects import PAPER_THETA, STRENGTH, TEMPERATURE, Subject, get_subject, simulated_shadow
from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.model.mesh import signed_areas
from liaam.photometry import CameraModel, invariant_row, srgb_to_linear, temperature_direction
from liaam.relighting import paint, shadow_free, without_shading
from liaam.training import TrainingOptions, sample_appearance, train

SIDES = (0.0, np.pi)
BLUR = 0.5
WHOLE = TrainingOptions(variance=1.0, blurs=(BLUR,), leave_out=False)
PAPER_CAMERA = CameraModel(theta=PAPER_THETA)


@pytest.fixture(scope="module")
def subject() -> Subject:
    return get_subject(None)


@pytest.fixture(scope="module")
def own_model(subject) -> AAM:
    return train(subject.pairs, WHOLE, camera=PAPER_CAMERA, prior="sample", methods=["li", "grey"])


@pytest.fixture(scope="module")
def lit_model(subject) -> AAM:
    """A model whose appearance holds shadows, which L(theta) cannot see."""
    shadowed = [(simulated_shadow(image, shape, side)[0], shape) for image, shape in subject.pairs for side in SIDES]
    return train(subject.pairs + shadowed, WHOLE, camera=PAPER_CAMERA)


def log_texture(model: AAM, image: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, usable = sample_appearance(image, shape, model.warp, "log", "srgb", BLUR)
    return values, usable > 0


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors, dtype=np.float64))))


def noisy(image: np.ndarray, sigma_n: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(image + rng.normal(0, sigma_n / 255, image.shape), 0, 1).astype(np.float32)


# What is rebuilt


@pytest.mark.parametrize("method", ["li", "li+noise", "li-pc"])
@pytest.mark.parametrize("picture", [0, 3])
def test_the_picture_without_its_shadow_comes_back(subject, own_model, method, picture, rng):
    image, shape = subject.pairs[picture]
    shadowed, _ = simulated_shadow(image, shape, 0.2)
    fitter = Fitter(own_model, method)
    truth, known = log_texture(own_model, image, shape)
    lit, seen = log_texture(own_model, shadowed, shape)
    for sigma_n, least in ((0.0, 2e-3), (2.0, 0.1)):
        spoilt = noisy(shadowed, sigma_n, rng)
        result = fitter.fit(spoilt, shape + rng.normal(0, 2, shape.shape))
        rebuilt = shadow_free(fitter, spoilt, result)
        assert rms((rebuilt.log_rgb - truth)[known]) < least
    assert rms((lit - truth)[seen & known]) > 0.3


def test_deviations_tell_how_far_coordinates_are_off(subject, own_model, rng):
    image, shape = subject.pairs[2]
    fitter = Fitter(own_model, "li")
    appearance = own_model.levels[-1].appearances["log"]
    truth, _ = log_texture(own_model, image, shape)
    lam = np.tensordot(appearance.modes, truth - appearance.mean, axes=([1, 2], [0, 1]))
    off = []
    for _ in range(20):
        spoilt = noisy(image, 3.0, rng)
        rebuilt = shadow_free(fitter, spoilt, fitter.fit(spoilt, shape))
        off.append((rebuilt.lam - lam) / rebuilt.deviations)
    assert 0.3 < rms(np.array(off)) < 3


@pytest.mark.parametrize("sigma_n", [0.0, 2.0])
def test_shading_that_the_invariant_does_not_see_stays_at_its_mean(subject, lit_model, sigma_n, rng):
    image, shape = subject.pairs[0]
    appearance = lit_model.levels[-1].appearances["log"]
    spread = np.sqrt(appearance.eigenvalues)
    visible = np.linalg.norm(appearance.modes @ invariant_row(PAPER_THETA)[0], axis=1)
    hidden = int(visible.argmin())
    assert visible[hidden] < 0.01 < visible.max()
    spoilt = noisy(simulated_shadow(image, shape, 0.2)[0], sigma_n, rng)
    fitter = Fitter(lit_model, "li")
    result = fitter.fit(spoilt, shape)
    free, held = (shadow_free(fitter, spoilt, result, prior) for prior in (0.0, 1.0))
    assert np.isfinite(free.deviations).all()
    assert free.deviations[hidden] > 1.5 * spread[hidden]
    assert abs(held.lam[hidden]) < spread[hidden]
    assert 0.5 * spread[hidden] < held.deviations[hidden] < 1.01 * spread[hidden]
    assert np.abs(held.lam / spread).max() < 3
    # What the invariant does see is not held.
    assert held.deviations[visible.argmax()] < 0.5 * spread[visible.argmax()]
    if sigma_n:  # noise is what the other modes take; without, they need not be held
        truth, known = log_texture(lit_model, image, shape)
        assert rms((held.log_rgb - truth)[known]) < rms((free.log_rgb - truth)[known])


def test_no_deviation_is_lost_to_rounding(subject):
    shadowed = [
        (simulated_shadow(image, shape, SIDES[i % 2])[0], shape) for i, (image, shape) in enumerate(subject.pairs)
    ]
    model = train(subject.pairs + shadowed, WHOLE, camera=PAPER_CAMERA, diagonal=100.0)
    fitter = Fitter(model, "li")
    image, shape = shadowed[0]
    deviations = shadow_free(fitter, image, fitter.fit(image, shape), prior=0.0).deviations
    assert np.isfinite(deviations).all()
    assert (deviations > 0).all()


@pytest.mark.parametrize("method", ["li-lit", "grey", "rgb", "varied", "igo"])
def test_methods_without_the_log_appearance_are_refused(model, lit_scene, method):
    fitter = Fitter(model, method)
    result = fitter.fit(lit_scene.image, lit_scene.landmarks)
    with pytest.raises(MethodError, match=f"{method} does not fit a log-RGB appearance.*'li', 'li-pc'"):
        shadow_free(fitter, lit_scene.image, result)


# Painting


@pytest.fixture
def place(model) -> np.ndarray:
    """Where the model lies in a picture of 90 by 110 pixels: smaller, turned, and not on the pixels' grid."""
    mean = model.shape_model.mean
    turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    return 0.83 * mean @ turn.T + [54.3, 44.7]


CANVAS = np.zeros((90, 110, 3), np.float32)


def covered(shape: np.ndarray, triangles: np.ndarray, size: tuple[int, int], border: float = 0.0) -> np.ndarray:
    """Pixels whose centres lie in a triangle, at least this far from its outline (outside where negative)."""
    y, x = np.indices(size)
    mask = np.zeros(size, bool)
    for corners in shape[triangles]:
        inside = np.ones(size, bool)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            (dx, dy), length = b - a, np.linalg.norm(b - a)
            inside &= dx * (y - a[1]) - dy * (x - a[0]) >= border * length
        mask |= inside
    return mask


def test_paint_keeps_a_constant_and_covers_the_mesh(model, place):
    picture, inside = paint(CANVAS, place, model, np.full((model.n_pixels, 2), 3.5, np.float32))
    assert picture.shape == (90, 110, 2)
    np.testing.assert_allclose(picture[inside], 3.5, rtol=1e-5)
    assert (picture[~inside] == 0).all()
    mesh = covered(place, model.triangles, (90, 110))
    assert inside.sum() > 1000
    assert not (inside & ~covered(place, model.triangles, (90, 110), border=-1e-6)).any()
    assert (mesh & ~inside).sum() <= 0.01 * mesh.sum()  # the frame has no pixel beside a few on the border


def test_paint_carries_values_to_where_they_belong(model, place):
    own = np.einsum("nv,nvx->nx", model.frame.weights, model.shape_model.mean[model.frame.vertices])
    picture, inside = paint(CANVAS, place, model, own.astype(np.float32))
    y, x = np.nonzero(inside)
    turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    back = (np.column_stack([x, y]) - [54.3, 44.7]) @ turn / 0.83
    errors = np.linalg.norm(picture[inside] - back, axis=1)
    # On the border, the nearest pixels there are stand in.
    assert np.median(errors) < 0.05
    assert errors.max() < 1.5


def test_a_shape_across_the_border_is_cut_there(model, place):
    values = np.arange(model.n_pixels, dtype=np.float32)[:, None]
    whole, inside = paint(CANVAS, place, model, values)
    for shift in ([-40, 0], [37, 21], [0, -38]):
        part, there = paint(CANVAS, place + shift, model, values)
        x, y = shift
        window = np.zeros((90, 110), bool)
        window[max(y, 0) : 90 + min(y, 0), max(x, 0) : 110 + min(x, 0)] = True
        expected = np.roll(inside, (y, x), axis=(0, 1)) & window
        assert np.array_equal(there, expected)
        assert 0 < there.sum() < inside.sum()
        np.testing.assert_allclose(part[there], np.roll(whole, (y, x), axis=(0, 1))[there], atol=0.5)


def test_an_object_may_be_large(model):
    shape = 5 * (model.shape_model.mean - model.shape_model.mean.min(axis=0)) + 10
    canvas = np.zeros((500, 500, 3), np.uint8)
    picture, inside = paint(canvas, shape, model, np.full((model.n_pixels, 1), 2.0, np.float32))
    mesh = covered(shape, model.triangles, (500, 500))
    assert mesh.sum() > 40_000
    assert (mesh & ~inside).sum() <= 0.01 * mesh.sum()
    np.testing.assert_allclose(picture[inside], 2.0, rtol=1e-5)


@pytest.mark.parametrize("shift", [[300, 0], [-300, 0], [0, 4000], [-9e3, -9e3]])
def test_a_shape_beyond_the_border_paints_nothing(model, place, shift):
    picture, inside = paint(CANVAS, place + shift, model, np.ones((model.n_pixels, 3), np.float32))
    assert not inside.any()
    assert not picture.any()


def test_triangles_that_are_turned_over_stay_empty(model, place):
    values = np.ones((model.n_pixels, 1), np.float32)
    mirrored = place * [-1, 1] + [109, 0]
    assert not paint(CANVAS, mirrored, model, values)[1].any()
    assert not paint(CANVAS, np.tile(place.mean(axis=0), (model.n_points, 1)), model, values)[1].any()
    folded = place.copy()
    folded[[0, 1]] = place.mean(axis=0) + np.array([[0, 0], [3, 3]])
    upright = model.triangles[signed_areas(folded, model.triangles) > 1e-3]
    assert len(upright) < len(model.triangles)
    _, inside = paint(CANVAS, folded, model, values)
    mesh = covered(folded, upright, (90, 110))
    assert not (inside & ~covered(folded, upright, (90, 110), border=-1e-6)).any()
    assert (mesh & ~inside).sum() <= 0.02 * mesh.sum()


# The picture under the training light


@pytest.fixture(scope="module")
def relit(subject, own_model) -> tuple[np.ndarray, np.ndarray, FitResult, Fitter]:
    """A shadowed picture, the share of shadow at each pixel, and a fit to it."""
    image, shape = subject.pairs[1]
    shadowed, mask = simulated_shadow(image, shape, 0.1)
    fitter = Fitter(own_model, "li")
    return shadowed, mask, fitter.fit(shadowed, shape), fitter


def test_the_shading_taken_off_is_the_shadow_laid_over(subject, own_model, relit):
    shadowed, mask, result, fitter = relit
    picture, shading = without_shading(
        shadowed, result.landmarks, own_model, shadow_free(fitter, shadowed, result), own_model.response
    )
    inside = paint(shadowed, result.landmarks, own_model, np.ones((own_model.n_pixels, 1), np.float32))[1]
    assert np.array_equal(picture[~inside], shadowed[~inside])
    assert (shading[~inside] == 0).all()
    change = STRENGTH + TEMPERATURE * temperature_direction(PAPER_THETA)
    np.testing.assert_allclose(np.median(shading[inside & (mask > 0.999)], axis=0), change, atol=0.02)
    np.testing.assert_allclose(np.median(shading[inside & (mask < 0.001)], axis=0), 0, atol=0.02)
    original = subject.images[1]
    assert rms((picture - original)[inside]) < 0.02 < 0.1 < rms((shadowed - original)[inside])


def test_the_shading_is_what_is_between_picture_and_appearance(own_model, relit):
    shadowed, _, result, fitter = relit
    appearance = shadow_free(fitter, shadowed, result)
    # Of a level at which nothing is cut to [0, 1].
    appearance = replace(appearance, log_rgb=np.minimum(appearance.log_rgb, -0.05))
    eight = np.round(255 * shadowed).astype(np.uint8)
    for stored, values in ((eight, eight / 255), (shadowed, shadowed), (eight.astype(np.uint16) * 257, eight / 255)):
        picture, shading = without_shading(stored, result.landmarks, own_model, appearance)
        assert picture.dtype == shading.dtype == np.float32
        inside = shading.any(axis=2) & (values > 4 / 255).all(axis=2)
        assert inside.sum() > 10_000
        rebuilt = np.log(srgb_to_linear(picture[inside].astype(np.float64)))
        expected = np.log(srgb_to_linear(values[inside].astype(np.float64))) - rebuilt
        np.testing.assert_allclose(shading[inside], expected, atol=2e-4)


def test_black_and_pixels_that_are_no_numbers_get_a_finite_shading(own_model, relit):
    shadowed, _, result, fitter = relit
    appearance = shadow_free(fitter, shadowed, result)
    spoilt = shadowed.copy()
    x, y = result.landmarks.mean(axis=0).astype(int)
    spoilt[y, x], spoilt[y, x + 1] = 0.0, np.nan
    picture, shading = without_shading(spoilt, result.landmarks, own_model, appearance)
    assert np.isfinite(picture).all()
    assert np.isfinite(shading).all()
    assert (shading[y, x : x + 2] < -3).all()


def test_another_fitter_than_the_fits_is_refused(own_model, subject):
    image, shape = subject.images[0], subject.shapes[0]
    result = Fitter(own_model, "grey").fit(image, shape)
    with pytest.raises(MethodError, match="made with method grey, but the fitter has li; use the fit's fitter"):
        shadow_free(Fitter(own_model, "li"), image, result)


def test_a_black_picture_rebuilds_what_training_says(own_model, subject):
    fitter, black = Fitter(own_model, "li"), np.zeros_like(subject.images[0])
    appearance = own_model.levels[-1].appearances["log"]
    rebuilt = shadow_free(fitter, black, fitter.fit(black, subject.shapes[0]))
    np.testing.assert_array_equal(rebuilt.log_rgb, appearance.mean)
    np.testing.assert_allclose(rebuilt.deviations, np.sqrt(appearance.eigenvalues))


@pytest.mark.parametrize("factor", [1e6, np.inf, np.nan])
def test_a_shape_that_has_blown_up_paints_nothing(own_model, subject, factor):
    shape = factor * (subject.shapes[0] - subject.shapes[0].mean(axis=0))
    _, inside = paint(subject.images[0], shape, own_model, np.ones((own_model.n_pixels, 1), np.float32))
    assert not inside.any()
