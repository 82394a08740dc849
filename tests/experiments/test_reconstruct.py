"""Reconstruction without shadows, on each kind of data."""

import csv

import pytest

from experiments import reconstruct
from experiments.reconstruct import reconstruct_experiment
from experiments.runner import run_experiment
from liaam.errors import MethodError
from liaam.io import write_image, write_landmarks
from scenes import Head, make_set
from setups import write_person

pytestmark = pytest.mark.slow

FILES = {"results.csv", "summary.json", "report.md", "figure.png", "figure.svg"}


def run(out, *options):
    summary = run_experiment(reconstruct_experiment(*options), out)
    assert {path.name for path in out.iterdir()} == FILES
    return summary, list(csv.DictReader((out / "results.csv").read_text().splitlines()))


def test_scenes_of_the_ideal_camera_lose_their_shadows(tmp_path, monkeypatch):
    monkeypatch.setattr(reconstruct, "CAMERAS", ("narrow",))
    monkeypatch.setattr(reconstruct, "SHOWN", 1)
    summary, rows = run(tmp_path / "out", None, ("li", "li+noise"), 3, 0)
    assert len(rows) == 2 * 3
    for method in ("li", "li+noise"):
        cell = summary["kinds"]["narrow"][method]
        assert cell["rebuilt_rms"]["median"] <= 0.05
        assert cell["input_rms"]["median"] >= 0.3
    for row in rows:
        # No fit can do better than the model; and these do hardly worse.
        assert float(row["model_rms"]) <= float(row["rebuilt_rms"]) < 2 * float(row["model_rms"])
    assert "| narrow | li |" in (tmp_path / "out" / "report.md").read_text()


def test_one_persons_pictures_get_a_shadow_that_is_taken_off_every_time_alike(tmp_path):
    for i, scene in enumerate(make_set(6, head=Head(5), size=(200, 150))):
        write_image(tmp_path / f"{i}.png", scene.image)
        write_landmarks(tmp_path / f"{i}.pts", scene.landmarks)
    summary, rows = run(tmp_path / "out", tmp_path, ("li",), 2)
    assert run(tmp_path / "again", tmp_path, ("li",), 2) == (summary, rows)
    assert run(tmp_path / "other", tmp_path, ("li",), 2, 1)[1] != rows
    assert {row["kind"] for row in rows} == {"shadow"}
    cell = summary["kinds"]["shadow"]["li"]
    assert cell["rebuilt_rms"]["median"] < 0.1 < 0.3 < cell["input_rms"]["median"]
    assert cell["model_rms"]["median"] < 0.01  # the picture was trained on


def test_persons_under_a_spot_light_have_no_truth(tmp_path):
    write_person(tmp_path, 3)
    summary, rows = run(tmp_path / "out", tmp_path, ("li",), 1)
    assert [(row["kind"], row["picture"], row["rebuilt_rms"]) for row in rows] == [("spot", "person 03", "nan")]
    assert summary["kinds"]["spot"]["li"]["rebuilt_rms"]["median"] is None
    assert summary["kinds"]["spot"]["li"]["error_px"]["median"] < 5


@pytest.mark.parametrize("method", ["li-lit", "grey", "rgb", "igo", "varied"])
def test_methods_that_rebuild_nothing_are_refused_before_any_work(method, tmp_path, monkeypatch):
    monkeypatch.setattr(reconstruct, "_plan", lambda *_: pytest.fail("the work has begun"))
    with pytest.raises(MethodError, match=f"{method} does not fit log-RGB.*give li, li-pc, li-pcs or chroma"):
        reconstruct_experiment(None, ("li", method))
    with pytest.raises(MethodError, match="does not fit log-RGB"):
        reconstruct_experiment(tmp_path / "no such folder", (method,))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": ()}, "no method is given"),
        ({"methods": ("li", "li")}, "given twice"),
        ({"trials": 0}, "at least 1"),
        ({"solver": "oracle"}, "unknown solver 'oracle'"),
    ],
)
def test_refuses_before_the_work_starts(options, message):
    with pytest.raises(MethodError, match=message):
        reconstruct_experiment(None, **options)
