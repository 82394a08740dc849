import numpy as np
import pytest

from liaam.io import Contour, Landmarks
from liaam.studio.safety import Refusal
from liaam.studio.template import Template, mirror_by_place, parse_template, template_of
from scenes import Head, make_set


@pytest.mark.parametrize("tilt", [-30, 0, 20])
def test_places_tell_twins(rng, tilt):
    half = rng.uniform((5, -50), (60, 50), (12, 2))
    points = np.concatenate([half, half * [-1, 1], [[0, -40], [0, 10]]])
    turn = np.deg2rad(tilt)
    turned = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [200, 100]
    assert mirror_by_place(turned) == (*range(12, 24), *range(12), 24, 25)


def test_of_two_axes_the_upright_one_is_taken():
    angles = np.deg2rad(np.arange(0, 360, 30) + 15.0)
    mouth = np.column_stack([50 * np.cos(angles), 12 * np.sin(angles)])
    for points in (mouth, mouth + np.where(mouth[:, :1] > 0, (0.4, 0.0), (0.0, 0.0))):  # the other axis suits better
        twins = mirror_by_place(points)
        np.testing.assert_allclose(mouth[list(twins)], mouth * [-1, 1], atol=1e-9)


def test_a_face_that_is_turned_a_little_is_still_symmetric():
    scene = make_set(1, Head(5), size=(160, 120))[0]
    twins = np.array(mirror_by_place(scene.landmarks))
    assert twins[0] == 12 and twins[6] == 6  # ends and middle of the jaw
    np.testing.assert_array_equal(twins[twins], np.arange(58))


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [50, 3], [20, 70], [90, 90], [10, 30], [77, 12]],
        [[0, 0], [1, 1]],
        [[5, 5]] * 4,
        [[10, 0], [10, 20], [10, 40]],  # on the axis all of them: there are no sides
    ],
)
def test_what_has_no_sides_gives_none(points):
    assert mirror_by_place(np.array(points, float)) is None


def test_a_template_survives_json():
    template = Template(
        ("a", "b", "c"), (Contour((0, 1, 2), closed=True),), (1, 0, 2), ((1.0, 2.0), (3.0, 4.5), (0.0, 9.0))
    )
    assert parse_template(template.as_json(), 3) == template
    assert parse_template({"names": [" a ", "b"]}, 3) == Template(("a", "b"))


def test_landmarks_without_sound_names_get_numbers():
    points = np.array([[0, 0], [1, 0], [0.5, 3]])
    for names in ((), ("a", "a", "b"), ("a", " ", "b")):
        assert template_of(Landmarks(points, (), names)).names == ("1", "2", "3")
    assert template_of(Landmarks([[0, 0], [np.nan, np.nan]])).points is None


@pytest.mark.parametrize("data", [None, "names", ["a", "b"], 3])
def test_what_is_no_object_is_refused(data):
    with pytest.raises(Refusal, match="not an object"):
        parse_template(data, 3)
