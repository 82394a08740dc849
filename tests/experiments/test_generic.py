"""Generic models on generated persons."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.experiments import generic, protocol
from setups import copy_files

METHODS = ("rgb", "li")


def test_a_generic_model_is_never_fitted_to_those_it_was_trained_on(folder, monkeypatch):
    trained = []
    monkeypatch.setattr(protocol.Request, "train", lambda self, samples, name, **_: trained.append(samples))
    experiment = generic.generic_experiment(folder, METHODS)
    generic.get_trained.cache_clear()
    for task in experiment.tasks:
        generic.get_trained(protocol.Request(folder, METHODS, 1, 0, "liaam"), task.fold)
        names = {sample.name for sample in trained[-1]}
        assert names
        assert not any(name.startswith(task.person) for name in names)
        assert not any("-5" in name for name in names)
    assert len(trained) == 2  # once for each fold
    assert [task.person for task in experiment.tasks] == ["03", "05", "04"]
    generic.get_trained.cache_clear()


def test_generic_summary_agrees_with_its_rows(done):
    summary, rows, _ = done("generic")
    for method in METHODS:
        cells = summary["methods"][method]
        for light, count in (("diffuse", 15), ("spot", 3), ("relit", 15)):
            own = [r for r in rows if (r["method"], r["light"]) == (method, light)]
            errors, bounds = (np.array([float(r[key]) for r in own]) for key in ("nme", "bound"))
            assert len(own) == count
            assert cells[light]["nme_median"] == pytest.approx(np.median(errors), abs=1e-6)
            assert cells[light]["beyond"] == pytest.approx(np.mean(errors >= 0.08))
            assert cells[light]["excess_median"] == pytest.approx(np.median(errors - bounds), abs=2e-6)
            medians = [cells[which]["nme_median"] for which in (light, "diffuse")]
            assert cells[light]["to_diffuse"] == pytest.approx(medians[0] / medians[1])


def test_a_generic_model_needs_three_persons(folder, tmp_path):
    copy_files(folder, tmp_path, "03-*", "04-*")
    with pytest.raises(LiaamError, match=r"2 persons are complete.*add some"):
        generic.generic_experiment(tmp_path, METHODS)
