"""Learn the projection of the channels of a function of the user."""

from collections.abc import Sequence

import numpy as np

from liaam.errors import TrainingError
from liaam.model.sampling import make_patch
from liaam.model.shape import align
from liaam.photometry import CameraModel
from liaam.photometry.encoding import as_colour
from liaam.photometry.features import WIDEST, Encoder, FeatureFunction, Features, channels_of, name_of
from liaam.training.entries import Entry

MOST_IMAGES = 50  # Largest number of images that the projection is learnt from


def encoder_of(function: FeatureFunction, entries: Sequence[Entry], mean: np.ndarray, camera: CameraModel) -> Encoder:
    """Learn the projection from the objects in images, at the resolution of the mean shape (n, 2).

    It is that on the principal components of the channels, or keeps all of them if there are few.
    """
    name = name_of(function)
    count = 0
    total = np.zeros(1)
    products = np.zeros((1, 1))
    for entry in entries[:: -(-len(entries) // MOST_IMAGES)]:
        image = camera.flatten(as_colour(entry.read_image(), entry.name))
        pose = align(mean, entry.points)
        patch = make_patch(image, entry.points, pose, encoding="value", response=camera.response, blur=0.0, margin=0.1)
        channels = channels_of(function, np.ascontiguousarray(patch.channels[..., :3]))
        rows = channels.reshape(-1, channels.shape[2])
        if count and rows.shape[1] != len(total):
            raise TrainingError(
                f"{entry.name}: the function {name} returns {rows.shape[1]} channels, but {len(total)} for the first "
                "image; it must return the same channels for all images"
            )
        count = count + len(rows)
        total = total + rows.sum(axis=0)
        products = products + rows.T @ rows
    mean = total / count
    if len(mean) <= WIDEST:
        return Encoder(function, Features(name, np.zeros(len(mean)), np.eye(len(mean))))
    vectors = np.linalg.eigh(products / count - np.outer(mean, mean))[1]
    return Encoder(function, Features(name, mean, np.ascontiguousarray(vectors[:, ::-1][:, :WIDEST])))
