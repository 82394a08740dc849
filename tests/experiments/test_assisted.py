"""Annotation with the model's help, on generated persons."""

from functools import partial

import numpy as np
import pytest

from experiments import assisted, cli
from experiments.runner import run_experiment
from liaam.errors import LiaamError, MethodError
from liaam.workers import one_thread
from setups import write_person

pytestmark = pytest.mark.slow

PERSONS, AFTER = 5, (3, 4)


@pytest.fixture(scope="module")
def six_persons(tmp_path_factory):
    """Write generated pictures of six persons, named as the spot protocol has them."""
    folder = tmp_path_factory.mktemp("persons")
    for person in range(3, 9):
        write_person(folder, person)
    return folder


@pytest.fixture(scope="module")
def finished(six_persons, tmp_path_factory):
    """Run two trials of both orders; gives summary and rows."""
    out = tmp_path_factory.mktemp("assisted")
    experiment = assisted.assisted_experiment(
        six_persons, ["smooth"], assisted.ORDERS, trials=2, persons=PERSONS, after=AFTER
    )
    with one_thread():  # as an experiment runs: sums of several threads end in other digits
        rows = [row for task in experiment.tasks for row in experiment.work(task)]
    return run_experiment(experiment, out), rows, out


def test_a_session_fits_what_is_left_and_who_never_takes_part(finished):
    _, rows, _ = finished
    for order in assisted.ORDERS:
        for trial in range(2):
            own = [row for row in rows if (row["order"], row["trial"]) == (order, trial)]
            for count in AFTER:
                roles = [row["role"] for row in own if row["annotated"] == count]
                assert sorted(roles) == ["fresh", "next", *["rest"] * (PERSONS - count - 1)]
            fresh = {row["person"] for row in own if row["role"] == "fresh"}
            assert len(fresh) == 1
            assert not fresh & {row["person"] for row in own if row["role"] != "fresh"}


def test_what_is_offered_is_annotated_next(finished):
    _, rows, _ = finished
    for order in assisted.ORDERS:
        first, then = (
            [row for row in rows if (row["order"], row["trial"], row["annotated"]) == (order, 0, count)]
            for count in AFTER
        )
        offered = next(row for row in first if row["role"] == "next")
        left = {row["person"] for row in first if row["role"] == "rest"}
        assert {row["person"] for row in then if row["role"] != "fresh"} == left
        if order == "uncertain":
            deviations = [row["deviation"] for row in first if row["role"] != "fresh"]
            assert offered["deviation"] == max(deviations) > min(deviations)


def test_the_summary_agrees_with_the_rows(finished, read_rows):
    summary, rows, out = finished
    assert [(cell["recipe"], cell["order"]) for cell in summary["cells"]] == [("smooth", o) for o in assisted.ORDERS]
    own = [row for row in rows if row["order"] == "drawn" and row["annotated"] == 4]
    cell = summary["cells"][0]["after"][1]
    for name, roles in (("next", ["next"]), ("waiting", ["next", "rest"]), ("fresh", ["fresh"])):
        assert cell[name]["nme_median"] == np.median([row["nme"] for row in own if row["role"] in roles])
    assert cell["point_median"] == np.median([row["point"] for row in own if row["role"] == "next"])
    assert all(0 < row["point"] < 2 * row["nme"] for row in own)  # at most half of the points lie beyond the median
    assert cell["bound_median"] <= cell["waiting"]["nme_median"]
    assert len(read_rows(out)) == len(rows)
    assert "| smooth | uncertain |" in (out / "report.md").read_text()


def test_the_command_prints_the_table(finished, six_persons, tmp_path, run_experiments, monkeypatch):
    summary, asked = finished[0], {}
    make = partial(assisted.assisted_experiment, persons=PERSONS, after=AFTER)
    monkeypatch.setattr(assisted, "assisted_experiment", make)

    def execute(experiment, out, jobs):
        asked.update(experiment.settings)
        return summary

    monkeypatch.setattr(cli, "execute", execute)
    options = ("--recipes", "smooth,sample", "--orders", "drawn", "--trials", 3, "--seed", 4)
    code, out, err = run_experiments("assisted", "--data", six_persons, "-o", tmp_path, *options)
    assert (code, err) == (0, "")
    assert list(asked["recipes"]) == ["smooth", "sample"]
    assert (asked["orders"], asked["trials"], asked["seed"]) == (["drawn"], 3, 4)
    header, rows = assisted.table(summary)
    assert all(word in out for word in (*header, *rows[0], *rows[-1]))


def test_refuses_before_the_work_starts(six_persons):
    make = assisted.assisted_experiment
    with pytest.raises(MethodError, match="unknown recipe 'magic'"):
        make(six_persons, ["magic"], persons=PERSONS)
    with pytest.raises(MethodError, match="unknown order 'random'"):
        make(six_persons, ["smooth"], ["random"], persons=PERSONS)
    with pytest.raises(MethodError, match="no recipe is given"):
        make(six_persons, [], persons=PERSONS)
    with pytest.raises(MethodError, match="at least 1"):
        make(six_persons, ["smooth"], trials=0, persons=PERSONS)
    with pytest.raises(LiaamError, match="6 persons are complete, but 12 are to be annotated"):
        make(six_persons)
