"""What a model keeps of its appearances, and how small its file is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import liaam
from liaam.errors import MethodError
from liaam.fitting import Fitter
from liaam.fitting.methods import METHODS, methods_of
from liaam.model import AAM, MESH, SURROUNDINGS, load_model
from liaam.model.rounding import encoded
from liaam.relighting import shadow_free
from liaam.training import train
from setups import disturb, model_pixels, train_on

MODEL = Path(__file__).with_name("heads-of-schema-4.liaam")

ON_LOG = ("soft-li", "li", "li-pc", "li-pcs", "chroma")
"""Methods that need no appearances besides those of soft-li and ``log``."""


@pytest.fixture(scope="module")
def own(trained_once, scenes) -> AAM:
    """A model of the default method alone."""
    return trained_once("own", lambda: train_on(scenes, diagonal=80.0, methods=()))


def test_a_model_has_the_default_method_the_search_and_relighting(own, lit_scene):
    assert methods_of(own) == ("soft-li",)
    fitter = Fitter(own)
    result = fitter.fit(lit_scene.image)
    assert result.found is not None
    assert model_pixels(own, result.landmarks, lit_scene.landmarks) < 1.0
    assert np.isfinite(shadow_free(fitter, lit_scene.image, result).log_rgb).all()
    assert [set(level.appearances) for level in own.levels] == [{"search"}, {"log"}]
    assert all(set(level.appearances) == {"soft"} for level in own.views[SURROUNDINGS].levels)


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        (["li"], ON_LOG),
        ("li", ON_LOG),
        (["grey+tukey"], ("soft-li", "grey", "rgb", "grey-plain", "grey-norm")),
        (["li-lit", METHODS["igo"]], ("soft-li", "li-lit", "igo")),
        ("all", {*METHODS} - {"varied", "aia"}),
    ],
)
def test_methods_are_trained_on_request(scenes, methods, expected):
    model = train_on(scenes[:4], diagonal=40.0, blurs=(2.0, 1.0, 0.0), copies=0, methods=methods)
    assert set(methods_of(model)) == set(expected)


def test_a_method_that_the_model_lacks_is_named_with_the_remedy(own):
    for method in ("grey", "grey+tukey"):
        with pytest.raises(MethodError) as error:
            Fitter(own, method)
        assert f"method {method}: the model was trained for soft-li; train it again with '--methods grey'" in str(
            error.value
        )


def test_unknown_methods_are_refused_before_any_work():
    with pytest.raises(MethodError, match=r"unknown method 'gray'; choose from soft-li, grey"):
        train([], methods=["gray"])


def test_a_saved_model_is_the_trained_one(scenes, tmp_path):
    trained = train_on(scenes[:5], diagonal=60.0, copies=1, methods=["grey"])
    trained.save(tmp_path / "m.liaam")
    loaded = load_model(tmp_path / "m.liaam")
    for name, view in trained.views.items():
        for ours, theirs in zip(view.levels, loaded.views[name].levels, strict=True):
            assert ours.appearances.keys() == theirs.appearances.keys()
            for kind, appearance in ours.appearances.items():
                for field in ("mean", "modes", "eigenvalues", "usable", "unexplained"):
                    mine, other = getattr(appearance, field), getattr(theirs.appearances[kind], field)
                    np.testing.assert_array_equal(mine, other)
                    assert mine is None or mine.dtype == other.dtype


def test_fits_are_those_of_the_model_in_single_precision(lit_scene, same_light_scene):
    exact = Fitter(load_model(MODEL))  # of version 4
    small = Fitter(liaam.compact(exact.model))
    for scene in (lit_scene, same_light_scene):
        shown = np.rint(255 * np.clip(scene.image / scene.image.max(), 0, 1) ** 0.45).astype(np.uint8)
        box = (*scene.landmarks.min(axis=0), *scene.landmarks.max(axis=0))
        ours, theirs = exact.fit(shown, box), small.fit(shown, box)
        assert model_pixels(exact.model, ours.landmarks, theirs.landmarks) < 0.05


def test_pixels_that_no_fit_uses_do_not_matter(fine_model, lit_scene):
    """Whatever they hold; only the sharpest level is used at all pixels."""
    view = fine_model.views[SURROUNDINGS]
    small = liaam.compact(fine_model).views[SURROUNDINGS]
    levels = []
    for level, kept in zip(view.levels, small.levels, strict=True):
        known = kept.appearances["soft"].mask
        levels.append(replace(level, appearances={"soft": level.appearances["soft"].only_at(known)}))
    assert [level.appearances["soft"].mask.mean() > 0.999 for level in levels] == [False, False, True]
    start = disturb(lit_scene.landmarks)
    changed = fine_model.with_view(SURROUNDINGS, levels=tuple(levels))
    ours, theirs = (Fitter(each).fit(lit_scene.image, start) for each in (fine_model, changed))
    np.testing.assert_array_equal(ours.landmarks, theirs.landmarks)
    assert ours.cost == theirs.cost


def test_modes_have_8_bits_and_those_of_methods_asked_for_16(own, scenes):
    asked = liaam.compact(train_on(scenes[:5], diagonal=60.0, copies=1), ["li"])
    for model, bits in ((own, 8), (asked, 16)):
        log = model.levels[-1].appearances["log"].modes
        assert (encoded(log) is not None) == (bits == 8)
        assert bits == 8 or np.array_equal(log.astype(np.float16), log)
        assert encoded(model.views[SURROUNDINGS].levels[0].appearances["soft"].modes) is not None


def test_models_that_keep_all_of_the_variance_are_not_rounded(fine_model):
    assert encoded(fine_model.views[SURROUNDINGS].levels[0].appearances["soft"].modes) is None


def test_old_files_load_and_become_small(tmp_path):
    old = load_model(MODEL)
    assert set(methods_of(old)) >= {"soft-li", "grey", "li", "igo"}
    assert old.is_colour and set(old.levels[0].appearances) >= {"orientation", "search"}
    small = liaam.compact(old)
    assert set(methods_of(small)) == set(ON_LOG)  # one level of the mesh, whose ``log`` is kept for relighting
    assert len(small.to_bytes()) < 0.4 * MODEL.stat().st_size


def test_a_method_that_the_old_model_lacks_cannot_be_kept(own):
    with pytest.raises(MethodError, match="method igo: the model was trained for soft-li"):
        liaam.compact(own, ["igo"])


def test_all_that_is_there_can_be_kept(model):
    assert methods_of(liaam.compact(model, "all")) == methods_of(model)
    assert set(liaam.compact(model, "all").views[MESH].levels[0].appearances) == set(model.levels[0].appearances)
