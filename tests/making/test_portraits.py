"""Photographs on scanned heads: heads that stay, turn and speak, with their landmarks."""

import cv2
import numpy as np
import pytest

import liaam
from liaam.datasets import load_face
from liaam.model.light_basis import in_field
from liaam.training.lamps.learning import unit_shape
from making.face.expressions import random_expression
from making.face.portraits import Portrait, Pose, Scheme
from making.face.relief import relief_on
from making.head.geometry import load_heads

FAR = 1e4
"""Distance of a camera without perspective, centimetres."""

FRONT = Pose(distance=FAR)


@pytest.fixture(scope="module")
def face():
    """A photograph, its landmarks by number, and their numbers by name."""
    image = load_face().read_image()
    result = liaam.fit("face", image)
    return image, result.landmarks, {name: i for i, name in enumerate(result.landmark_names)}


@pytest.fixture(scope="module")
def scheme(shared_data, face):
    path = shared_data / "ict-face/ict-face.safetensors"
    if not path.exists():
        pytest.skip("the scanned heads are absent")
    model = liaam.load_model("face")
    (jaw,) = (line for line, _ in model.contours if face[2]["chin"] in line)
    return Scheme.of(load_heads(path), model.shape_model.mean, model.landmark_names, list(jaw))


@pytest.fixture(scope="module")
def portrait(face, scheme):
    return Portrait(scheme, *face[:2])


def apart(points, number, first, second):
    """Distance of two landmarks."""
    return float(np.linalg.norm(points[number[first]] - points[number[second]]))


def test_landmarks_have_vertices(scheme, face):
    carriers = scheme.carriers
    number = face[2]
    at = scheme.heads.vertices[carriers]
    assert at[number["right_eye_outer"], 0] < at[number["nose_base"], 0] < at[number["left_eye_outer"], 0]
    upper, lower = (carriers[number[name]] for name in ("upper_lip_bottom", "lower_lip_top"))
    opened = scheme.heads.expressions["jawOpen"][:, 1].astype(float)
    assert opened[lower] < opened[upper] - 0.5  # they touch in the mean head
    assert len(set(carriers.tolist())) > 80


def test_a_head_that_is_not_turned_stays(face, portrait):
    image, points, _ = face
    seen, moved = portrait.seen(FRONT)
    low = np.rint((points - moved)[0]).astype(int)
    assert np.abs(points - moved - low).max() < 2.0
    before = image[low[1] : low[1] + len(seen), low[0] : low[0] + seen.shape[1]]
    left, top = moved.min(axis=0).astype(int)
    right, bottom = moved.max(axis=0).astype(int)
    blurred = [cv2.GaussianBlur(each, (0, 0), 2.0).astype(float) for each in (seen, before)]
    assert np.abs(blurred[0] - blurred[1])[top:bottom, left:right].mean() < 3.0


@pytest.mark.parametrize(("yaw", "pitch"), [(30, 0), (-30, 0), (0, 15)])
def test_turning_moves_near_points_more_than_far_ones(face, portrait, yaw, pitch):
    _, points, number = face
    seen, moved = portrait.seen(Pose(*np.deg2rad([yaw, pitch])))
    eyes = [number["right_pupil"], number["left_pupil"]]
    shift = (moved - moved[eyes].mean(0)) - (points - points[eyes].mean(0))
    tip = shift[number["nose_base"]] / np.linalg.norm(points[eyes[1]] - points[eyes[0]])
    assert np.sign(tip[0]) == np.sign(yaw) if yaw else tip[1] < -0.02
    if yaw:
        near, far = ("right", "left") if yaw > 0 else ("left", "right")
        widths = [apart(moved, number, f"{side}_eye_outer", f"{side}_eye_inner") for side in (near, far)]
        assert 0.5 * widths[0] < widths[1] < widths[0]
    assert seen.dtype == np.uint8
    assert 20 < seen.mean() < 235


def test_hidden_landmarks_of_the_jaw_are_on_the_outline(face, portrait):
    number = face[2]
    pose = Pose(yaw=np.deg2rad(35.0), distance=FAR)
    _, seen = portrait.seen(pose)
    on_vertices = portrait._turned(portrait.head.vertices, pose)[portrait.scheme.carriers, :2]
    shift = (seen - on_vertices) - (seen - on_vertices)[number["nose_base"]]  # without the crop
    assert shift[number["jaw_left_2"], 0] > 1.0
    assert np.abs(shift[number["mouth_left"]]).max() < 1e-9


def test_an_open_mouth_is_dark_between_its_lips(face, portrait):
    number = face[2]
    closed, before = portrait.seen(FRONT)
    seen, after = portrait.seen(FRONT, {"jawOpen": 0.8})
    lips = ("upper_lip_bottom", "lower_lip_top")
    unit = apart(before, number, "right_pupil", "left_pupil")
    assert apart(after, number, *lips) > apart(before, number, *lips) + 0.15 * unit

    def brightness(image, points):
        x, y = np.rint(np.mean([points[number[name]] for name in lips], axis=0)).astype(int)
        return image[y - 1 : y + 2, x - 1 : x + 2].mean()

    assert brightness(seen, after) < 0.5 * brightness(closed, before)
    assert apart(after, number, "right_eye_outer", "nose_base") == pytest.approx(
        apart(before, number, "right_eye_outer", "nose_base"), rel=0.02
    )


def test_smiles_widen_the_mouth(face, portrait):
    number = face[2]
    _, before = portrait.seen(FRONT)
    _, after = portrait.seen(FRONT, {"mouthSmile_L": 0.8, "mouthSmile_R": 0.8})
    corners = ("mouth_right", "mouth_left")
    assert apart(after, number, *corners) > 1.05 * apart(before, number, *corners)


def test_expressions_are_known_and_moderate(scheme):
    for i in range(200):
        strengths = random_expression(np.random.default_rng(i))
        assert strengths.keys() <= scheme.heads.expressions.keys()
        assert all(-0.5 < strength < 1.5 for strength in strengths.values())


def test_the_relief_of_a_face_has_a_nose(scheme, face):
    """The sides of the nose face outwards, and its base downwards."""
    mean = unit_shape(liaam.load_model("face").shape_model.mean)
    relief = relief_on(scheme, mean)
    number = face[2]

    def normal(*names):
        x, y = np.rint(in_field(np.mean([mean[number[name]] for name in names], axis=0))).astype(int)
        return relief[y, x]

    right = normal("nose_ridge_right_2", "right_eye_inner")[0]
    left = normal("nose_ridge_left_2", "left_eye_inner")[0]
    assert right < -0.2 < normal("nose_ridge_right_1", "nose_ridge_left_1")[0] < 0.2 < left
    assert normal("nose_base")[1] > 0.1
    assert (np.square(relief).sum(axis=2) <= 1.0).all()
    assert np.abs(relief[0, [0, -1]]).max() < 0.05  # even far from the head
