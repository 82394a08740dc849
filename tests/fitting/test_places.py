"""Which of several places is the object's, and how far that is believed."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from liaam.fitting import Detection, FitStatus, Fitter
from liaam.fitting.search.finder import LARGE
from liaam.fitting.search.other_places import BRIEF
from liaam.model import SURROUNDINGS
from liaam.model.shape import diagonal_of

HIGH = 0.9


@pytest.fixture
def place(calibrated, lit_scene, monkeypatch):
    """Give the function that fits without a start where the search finds places of given sizes and qualities.

    The qualities are for equal odds.
    """
    known = calibrated.views[SURROUNDINGS].reliabilities["soft-li"]
    calibrated = calibrated.with_view(SURROUNDINGS, reliabilities={"soft-li": replace(known, prior=1.0)})
    calibrated = replace(calibrated, refiner=None)  # so that the landmarks are those of a place
    image, right = lit_scene.image, Fitter(calibrated).fit(lit_scene.image, lit_scene.landmarks)

    def call(*places: tuple[float, float]):
        unit = (lit_scene.landmarks - lit_scene.landmarks.mean(axis=0)) / diagonal_of(lit_scene.landmarks)
        shapes = [size * min(image.shape[:2]) * unit + 60.0 + 40.0 * i for i, (size, _) in enumerate(places)]
        found = [Detection(shape, 0.6, 0.0, 1.0) for shape in shapes]
        fits = {
            shape.tobytes(): replace(right, landmarks=shape, quality=quality, status=FitStatus.CONVERGED)
            for shape, (_, quality) in zip(shapes, places, strict=True)
        }
        fitter = Fitter(calibrated, restarts=False)
        vars(fitter)["finder"] = SimpleNamespace(
            first_in=lambda _: found[0], others_in_turn=lambda *_: iter([found[1:]]), parts=(None,)
        )
        call.briefly = []

        def fit_from(_self, target, options=None):
            fit, brief = fits[target.start.tobytes()], options is not None and options.max_iterations == BRIEF
            call.briefly.append(brief)
            if brief and fit.quality < call.slow:
                return replace(fit, status=FitStatus.MAX_ITERATIONS)
            return fit if call.ends is None or len(call.briefly) == 1 else replace(fit, quality=call.ends)

        monkeypatch.setattr(Fitter, "fit_target", fit_from)
        monkeypatch.setattr(Fitter, "fit_sharpest", lambda own, each, brief: fit_from(own, each.target, brief))
        result = fitter.fit(image)
        return next(i for i, shape in enumerate(shapes) if shape is result.landmarks), result

    call.slow, call.ends = 0.0, None
    return call


def test_other_places_are_fitted_briefly_and_the_best_to_its_end(place):
    place((0.4, 0.1), (0.8, 0.7), (0.8, 0.3))
    assert place.briefly == [False, True, True]
    place.slow = 0.8
    which, result = place((0.4, 0.1), (0.8, 0.7), (0.8, 0.3))
    assert place.briefly == [False, True, True, False]
    assert (which, result.n_starts) == (1, 3)
    assert result.status is FitStatus.CONVERGED
    place.ends = 0.01  # what looked best turns out to be nothing, so the next best is taken to its end, too
    which, result = place((0.4, 0.1), (0.8, 0.7), (0.8, 0.3))
    assert place.briefly == [False, True, True, False, False]
    assert (which, result.n_starts) == (0, 3)


def test_a_large_place_of_high_quality_is_believed_and_ends_the_search(place):
    which, result = place((1.0, HIGH), (1.0, 0.99))
    assert which == 0
    assert result.n_starts == 1
    assert result.quality == pytest.approx(HIGH)
    assert result.status is FitStatus.CONVERGED


def test_the_smaller_a_place_the_less_it_is_believed(place):
    qualities = [place((size, HIGH))[1].quality for size in (0.15, 0.2, LARGE, 0.8)]
    assert qualities[0] < qualities[1] < qualities[2]
    assert qualities[2] == pytest.approx(qualities[3]) == pytest.approx(HIGH)
    odds = [quality / (1 - quality) for quality in qualities]
    assert odds[0] / odds[2] == pytest.approx((0.15 / LARGE) ** 2)


def test_of_places_that_look_alike_the_largest_is_taken(place):
    assert place((0.4, 0.3), (0.8, 0.3), (0.2, 0.3))[0] == 1
    assert place((0.4, 0.3), (0.2, 0.9))[0] == 1


def test_where_the_first_place_looks_wrong_and_two_others_right_neither_is_believed(place):
    _, alone = place((0.5, 0.1), (0.5, 0.6))
    which, one_of_two = place((0.5, 0.1), (0.5, 0.6), (0.5, 0.59))
    assert alone.status is FitStatus.CONVERGED
    assert (which, one_of_two.n_starts) == (1, 3)
    assert one_of_two.status is FitStatus.DOUBTFUL
    own, others = 0.6 / 0.4, 0.59 / 0.41 + 0.1 / 0.9
    assert one_of_two.quality == pytest.approx(own / (1 + own + others))


def test_a_first_place_that_is_more_likely_right_than_wrong_is_not_compared_with_others(place):
    which, result = place((0.5, 0.6), (0.5, 0.9))
    assert (which, result.n_starts) == (0, 1)


@pytest.mark.parametrize("first", [(0.15, 0.7), (0.9, 0.3)], ids=["small", "large, of low quality"])
def test_a_first_place_that_is_more_likely_wrong_is_compared_with_others(place, first):
    """Being large adds nothing to its quality."""
    assert place(first, (0.5, 0.1))[1].n_starts == 2


def test_what_is_lost_everywhere_stays_lost(place):
    which, result = place((0.5, 0.0), (0.8, 0.0))
    assert which == 0
    assert result.quality == 0.0


def test_what_is_blurred_or_half_outside_speaks_little_for_a_fit(calibrated, same_light_scene):
    image, truth = same_light_scene.image, same_light_scene.landmarks
    fitter, middle = Fitter(calibrated, restarts=False), int(truth[:, 0].mean())

    def explained(picture, shape=truth):
        return fitter.fit(np.ascontiguousarray(picture), shape).evidence[0]

    whole = explained(image)
    assert explained(cv2.GaussianBlur(image, (0, 0), 12.0)) < 0.5 * whole
    assert explained(image[:, middle:], truth - [middle, 0]) < 0.8 * whole
