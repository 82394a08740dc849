"""Results of fits as files."""

import json
import os

import numpy as np
import pytest

from liaam.errors import LandmarkError
from liaam.io import Contour, Landmarks, read_landmarks, write_landmarks
from liaam.io.fit_files import FIT_SUFFIXES, corrected_file, fit_text, points_of_fit, read_fit, write_fit

POINTS = np.array([[1.5, 2.0], [3.25, -4.0]])


def test_a_fit_is_written_in_each_format(tmp_path):
    landmarks = Landmarks(POINTS, image_name="anna.1.png", scale=0.25)
    paths = [tmp_path / f"anna.1{suffix}" for suffix in FIT_SUFFIXES]
    for path in paths:
        write_fit(path, landmarks, {"status": "converged", "cost": 0.5}, (40, 30))
    for path in paths[:3]:
        assert np.array_equal(read_landmarks(path, (40, 30)).points, POINTS)
    assert paths[2].read_text() == "LM=2\n1.5 27.0\n3.25 33.0\nIMAGE=anna.1.png\nID=anna.1\nSCALE=0.25\n"
    content = json.loads(paths[3].read_text())
    assert content == {"status": "converged", "cost": 0.5, "image_size": [40, 30], "landmarks": POINTS.tolist()}
    assert paths[3].read_text().startswith('{\n "status": "converged",\n "cost": 0.5,\n "image_size": [\n  40,')
    assert paths[3].read_text().endswith("}\n")


def test_a_fit_is_read_as_landmarks(tmp_path):
    points = np.array([*POINTS, [np.nan, np.nan]])
    given = Landmarks(points, (Contour((0, 2, 1), closed=True),), ("a", "b", "c"))
    path = tmp_path / "anna.json"
    write_fit(path, given, {"status": "converged", "landmark_names": given.names}, SIZE)
    read = read_landmarks(path)
    np.testing.assert_array_equal(read.points, points)
    assert (read.contours, read.names) == (given.contours, given.names)
    for damaged in ({"landmarks": [[1]]}, {"landmarks": 3}, {"contours": [[["0"], True]]}, {"landmark_names": [1, 2]}):
        path.write_text(json.dumps({**json.loads(fit_text(given, {"status": "", "landmark_names": ()})), **damaged}))
        with pytest.raises(LandmarkError, match=r"anna\.json"):
            read_landmarks(path)


def test_estimates_of_absent_landmarks_are_placed_but_not_seen(tmp_path):
    path = tmp_path / "torn.json"
    points = np.array([*POINTS, [np.nan, np.nan]])
    for present, invisible in (([0.9, 0.2, 0.1], (1,)), (None, ()), ([None, 0.5, 0.1], ())):
        write_fit(path, Landmarks(points), {"status": "converged", "present": present}, SIZE)
        assert read_landmarks(path).invisible == invisible
    for damaged in ([0.1], 3, ["a", 0.1, 0.1]):
        write_fit(path, Landmarks(points), {"status": "converged", "present": damaged}, SIZE)
        with pytest.raises(LandmarkError, match=r"torn\.json"):
            read_landmarks(path)


def test_facts_of_every_kind_become_json():
    facts = {
        "nan": float("nan"),
        "infinite": np.float32(np.inf),
        "single": np.float32(0.5),
        "count": np.int64(3),
        "flag": np.bool_(True),
        "array": np.array([[1.0, np.nan]]),
        "tuple": (1, None, "text"),
        "nested": {2: {"a": np.array([1, 2])}},
    }
    content = json.loads(fit_text(Landmarks(POINTS), facts))
    assert content == {
        "nan": None,
        "infinite": None,
        "single": 0.5,
        "count": 3,
        "flag": True,
        "array": [[1.0, None]],
        "tuple": [1, None, "text"],
        "nested": {"2": {"a": [1, 2]}},
        "landmarks": POINTS.tolist(),
    }


SIZE = (40, 30)


@pytest.fixture
def fit(tmp_path):
    """Write a fit; give its .json file and its content, without the size of the image if asked."""

    def make(points=POINTS, sized=True):
        for suffix in FIT_SUFFIXES:
            path = tmp_path / f"a{suffix}"
            write_fit(path, Landmarks(points, image_name="a.png"), {"status": "converged"}, SIZE)
        content = read_fit(path)
        assert content is not None and content["image_size"] == list(SIZE)
        return path, content if sized else {**content, "image_size": None}

    return make


def test_other_json_files_are_no_fits(tmp_path):
    assert read_fit(tmp_path / "a.json") is None
    for content in ({"landmarks": []}, {"status": "converged"}, [1]):
        (tmp_path / "a.json").write_text(json.dumps(content))
        assert read_fit(tmp_path / "a.json") is None


@pytest.mark.parametrize("suffix", [".pts", ".csv", ".tps"])
@pytest.mark.parametrize(("shift", "is_changed"), [(0.0, False), (0.015, False), (0.03, True), (np.nan, True)])
def test_what_is_changed_after_a_fit_is_found(fit, suffix, shift, is_changed):
    path, content = fit()
    assert corrected_file(path, content) is None
    moved = POINTS + np.array([[0, 0], [shift, shift]])
    write_landmarks(path.with_suffix(suffix), Landmarks(moved, image_name="a.png"), SIZE)
    assert corrected_file(path, content) == (path.with_suffix(suffix) if is_changed else None)
    np.testing.assert_allclose(points_of_fit(path.with_suffix(suffix), content), moved, atol=1e-3)


def test_points_are_not_compared_where_no_image_reaches(fit):
    far = POINTS + np.array([[0, 0], [1.2e6, -1.2e6]])
    path, content = fit(far)
    for shift, is_changed in ((2e5, False), (-1e6, True)):
        write_landmarks(path.with_suffix(".csv"), far + np.array([[0, 0], [shift, -shift]]))
        assert (corrected_file(path, content) is not None) == is_changed


def test_a_tps_needs_the_size_to_be_compared(fit):
    path, content = fit(sized=False)
    write_landmarks(path.with_suffix(".tps"), Landmarks(POINTS + 3, image_name="a.png"), SIZE)
    assert corrected_file(path, content) is None
    write_landmarks(path.with_suffix(".csv"), POINTS + 3)
    assert corrected_file(path, content) == path.with_suffix(".csv")


def test_of_several_corrections_the_newest_that_can_be_read_counts(fit):
    path, content = fit()
    files = [path.with_suffix(suffix) for suffix in (".csv", ".pts")]
    for file in files:
        write_landmarks(file, np.vstack([POINTS, POINTS]))
    for first, second in (files, files[::-1]):
        os.utime(first, (1e9, 1e9))
        os.utime(second, (2e9, 2e9))
        assert corrected_file(path, content) == second
    files[0].write_bytes(b"\0\xff")
    os.utime(files[0], (3e9, 3e9))
    assert corrected_file(path, content) == files[1]
    files[1].unlink()
    assert corrected_file(path, content) == files[0]


@pytest.mark.parametrize("landmarks", ["abc", [[1, 2], [3]], 5])
def test_damaged_fits_are_refused(fit, landmarks):
    path, content = fit()
    with pytest.raises(LandmarkError, match=r"a\.json: the landmarks are damaged"):
        corrected_file(path, content | {"landmarks": landmarks})


def test_fits_in_tps_have_three_decimals(tmp_path):
    points = np.array([[10.123456, 20.5], [30.1, 119 - 57.123], [np.nan, np.nan]])
    write_fit(tmp_path / "a.tps", Landmarks(points, image_name="a.png"), {}, (200, 120))
    lines = (tmp_path / "a.tps").read_text().splitlines()
    assert lines[1:4] == ["10.123 98.5", "30.1 57.123", "-1 -1"]
