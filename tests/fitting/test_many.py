"""Many images on threads: in order, the bits of single fits, bounded, stoppable, and clear about what is wrong."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import count, islice
from pathlib import Path
from weakref import WeakSet

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info

import liaam
from liaam import progress
from liaam.errors import ImageError, MethodError, StartError
from liaam.fitting import Fitter, detection, fit_each, fit_many
from liaam.fitting.many import _is_one_start
from liaam.fitting.search.finder import Finder
from liaam.io import Landmarks, write_image
from liaam.workers import AHEAD, BEHIND, in_order, one_blas_thread, one_thread
from setups import disturb

FAR = ((1.2, (-0.15, 0.1)), (1.35, (0.02, 0.16)), (0.8, (-0.2, -0.05)))
"""Starts of which some are too far off: the fits are begun again."""

FEW = {"method": "grey", "max_iterations": 3}


@pytest.fixture(scope="module")
def pictures(lit_scene, scenes):
    """Give images and starts, some of them so far off that the fit is begun again."""
    moves = [(1.03, (0.02, -0.015)), *FAR, (0.97, (0.0, 0.01)), (1.02, (-0.02, 0.0)), (1.0, (0.01, 0.02))]
    chosen = [scenes[0], lit_scene, lit_scene, lit_scene, lit_scene, scenes[3], scenes[5]]
    starts = [disturb(scene.landmarks, *move) for scene, move in zip(chosen, moves, strict=True)]
    return [scene.image for scene in chosen], starts


def assert_same(found, expected):
    """All but how an object was found, to the last bit."""
    for field in fields(found):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        if field.name == "history":
            assert [step.cost for step in ours] == [step.cost for step in theirs]
        elif field.name == "pose":
            np.testing.assert_array_equal(ours.matrix, theirs.matrix)
        elif field.name == "found":
            assert (ours is None) == (theirs is None)
            assert ours is None or ours.score == theirs.score
        else:
            np.testing.assert_array_equal(ours, theirs, err_msg=field.name)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_each_fit_is_that_of_a_single_one_to_the_last_bit(calibrated, pictures, workers):
    many = fit_many(calibrated, *pictures, workers=workers)
    fitter = Fitter(calibrated)
    with one_thread():
        single = [fitter.fit(image, start) for image, start in zip(*pictures, strict=True)]
    assert len(many) == len(single)
    for found, expected in zip(many, single, strict=True):
        assert_same(found, expected)
    assert any(result.n_starts > 1 for result in many) and any(result.n_starts == 1 for result in many)


@pytest.mark.parametrize("method", ["li-pc", "li+tukey", "li-lit+noise", "grey-norm"])
def test_threads_do_not_see_what_others_keep_of_their_fits(model, pictures, method):
    images, starts = ([several[i] for i in (0, 4, 5, 6) * 2] for several in pictures)
    many = fit_many(model, images, starts, method, workers=4, max_iterations=8)
    fitter = Fitter(model, method, liaam.SolverOptions(max_iterations=8))
    with one_thread():
        single = [fitter.fit(image, start) for image, start in zip(images[:4], starts[:4], strict=True)]
    for found, expected in zip(many, single * 2, strict=True):
        assert_same(found, expected)


def test_objects_are_searched_for_where_there_is_no_start(calibrated, pictures, lit_scene):
    image = lit_scene.image
    with one_thread():
        searched, started = Fitter(calibrated).fit(image), Fitter(calibrated).fit(image, pictures[1][4])
    for found in fit_many(calibrated, [image, image], workers=2):
        assert_same(found, searched)
    both = fit_many(calibrated, [image, image], [pictures[1][4], None], workers=2)
    assert_same(both[0], started)
    assert_same(both[1], searched)


def test_one_start_serves_all_images(model, lit_scene, tmp_path):
    low, high = lit_scene.landmarks.min(axis=0), lit_scene.landmarks.max(axis=0)
    write_image(tmp_path / "a.tiff", lit_scene.image)
    paths = [tmp_path / "a.tiff", str(tmp_path / "a.tiff")]
    box = tuple(map(float, (*low, *high)))
    starts = box, Landmarks(lit_scene.landmarks), Fitter(model).find(lit_scene.image)[0]
    for start in starts:
        one = liaam.fit_many(model, paths, start, **FEW)
        each = liaam.fit_many(model, iter(paths), iter([start, start]), **FEW)
        assert_same(one[0], each[1])
        assert_same(one[0], Fitter(model, "grey", liaam.SolverOptions(max_iterations=3)).fit(paths[0], start))


@pytest.mark.parametrize(
    ("given", "one"),
    [
        ((1, 2, 3, 4), True),
        ([1.0, 2.0, 3.0], True),
        (np.zeros((58, 2)), True),
        ([(1, 2), (3, 4), (5, 6)], True),
        ([(1, 2, 3, 4)], False),
        ([(1, 2, 3), (1, 2, 3, 4)], False),
        (np.zeros((2, 4)), False),
        (np.zeros((2, 58, 2)), False),
        ([None, None], False),
        ([np.zeros((58, 2)), None], False),
        ([], False),
        (iter([(1, 2, 3, 4)]), False),
    ],
)
def test_one_start_is_told_from_several(given, one):
    assert _is_one_start(given) is one


@pytest.mark.parametrize(
    ("n_images", "init", "message"),
    [
        (2, [(9, 9, 99, 99)], "2 images but 1 start; give one start for all images, or one for each"),
        (0, [(9, 9, 99, 99)], "0 images but 1 start;"),
        (2, [], "2 images but 0 starts"),
        (2, iter([(90, 90, 99)]), "more than 1 image but 1 start"),
        (2, iter([(90, 90, 99)] * 3), "2 images but more starts"),
        (2, 7, "init 7 is not valid; give one start"),
        (2, "starts", "init 'starts' is not valid; give one start"),
    ],
)
def test_numbers_that_differ_are_refused(model, lit_scene, n_images, init, message):
    with pytest.raises(StartError, match=message):
        fit_many(model, [lit_scene.image] * n_images, init, **FEW)


@pytest.mark.parametrize("single", ["a.png", Path("a.png"), np.zeros((20, 20, 3)), np.zeros((20, 20)), 3])
def test_a_single_image_is_refused(model, single):
    with pytest.raises(ImageError, match=r"images is not a list; give a list .* also for a single one: \[image\]"):
        fit_many(model, single, **FEW)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers 0 is too small; give 1 or more"),
        ({"errors": "ignore"}, "unknown errors 'ignore'; choose from raise, return"),
        ({"method": "magic"}, "choose from soft-li, grey"),
    ],
)
def test_options_that_make_no_sense_are_refused(model, options, message):
    with pytest.raises(MethodError, match=message):
        fit_many(model, [], **options)


def test_unknown_options_are_refused_without_images(model):
    with pytest.raises(TypeError, match="unknown option 'iterations'"):
        fit_many(model, [], iterations=3)


def test_no_images_give_no_results(model):
    assert fit_many(model, [], **FEW) == fit_many(model, iter(()), (1, 2, 3), **FEW) == []


@pytest.fixture
def spoilt(lit_scene, tmp_path):
    """Give pictures of which the second and the fourth cannot be fitted, and a start."""
    (tmp_path / "cut.png").write_bytes(b"no picture")
    grey = np.repeat(lit_scene.image[..., :1], 3, axis=2)
    return [lit_scene.image, tmp_path / "cut.png", lit_scene.image, grey], disturb(lit_scene.landmarks)


@pytest.mark.parametrize("workers", [1, 3])
def test_the_error_of_the_first_bad_picture_is_raised_and_names_it(model, spoilt, workers):
    images, start = spoilt
    with pytest.raises(ImageError, match=r"cut\.png"):
        fit_many(model, images, start, "li", workers=workers, max_iterations=2)
    with pytest.raises(ImageError, match=r"images\[3\]: the image is grey"):
        fit_many(model, [images[i] for i in (0, 2, 0, 3, 3)], start, "li", workers=workers, max_iterations=2)


def test_errors_may_take_the_place_of_results(model, spoilt):
    images, start = spoilt
    results = fit_many(model, images, start, "li", errors="return", workers=2, max_iterations=2)
    assert [isinstance(result, ImageError) for result in results] == [False, True, False, True]
    assert "cut.png" in str(results[1]) and "images[3]: the image is grey" in str(results[3])
    for fault in (results[1], results[1].__cause__, results[3]):
        assert fault is None or fault.__traceback__ is None, "its frames hold on to the picture"


def test_what_is_not_expected_is_raised_and_says_at_which_picture(model, lit_scene, monkeypatch):
    def fail(_self, image, _init, _name):
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(Fitter, "fit", fail)
    with pytest.raises(ZeroDivisionError) as caught:
        fit_many(model, [lit_scene.image], errors="return", **FEW)
    assert caught.value.__notes__ == ["liaam was fitting images[0]"]


def test_images_are_taken_as_there_is_room(model, lit_scene):
    taken = []

    def images():
        for i in count():
            taken.append(i)
            yield lit_scene.image

    options = liaam.SolverOptions(max_iterations=0)
    fits = fit_each(Fitter(model, "grey", options), images(), disturb(lit_scene.landmarks), workers=3)
    assert not taken, "nobody has asked for a result"
    for n in range(1, 40):
        assert next(fits).status
        assert len(taken) < n + BEHIND * 3
    fits.close()
    assert len(taken) < 40 + BEHIND * 3


class Picture:
    """Something that can be seen to be let go."""

    def __init__(self, number):
        self.number = number


def test_what_waits_for_a_slow_item_is_bounded_and_what_is_done_is_let_go():
    go, taken, alive, seen = threading.Event(), [], WeakSet(), []

    def items():
        for i in range(200):
            taken.append(i)
            yield Picture(i)

    def perform(item):
        alive.add(item)
        if item.number == 0:
            go.wait()
        return item.number

    def tick():
        seen.append((len(taken), len(alive)))
        if sum(n == BEHIND * 2 for n, _ in seen) > 3:
            go.set()

    results = in_order(perform, items(), 2, tick=tick)
    assert list(results) == list(range(200))
    before = seen[: [n for n, _ in seen].index(BEHIND * 2) + 3]
    assert max(n for n, _ in before) == BEHIND * 2
    assert all(held <= AHEAD * 2 + 1 for _, held in before)


def test_an_item_that_fails_ends_the_others():
    begun = []

    def perform(i):
        begun.append(i)
        if i == 3:
            raise ValueError("three")
        return i

    results = in_order(perform, count(), 2)
    assert list(islice(results, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)
    assert len(begun) <= 4 + BEHIND * 2
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("liaam")]


def limits():
    return {info["filepath"]: info["num_threads"] for info in threadpool_info()}, cv2.getNumThreads()


def test_blas_and_opencv_are_held_to_one_thread_and_let_go(model, lit_scene, monkeypatch):
    before, seen, start = limits(), [], disturb(lit_scene.landmarks)
    fits = fit_each(Fitter(model, "grey"), [lit_scene.image] * 2, start)
    assert limits() == before
    monkeypatch.setattr(Fitter, "fit", lambda *_: seen.append(limits()))
    next(fits)
    assert set(seen[0][0].values()) == {1} and seen[0][1] == 1
    fits.close()
    assert limits() == before


@pytest.fixture
def own_threads() -> Iterator[None]:
    """Let a test set OpenCV's threads, which are those of all later tests, too."""
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_the_last_to_let_go_restores_the_threads(own_threads):
    cv2.setNumThreads(3)
    before = limits()
    first, second, third = one_thread(), one_blas_thread(), one_thread()
    first.__enter__()
    second.__enter__()
    cv2.setNumThreads(2)
    third.__enter__()
    assert cv2.getNumThreads() == 1
    first.__exit__(None, None, None)
    assert set(limits()[0].values()) == {1} and cv2.getNumThreads() == 1
    second.__exit__(None, None, None)
    third.__exit__(None, None, None)
    assert limits() == before


SCRIPT = """
import os, signal, threading
from concurrent.futures import ThreadPoolExecutor
from liaam.fitting import many

close, dropped = ThreadPoolExecutor.shutdown, threading.Event()

class Slow:
    def fit(self, image, init, name):
        os.write(1, b"begun\\n")  # in one piece
        if image > 0:  # the first ends at once, the others once what was not begun is dropped
            dropped.wait(60)

def shutdown(pool, wait=True, *, cancel_futures=False):
    close(pool, False, cancel_futures=cancel_futures)
    dropped.set()
    close(pool, wait)

ThreadPoolExecutor.shutdown = shutdown
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
try:
    list(many.fit_each(Slow(), range(10**9), workers=2))
except KeyboardInterrupt:
    print("stopped", threading.active_count(), flush=True)
"""


def test_a_ctrl_c_drops_what_was_not_begun(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline() for _ in range(3)]  # the third comes while others are under way
        assert all(line.startswith("begun") for line in lines)
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert rest.splitlines() == ["stopped 1"], "what was not begun was to be dropped"


class Terminal:
    """Standard error of a terminal."""

    def __init__(self):
        self.text = ""

    def write(self, text):
        self.text += text

    def flush(self):
        pass

    def isatty(self):
        return True


@pytest.mark.parametrize(("patience", "shown"), [(0.0, True), (60.0, False)])
def test_a_terminal_shows_progress_where_it_takes_long(monkeypatch, patience, shown):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "PATIENCE", patience)
    monkeypatch.setenv("TERM", "xterm")
    with progress.progress_bar("pictures", 7) as tell:
        for done in range(8):
            tell(done)
    assert ("7/7" in terminal.text) is shown
    assert ("left:" in terminal.text) is shown


@pytest.mark.parametrize(("show", "shown"), [(None, False), (True, True), (False, False)])
def test_without_a_terminal_progress_is_shown_to_who_asks_for_it(model, lit_scene, capsys, show, shown):
    fit_many(model, [lit_scene.image] * 3, disturb(lit_scene.landmarks), progress=show, **FEW)
    captured = capsys.readouterr()
    assert ("3/3 images" in captured.err) is shown
    assert not captured.out


def test_every_object_of_each_image_is_fitted_on_request(calibrated, scenes):
    two = np.concatenate([scenes[0].image, scenes[1].image], axis=1)
    one, several = fit_many(calibrated, [scenes[2].image, two], every=True, workers=2, max_iterations=20)
    assert len(one) == 1 and len(several) == 2
    assert [each.n_found for each in several] == [1, 1]
    alone = liaam.fit(calibrated, two, max_iterations=20)
    assert alone.n_found == alone.to_dict()["n_found"] == 2
    again = liaam.fit_all(calibrated, two, max_iterations=20)
    np.testing.assert_array_equal([each.landmarks for each in again], [each.landmarks for each in several])
    assert liaam.fit(calibrated, two, scenes[0].landmarks, max_iterations=20).n_found is None
    with pytest.raises(StartError, match="use only one"):
        fit_many(calibrated, [two], scenes[0].landmarks, every=True)


def test_every_object_is_never_less_than_the_fit_of_one(calibrated, scenes, monkeypatch):
    picture = scenes[2].image
    alone = liaam.fit(calibrated, picture)
    (certain,) = liaam.fit_all(calibrated, picture)
    monkeypatch.setattr(detection, "DOUBTFUL", 1.1)  # no score is enough
    assert alone.status.ok and alone.quality >= alone.least_quality
    (fit,) = liaam.fit_all(calibrated, picture)
    np.testing.assert_array_equal(fit.landmarks, alone.landmarks)
    np.testing.assert_allclose(fit.landmarks, certain.landmarks, atol=1.0)


def test_a_place_that_only_scores_as_an_object_does_not_displace_one(calibrated, scenes, monkeypatch):
    wall = np.full_like(scenes[2].image, 0.3)
    image = np.concatenate([scenes[2].image, wall], axis=1)
    alone = liaam.fit(calibrated, image)
    there = replace(alone.found, landmarks=alone.landmarks + np.array([wall.shape[1], 0.0]), score=0.9)
    monkeypatch.setattr(Finder, "places_in", lambda *_: [there])  # as on a ruler
    fits = liaam.fit_all(calibrated, image)
    assert [fit.status.ok for fit in fits] == [True, False]
    np.testing.assert_array_equal(fits[0].landmarks, alone.landmarks)
    assert fits[0].n_found == 1


def test_a_small_place_in_an_object_does_not_displace_it(calibrated, scenes, monkeypatch):
    alone = liaam.fit(calibrated, scenes[2].image)
    centre = alone.landmarks.mean(axis=0)
    there = replace(alone.found, score=0.55)
    within = replace(there, landmarks=centre + 0.2 * (alone.landmarks - centre), scale=0.2 * there.scale, score=0.6)
    monkeypatch.setattr(Finder, "_find_all", lambda *_: [within, there])
    (found,) = Finder(calibrated).find(scenes[2].image, limit=None)
    np.testing.assert_array_equal(found.landmarks, there.landmarks)
    (fit,) = liaam.fit_all(calibrated, scenes[2].image)
    np.testing.assert_allclose(fit.landmarks, alone.landmarks, atol=1.0)


def test_an_object_of_which_a_part_is_absent_is_found_beside_a_whole_one(calibrated, scenes):
    whole, torn = scenes[2], scenes[3]
    image = torn.image.copy()
    low, high = torn.landmarks[:, 1].min(), torn.landmarks[:, 1].max()
    image[int(high - 0.4 * (high - low)) :] = image[:4].mean(axis=(0, 1))
    beside = np.array([whole.image.shape[1], 0.0])
    first, second = liaam.fit_all(calibrated, np.concatenate([whole.image, image], axis=1))
    assert first.status.ok and second.status.ok
    assert not first.absent.any()
    assert second.found.doubtful and second.absent.any()
    errors = np.linalg.norm(second.landmarks - torn.landmarks - beside, axis=1)
    assert errors[~second.absent].mean() < 1.0


def test_what_lies_on_a_code_is_no_object(calibrated, scenes):
    scene, fitter = scenes[2], Fitter(calibrated)
    assert len(fitter.fit_objects(scene.image, codes=[scene.landmarks + 500.0])) == 1
    with pytest.raises(StartError, match=r"tray: no object was found beside the codes .*; give a start \(--init\)"):
        fitter.fit_objects(scene.image, "tray", codes=[box_around(scene.landmarks)])


def box_around(shape):
    """Return the corners of the box around a shape (n, 2)."""
    (left, top), (right, bottom) = shape.min(axis=0) - 9.0, shape.max(axis=0) + 9.0
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
