"""Points of another landmarker on the spot protocol, with a generated person."""

import numpy as np
import pytest

from experiments import points
from experiments.points import OFF, Simulated
from experiments.runner import run_experiment
from experiments.spot import EYES
from liaam.errors import LiaamError
from liaam.evaluation import inter_ocular_distance
from liaam.io import read_landmarks, write_landmarks
from setups import copy_files


@pytest.fixture(scope="module")
def person(folder, tmp_path_factory):
    return copy_files(folder, tmp_path_factory.mktemp("person"), "03-*")


def test_every_way_is_compared(person, tmp_path):
    """With files, too: those of the simulation."""
    rng, theirs = np.random.default_rng(0), tmp_path / "theirs"
    theirs.mkdir()
    shapes = {file: read_landmarks(file).points for file in sorted(person.glob("*.pts"))}
    simulated = Simulated.of(next(iter(shapes.values())), rng)
    for file, shape in shapes.items():
        write_landmarks(theirs / file.name, simulated.on(shape, rng))
    summary = run_experiment(points.points_experiment(person, theirs), tmp_path / "out")
    assert list(summary["methods"]) == list(points.WAYS)
    cells = summary["methods"]
    assert [cells[way]["fits"] for way in points.WAYS] == [1] * 7
    assert cells["weighed"]["nme_median"] < cells["mapped"]["nme_median"]
    assert cells["box"]["to_box"] == 1.0
    assert summary["p90_gain"] == cells["weighed"]["nme_p90"] / min(cells[w]["nme_p90"] for w in ("mapped", "box"))
    assert cells["best"]["nme_median"] <= min(cells[way]["nme_median"] for way in ("mapped", "box", "mean"))
    assert -1 < summary["correlation"] < 1
    assert "| weighed |" in (tmp_path / "out" / "report.md").read_text()


def test_errors_that_are_shared_are_correlated():
    shared, one, other = np.random.default_rng(0).normal(size=(3, 4000, 2))
    assert points.correlation(shared + one, shared + other) == pytest.approx(0.5, abs=0.05)
    assert points.correlation(one, other) == pytest.approx(0.0, abs=0.05)
    assert points.correlation(one, -2 * one) == pytest.approx(-1.0)


def test_simulated_points_are_as_far_off_as_they_say(person):
    shape = read_landmarks(next(person.glob("*-1*.pts"))).points
    iod, rng = inter_ocular_distance(shape, *EYES), np.random.default_rng(0)
    simulated = Simulated.of(shape, rng)
    draws = np.array([simulated.on(shape, rng) for _ in range(200)])
    away = np.linalg.norm(draws - draws.mean(axis=0), axis=2).mean() / iod
    assert away == pytest.approx(OFF, rel=0.05)
    places = np.einsum("mk,mkd->md", simulated.shares, shape[simulated.corners])
    bias = np.sqrt(np.square(draws.mean(axis=0) - places).sum(axis=1).mean()) / iod
    assert bias == pytest.approx(points.BIAS, rel=0.3)


def test_a_folder_that_does_not_exist_is_refused(person, tmp_path):
    with pytest.raises(LiaamError, match="is not a folder; give the folder of the other landmarker"):
        points.points_experiment(person, tmp_path / "none")
