"""Generic models on generated persons."""

import shutil

import numpy as np
import pytest

from experiments import generic
from experiments.runner import run_experiment
from liaam.errors import LiaamError
from setups import copy_files

pytestmark = pytest.mark.slow

METHODS = ("rgb", "li")


def test_a_generic_model_is_never_fitted_to_those_it_was_trained_on(folder):
    experiment = generic.generic_experiment(folder, METHODS)
    folds, _ = generic.get_folds(generic.GenericRequest(folder, METHODS, 1, 0, "liaam"))
    for fold in folds:
        trained = {sample.name for sample in fold.training}
        assert trained
        assert not any("-5" in name for name in trained)
        assert not any(shown.sample.name in trained for own in fold.tested.values() for shown in own)
    assert [task.key for task in experiment.tasks] == ["group 0, person 03", "group 0, person 05", "group 1, person 04"]


def test_generic_summary_agrees_with_its_rows(done):
    summary, rows, _ = done("generic")
    for method in METHODS:
        cells = summary["methods"][method]["near"]
        for light, count in (("diffuse", 15), ("spot", 3), ("relit", 15), ("all", 33)):
            own = [r for r in rows if r["method"] == method and light in (r["light"], "all")]
            errors, bounds, held = (np.array([float(r[key]) for r in own]) for key in ("nme", "bound", "held_95"))
            usable = np.array([r["status"] in ("converged", "light unobservable") for r in own])
            cell = cells[light]
            assert len(own) == cell["fits"] == count
            assert cell["nme_median"] == pytest.approx(np.median(errors), abs=1e-6)
            assert cell["beyond"] == pytest.approx(np.mean(errors >= 0.08))
            assert cell["silent"] == pytest.approx(np.mean((errors >= 0.08) & usable))
            refused = ~usable[errors < 0.08]
            assert cell["refused"] == (pytest.approx(refused.mean()) if len(refused) else None)
            assert cell["excess_median"] == pytest.approx(np.median(errors - bounds), abs=2e-6)
            right = held[np.array([float(r["outline"]) for r in own]) < 0.08]
            assert cell["held_95"] == (pytest.approx(right.mean(), abs=1e-6) if len(right) else None)
            assert cell["roc_area"] is None  # these methods know no quality


@pytest.fixture(scope="module")
def folders(folder, tmp_path_factory):
    """Give pictures of two persons to train on, and two pictures of a third one to fit."""
    root = tmp_path_factory.mktemp("folders")
    return copy_files(folder, root / "train", "0[34]-[12346]*"), copy_files(folder, root / "test", "05-[15]*")


def test_folders_are_taken_as_they_come(folders, tmp_path, read_rows):
    train, test = folders
    options = {"test": test, "starts": ("near", "box", "none"), "diagonal": 80.0, "methods": ("soft-li",)}
    experiment = generic.generic_experiment(train, **options)
    assert [task.key for task in experiment.tasks] == ["group 0, 05"]
    summary = run_experiment(experiment, tmp_path, jobs=1)
    rows = read_rows(tmp_path)
    assert len(rows) == 2 * 3
    assert all(float(row["nme"]) < 0.2 for row in rows if row["start"] == "near")
    for start, cells in summary["methods"]["soft-li"].items():
        assert start in options["starts"]
        assert list(cells) == ["all", *summary["lights"]]
        assert cells["all"]["fits"] == 2
    starts = {row["start"]: generic.table(summary)[1][0][0] for row in rows}
    assert list(starts) == list(options["starts"])
    assert (tmp_path / "pictures.png").stat().st_size


def test_the_first_pictures_train_and_the_others_are_fitted(folders):
    request = generic.GenericRequest(folders[0], ("soft-li",), 1, 0, "liaam", first=7)
    (fold,), left_out = generic.get_folds(request)
    assert len(fold.training) == 7
    assert sum(map(len, fold.tested.values())) == 3
    assert not left_out


def test_lamps_reach_the_training(folder, folders, monkeypatch, tmp_path):
    asked = {}
    monkeypatch.setattr(generic.Trained, "on", lambda request, samples, name, **options: asked.update(options))
    lamps = copy_files(folder, tmp_path / "lamps", "03-1m*")
    for name in ("03-1m", "03-5m"):  # a person who has not moved, under two lamps
        for suffix in ("png", "pts"):
            shutil.copy(folder / f"03-1m.{suffix}", lamps / f"{name}.{suffix}")
    options = {"test": folders[1], "lamps": lamps, "training_lamp": "1m"}
    request = generic.GenericRequest(folders[0], ("soft-li", "varied"), 1, 0, "liaam", **options)
    generic.get_trained.cache_clear()
    generic.get_trained(request, 0)
    generic.get_trained.cache_clear()
    assert len(asked["lamps"]) == 1
    assert asked["leave_out"]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"starts": ("far",)}, "near, box, none"),
        ({"starts": ("near", "near")}, "each once"),
        ({"unit": "feet"}, "centres, corners"),
        ({"unit": "corners", "first": 4}, "known of 68 landmarks"),
        ({"first": 10}, r"10 pictures can be used; train on the first 2 to 9"),
        ({"first": 4, "test": "there"}, "give one"),
    ],
)
def test_what_makes_no_sense_is_refused(folders, options, what):
    with pytest.raises(LiaamError, match=what):
        generic.generic_experiment(folders[0], METHODS, **options)


def test_a_generic_model_needs_three_persons(folder, tmp_path):
    copy_files(folder, tmp_path, "03-*", "04-*")
    with pytest.raises(LiaamError, match=r"2 persons are complete.*add some"):
        generic.generic_experiment(tmp_path, METHODS)
