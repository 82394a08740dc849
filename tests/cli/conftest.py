"""A model that the tests of several commands fit."""

import pytest

from liaam.training import train
from scenes import Head, make_set


@pytest.fixture(scope="session")
def model_file(trained_once, tmp_path_factory):
    """Write a model of portraits of one head, for all methods.

    Without lamps: light is not what is tested, and a model with them sees half a face in one that lies on its side or
    is upside down.
    """

    def made():
        pairs = [(scene.image, scene.landmarks) for scene in make_set(6, head=Head(5), size=(160, 120))]
        return train(pairs, diagonal=80, methods="all", lamps=None, regressor=False)  # one would not be kept

    path = tmp_path_factory.mktemp("model") / "face.safetensors"
    trained_once("portraits", made).save(path)
    return path
