"""``python -m experiments``: what it prints and writes, and what it refuses."""

import pytest

from experiments import simulated
from experiments.cli import EXPERIMENTS
from liaam.io import Landmarks, write_image, write_landmarks
from scenes import Head, make_set


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    """Six landmarked pictures of one head."""
    folder = tmp_path_factory.mktemp("person")
    for i, scene in enumerate(make_set(6, Head(5), size=(160, 120))):
        write_image(folder / f"p{i}.png", scene.image)
        write_landmarks(folder / f"p{i}.pts", Landmarks(scene.landmarks))
    return folder


@pytest.mark.parametrize(
    ("name", "column", "by"),
    [
        ("displacement", "gamma", "displacement"),
        ("convergence", "iteration", "iteration"),
    ],
)
def test_medians_are_printed_and_files_written(run_experiments, person, tmp_path, name, column, by):
    options = ("--data", person, "--methods", "grey,li", "--trials", 1, "--solver", "paper-100px", "--jobs", 1)
    code, out, err = run_experiments(name, "--out", tmp_path / "o", *options)
    assert (code, err) == (0, "")
    assert f"px, by {by}" in out
    assert "grey" in out
    assert f"written to {tmp_path / 'o'}" in out
    written = sorted(path.name for path in (tmp_path / "o").iterdir())
    pictures = [] if name == "convergence" else ["pictures.png"]
    assert written == ["figure.png", "figure.svg", *pictures, "report.md", "results.csv", "summary.json"]
    assert column in (tmp_path / "o" / "results.csv").read_text().splitlines()[0]


def test_a_stopped_experiment_says_how_to_go_on(run_experiments, person, tmp_path, monkeypatch):
    def stop(_setup, _trial):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulated, "run_trial", stop)
    options = ("--data", person, "--out", tmp_path, "--methods", "li", "--jobs", 1)
    code, _, err = run_experiments("noise", *options)
    assert code == 130
    assert err.startswith("stopped: 0 of 144 tasks are kept")
    assert "the same command goes on" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("spot", "--data", "{person}", "--out", "o"), "named as the IMM"),
        (("spot", "--data", "{person}", "--out", "o", "--methods", ","), "is empty"),
        (("noise", "--out", "o", "--methods", "li,magic"), "unknown method 'magic'"),
        (("generic", "--data", "{person}", "--out", "o"), "named as the IMM"),
        (("peer", "--data", "{person}", "--out", "o", "--methods", "magic"), "unknown method 'magic'"),
        (("displacement", "--out", "o", "--solver", "oracle"), "choose from liaam, liaam-smooth, liaam-sample, paper"),
        (("displacement", "--out", "{person}/p0.png", "--methods", "li"), "is a file"),
        (("convergence", "--out", "o", "--data", "missing"), "does not exist"),
    ],
)
def test_wrong_input_is_one_line_that_says_what_to_do(
    run_experiments, arguments, message, person, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, _, err = run_experiments(*(text.format(person=person) for text in arguments))
    assert code == 1
    assert err.startswith("error: ")
    assert message in err
    assert len(err.splitlines()) == 1


def test_help(run_experiments):
    for command in ((), *((name,) for name in (*EXPERIMENTS, "reproduce"))):
        code, out, _ = run_experiments(*command, "--help")
        assert code == 0
        assert "Usage" in out
