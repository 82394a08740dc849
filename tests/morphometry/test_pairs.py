"""Pairs of landmarks by names, as text and from files, and what is wrong with them."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.morphometry.pairs import checked_twins, pairs_text, parse_pairs, twins_by_names, twins_by_place
from scenes import Head, make_set


@pytest.mark.parametrize(
    ("names", "twins"),
    [
        (("left_eye", "right_eye", "nose"), (1, 0, 2)),
        (("eye-L", "eye-R", "chin 1", "chin 2"), (1, 0, 2, 3)),
        (("LeftEye1", "RightEye1", "LeftEye2", "RightEye2"), (1, 0, 3, 2)),
        (("l.brow", "nose", "r.brow"), (2, 1, 0)),
        (("eyeLeftUpper", "mouth", "eyeRightUpper"), (2, 1, 0)),
    ],
)
def test_names_tell_twins(names, twins):
    assert twins_by_names(names) == twins


@pytest.mark.parametrize(
    "names", [("1", "2", "3"), ("left", "left_2", "nose"), ("lip", "rim"), ("L eye", "l-eye"), ("a",)]
)
def test_names_that_do_not_tell_give_none(names):
    assert twins_by_names(names) is None


def test_names_without_a_partner_are_said() -> None:
    with pytest.raises(
        LiaamError, match=r"landmarks without a partner on the other side: left_eye, R_ear; rename them"
    ):
        checked_twins(["left_eye", "nose", "R_ear", "left_jaw", "right_jaw"])
    with pytest.raises(LiaamError, match=r"\(lip, rim\) tell no left and right ones; give pairs such as 1-2,3-4"):
        checked_twins(["lip", "rim"])
    with pytest.raises(LiaamError, match="the landmarks have no names that tell pairs"):
        checked_twins([])
    symmetric = np.array([[-30.0, 20], [30, 20], [0, 45], [0, -50], [-40, -25], [40, -25]])
    with pytest.raises(LiaamError, match="By their places, they may be 1-2,5-6"):
        checked_twins([], symmetric)


@pytest.mark.parametrize("text", ["1-2,3-5", "1-2, 5-3", "a-b,c-e"])
def test_pairs_are_read_from_text(text) -> None:
    assert parse_pairs(text, "abcde", 5) == (1, 0, 4, 3, 2)


@pytest.mark.parametrize(
    "content", ['"right","left"\n1,2\n3,5\n', "a;b\n\nc;e\n", "1\t2\n3\t5\n", "\ufeffright,left\r\na,b\r\n3,e\r\n"]
)
def test_pairs_are_read_from_files(tmp_path, content) -> None:
    (tmp_path / "pairs.csv").write_text(content, "utf-8")
    assert parse_pairs(str(tmp_path / "pairs.csv"), "abcde", 5) == (1, 0, 4, 3, 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1-1", "the pair 1-1 names the same landmark twice"),
        ("1-2,2-3", "landmark 2 is in the pairs 1-2 and 2-3"),
        ("1-2,2-1", "landmark 2 is in the pairs 1-2 and 2-1"),
        ("1-2-3", "'1-2-3' is no pair of landmarks; give pairs such as 1-2,3-4"),
        ("1", "'1' is no pair"),
        ("", "'' is no pair"),
        ("1-9", "there is no landmark '9'; give numbers from 1 to 5"),
        ("1-x", "there is no landmark 'x'"),
        ("none.csv", "none.csv"),
    ],
)
def test_wrong_pairs_are_named(text, words) -> None:
    with pytest.raises(LiaamError) as fault:
        parse_pairs(text, (), 5)
    assert words in str(fault.value)


def test_files_without_pairs_are_named(tmp_path) -> None:
    file = tmp_path / "pairs.csv"
    file.write_text("right,left\n")
    with pytest.raises(LiaamError, match=r"pairs\.csv has no pairs; give pairs such as"):
        parse_pairs(str(file), (), 5)


def test_twins_are_written_as_pairs() -> None:
    assert pairs_text((1, 0, 4, 3, 2)) == "1-2,3-5"


@pytest.mark.parametrize("tilt", [-30, 0, 20])
def test_places_tell_twins(rng, tilt):
    half = rng.uniform((5, -50), (60, 50), (12, 2))
    points = np.concatenate([half, half * [-1, 1], [[0, -40], [0, 10]]])
    turn = np.deg2rad(tilt)
    turned = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [200, 100]
    assert twins_by_place(turned) == (*range(12, 24), *range(12), 24, 25)


def test_of_two_axes_the_upright_one_is_taken():
    angles = np.deg2rad(np.arange(0, 360, 30) + 15.0)
    mouth = np.column_stack([50 * np.cos(angles), 12 * np.sin(angles)])
    for points in (mouth, mouth + np.where(mouth[:, :1] > 0, (0.4, 0.0), (0.0, 0.0))):  # the other axis suits better
        twins = twins_by_place(points)
        np.testing.assert_allclose(mouth[list(twins)], mouth * [-1, 1], atol=1e-9)


def test_a_face_that_is_turned_a_little_is_still_symmetric():
    scene = make_set(1, Head(5), size=(160, 120))[0]
    twins = np.array(twins_by_place(scene.landmarks))
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
    assert twins_by_place(np.array(points, float)) is None
