"""Fits end where the picture says, not where its last bits do."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import METHODS, Fitter, SolverOptions, get_method
from setups import disturb, model_pixels, stands_light

NAMES = (*METHODS, "li+noise")
STARTS = ((1.03, (0.02, -0.015)), (0.97, (-0.02, 0.02)), (1.0, (0.03, 0.0)))
CHANGE = 1e-6
# Standard deviations. The gradient of a bilinear interpolant jumps at pixel lines, so that a fit from another start may
# end at a neighbouring jump: igo moves by 0.002 of its standard deviation there.
NEVER_MORE = 0.01


@pytest.fixture(scope="module")
def nearly(same_light_scene, lit_scene):
    """Give pictures, as they are and with all of their values changed by next to nothing."""
    rng, pictures = np.random.default_rng(3), {}
    for name, scene in (("same light", same_light_scene), ("other light", lit_scene)):
        image = scene.image.astype(np.float64)
        changed = [image + CHANGE * rng.choice([-1.0, 1.0], image.shape) for _ in range(2)]
        pictures[name] = scene, [each.astype(np.float32) for each in (image, *changed)]
    return pictures


@pytest.mark.parametrize(
    ("method", "light"),
    [(name, "same light") for name in NAMES] + [(name, "other light") for name in NAMES if stands_light(name)],
)
def test_what_nobody_can_see_does_not_move_a_fit(model, nearly, method, light):
    (scene, pictures), fitter = nearly[light], Fitter(model, method)
    for start in STARTS:
        fits = [fitter.fit(picture, disturb(scene.landmarks, *start)) for picture in pictures]
        if any(fit.status.lost for fit in fits):
            continue
        assert len({fit.status for fit in fits}) == 1
        for fit in fits[1:]:
            moved = np.linalg.norm(fit.landmarks - fits[0].landmarks, axis=1)
            assert (moved / fits[0].sd).mean() < NEVER_MORE


FIELDS = ("landmarks", "p", "lam", "covariance", "landmark_covariances", "evidence", "residual_variance", "cost")


@pytest.mark.parametrize("method", NAMES)
def test_nothing_of_a_fit_is_left_in_the_next(model, same_light_scene, method):
    """A fitter reuses the arrays of earlier fits, also of those that diverged or saw nothing."""
    image, start = same_light_scene.image, disturb(same_light_scene.landmarks)
    noise = np.random.default_rng(0).integers(0, 255, image.shape).astype(np.uint8)
    pictures = [image, noise, np.zeros_like(image), np.full(image.shape, np.nan, np.float32), image]
    fitter = Fitter(model, method, restarts=False)
    for picture in pictures:
        own, fresh = (each.fit(picture, start) for each in (fitter, Fitter(model, method, restarts=False)))
        assert own.status == fresh.status
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(own, name), getattr(fresh, name), err_msg=name)


@pytest.mark.parametrize("method", NAMES)
def test_a_copy_of_a_row_is_the_same_method(model, same_light_scene, method):
    copy, start = replace(get_method(method), name="mine", summary="a copy"), disturb(same_light_scene.landmarks)
    ours, theirs = (Fitter(model, row).fit(same_light_scene.image, start) for row in (method, copy))
    assert theirs.method.name == "mine"
    assert (ours.status, ours.cost, ours.n_iterations) == (theirs.status, theirs.cost, theirs.n_iterations)
    for name in (*FIELDS, "theta"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name), err_msg=name)


@pytest.mark.parametrize("method", ["soft-li", "li", "grey"])
def test_how_far_a_fit_is_taken_hardly_matters(model, same_light_scene, method):
    """Fits that stop sooner end where patient ones do, by far less than they are uncertain."""
    start, patience = (
        disturb(same_light_scene.landmarks),
        SolverOptions(tolerance=1e-4, early_tolerance=0.0, relative_tolerance=0.0),
    )
    soon, late = (Fitter(model, method, o).fit(same_light_scene.image, start) for o in (SolverOptions(), patience))
    assert model_pixels(model, soon.landmarks, late.landmarks) < 0.1
