"""Annotated frames, and models."""

from dataclasses import replace

import numpy as np

from liaam.drawing import LANDMARK, LOST, rgb
from liaam.plotting import figure_of_model
from liaam.plotting.video import annotated

GOOD = rgb(LANDMARK)
BAD = rgb(LOST)


def test_landmarks_ellipses_and_a_caption_are_drawn(head_model, moving):
    scene = moving[0]
    before = scene.image.copy()
    covariances = np.broadcast_to(4.0 * np.eye(2), (58, 2, 2))
    plain = annotated(scene.image, scene.landmarks, head_model, "3   tracked")
    rich = annotated(scene.image, scene.landmarks, head_model, "3   tracked", covariances)
    lost = annotated(scene.image, None, head_model, "3   lost")
    assert plain.shape == rich.shape == lost.shape  # a video has one size
    assert (plain != rich).any()
    assert (lost.reshape(-1, 3) == BAD).all(axis=1).any()
    assert not (lost.reshape(-1, 3) == GOOD).all(axis=1).any()
    np.testing.assert_array_equal(scene.image, before)


def test_any_size_has_room_for_a_caption(head_model):
    for size in ((12, 9), (40, 1500), (900, 30)):
        frame = np.full((*size, 3), 128, np.uint8)
        picture = annotated(frame, None, head_model, "a rather long caption " * 3)
        assert (picture == BAD).all(axis=2).any()  # the dot before the caption
        assert picture.shape[0] * size[1] == picture.shape[1] * size[0]
        assert (frame == 128).all()  # drawn on a copy, also where it is large enough as it is


def test_every_shape_of_a_model_is_drawn(head_model):
    rows = [len(figure_of_model(model).axes) for model in (head_model, replace(head_model, others=(head_model,)))]
    assert rows[1] == 2 * rows[0]
