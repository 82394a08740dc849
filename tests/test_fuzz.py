"""Hostile inputs: some hundred cases of every target, and the fuzzer itself, which has to notice whatever happens."""

import contextlib
import sys
from pathlib import Path

import pytest

from fuzz import forged, guided, parent
from fuzz.__main__ import keep, main, report
from fuzz.parent import run
from fuzz.target import MODULES, Target, targets_of
from fuzz.worker import GIGABYTES, SECONDS, Job, Limits, outcome_of
from liaam.errors import LiaamError, ModelFileError
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.model import load_model

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fuzzer runs on Linux only")

LIMITS = Limits(seconds=0.4, n_bytes=100_000_000)
HERE = ("hostile_targets",)
TARGETS = targets_of(*MODULES)
ROOT = Path(__file__).parents[1]
KINDS = {
    "crash": "SIGSEGV",
    "leave": "exit 3",
    "spin": "time",
    "sleep": "time",
    "gorge": "memory",
    "swallow_lack": "memory",
    "foreign": "exception",
    "depart": "exception",
    "unmade": "making",
}


@pytest.fixture(scope="module")
def faulty():
    jobs = [Job(name, 0, 0, 12, HERE) for name in (*KINDS, "sound")]
    return run(jobs, n_children=2, limits=LIMITS)


def test_a_fault_is_told_with_its_kind_and_case_and_the_others_go_on(faulty):
    assert {name: [(each.kind, each.case) for each in faulty[name].failures] for name in KINDS} == {
        name: [(kind, 5)] for name, kind in KINDS.items()
    }
    assert {(faulty[name].cases, faulty[name].returned + faulty[name].refused) for name in KINDS} == {(12, 11)}


def test_a_fault_says_where_it_was(faulty):
    assert "ValueError: what a user would see" in faulty["foreign"].failures[0].what
    for name in ("crash", "spin", "sleep"):
        assert f"in {name}" in faulty[name].failures[0].what


def test_a_sound_target_has_no_failures(faulty):
    tally = faulty["sound"]
    assert not tally.failures and tally.returned and tally.refused and tally.returned + tally.refused == 12


def test_the_report_says_how_to_run_a_failure_again(faulty):
    text = "\n".join(report(faulty))
    assert "time: python -m fuzz spin --seed 0 --case 5" in text
    assert "sound" in text


def test_failing_inputs_are_kept(faulty, tmp_path):
    keep(faulty["crash"].failures + faulty["foreign"].failures, tmp_path, HERE)
    targets = targets_of(*HERE)
    for name in ("crash", "foreign"):
        assert (tmp_path / f"{name}-0-5.bin").read_bytes() == targets[name].input_of(0, 5)


def test_memory_is_counted_beyond_what_was_there_before():
    before = Limits(n_bytes=300_000_000)  # more than the case takes, less than it and the libraries
    assert not run([Job("gorge", 0, 0, 8, HERE)], 1, before)["gorge"].failures


def test_a_busy_machine_does_not_end_a_child_that_prepares(monkeypatch):
    """It may take longer by the clock than the limit on its processor time."""
    monkeypatch.setattr(parent, "_PREPARING", 0.3)
    monkeypatch.setattr(parent, "_BUSY", 200.0)  # a minute
    monkeypatch.setattr(parent, "_processor_time", lambda pid: 0.0)
    tally = run([Job("slow_start", 0, 0, 5, HERE)], 1)["slow_start"]
    assert tally.cases == 5 and not tally.failures


def test_a_case_depends_on_target_seed_and_number_alone():
    for name, target in TARGETS.items():
        alone = [repr(target.input_of(3, 7)) for _ in range(2)]
        for case in range(9):  # this one's, too
            target.input_of(3, case)
        assert repr(target.input_of(3, 7)) == alone[0] == alone[1], name
        others = [repr(target.input_of(4, case)) != repr(target.input_of(3, case)) for case in (7, 8)]
        assert any(others), name


def test_the_documents_state_the_limits_of_a_case():
    assert Limits() == Limits(seconds=SECONDS, n_bytes=GIGABYTES * 10**9)
    assert f"may take at most {SECONDS} s and {GIGABYTES} GB" in " ".join((ROOT / "SECURITY.md").read_text().split())
    rule = " ".join((ROOT / "fuzz" / "README.md").read_text().split())
    assert f"within {SECONDS} s of processor time and with at most {GIGABYTES} GB more memory" in rule


def test_a_third_of_the_forged_models_is_accepted(tmp_path):
    n_accepted, path = 0, tmp_path / "forged.liaam"
    for case in range(100):
        path.write_bytes(TARGETS["forged"].input_of(5, case))
        with contextlib.suppress(ModelFileError):
            load_model(path)
            n_accepted += 1
    assert n_accepted >= forged.SHARE_ACCEPTED * 100


def test_forged_models_that_are_accepted_are_fitted_without_a_fault():
    tally = run([Job("forged", 5, 80, 120)], n_children=1)["forged"]  # in two of them, a quality was above 1
    assert not tally.failures
    assert tally.returned >= forged.SHARE_ACCEPTED * tally.cases


def test_forged_models_are_of_all_kinds():
    headers = [forged.header_of(TARGETS["forged"].input_of(0, case)) for case in range(60)]
    assert any(header.get("others") for header in headers)
    assert any(len(header["views"]) == 1 for header in headers)
    assert any(set(view["blurs"]) == {0.0} for header in headers for view in header["views"].values())


def test_every_suffix_of_landmark_files_has_a_target():
    assert {f"landmarks{suffix}" for suffix in LANDMARK_SUFFIXES} <= TARGETS.keys()


def test_no_two_targets_have_one_name():
    with pytest.raises(AssertionError, match="two targets have one name"):
        targets_of(*HERE, *HERE)


def test_the_command_line_gives_a_status(capsys, tmp_path):
    assert main(["landmarks.pts", "--cases", "20", "--jobs", "1", "--keep", str(tmp_path / "kept")]) == 0
    assert "landmarks.pts" in capsys.readouterr().out
    assert not (tmp_path / "kept").exists()
    assert main(["nonsense"]) == 2
    assert "no target nonsense" in capsys.readouterr().err


def test_the_command_line_fails_where_a_case_does(capsys, tmp_path):
    assert main(["foreign", "--cases", "6", "--jobs", "1", "--keep", str(tmp_path)], HERE) == 1
    out = capsys.readouterr().out
    assert "--case 5" in out and "1 of 6 cases failed" in out
    assert main(["foreign", "--case", "4", "--jobs", "1", "--keep", str(tmp_path)], HERE) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["foreign-0-5.bin"]


@pytest.mark.parametrize("command", [main, guided.main])
def test_other_systems_are_told(command, capsys, monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert command(["landmarks.pts"]) == 2
    assert "Linux only" in capsys.readouterr().err


def test_targets_of_bytes_can_be_guided():
    suited = guided.suited()
    assert {"landmarks.pts", "pictures.png", "models", "cameras", "lamps", "videos"} <= set(suited)
    assert not {"folder", "images", "requests"} & set(suited)


def test_a_guided_input_that_breaks_the_property_is_told():
    target = targets_of(*HERE)["foreign"]
    guided.check_one(target, target.input_of(0, 4), LIMITS)
    with pytest.raises(guided.Broken, match="what a user would see"):
        guided.check_one(target, target.input_of(0, 5), LIMITS)


def test_an_input_is_read_again_alone(tmp_path, capsys, monkeypatch):
    path = tmp_path / "x.pts"
    path.write_bytes(b"nonsense")
    monkeypatch.chdir(tmp_path)
    assert guided.main(["landmarks.pts", "--input", str(path)]) == 0
    assert "refused: " in capsys.readouterr().out


@pytest.mark.slow
def test_guided_fuzzing_runs(tmp_path):
    pytest.importorskip("atheris", reason="Atheris is not installed: pip install atheris")
    status, what = guided.fuzz("landmarks.pts", 2, tmp_path)
    assert (status, list(tmp_path.iterdir())) == (0, [])
    assert int(what.split()[0]) > 1000


def test_a_size_that_ffmpeg_refuses_is_no_lack_of_memory():
    error = pytest.importorskip("av.error")

    def check(_):
        raise LiaamError("refused") from error.MemoryError(12, "Cannot allocate memory")

    assert outcome_of(Target("x", make=lambda rng: b"", check=check), b"") == "refused"
