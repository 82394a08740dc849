"""Frames of a track: the pose that the similarity of the shape gives."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import FitStatus
from liaam.tracking import TrackedFrame, TrackStatus

MEAN = np.array([[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]])


def frame_of(landmarks, status=TrackStatus.TRACKED) -> TrackedFrame:
    spread = np.zeros((4, 2, 2))
    return TrackedFrame(0, 0.0, status, FitStatus.CONVERGED, 1.0, np.nan, landmarks, landmarks, spread, spread, MEAN)


@pytest.mark.parametrize("degrees", [0.0, 30.0, -90.0, 170.0])
def test_roll_and_size_are_those_of_the_shape(degrees):
    turn = np.deg2rad(degrees)
    matrix = 3.0 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    frame = frame_of(MEAN @ matrix.T + [100.0, 50.0])
    assert np.rad2deg(frame.roll) == pytest.approx(degrees)
    assert frame.size == pytest.approx(3.0 * np.linalg.norm(MEAN))
    np.testing.assert_allclose(frame.pose.offset, [100.0, 50.0], atol=1e-9)
    assert frame.to_dict()["roll_deg"] == pytest.approx(degrees)


def test_roll_is_clockwise_as_seen():
    right_side_down = np.add(MEAN, [[0, 0], [0, 0.5], [0, 0.5], [0, 0]])  # y points down
    assert frame_of(right_side_down).roll > 0


def test_a_change_of_shape_is_no_pose():
    wider = frame_of(MEAN * [1.2, 0.8])
    assert wider.roll == pytest.approx(0.0, abs=1e-12)
    assert wider.size == pytest.approx(np.linalg.norm(MEAN) * (1.2 * 16 + 0.8 * 4) / 20)


def test_lost_frames_have_no_pose():
    frame = frame_of(np.full((4, 2), np.nan), TrackStatus.LOST)
    assert np.isnan([frame.roll, frame.size]).all()
    assert frame.to_dict()["roll_deg"] is frame.to_dict()["size"] is None


def test_a_larger_picture_has_a_larger_size():
    frame = frame_of(MEAN)
    assert replace(frame, landmarks=2 * MEAN).size == pytest.approx(2 * frame.size)
