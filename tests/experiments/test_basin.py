"""The basin of convergence, on generated persons and on three real ones."""

import shutil

import numpy as np
import pytest

from experiments import basin
from experiments.runner import run_experiment
from liaam.model.shape import align

pytestmark = pytest.mark.slow

METHODS = ("rgb", "li")


def test_starts_of_the_basin_are_disturbed_within_their_limits(rng):
    shape, unit = rng.normal(100, 20, (30, 2)), 50.0
    for share in (basin.SMALL, 1.0):
        for _ in range(50):
            start = basin.disturbed(shape, unit, share, rng)
            found = align(shape, start)
            assert abs(found.scale - 1) <= share * basin.SCALE + 1e-9
            assert abs(np.arctan2(found.matrix[1, 0], found.matrix[0, 0])) <= share * basin.TURN + 1e-9
            assert np.linalg.norm(start.mean(axis=0) - shape.mean(axis=0)) <= share * basin.SHIFT * unit + 1e-9
    truth = 2 * shape + 30
    assert basin.placed(shape, truth) == pytest.approx(truth)


def test_shares_of_the_basin_agree_with_its_rows(done):
    summary, rows, _ = done("basin")
    for method in METHODS:
        cell, own = summary["methods"][method], [r for r in rows if r["method"] == method]
        for name in ("converged", "same_end"):
            assert cell[name] == pytest.approx(np.mean([int(r[name]) for r in own]))
        assert sum(part["fits"] for part in cell["by_disturbance"]) == len(own) == cell["fits"]
        for row in own:
            assert int(row["converged"]) == (float(row["nme"]) < 0.08)
            assert int(row["same_end"]) == (float(row["away"]) < 0.01)


def test_the_basin_takes_any_folder_grouped_by_person(folder, tmp_path):
    for path in folder.glob("03-*"):
        shutil.copy(path, tmp_path / path.name.replace("03-", "anna_"))
    splits, left_out = basin.find_splits(tmp_path)
    assert [split.name for split in splits] == ["anna"]
    assert [sample.name for sample in splits[0].training] == ["anna_1m", "anna_3m", "anna_5m"]
    assert [sample.name for sample in splits[0].tested] == ["anna_2m", "anna_4m", "anna_6m"]
    assert left_out == ()


def test_fits_from_far_away_find_real_faces(three_persons, tmp_path):
    summary = run_experiment(basin.basin_experiment(three_persons, ["rgb"], trials=2), tmp_path)
    assert len(summary["persons"]) == 3
    assert summary["methods"]["rgb"]["reference_converged"] == 1.0
    assert summary["methods"]["rgb"]["converged"] >= 0.8
