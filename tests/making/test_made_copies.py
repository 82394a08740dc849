"""What the face model is made from: turned heads, and parts that are small enough."""

import cv2
import numpy as np
import pytest

import liaam
from liaam.datasets import load_face
from making.face.build import other_side, with_modes
from making.face.turning import Portrait


@pytest.fixture(scope="module")
def face():
    """A photograph, its landmarks by number, and their numbers by name."""
    image = load_face().read_image()
    result = liaam.fit("face", image)
    return image, result.landmarks, {name: i for i, name in enumerate(result.landmark_names)}


@pytest.fixture(scope="module")
def portrait(face):
    image, points, number = face
    (jaw,) = (line for line, _ in liaam.load_model("face").contours if number["chin"] in line)
    return Portrait(image, points, list(number), jaw, seed=0)


def test_a_head_that_is_not_turned_stays(face, portrait):
    image, points, _ = face
    seen, moved = portrait.turned(0.0, 0.0)
    low = np.rint((points - moved)[0]).astype(int)
    assert np.abs(points - moved - low).max() < 2.0  # a jaw point may move to the edge of the hull
    before = image[low[1] : low[1] + len(seen), low[0] : low[0] + seen.shape[1]]
    (left, top), (right, bottom) = moved.min(axis=0).astype(int), moved.max(axis=0).astype(int)
    where = slice(top, bottom), slice(left, right)
    blurred = [cv2.GaussianBlur(each, (0, 0), 2.0).astype(float)[where] for each in (seen, before)]
    assert np.abs(blurred[0] - blurred[1]).mean() < 3.0


@pytest.mark.parametrize(("yaw", "pitch"), [(30, 0), (-30, 0), (0, 15)])
def test_turning_moves_near_points_more_than_far_ones(face, portrait, yaw, pitch):
    _, points, number = face
    seen, moved = portrait.turned(*np.deg2rad([yaw, pitch]))
    eyes = [number["right_pupil"], number["left_pupil"]]
    shift = (moved - moved[eyes].mean(0)) - (points - points[eyes].mean(0))
    apart = np.linalg.norm(points[eyes[1]] - points[eyes[0]])
    tip = shift[number["nose_base"]] / apart
    assert np.sign(tip[0]) == np.sign(yaw) if yaw else tip[1] < -0.02
    if yaw:
        near, far = ("right", "left") if yaw > 0 else ("left", "right")
        widths = [np.ptp(moved[[number[f"{s}_eye_outer"], number[f"{s}_eye_inner"]], 0]) for s in (near, far)]
        assert 0.6 * widths[0] < widths[1] < widths[0]
    assert seen.dtype == np.uint8 and 20 < seen.mean() < 235


def test_the_names_tell_the_other_side(face):
    names = list(face[2])
    order = other_side(names)
    assert np.array_equal(order[order], np.arange(len(names)))
    assert names[order[names.index("mouth_left")]] == "mouth_right" and order[names.index("chin")] == names.index(
        "chin"
    )


def test_what_weak_modes_explain_becomes_unexplained():
    part = liaam.load_model("face").others[0]
    fewer = with_modes(part, [3, 3, 3])
    # At the sharpest level: others hold only some of the pixels.
    before, after = (each.views["surroundings"].levels[-1].appearances["soft"] for each in (part, fewer))
    total = [each.eigenvalues.sum() + np.trace(each.unexplained, 0, 1, 2).sum() for each in (before, after)]
    assert after.n_modes == 3 < before.n_modes
    assert total[0] == pytest.approx(total[1], rel=0.01)
