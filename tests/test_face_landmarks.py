"""The points of the face model, and the landmarks of the smiling faces that it is trained on."""

import json
from pathlib import Path

import numpy as np
import pytest

from liaam.io import read_collection

FOLDER = Path(__file__).parents[1] / "making" / "face"
POINTS = json.loads((FOLDER / "points.json").read_text(encoding="utf-8"))
NAMES = [point["name"] for point in POINTS["points"]]


@pytest.fixture(scope="module")
def smiling():
    """Return the landmarks of the smiling faces by image."""
    return read_collection(FOLDER / "smiling.csv")


def test_exchanging_left_and_right_gives_the_names_of_the_mirrored_face():
    def other(name):
        return name.replace("right", "#").replace("left", "right").replace("#", "left")

    assert len(set(NAMES)) == len({point["index"] for point in POINTS["points"]}) == len(NAMES)
    assert {other(name) for name in NAMES} == set(NAMES)
    mirrored = {frozenset(map(other, line)) for line in POINTS["contours"]}
    assert mirrored == {frozenset(line) for line in POINTS["contours"]}


def test_the_contours_pass_all_points_but_the_pupils():
    assert set(NAMES) - {name for line in POINTS["contours"] for name in line} == {"right_pupil", "left_pupil"}


def test_the_smiling_faces_have_the_points_by_name(smiling):
    assert len(smiling) == 102
    assert all(list(landmarks.names) == NAMES and not landmarks.missing.any() for landmarks in smiling.values())


def test_left_is_the_persons_and_the_lips_are_in_order(smiling):
    at = {name: np.array([landmarks.points[i] for landmarks in smiling.values()]) for i, name in enumerate(NAMES)}
    down = at["chin"] - (at["right_pupil"] + at["left_pupil"]) / 2
    down /= np.linalg.norm(down, axis=1, keepdims=True)

    def depth(name):
        return np.sum(at[name] * down, axis=1)

    assert (at["left_pupil"] - at["right_pupil"])[:, 0].min() > 90  # a person's left is at the right of the picture
    lips = [depth(name) for name in ("upper_lip_top", "upper_lip_bottom", "lower_lip_top", "lower_lip_bottom")]
    assert np.diff(lips, axis=0).min() >= -0.2  # a closed mouth's inner edges coincide, to the rounding
    assert 0.5 < np.mean(lips[2] - lips[1] > 2.0) < 0.7  # three in five show their teeth
