"""Errors are those that users of other libraries expect, too."""

import pickle

import numpy as np
import pytest

import liaam
from liaam import errors
from liaam.errors import LONGEST_MESSAGE, LiaamError, MissingImageError, ModelFileError, OptionError, shortened

ABSENT = "no/such/file"


@pytest.mark.parametrize(
    ("kind", "read"),
    [
        (errors.ImageError, lambda: liaam.read_image(f"{ABSENT}.png")),
        (errors.ImageError, lambda: liaam.load_folder(ABSENT)),
        (errors.LandmarkError, lambda: liaam.read_landmarks(f"{ABSENT}.pts")),
        (errors.ModelFileError, lambda: liaam.load_model(f"{ABSENT}.liaam")),
        (errors.CameraError, lambda: liaam.load_camera(f"{ABSENT}.json")),
        (errors.ImageError, lambda: liaam.fit(liaam.load_model("face"), f"{ABSENT}.jpg")),
    ],
)
def test_a_missing_file_is_a_file_not_found_error(kind, read):
    with pytest.raises(FileNotFoundError) as caught:
        read()
    assert isinstance(caught.value, kind)
    assert str(caught.value).startswith(ABSENT)


def test_invalid_input_is_a_value_error(tmp_path):
    (tmp_path / "empty.png").touch()
    with pytest.raises(ValueError, match="is empty"):
        liaam.read_image(tmp_path / "empty.png")
    with pytest.raises(ValueError, match="unknown method"):
        liaam.Fitter(liaam.load_model("face"), "no-method")


def test_a_misspelt_keyword_is_a_type_error_with_a_suggestion():
    model = liaam.load_model("face")
    with pytest.raises(TypeError, match="did you mean 'damping'"):
        liaam.fit(model, np.zeros((64, 64, 3), np.uint8), dampin=1.0)
    with pytest.raises(TypeError, match="did you mean 'variance'"):
        liaam.train([], varience=0.9)


def test_each_kind_of_error_survives_pickling():
    kinds = [each for each in vars(errors).values() if isinstance(each, type) and issubclass(each, LiaamError)]
    for kind in kinds:
        error = pickle.loads(pickle.dumps(kind("a sentence")))
        assert type(error) is kind
        assert str(error) == "a sentence"


@pytest.mark.parametrize("kind", [LiaamError, ModelFileError, MissingImageError, OptionError])
def test_a_long_message_loses_its_middle(kind):
    text = str(kind("path: " + 1_000_000 * "x" + "; the remedy"))
    assert len(text) == LONGEST_MESSAGE and text.startswith("path: xx") and text.endswith("xx; the remedy")
    assert str(kind("short")) == "short"


def test_errors_of_missing_files_keep_their_kind_and_can_be_sent_to_other_processes():
    error = pickle.loads(pickle.dumps(MissingImageError("a.png does not exist")))
    assert isinstance(error, FileNotFoundError) and str(error) == "a.png does not exist"


def test_values_are_shortened_in_their_middle():
    assert shortened("a" * 200) == "a" * 200
    cut = shortened("a" * 150 + "b" * 150)
    assert len(cut) == 200 and cut.startswith("aaa") and " ... " in cut and cut.endswith("bbb")


def test_names_that_people_expect_are_answered_with_those_that_there_are():
    with pytest.raises(OptionError, match=r"unknown option 'start'; choose from margin; did you mean 'init'\?"):
        errors.check_options(["start"], ["margin"])


def test_a_name_of_no_model_is_answered_with_the_names_of_models():
    with pytest.raises(
        ModelFileError, match=r"^'fase' is not a model; .*the name of one that comes with liaam \('face'"
    ):
        liaam.fit("fase", np.zeros((9, 9, 3), np.uint8))
