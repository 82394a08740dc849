"""What several tests of fits share."""

import pytest

from liaam.photometry import CameraModel
from liaam.training import train
from setups import train_on


@pytest.fixture(scope="session")
def calibrated(trained_once, scenes):
    """Give a model that has learnt how far its fits can be trusted."""
    options = {"leave_out": True, "regressor": False}  # one would be tried, and not be kept
    return trained_once("calibrated", lambda: train_on(scenes, diagonal=60.0, **options))


@pytest.fixture(scope="session")
def grey_model(trained_once, scenes):
    """Give a model of the scenes without their colours."""
    pairs = [(scene.image.mean(axis=2), scene.landmarks) for scene in scenes]
    options = {"variance": 1.0, "prior": "sample", "methods": ["soft-li", "grey"], "leave_out": False}
    return trained_once("grey", lambda: train(pairs, diagonal=80.0, camera=CameraModel(response="linear"), **options))
