"""Ellipses and quality against the truth, on generated heads and generated persons."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import cli, uncertainty
from experiments.measures import roc_area
from experiments.runner import run_experiment
from liaam.error_measures import within_ellipses

pytestmark = pytest.mark.slow

PICTURES = 4  # of a generated head, to train on and to fit


@pytest.fixture(scope="module")
def finished(folder, tmp_path_factory):
    """Run one task of each group on few pictures; gives summary, rows and folder."""
    out = tmp_path_factory.mktemp("uncertainty")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertainty, "PICTURES", PICTURES)
        patch.setattr(uncertainty, "LEFT_OUT", (1,))
        whole = uncertainty.uncertainty_experiment(folder, heads=1, seed=5)
        first = {task.group: task for task in reversed(whole.tasks)}
        rows = {task: whole.work(task) for task in first.values()}
        told = replace(whole, tasks=tuple(rows), work=rows.__getitem__)
        return run_experiment(told, out, jobs=1), [row for own in rows.values() for row in own], out


def test_every_group_is_fitted_from_near_and_far(finished):
    summary, rows, out = finished
    assert {row["group"] for row in rows} == set(uncertainty.GROUPS)
    for group in uncertainty.GROUPS:
        own = [row for row in rows if row["group"] == group]
        assert {row["start"] for row in own} == set(uncertainty.STARTED)
        assert summary["groups"][group]["fits"] == len(own)
    generated = [row for row in rows if row["group"] == "generated"]
    assert {row["noise"] for row in generated} == set(uncertainty.NOISES)
    assert {row["light"] for row in generated} == {"training", "side"}
    # Each picture once at each noise, and once from far.
    assert len(generated) == PICTURES * (len(uncertainty.NOISES) + 1)
    assert "ROC" in (out / "report.md").read_text(encoding="utf-8")


def test_a_persons_left_out_pictures_are_not_those_it_was_trained_on(folder, monkeypatch):
    seen = []
    monkeypatch.setattr(uncertainty, "trained", lambda request, data, name: seen.append([s.name for s in data]))
    request = uncertainty.Request(folder, ("soft-li",), 1, 0, "liaam")
    tested = [pictures[0].name for _, pictures in uncertainty.left_out(request, "03")]
    assert len(tested) == len(uncertainty.LEFT_OUT) == len(seen)
    for name, training in zip(tested, seen, strict=True):
        assert name not in training
        assert len(training) == 4
    uncertainty.get_half.cache_clear()
    (((_, pictures)),) = uncertainty.strangers(request, "04")
    uncertainty.get_half.cache_clear()
    assert all("04-" in picture.name for picture in pictures)
    assert not any("04-" in name for name in seen[-1])


def test_held_shares_rise_with_the_level_and_agree_with_the_rows(finished):
    summary, rows, _ = finished
    for row in rows:
        shares = [row[f"held_{level}"] for level in uncertainty.LEVELS]
        assert shares == sorted(shares)
    right = [row for row in rows if row["start"] == "near" and row["nme"] < 0.08]
    assert summary["groups"]["all"]["held_95"] == pytest.approx(np.mean([row["held_95"] for row in right]))


def test_ellipses_of_the_true_covariance_hold_what_they_say(rng):
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    errors = rng.multivariate_normal(np.zeros(2), covariance, 20000)
    spread = np.broadcast_to(covariance, (20000, 2, 2))
    for level in uncertainty.LEVELS:
        inside = within_ellipses(np.zeros_like(errors), errors, spread, level / 100)
        assert np.mean(inside) == pytest.approx(level / 100, abs=0.01)


def test_the_area_under_the_roc_curve_is_the_chance_of_the_right_order():
    right, wrong = np.array([0.9, 0.8, 0.3]), np.array([0.3, 0.1])
    assert roc_area(right, wrong) == pytest.approx(5.5 / 6)
    assert np.isnan(roc_area(right, wrong[:0]))


def test_a_lost_start_is_far_from_the_object(rng):
    shape = rng.normal(100, 20, (30, 2))
    starts = [uncertainty.lost(shape, 50.0, (300, 280), rng) for _ in range(50)]
    assert min(np.linalg.norm(start - shape, axis=1).mean() for start in starts) > 10
    for start in starts:
        assert (start.min(axis=0) >= -1e-9).all()
        assert (start.max(axis=0) <= [299, 279]).all()


def test_it_runs_from_the_command_line_without_data(finished, tmp_path, monkeypatch, run_experiments):
    asked = []
    monkeypatch.setattr(cli, "execute", lambda experiment, *_: (asked.append(experiment), finished[0])[1])
    code, said, _ = run_experiments("uncertainty", "-o", tmp_path / "out", "--heads", 1, "--jobs", 1)
    assert code == 0
    assert "generated, noise 5" in said
    assert {task.group for task in asked[0].tasks} == {"generated"}
