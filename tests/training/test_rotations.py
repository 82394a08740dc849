"""Models of objects that are turned in any direction."""

import json

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save

import liaam
from liaam.errors import ModelFileError
from liaam.fitting import Fitter
from liaam.model.shape import diagonal_of, rotation, scaled_mean
from liaam.training.rotations import rotations_of
from scenes import Head, make_set
from setups import train_on

SHAPE = np.array([[0, 0], [10, 1], [12, 6], [3, 8], [-4, 5]], float)


def turned(angles) -> np.ndarray:
    return np.array([SHAPE @ rotation(np.deg2rad(angle)).T + 40.0 for angle in angles])


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ([0.0] * 20, "upright"),
        (np.linspace(-35, 35, 20), "upright"),
        ([0.0] * 39 + [180.0], "upright"),  # a scan upside down
        ([0.0] * 30 + [180.0] * 10, "all"),
        (np.linspace(-180, 180, 20, endpoint=False), "all"),
        (np.linspace(80, 100, 20), "upright"),  # the mean is turned as well
    ],
)
def test_rotations_are_those_of_the_shapes(angles, expected):
    shapes = turned(angles)
    assert rotations_of(shapes, scaled_mean(shapes, 60.0)) == expected


def quarter_turned(image: np.ndarray, points: np.ndarray, quarters: int) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(quarters):
        image = np.ascontiguousarray(np.rot90(image))
        points = np.column_stack([points[:, 1], image.shape[0] - 1 - points[:, 0]])
    return image, points


@pytest.fixture(scope="module")
def scenes():
    return make_set(9, Head(7), size=(128, 128))


@pytest.fixture(scope="module")
def turning(scenes):
    """A model of heads, a third of which lie on each of three sides."""
    pairs = [quarter_turned(scene.image, scene.landmarks, i % 3) for i, scene in enumerate(scenes[:-1])]
    return liaam.train(pairs, diagonal=50.0, leave_out=False, lamps=None, copies=0)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_turned_objects_are_fitted_from_a_box_and_without_a_start(turning, scenes, quarters):
    image, truth = quarter_turned(scenes[-1].image, scenes[-1].landmarks, quarters)
    assert turning.rotations == "all"
    for start in (np.concatenate([truth.min(axis=0), truth.max(axis=0)]), None):
        result = liaam.fit(turning, image, start)
        assert np.linalg.norm(result.landmarks - truth, axis=1).mean() < 0.03 * diagonal_of(truth)


def test_users_may_search_for_upright_objects_alone(turning):
    assert Fitter(turning).searched_rotations == "all"
    assert Fitter(turning, rotations="upright").searched_rotations == "upright"


def test_files_hold_the_rotations(turning, scenes, tmp_path):
    turning.save(tmp_path / "turning.liaam")
    assert liaam.load_model(tmp_path / "turning.liaam").rotations == "all"
    upright = train_on(scenes[:4], diagonal=40.0, methods="grey")
    assert upright.rotations == "upright"
    with safe_open(tmp_path / "turning.liaam", framework="numpy") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        header = json.loads(file.metadata()["liaam"])
    content = save(tensors, {"liaam": json.dumps({**header, "rotations": "odd"})})
    (tmp_path / "odd.liaam").write_bytes(content)
    with pytest.raises(ModelFileError, match="rotations odd are not known; they are upright or all"):
        liaam.load_model(tmp_path / "odd.liaam")
