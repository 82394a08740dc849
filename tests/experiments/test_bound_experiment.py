"""The experiment of the bound on tiny runs."""

import csv

import numpy as np
import pytest

from experiments.bound import MEASURES, UNDER, bound_experiment, curves
from experiments.cramer_rao import cramer_rao_bound
from experiments.runner import run_experiment
from experiments.simulated import make_case, sharp_model
from experiments.subjects import get_subject
from liaam.errors import MethodError

pytestmark = pytest.mark.slow

FILES = {"results.csv", "summary.json", "report.md", "figure.png", "figure.svg"}


def test_a_tiny_run_writes_all_and_repeats_itself(tmp_path):
    summary = run_experiment(bound_experiment(None, trials=2, seed=1, sigmas=(1, 4)), tmp_path / "a")
    run_experiment(bound_experiment(None, trials=2, seed=1, sigmas=(1, 4)), tmp_path / "b")
    assert {path.name for path in (tmp_path / "a").iterdir()} == FILES
    text = (tmp_path / "a" / "results.csv").read_text()
    assert text == (tmp_path / "b" / "results.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    assert len(rows) == 2 * 2 * sum(len(measures) for measures in UNDER.values())

    lines = curves(summary, "same light", "bound_px")
    assert tuple(lines) == tuple(MEASURES)
    for line in lines.values():
        (_, low), (sigma, high) = line
        assert (sigma, high) == (4.0, pytest.approx(4 * low))
    least = {measure: line[0][1] for measure, line in lines.items()}
    assert least["rgb"] < least["grey"] < least["chroma"] < least["li"]
    assert tuple(curves(summary, "shadow", "bound_px")) == ("li",)
    assert tuple(curves(summary, "same light", "theta_bound_deg")) == ("li",)
    assert summary["bounds"]["shadow"]["li"][0]["theta_bound_deg"] > 0
    report = (tmp_path / "a" / "report.md").read_text()
    assert f"at best {least['li'] / least['rgb']:.1f} times as far from the truth as `rgb`" in report
    figure = (tmp_path / "a" / "figure.svg").read_text()
    assert "li, under the shadow" in figure


def test_its_numbers_are_those_of_the_bound(tmp_path):
    summary = run_experiment(bound_experiment(None, trials=1, seed=5, sigmas=(3,)), tmp_path)
    case = make_case(get_subject(None), 5, 0, gamma=0.0, sigma_n=0.0)
    bound = cramer_rao_bound(sharp_model(None), case.image, case.truth, "li", 3 / 255)
    cell = summary["bounds"]["shadow"]["li"][0]
    assert cell["bound_px"] == pytest.approx(bound.rms)
    assert cell["theta_bound_deg"] == pytest.approx(np.rad2deg(bound.theta))


def test_refuses_no_trials():
    with pytest.raises(MethodError, match="at least 1"):
        bound_experiment(None, trials=0)
