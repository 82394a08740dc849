"""The table of methods, and what it refuses."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import liaam
from liaam.errors import MethodError, OptionError
from liaam.fitting import METHODS, Fitter, Method, fit, get_method
from liaam.fitting.methods import LOSSES
from liaam.model.appearance import CHANNELS
from liaam.photometry import invariant_row

ROUNDING = 16 * np.finfo(float).eps
"""Limit of a sum of three numbers up to 1.5 that is zero but for rounding: twice what its roundings may add up to."""


def test_an_unknown_method_lists_those_that_exist():
    with pytest.raises(
        MethodError, match=re.escape(f"'sift'; choose from {', '.join(METHODS)} (see 'liaam fit --help')")
    ):
        get_method("sift")


def test_the_reference_lists_all_methods_and_losses():
    text = (Path(__file__).parents[2] / "docs/reference/methods.md").read_text(encoding="utf-8")
    names = re.findall(r"`([^`]+)`", text)
    assert METHODS.keys() <= set(names)
    assert {f"+{loss}" for loss in LOSSES} <= {part for name in names for part in re.findall(r"\+[a-z0-9-]+", name)}


def test_a_method_of_ones_own_passes_through():
    own = replace(METHODS["li"], name="own", free_angles="none")
    assert get_method(own) is own


def test_every_row_of_the_table_is_consistent():
    for name, method in METHODS.items():
        assert method.name == name
        channels = 6 if method.encoding == "soft" else 3
        assert method.image_metric(2.0).shape == (method.n_rows, channels), name
        assert method.model_metric(2.0).shape == (method.n_rows, CHANNELS[method.appearance]), name
        assert (method.angle_directions.shape[1] > 0) == (method.free_angles != "none"), name
        assert method.weighs_noise == (method.weights != "model"), name
        assert method.expects == (method.step in ("scored", "expected")), name


@pytest.mark.parametrize("metric", ["invariant", "chromaticity"])
def test_a_common_bias_is_refused_where_it_is_a_null_vector(metric):
    with pytest.raises(MethodError, match=f"a common bias is invisible to metric {metric}"):
        Method("x", "", "log", "log", metric, bias="common")
    assert np.abs(Method("x", "", "log", "log", metric).image_metric(2.0).sum(axis=1)).max() < ROUNDING


@pytest.mark.parametrize("metric", ["luminance", "rgb", "chromaticity"])
def test_angles_cannot_be_freed_where_there_are_none(metric):
    with pytest.raises(MethodError, match=f"metric {metric} has no angle to free"):
        Method("x", "", "log", "log", metric, free_angles="image")


@pytest.mark.parametrize("free", ["both", "shared"])
def test_an_appearance_that_is_already_projected_fixes_theta_1(free):
    with pytest.raises(MethodError, match="theta_1 is fixed"):
        Method("x", "", "log", "invariant", "invariant", free_angles=free)


@pytest.mark.parametrize(
    "field", ["encoding", "appearance", "metric", "free_angles", "bias", "weights", "step", "view"]
)
def test_an_unknown_choice_lists_those_that_exist(field):
    with pytest.raises(MethodError, match=f"unknown {field} 'nonsense'; choose from .*, "):
        replace(METHODS["li"], **{field: "nonsense"})


def test_shared_angles_move_together_and_both_apart():
    assert METHODS["li-pcs"].angle_directions.tolist() == [[1], [1]]
    assert METHODS["li-pc"].angle_directions.tolist() == [[1, 0], [0, 1]]
    assert METHODS["li"].angle_directions.tolist() == [[0], [1]]


def test_image_and_model_are_measured_by_their_own_angles():
    np.testing.assert_array_equal(METHODS["li"].image_metric(1.9), invariant_row(1.9))
    np.testing.assert_array_equal(METHODS["li-lit"].model_metric(1.9), [[1.0]])


@pytest.mark.parametrize(
    ("row", "match"),
    [
        (("log", "log", "invariant", "both", True), "gain"),
        (("log", "value", "rgb"), "do not suit"),
        (("value", "log", "rgb"), "do not suit"),
        (("log", "invariant", "rgb"), "needs the invariant metric"),
        (("value", "orientation", "orientation"), "do not suit"),
        (("value", "value", "orientation"), "does not suit"),
        (("orientation", "orientation", "rgb"), "does not suit"),
    ],
)
def test_rows_that_cannot_be_are_refused(row, match):
    with pytest.raises(MethodError, match=match):
        Method("mine", "", *row)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"illumination": True}, "need encoding value"),
        ({"normalise": True}, "need encoding value"),
        ({"loss": "nonsense"}, "unknown loss 'nonsense'; choose from squares, huber, l1"),
    ],
)
def test_terms_that_do_not_suit_are_refused(changes, match):
    with pytest.raises(MethodError, match=match):
        replace(METHODS["li"], **changes)


def test_suffixes_change_a_method():
    method = get_method("li+noise+huber")
    assert (method.name, method.weights, method.loss, method.metric) == (
        "li+noise+huber",
        "noise",
        "huber",
        "invariant",
    )
    assert method.reweighs and method.weighs_noise and method.expects
    assert not get_method("li").reweighs


@pytest.mark.parametrize("name", ["li+nonsense", "li+noise+noise", "li+huber+tukey", "li+", "li+squares"])
def test_suffixes_that_do_not_exist_are_listed(name):
    with pytest.raises(MethodError, match=r"is unknown or repeated; use \+noise and at most one of \+huber"):
        get_method(name)


@pytest.mark.parametrize("name", ["igo+noise", "grey+noise", "rgb+noise+huber"])
def test_noise_weights_are_for_logarithms(name):
    with pytest.raises(MethodError, match="noise weights are for methods that compare logarithms"):
        get_method(name)


def test_weights_by_rows_are_for_soft_directions():
    with pytest.raises(MethodError, match="weights by rows are for encoding soft"):
        replace(METHODS["li"], weights="rows")


@pytest.mark.parametrize("name", ["li+noise+learnt", "soft-li+learnt"])
def test_the_models_errors_are_not_counted_twice(name):
    with pytest.raises(MethodError, match="already include the model's errors; leave out 'learnt'"):
        get_method(name)


def test_methods_that_compare_logarithms_end_with_steps_by_the_expected_gradient():
    for name in (*METHODS, "li+noise"):
        method = get_method(name)
        assert (method.step == "scored") == (method.encoding == "log")


def test_spaces_around_suffixes_do_not_matter():
    assert get_method("li + noise ").name == "li+noise"


def test_methods_that_learn_light_need_a_model_that_has(fine_model):
    for name in ("aia", "varied"):
        with pytest.raises(MethodError, match="--lamps"):
            Fitter(fine_model, name)


def test_unknown_options_are_listed(model, scenes):
    with pytest.raises(OptionError, match=r"'max_iteration'; choose from model, .*camera, .*max_iterations, tolerance"):
        fit(model, scenes[0].image, scenes[0].landmarks, max_iteration=3)
    with pytest.raises(MethodError, match="finite"):
        fit(model, scenes[0].image, scenes[0].landmarks, tolerance=float("nan"))


def test_rows_are_compared_by_what_they_do():
    copy = replace(METHODS["soft-li"], name="mine", summary="a copy")
    assert copy == METHODS["soft-li"] and hash(copy) == hash(METHODS["soft-li"])
    assert replace(copy, loss="huber") != METHODS["soft-li"]
    assert len(set(METHODS.values())) == len(METHODS)


def test_the_table_of_methods_prints_a_line_for_each():
    lines = str(METHODS).splitlines()
    assert len(lines) == len(METHODS)
    assert lines[0].startswith("soft-li  ")
    assert lines[0].endswith(METHODS["soft-li"].summary)


@pytest.mark.parametrize(
    ("function", "misspelt", "meant"),
    [
        (liaam.fit, "methd", "method"),
        (liaam.fit_many, "worker", "workers"),
        (liaam.relight, "ambiant", "ambient"),
        (liaam.evaluate, "normalize", "normalise"),
        (liaam.fit_all, "max_iteration", "max_iterations"),
    ],
)
def test_a_misspelt_keyword_names_the_one_that_was_meant(function, misspelt, meant):
    with pytest.raises(TypeError, match=f"unknown option '{misspelt}'; choose from .*; did you mean '{meant}'"):
        function("face", ["new.jpg"], **{misspelt: 1})
