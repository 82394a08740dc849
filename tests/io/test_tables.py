"""Results as data frames."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import liaam
from liaam.errors import ImageError, LiaamError
from liaam.fitting import METHODS, FitResult, FitStatus
from liaam.io import write_columns
from liaam.model.shape import Similarity
from liaam.morphometry import Specimen
from liaam.tracking import TrackedFrame, TrackStatus

COLUMNS = ["image", "landmark", "name", "x", "y", "sd", "quality", "status"]
POINTS = np.array([[1.0, 2.0], [3.0, 4.5]])
SPREAD = np.array([np.eye(2), 4.0 * np.eye(2)])


@pytest.fixture(scope="module")
def result():
    none, pose = np.zeros(0), Similarity(np.eye(2), np.zeros(2))
    numbers = {"p": none, "pose": pose, "lam": none, "cost": 0.0, "n_iterations": 0, "history": ()}
    numbers |= {"covariance": none, "residual_variance": 1.0, "evidence": none, "theta": np.nan, "theta_model": np.nan}
    method = METHODS["grey"]
    return FitResult(POINTS, FitStatus.DOUBTFUL, landmark_covariances=SPREAD, quality=0.25, method=method, **numbers)


def test_a_fit_is_a_row_per_landmark_counted_from_1(result):
    table = result.to_dataframe()
    n = len(result.landmarks)
    assert list(table) == COLUMNS
    assert table.landmark.tolist() == list(range(1, n + 1))
    np.testing.assert_array_equal(table[["x", "y"]], result.landmarks)
    np.testing.assert_allclose(table.sd, result.sd)
    assert set(table.image) == {"image 1"} and set(table.status) == {str(result.status)}
    named = replace(result, image=Path("a/b.png"), landmark_names=tuple(f"p{i}" for i in range(n)))
    assert named.to_dataframe().iloc[-1][["image", "name"]].tolist() == ["b.png", f"p{n - 1}"]
    assert set(named.to_dataframe("other").image) == {"other"}


def test_lists_of_fits_keep_images_that_could_not_be_fitted(result):
    table = liaam.to_dataframe([result, ImageError("cut short"), replace(result, image=Path("c.png"))])
    assert table.groupby("image", sort=False).size().to_dict() == dict.fromkeys(
        ("image 1", "image 2", "c.png"), len(result.landmarks)
    )
    failed = table[table.image == "image 2"]
    assert set(failed.status) == {"error"} and failed[["x", "y", "sd", "quality"]].isna().all(axis=None)
    assert set(liaam.to_dataframe([result, result], ["a", "b"]).image) == {"a", "b"}
    for nothing in ([], [ImageError("cut short")]):
        assert len(liaam.to_dataframe(nothing)) == 0


def test_tracks_specimens_and_measurements():
    lost = np.full((2, 2), np.nan)
    frames = [
        TrackedFrame(i, 0.5 * i, status, FitStatus.CONVERGED, 0.9, np.nan, points, points, SPREAD, SPREAD, POINTS)
        for i, (status, points) in enumerate([(TrackStatus.FOUND, POINTS), (TrackStatus.LOST, lost)])
    ]
    table = liaam.to_dataframe(iter(frames))
    assert list(table) == ["frame", "time", *COLUMNS[1:]]
    assert table.status.tolist() == ["found", "found", "lost", "lost"]
    specimens = [Specimen("a", POINTS, SPREAD, ("tip", "base")), Specimen("b", POINTS)]
    long = liaam.to_dataframe(specimens)
    assert long.name.tolist() == ["tip", "base", "", ""]
    assert long.sd.fillna(-1).tolist() == [1.0, 2.0, -1.0, -1.0]
    assert liaam.to_dataframe(liaam.measure(specimens, "distance:1-2")).specimen.tolist() == ["a", "b"]


def test_wrong_lists_are_refused(result, monkeypatch):
    with pytest.raises(LiaamError, match="1 results but 2 names; give one name for each"):
        liaam.to_dataframe(result, ["a", "b"])
    with pytest.raises(LiaamError, match="of different kinds, by image and by specimen"):
        liaam.to_dataframe([result, Specimen("a", POINTS)])
    with pytest.raises(LiaamError, match="result 1 is ndarray; give fits, tracked frames or specimens"):
        liaam.to_dataframe([POINTS])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LiaamError, match=r'need pandas; run pip install "\.\[pandas\]"'):
        liaam.to_dataframe(result)


def test_columns_are_written_with_empty_cells(tmp_path):
    write_columns(tmp_path / "t.csv", {"a": ["x,y", "z"], "b": [1, 2], "c": [np.nan, 0.25], "d": [True, False]})
    assert (tmp_path / "t.csv").read_text() == 'a,b,c,d\n"x,y",1,,1\nz,2,0.25,0\n'
