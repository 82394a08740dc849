"""The times of the tables in the README files are those of one run of ``python -m benchmarks peers``, the saved one."""

import re
from pathlib import Path

import pytest

from benchmarks.metrics import BASELINE, read_baseline

ROOT = Path(__file__).resolve().parents[2]

IN_README = {
    "liaam, `soft-li` (default)": ("liaam_soft_li",),
    "liaam, `grey`": ("liaam_grey",),
    "menpofit, gradient orientations": ("menpofit_igo",),
    "menpofit, grey values": ("menpofit_grey",),
    "OpenCV, `FacemarkAAM`": ("opencv_aam",),
    "dlib, trained on the same 24 images": ("dlib_trained",),
    "liaam, the face model that comes with it": ("liaam_face", "liaam_face_found"),
    "dlib and MediaPipe, ready-made face models": ("dlib_68", "mediapipe_still"),
}
"""Metrics of the last column, by row."""
IN_BENCHMARKS = {
    "liaam `soft-li`": ("liaam_soft_li", "liaam_soft_li_iteration"),
    "liaam `li`": ("liaam_li", "liaam_li_iteration"),
    "liaam `grey`": ("liaam_grey", "liaam_grey_iteration"),
    "menpofit, orientations": ("menpofit_igo", "menpofit_igo_iteration"),
    "menpofit, grey": ("menpofit_grey", "menpofit_grey_iteration"),
    "OpenCV `FacemarkAAM`": ("opencv_aam", "opencv_aam_iteration"),
    "dlib, trained on the heads": ("dlib_trained",),
    "BLAS products alone": ("floor_blas",),
}
"""Metrics of the columns with times, by row."""


@pytest.fixture(scope="module")
def saved():
    return read_baseline(BASELINE)["peers"]["metrics"]


def cells(path: str, row: str) -> list[str]:
    """Return the cells of a row of a table, without its name."""
    for line in (ROOT / path).read_text().splitlines():
        name, *others = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if name == row:
            return others
    raise AssertionError(f"{path} has no row {row!r}")


def check(shown: list[str], metrics: tuple[str, ...], saved: dict) -> None:
    """Compare numbers with metrics, rounded to as many decimals."""
    assert len(shown) == len(metrics)
    for number, metric in zip(shown, metrics, strict=True):
        decimals = len(number.partition(".")[2])
        assert number == f"{saved[f'peers_{metric}_ms']:.{decimals}f}", metric


@pytest.mark.parametrize("row", IN_README)
def test_the_times_of_the_readme_are_those_of_the_saved_run(row, saved):
    check(re.findall(r"\d+(?:\.\d+)?", cells("README.md", row)[-1]), IN_README[row], saved)


@pytest.mark.parametrize("row", IN_BENCHMARKS)
def test_the_times_of_the_benchmarks_table_are_those_of_the_saved_run(row, saved):
    ms, _, ms_per_iteration = cells("benchmarks/README.md", row)
    check([each for each in (ms, ms_per_iteration) if each], IN_BENCHMARKS[row], saved)


def test_the_times_in_the_text_are_those_of_the_saved_run(saved):
    text = " ".join((ROOT / "README.md").read_text().split())
    told = re.search(r"`soft-li` takes ([\d.]+) ms from a box and ([\d.]+) ms with the search", text)
    assert told is not None
    check(list(told.groups()), ("liaam_photo", "liaam_photo_found"), saved)
    told = re.search(r"in the wild, the face model takes ([\d.]+) ms, and MediaPipe ([\d.]+)", text)
    assert told is not None
    check(list(told.groups()), ("liaam_face_wild", "mediapipe_wild"), saved)
