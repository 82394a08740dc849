"""Which part of a model an object is of: one search for all parts, and no more fits than that needs."""

from collections import Counter
from types import SimpleNamespace
from weakref import ref

import cv2
import numpy as np
import pytest

import liaam
from liaam.datasets import load_face
from liaam.fitting import Detection, FitStatus, Fitter
from liaam.fitting.detection import are_apart
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.low_quality import Elsewhere
from liaam.fitting.one_shape_fitter import Blurred, OneShapeFitter
from liaam.fitting.search import finder as search
from liaam.fitting.search.finder import AT_FIRST, LARGE, OTHERS_OF_PARTS
from liaam.fitting.search.other_places import PROMISING_OF_PARTS
from liaam.fitting.search.parts import (
    BRIEFEST,
    CLOSE,
    FIRST,
    HOPEFUL,
    LIKELY,
    SURE,
    fit_likeliest_part,
)
from liaam.model.shape import diagonal_of

USUAL = SolverOptions()


@pytest.fixture(scope="module")
def fitter():
    """Give a fitter of the face model, which has three parts."""
    return Fitter(liaam.load_model("face"))


@pytest.fixture(scope="module")
def portrait():
    return load_face().read_image()


@pytest.fixture
def work(monkeypatch):
    """Count the calls that a fit consists of."""
    done: Counter[str] = Counter()

    def count(owner, name: str) -> None:
        original = getattr(owner, name)

        def counted(*given, **named):
            done[name] += 1
            return original(*given, **named)

        monkeypatch.setattr(owner, name, counted)

    count(search.Grey, "field")
    for name in ("fit_coarsest", "fit_other_blurred", "fit_sharpest", "fit_target"):
        count(OneShapeFitter, name)
    return done


def test_the_parts_share_a_search_and_only_the_likely_ones_go_on(fitter, portrait, work):
    result = fitter.fit(portrait)
    sizes = search.search_sizes(portrait.shape[:2], fitter.finder.small.diagonal)
    assert (result.status.ok, result.part, result.n_starts, result.found.part) == (True, 0, 1, 0)
    assert work["field"] == (sizes >= LARGE * min(portrait.shape[:2])).sum()
    assert work["fit_coarsest"] == 3
    assert work["fit_other_blurred"] < 3
    assert (work["fit_sharpest"], work["fit_target"]) == (1, 0)


def test_from_a_box_all_parts_are_tried_without_a_search(fitter, portrait, work):
    there = fitter.fit(portrait).landmarks
    work.clear()
    box = np.concatenate([there.min(axis=0), there.max(axis=0)])
    result = fitter.fit(portrait, box)
    assert result.part == 0
    assert np.abs(result.landmarks - there).max() < 0.01 * diagonal_of(there)
    assert (work["field"], work["fit_coarsest"], work["fit_sharpest"]) == (0, 3, 1)


def test_where_there_is_no_face_the_work_is_bounded(fitter, rng, work):
    image = rng.integers(0, 255, (120, 160, 3), np.uint8)
    result = fitter.fit(image)
    assert not result.status.ok
    places = 1 + OTHERS_OF_PARTS + len(search.FILLING)
    assert work["fit_coarsest"] <= 3 * places
    assert work["fit_other_blurred"] <= 3 + places
    assert work["fit_sharpest"] <= 2 * PROMISING_OF_PARTS + 1
    sizes = search.search_sizes(image.shape[:2], fitter.finder.small.diagonal)
    assert work["field"] == len(sizes)  # each is looked at once, although the search is continued


@pytest.mark.parametrize("settings", [{"max_iterations": 20}, {"restarts": False}], ids=["limited", "from a box"])
def test_a_fit_that_no_other_follows_is_finished(fitter, rng, settings, monkeypatch):
    """Where the object is not looked for elsewhere, the first fit has all of its steps, although it is hopeless."""
    steps = []
    sharpest = OneShapeFitter.fit_sharpest

    def recorded(own, fit, options):
        steps.append(options.max_iterations)
        return sharpest(own, fit, options)

    monkeypatch.setattr(OneShapeFitter, "fit_sharpest", recorded)
    other = Fitter.of(fitter.model, **settings)
    image = rng.integers(0, 255, (120, 160, 3), np.uint8)
    other.fit(image, None if "max_iterations" in settings else (30, 20, 110, 110))
    assert set(steps) == {other.options.max_iterations}


def test_without_other_places_the_first_is_doubtful(fitter, rng, monkeypatch):
    monkeypatch.setattr(search.Finder, "others_in_turn", lambda *_: iter([]))
    result = fitter.fit(rng.integers(0, 255, (120, 160, 3), np.uint8))
    assert (result.status, result.n_starts) == (FitStatus.DOUBTFUL, 1)


def test_other_places_come_in_turn_and_none_twice(fitter, rng):
    image = rng.integers(0, 255, (120, 160, 3), np.uint8)
    linear = fitter.linear(image)
    first = fitter.finder.first_in(linear)
    large, others = fitter.finder.others_in_turn(linear)
    assert len(large) <= AT_FIRST
    assert not are_apart(fitter.finder.parts[first.part].mean_at(first.landmarks), large[0].landmarks)
    places = [*large, *others]
    assert all(are_apart(one.landmarks, other.landmarks) for i, one in enumerate(places) for other in places[:i])
    assert {place.part for place in places} <= {0, 1, 2}


def test_an_image_and_its_search_are_forgotten_together(fitter, portrait):
    linear = fitter.linear(portrait)
    fitter.finder.first_in(linear)
    assert linear.searches
    gone = ref(linear)
    del linear
    assert gone() is None


def test_the_search_for_one_face_is_that_of_all_parts(fitter, portrait):
    (found,) = fitter.find(portrait)
    assert found.part == 0
    assert not are_apart(fitter.fit(portrait).landmarks, found.landmarks)


def odd(odds: float) -> float:
    """Return the quality of given odds."""
    return odds / (1.0 + odds)


@pytest.fixture
def pretended():
    """Give the function that fits with parts of given odds at the coarsest and the second level; it counts steps."""

    def call(*odds: tuple[float, float], is_last: bool = True, is_judged: bool = True):
        sharpest: dict[int, int] = {}

        def part(i: int, coarse: float, second: float) -> SimpleNamespace:
            def result(options: SolverOptions) -> SimpleNamespace:
                sharpest[i] = options.max_iterations
                return SimpleNamespace(
                    status=SimpleNamespace(ok=True, lost=False), quality=0.1 * i, evidence=(0.0, 0.0)
                )

            at = np.zeros((1, 2))
            return SimpleNamespace(
                reliability=object() if is_judged else None,
                regressor=None,
                objectives=(1, 2, 3),
                fit_coarsest=lambda target, _: Blurred(target, [], at, odd(coarse)),
                fit_other_blurred=lambda fit, _: fit._replace(quality=odd(second)),
                fit_sharpest=lambda _, options: result(options),
                fit_target=lambda _, options: result(options),
            )

        fitters = [part(i, *each) for i, each in enumerate(odds)]
        targets = [SimpleNamespace(pull=None)] * len(odds)
        best, _ = fit_likeliest_part(fitters, targets, USUAL, is_last)  # type: ignore[arg-type]
        return best, sharpest

    return call


def test_a_part_goes_on_if_it_is_likely_beside_the_best(pretended):
    steps = USUAL.max_iterations
    unlikely = 0.9 * LIKELY * FIRST
    assert pretended((1.0, 1.0), (unlikely, 1000.0)) == (0, {0: steps})
    assert pretended((1.0, 1.0), (2.0 * unlikely, 1000.0)) == (1, {1: steps})
    assert pretended((1.0, 1.0), (1.0, 0.9 * CLOSE * FIRST), (1.0, 1.1 * CLOSE * FIRST)) == (2, {0: steps, 2: steps})


def test_a_first_part_that_is_sure_is_fitted_alone(pretended):
    sure = SURE / (1.0 - SURE)
    assert pretended((1.01 * sure, 1.0), (1e6, 1e6))[0] == 0
    assert pretended((0.99 * sure, 1.0), (1e6, 1e6))[0] == 1


def test_without_hope_a_fit_is_not_finished_if_others_follow(pretended):
    hopeless = 0.9 * HOPEFUL / (1.0 - HOPEFUL)
    assert pretended((1.0, hopeless), (1e-9, 1e-9), is_last=False)[1] == {0: BRIEFEST}
    assert pretended((1.0, hopeless), (1e-9, 1e-9), is_last=True)[1] == {0: USUAL.max_iterations}


def test_without_calibration_all_parts_are_fitted(pretended):
    best, sharpest = pretended((1.0, 1.0), (1e-9, 1e-9), is_judged=False)
    assert (best, set(sharpest)) == (1, {0, 1})


def test_detections_of_most_models_are_of_their_only_part():
    assert Detection(np.zeros((3, 2)), 1.0, 0.0, 1.0).part == 0


def test_a_hopeless_fit_is_not_tried_at_other_places_again(fitter, monkeypatch):
    """Most of it is absent, for which other places would be fitted without what is absent there."""

    def refuse(*_):
        raise AssertionError("these places were fitted already")

    noise = np.random.default_rng(0).integers(0, 256, (160, 140, 3)).astype(np.uint8)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.0).astype(np.float32)
    image = np.rint(20.0 + 210.0 * (blurred - blurred.min()) / np.ptp(blurred)).astype(np.uint8)
    monkeypatch.setattr(Elsewhere, "starts_of", refuse)
    result = fitter.fit(image)
    assert result.status is FitStatus.DOUBTFUL
    assert result.quality < HOPEFUL
    assert result.n_starts > 1
