"""``liaam.fit`` keeps the last fitters with their model."""

import gc
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import liaam
from liaam.fitting.single import FITTERS_KEPT
from liaam.photometry import CameraModel
from setups import disturb, train_on


def test_calls_in_a_loop_prepare_a_fitter_once(scenes, lit_scene):
    model, start = train_on(scenes[:3], diagonal=40.0), disturb(lit_scene.landmarks)
    first = liaam.fit(model, lit_scene.image, start, "li")
    (fitter,) = vars(model)["_fitters"].values()
    again = liaam.fit(model, lit_scene.image, start, "li")
    assert list(vars(model)["_fitters"].values()) == [fitter]
    np.testing.assert_array_equal(again.landmarks, first.landmarks)
    for changes in ({"max_iterations": 1}, {"margin": 0.3}, {"camera": CameraModel(theta=2.0)}, {"restarts": False}):
        liaam.fit(model, lit_scene.image, start, "li", **changes)
    kept = list(vars(model)["_fitters"].values())
    assert len(kept) == FITTERS_KEPT and fitter not in kept
    # One of another camera with the same place in memory is not taken for it.
    camera = CameraModel(theta=1.9)
    assert liaam.fit(model, lit_scene.image, start, "grey", camera=camera).status


def test_they_are_dropped_with_the_model_and_not_pickled(scenes, lit_scene):
    model = train_on(scenes[:3], diagonal=40.0)
    liaam.fit(model, lit_scene.image, disturb(lit_scene.landmarks))
    assert "_fitters" not in vars(pickle.loads(pickle.dumps(model)))
    gone = weakref.ref(model)
    del model
    gc.collect()
    assert gone() is None


def test_threads_share_them(scenes, lit_scene):
    model, start = train_on(scenes[:3], diagonal=40.0), disturb(lit_scene.landmarks)
    methods = ["li", "grey", "rgb", "igo", "soft-li", "li-lit"] * 4
    with ThreadPoolExecutor(8) as pool:
        fits = list(pool.map(lambda method: liaam.fit(model, lit_scene.image, start, method), methods))
    for method, fit in zip(methods, fits, strict=True):
        np.testing.assert_array_equal(fit.landmarks, liaam.fit(model, lit_scene.image, start, method).landmarks)
    assert len(vars(model)["_fitters"]) <= FITTERS_KEPT


def test_a_start_by_the_name_of_another_library_is_told(model, lit_scene):
    for start in (lit_scene.landmarks, lit_scene.landmarks.tolist()):
        with pytest.raises(liaam.LiaamError, match=r"unknown option 'start'.*did you mean 'init'"):
            liaam.fit(model, lit_scene.image, start=start)
