"""The framework of the experiments, on tasks that only count."""

import csv
import json
import multiprocessing
import os
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from experiments.charts import Panel, figure_of_curves
from experiments.runner import Experiment, Journal, run_experiment
from liaam.errors import LiaamError
from liaam.plotting.figures import subplots
from liaam.workers import all_cores

FILES = ["figure.png", "figure.svg", "report.md", "results.csv", "summary.json"]


@dataclass(frozen=True)
class Count:
    number: int

    @property
    def key(self) -> str:
        return f"task {self.number}"


def work(folder, task):
    """Note the call in a folder, and give rows of NumPy's numbers."""
    with (folder / f"{task.number}").open("a") as calls:
        calls.write("x")
    value = np.float64(np.random.default_rng(task.number).standard_normal())
    return [{"method": method, "number": task.number, "value": value * k, "fine": value > 0} for method, k in METHODS]


METHODS = (("one", 1.0), ("third", 1 / 3))


def crash(task):
    if task.number == 1:
        os._exit(3)
    return [{"method": "one", "number": task.number, "value": 0.0, "fine": True}]


def complain(task):
    if task.number:
        raise LiaamError("no such thing")
    return [{"method": "one", "number": task.number, "value": 0.0, "fine": True}]


def summarise(rows):
    return {"sum": sum(row["value"] for row in rows)}


def draw(rows, _summary):
    lines = {name: [(row["number"], row["value"]) for row in rows if row["method"] == name] for name, _ in METHODS}
    return figure_of_curves([Panel("number", "value, px", {name: line for name, line in lines.items() if line})])


def draw_nothing(_rows, _summary):
    """Make a figure that is quickly written, where it does not matter."""
    return subplots(1, 1, (1.0, 1.0))[0]


def report(summary):
    return f"{summary['sum']:.3f} in all"


def counting(work, n=6, draw=draw_nothing, **settings) -> Experiment:
    return Experiment(
        name="counting",
        title="Counting",
        settings={"n": n, "step": 0.5, **settings},
        tasks=tuple(Count(i) for i in range(n)),
        work=work,
        summarise=summarise,
        draw=draw,
        report=report,
        choices=("numbers are whole",),
    )


@pytest.fixture
def calls(tmp_path):
    """Give a folder for calls, and what counts them by task."""
    folder = tmp_path / "calls"
    folder.mkdir()
    return folder, lambda: {int(path.name): len(path.read_text()) for path in folder.iterdir()}


def stop_after(n):
    """Progress that a person watches, and stops by Ctrl-C."""

    def tell(done, _total, _what):
        if done == n:
            raise KeyboardInterrupt

    return tell


def test_writes_all_files_and_the_summary_it_gives(tmp_path, calls):
    told = []
    summary = run_experiment(
        counting(partial(work, calls[0]), draw=draw), tmp_path / "a" / "b", progress=lambda *t: told.append(t)
    )
    out = tmp_path / "a" / "b"
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert json.loads((out / "summary.json").read_text()) == summary
    assert (summary["experiment"], summary["settings"]["n"], summary["left_out"]) == ("counting", 6, [])
    rows = list(csv.DictReader((out / "results.csv").read_text().splitlines()))
    assert [(row["number"], row["method"]) for row in rows] == [(str(i), m) for i in range(6) for m, _ in METHODS]
    text = (out / "report.md").read_text()
    for part in ("# Counting", "in all", "![Counting](figure.png)", "numbers are whole", "| step | 0.5 |"):
        assert part in text
    assert told[0][:2] == (0, 6)
    assert told[-1][:2] == (6, 6)


def test_a_stopped_run_goes_on_and_ends_the_same(tmp_path, calls):
    folder, counts = calls
    experiment = counting(partial(work, folder), draw=draw)
    run_experiment(experiment, tmp_path / "whole")
    for path in folder.iterdir():
        path.unlink()
    out = tmp_path / "parts"
    with pytest.raises(KeyboardInterrupt, match=r"3 of 6 tasks are kept in .*goes on from there"):
        run_experiment(experiment, out, 2, stop_after(3))
    assert not multiprocessing.active_children()
    done = {json.loads(line)["key"] for line in (out / experiment.journal).read_text().splitlines()}
    assert len(done) == 3
    before = counts()
    with (out / experiment.journal).open("a") as journal:  # a kill in the middle of a write
        journal.write('{"key": "task 5", "rows": [{"meth')
    run_experiment(experiment, out)
    assert all(counts()[i] == before[i] for i in range(6) if f"task {i}" in done)
    assert sorted(path.name for path in out.iterdir()) == FILES
    for name in FILES:
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("change", [{"settings": {"n": 6, "step": 0.25}}, {"name": "counting again"}])
def test_other_settings_have_a_journal_of_their_own(tmp_path, calls, change):
    folder, counts = calls
    experiment = counting(partial(work, folder))
    with pytest.raises(KeyboardInterrupt):
        run_experiment(experiment, tmp_path / "out", 1, stop_after(3))
    run_experiment(replace(experiment, **change), tmp_path / "out")
    assert counts() == {0: 2, 1: 2, 2: 2, 3: 1, 4: 1, 5: 1}
    run_experiment(experiment, tmp_path / "out")  # what the first had done is still there
    assert counts() == {0: 2, 1: 2, 2: 2, 3: 2, 4: 2, 5: 2}


@pytest.mark.parametrize("text", [b"\xff\x00 nonsense\n{}\n", b"[1]\n", b'{"key": "task 1"}\n'])
def test_a_journal_of_something_else_is_no_obstacle(tmp_path, calls, text):
    experiment = counting(partial(work, calls[0]))
    (tmp_path / experiment.journal).write_bytes(text)
    run_experiment(experiment, tmp_path)
    assert set(calls[1]().values()) == {1}


def test_a_worker_that_dies_is_an_error_with_a_remedy(tmp_path):
    with pytest.raises(LiaamError, match=r"worker process died.*the same command goes on"):
        run_experiment(counting(crash), tmp_path, jobs=2)
    assert not multiprocessing.active_children()
    assert not (tmp_path / "results.csv").exists()


def test_a_fault_ends_the_run_or_leaves_the_task_out(tmp_path):
    with pytest.raises(LiaamError, match="no such thing"):
        run_experiment(counting(complain), tmp_path)
    summary = run_experiment(replace(counting(complain, 3), skips_faults=True, left_out=("x: grey",)), tmp_path, 2)
    assert summary["left_out"] == ["x: grey", "task 1: no such thing", "task 2: no such thing"]
    assert "## Left out\n\n- x: grey" in (tmp_path / "report.md").read_text()


def test_refuses_what_makes_no_sense(tmp_path):
    with pytest.raises(LiaamError, match="nothing to do"):
        counting(crash, 0)
    with pytest.raises(LiaamError, match="same name"):
        replace(counting(crash), tasks=(Count(1), Count(1)))
    with pytest.raises(LiaamError, match="jobs must be at least 1"):
        run_experiment(counting(crash), tmp_path / "out", 0)
    (tmp_path / "file").touch()
    with pytest.raises(LiaamError, match="is a file"):
        run_experiment(counting(crash), tmp_path / "file")
    with pytest.raises(LiaamError, match="has no result; task 0: never"):
        run_experiment(replace(counting(partial(never), 1), skips_faults=True), tmp_path)
    assert all_cores() >= 1


def never(_task):
    raise LiaamError("never")


@pytest.mark.parametrize(
    "line",
    ['{"key": [], "rows": [], "fault": null}', '{"key": "b", "rows": [1], "fault": null}', "[" * 100_000,
     '{"key": "b", "rows": null, "fault": null}', '{"key": "b", "rows": [], "fault": 7}'],
    ids=range(5),
)  # fmt: skip
def test_a_journal_counts_up_to_its_first_damaged_line(tmp_path, line):
    first, last = (json.dumps({"key": key, "rows": [{"x": 1}], "fault": None}) for key in "ac")
    (tmp_path / "j.jsonl").write_text("\n".join([first, line, last, ""]))
    with Journal(tmp_path / "j.jsonl") as journal:
        assert list(journal.outcomes) == ["a"]
