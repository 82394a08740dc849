"""What the protocols on folders of persons share, asked of each of them and of its parts."""

import json
import shutil

import numpy as np
import pytest

from experiments import cli, protocol
from experiments.runner import run_experiment
from experiments.solvers import Request
from liaam.errors import LiaamError, MethodError
from liaam.io import write_image, write_landmarks
from liaam.model.shape import diagonal_of
from setups import copy_files

pytestmark = pytest.mark.slow

METHODS = ("rgb", "li")

N_ROWS = {
    "generic": 3 * (5 + 1 + 5),
    "peer": 3 * 2 * 4,
    "basin": 3,
    "occlusion": 3 * 2 * 2,
    "unchanged": 3 * 5,
}
"""Rows for each method with three persons and one start."""


@pytest.mark.parametrize("name", N_ROWS)
def test_writes_a_row_per_fit_and_all_files(done, name):
    summary, rows, out = done(name)
    assert len(rows) == len(METHODS) * N_ROWS[name]
    assert tuple(summary["methods"]) == METHODS
    assert json.loads((out / "summary.json").read_text()) == summary
    pictures = {"pictures.png"} if name in ("generic", "peer", "occlusion") else set()
    files = {"results.csv", "summary.json", "report.md", "figure.png", "figure.svg", *pictures}
    assert {path.name for path in out.iterdir()} == files
    report = (out / "report.md").read_text()
    assert all(f"| {method} |" in report for method in METHODS)
    assert "| nan |" not in report


@pytest.mark.parametrize("name", N_ROWS)
def test_commands_print_the_table_of_the_report(done, make, folder, tmp_path, run_experiments, monkeypatch, name):
    asked = {}

    def execute(experiment, out, jobs):
        asked.update(experiment.settings)
        return done(name)[0]

    monkeypatch.setattr(cli, "execute", execute)
    options = ("--methods", "rgb,li", "--trials", 3, "--seed", 4, "--jobs", 1)
    code, out, err = run_experiments(name, "--data", folder, "-o", tmp_path, *options)
    assert (code, err) == (0, "")
    assert (asked["methods"], asked["trials"], asked["seed"]) == (["rgb", "li"], 3, 4)
    assert make(name).report(done(name)[0]) in out
    assert f"written to {tmp_path}" in out


def test_results_do_not_depend_on_the_number_of_workers(done, make, read_rows, tmp_path):
    _, rows, _ = done("basin")
    run_experiment(make("basin"), tmp_path, jobs=2)
    assert read_rows(tmp_path) == rows


@pytest.mark.parametrize("name", N_ROWS)
def test_refuses_before_the_work_starts(make, folder, tmp_path, name):
    with pytest.raises(MethodError, match="unknown method 'magic'"):
        make(name, methods=["magic"])
    with pytest.raises(MethodError, match="at least 1"):
        make(name, trials=0)
    with pytest.raises(MethodError, match="unknown solver 'oracle'"):
        make(name, solver="oracle")
    copy_files(folder, tmp_path, "03-1*")
    with pytest.raises(LiaamError, match="no person has"):
        make(name, data=tmp_path)


def test_persons_are_told_by_the_names_of_pictures(folder, tmp_path, rng):
    copy_files(folder, tmp_path, "03-[12]*", "04-1*")
    shutil.copy(folder / "05-1m.png", tmp_path / "nobody.png")
    shutil.copy(folder / "05-1m.pts", tmp_path / "nobody.pts")
    grey = np.repeat(rng.integers(0, 255, (60, 60, 1)), 3, axis=2).astype(np.uint8)
    for name in ("grey_1", "grey_2"):
        write_image(tmp_path / f"{name}.png", grey)
        write_landmarks(tmp_path / f"{name}.pts", rng.uniform(10, 50, (58, 2)))
    persons, left_out = protocol.group_by_person(tmp_path, 2)
    assert {name: [sample.name for sample in samples] for name, samples in persons.items()} == {
        "03": ["03-1m", "03-2m"]
    }
    assert left_out == (
        "nobody: the name does not begin with a person's, as in 01_03",
        "person 04: 1 pictures where 2 are needed",
        "person grey: the pictures are grey",
    )


def test_the_unit_is_the_distance_of_the_eyes_where_they_are_known(rng):
    for count, (left, right) in protocol.EYES_BY_COUNT.items():
        shape = rng.uniform(0, 100, (count, 2))
        expected = np.linalg.norm(shape[left].mean(axis=0) - shape[right].mean(axis=0))
        assert protocol.face_size(shape) == pytest.approx(expected)
    shape = rng.uniform(0, 100, (10, 2))
    assert protocol.face_size(shape) == pytest.approx(0.3 * diagonal_of(shape))


def test_statistics_of_fits_that_ran_away():
    row = {"method": "li", "bound": 0.02, "seconds": 1.0}
    cell = protocol.statistics([row | {"nme": value} for value in (0.05, 0.09, np.inf)])
    assert cell["beyond"] == pytest.approx(2 / 3)
    assert cell["nme_median"] == 0.09
    assert cell["nme_p90"] is None
    assert protocol.statistics([]) == dict.fromkeys(cell) | {"fits": 0}


def test_starts_depend_on_seed_and_what_is_drawn(folder):
    request = Request(folder, METHODS, 1, 5, "liaam")
    draws = [request.rng(*what).uniform() for what in (("a", 0), ("a", 0), ("a", 1), ("b", 0), ("a", 0, "light"))]
    assert draws[0] == draws[1]
    assert len(set(draws)) == 4


def test_pictures_of_other_depths_become_8_bits(folder):
    samples = protocol.group_by_person(folder, 1)[0]["03"]
    image = protocol.eight_bit(samples[0])
    assert image.dtype == np.uint8
    for other in (image.astype(np.uint16) * 257, image.astype(np.float32) / 255):
        again = protocol.eight_bit(type(samples[0])("x", other, samples[0].landmarks))
        assert np.array_equal(again, image)
