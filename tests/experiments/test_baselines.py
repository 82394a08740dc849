"""The paper's references on tiny runs."""

import csv

import numpy as np
import pytest

from experiments.baselines import (
    COVERED,
    SITUATIONS,
    Trial,
    baselines_experiment,
    changed_picture,
    covered,
    run_trial,
)
from experiments.runner import run_experiment
from experiments.solvers import Request
from experiments.subjects import get_subject
from liaam.errors import MethodError

pytestmark = pytest.mark.slow

FILES = {"results.csv", "summary.json", "report.md", "figure.png", "figure.svg"}


def test_a_tiny_run_writes_all(tmp_path):
    summary = run_experiment(baselines_experiment(None, trials=1, seed=3), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == FILES
    rows = list(csv.DictReader((tmp_path / "results.csv").read_text().splitlines()))
    assert len(rows) == sum(len(situation.methods) for situation in SITUATIONS)
    report = (tmp_path / "report.md").read_text()
    for situation in SITUATIONS:
        found = summary["situations"][situation.name]
        assert found["baseline"] == situation.baseline
        assert tuple(found["methods"]) == situation.methods
        plain = found["methods"][situation.baseline]["median"]
        for method, cell in found["methods"].items():
            own = [float(r["error_px"]) for r in rows if (r["situation"], r["method"]) == (situation.name, method)]
            assert cell["median"] == pytest.approx(np.median(own), abs=1e-6)
            assert ("beats_plain" in cell) == (method in situation.claimed)
            if method in situation.claimed:
                assert cell["beats_plain"] == (cell["median"] < plain)
        assert f"better than {situation.baseline}" in report
    gain = summary["situations"]["gain"]["methods"]
    assert gain["grey"]["beats_plain"]
    assert gain["grey"]["median"] < 0.1 < gain["grey-plain"]["median"]
    assert summary["situations"]["light"]["methods"]["li"]["median"] < 0.3


def test_baselines_and_claims_are_among_the_methods():
    for situation in SITUATIONS:
        assert {situation.baseline, *situation.claimed} <= set(situation.methods)
        assert situation.baseline not in situation.claimed or situation.name == "gain"


@pytest.mark.parametrize("number", [10, 17, 18, 21])
def test_tukeys_loss_comes_free_of_a_patch(number):
    rows = run_trial(Request(None, ("grey",), 1, 0, "liaam"), Trial("occlusion", number))
    (tukey,) = (row for row in rows if row["method"] == "grey+tukey")
    assert tukey["status"] == "converged"
    assert tukey["error_px"] < 0.1
    assert tukey["iterations"] < 30


def test_a_patch_covers_its_share(rng):
    image, shape = get_subject(None).pairs[0]
    box = np.prod(np.ptp(shape, axis=0))
    for _ in range(5):
        spoilt = covered(image, shape, rng)
        changed = (spoilt != image).any(axis=2)
        assert changed.sum() / box == pytest.approx(COVERED, rel=0.05)
        assert len(np.unique(spoilt[changed], axis=0)) == 1
    assert covered(image, shape, rng) is not image


@pytest.mark.parametrize("situation", [situation.name for situation in SITUATIONS])
def test_what_is_changed_depends_on_the_draw_only(situation):
    subject = get_subject(None)
    first, again, other = (changed_picture(subject, situation, 2, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.dtype == np.float32
    assert (first.min(), first.max()) >= (0, 0)
    assert first.max() <= 1
    assert not np.array_equal(first, subject.images[2])


def test_tasks_have_names_of_their_own():
    experiment = baselines_experiment(None, trials=2)
    assert [task.key for task in experiment.tasks[:2]] == ["light, trial 0", "light, trial 1"]
    assert experiment.tasks[-1] == Trial("gain", 1)


@pytest.mark.parametrize(
    ("options", "message"), [({"trials": 0}, "at least 1"), ({"solver": "oracle"}, "unknown solver 'oracle'")]
)
def test_refuses_before_the_work_starts(options, message):
    with pytest.raises(MethodError, match=message):
        baselines_experiment(None, **options)
