"""Error against iterations, on each kind of data."""

import csv

import numpy as np
import pytest

from experiments.convergence import SHOWN, convergence_experiment, errors_by_iteration
from experiments.runner import run_experiment
from experiments.simulated import get_fitters, make_case
from experiments.subjects import get_subject
from liaam.io import write_image, write_landmarks
from scenes import Head, make_set
from setups import write_person

pytestmark = pytest.mark.slow


def run(tmp_path, *options):
    summary = run_experiment(convergence_experiment(*options), tmp_path / "out")
    rows = list(csv.DictReader((tmp_path / "out" / "results.csv").read_text().splitlines()))
    return summary, rows


def test_scenes_under_lateral_light(tmp_path):
    summary, rows = run(tmp_path, None, ("grey", "li"), 2)
    assert summary["settings"]["light"] == "generated, hard, from the left"
    assert len(rows) == 2 * 2 * 51
    li, grey = (summary["methods"][method]["median"] for method in ("li", "grey"))
    assert li[0] == grey[0]
    assert li[-1] < 0.5 < grey[-1]
    assert li[-1] == li[-2]  # has ended, and keeps its last error
    assert "| grey |" in (tmp_path / "out" / "report.md").read_text()


def test_spot_protocol_follows_every_person(tmp_path):
    for person, conditions in ((3, "123456"), (4, "123456"), (5, "1234")):
        write_person(tmp_path, person, conditions)
    summary, rows = run(tmp_path, tmp_path, ("li",), 1)
    assert summary["settings"]["light"] == "a spot light"
    assert {row["picture"] for row in rows} == {"03", "04"}
    assert summary["left_out"] == ["person 05: picture 5, 6 is missing"]
    assert summary["methods"]["li"]["fits"] == 2
    assert summary["methods"]["li"]["median"][-1] < summary["methods"]["li"]["median"][0]


def test_one_persons_pictures_get_a_shadow(tmp_path):
    for i, scene in enumerate(make_set(6, head=Head(5), size=(200, 150))):
        write_image(tmp_path / f"{i}.png", scene.image)
        write_landmarks(tmp_path / f"{i}.pts", scene.landmarks)
    summary, _ = run(tmp_path, tmp_path, ("li",), 1)
    assert summary["settings"]["light"] == "a simulated shadow"
    assert summary["methods"]["li"]["median"][-1] < 0.5


def test_levels_follow_each_other_and_the_last_error_is_kept():
    case = make_case(get_subject(None), 0, 0, 4.0, 0.0)
    result = get_fitters(None, ("li",), "liaam")["li"].fit(case.image, case.start)
    errors = errors_by_iteration(result, case.truth)
    n_steps = len(result.history) - 2  # two levels, each with its start
    assert len(errors) == SHOWN[-1] + 1
    assert errors[n_steps:] == [errors[-1]] * (len(errors) - n_steps)
    assert errors[-1] == pytest.approx(np.linalg.norm(result.landmarks - case.truth, axis=1).mean())
