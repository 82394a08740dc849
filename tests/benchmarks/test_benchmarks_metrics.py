"""What benchmarks share: metrics printed and recorded, and the baseline. Nothing is timed here."""

import json

import numpy as np
import pytest

from benchmarks import __main__ as command, metrics
from benchmarks.metrics import (
    BaselineError,
    compare,
    has_moved,
    in_turn,
    read_baseline,
    recording,
    report,
    save_baseline,
)


@pytest.fixture
def baseline(tmp_path, monkeypatch):
    """A baseline of one benchmark that is not there yet, and a benchmark that reports two metrics."""

    def bench():
        report("speed", 2.0, "of all")
        report("same", True)

    monkeypatch.setattr(metrics, "BASELINE", tmp_path / "baseline.json")
    monkeypatch.setattr(command, "BENCHMARKS", {"one": bench, "silent": lambda: None})
    return metrics.BASELINE


def test_a_metric_is_a_line_of_name_value_and_note(capsys):
    report("lost", 3, "of 7", form=".0f")
    report("speed", 2.5)
    report("killed_same", np.bool_(True), "after 3 kills")
    assert capsys.readouterr().out == "lost 3 of 7\nspeed 2.500\nkilled_same True after 3 kills\n"


def test_a_metric_of_a_table_stands_in_columns(capsys):
    report("fit_ms", 12.345, "(bar: at most 4)", form=".2f", width=24)
    assert capsys.readouterr().out == f"  fit_ms{' ' * 18}   12.35   (bar: at most 4)\n"


def test_what_is_reported_meanwhile_is_recorded():
    report("before", 1.0)
    with recording() as outer:
        report("a", np.float32(2.0))
        with recording() as inner:
            report("b", np.bool_(False))
        report("none", np.nan)
    report("after", 1.0)
    assert outer == {"a": 2.0, "b": False, "none": None}
    assert inner == {"b": False}


def test_recording_ends_with_an_error():
    with pytest.raises(ValueError, match="broken"), recording() as metrics_seen:
        raise ValueError("broken")
    report("after", 1.0)
    assert metrics_seen == {}


def test_two_recordings_that_hold_the_same_end_each_for_itself():
    with recording() as outer:
        with recording():
            pass
        report("a", 1.0)
    assert outer == {"a": 1.0}


def test_calls_are_timed_in_turn_and_warmed_up():
    seen = []
    times = in_turn({"x": [lambda: seen.append("x1"), lambda: seen.append("x2")], "y": [lambda: seen.append("y")]}, 2)
    assert seen == ["x1", "x2", "y"] * 3
    assert times["x"].shape == (2, 2)
    assert times["y"].shape == (2, 1)


def test_a_baseline_keeps_what_did_not_run(tmp_path):
    path = tmp_path / "baseline.json"
    save_baseline({"one": {"a": 1.0}, "two": {"b": None}}, path)
    save_baseline({"two": {"c": True}, "none": {}}, path)
    found = read_baseline(path)
    assert {name: part["metrics"] for name, part in found.items()} == {"one": {"a": 1.0}, "two": {"c": True}}
    assert found["one"]["machine"]["cores"] >= 1


def test_a_baseline_names_no_folder_and_no_host(tmp_path):
    import platform

    path = tmp_path / "baseline.json"
    save_baseline({"one": {"a": 1.0}}, path)
    assert platform.node() not in path.read_text()
    assert "/" not in path.read_text().replace("/Intel", "")


@pytest.mark.parametrize("text", ["{", "[]", '{"one": 3}', '{"one": {"metrics": {}}}'])
def test_a_broken_baseline_is_named_with_the_remedy(tmp_path, text):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with pytest.raises(BaselineError, match=r"baseline\.json is not .*; restore it, or delete it"):
        read_baseline(path)


@pytest.mark.parametrize(
    ("before", "now", "moved"),
    [
        (4.0, 5.0, False),
        (4.0, 5.01, True),
        (5.0, 4.0, False),
        (5.01, 4.0, True),
        (0.0, 0.0, False),
        (0.0, 0.1, True),
        (1.0, -1.0, True),
        (True, True, False),
        (True, False, True),
        (None, None, False),
        (None, 1.0, True),
        (1.0, None, True),
    ],
)
def test_more_than_a_quarter_either_way_has_moved(before, now, moved):
    assert has_moved(before, now) is moved


def test_the_table_says_what_moved_what_is_new_and_what_is_gone(tmp_path):
    path = tmp_path / "baseline.json"
    save_baseline({"one": {"still": 4.0, "slower": 4.0, "gone": 1.0}, "other": {"untouched": 1.0}}, path)
    lines = compare({"one": {"still": 4.1, "slower": 8.0, "new": 1.0}}, path)
    table = {line.split()[0]: line.split()[1:] for line in lines}
    assert table["still"] == ["4", "4.1", "1.02"]
    assert table["slower"] == ["4", "8", "2.00", "moved"]
    assert "not measured now" in next(line for line in lines if line.startswith("gone"))
    assert "not in the baseline" in next(line for line in lines if line.startswith("new"))
    assert "untouched" not in table
    assert lines[-1] == "moved by more than a quarter: slower"


def test_a_baseline_of_another_machine_is_said(tmp_path):
    path = tmp_path / "baseline.json"
    save_baseline({"one": {"a": 1.0}}, path)
    found = json.loads(path.read_text())
    found["one"]["machine"]["processor"] = "Babbage 1"
    path.write_text(json.dumps(found))
    assert any("another machine" in line and "Babbage 1" in line for line in compare({"one": {"a": 1.0}}, path))


def test_the_command_saves_and_compares(baseline, capsys):
    assert command.main(["one", "silent", "--save"]) == 0
    assert read_baseline(baseline)["one"]["metrics"] == {"speed": 2.0, "same": True}
    assert "silent" not in read_baseline(baseline)
    capsys.readouterr()
    assert command.main(["--compare"]) == 0
    out = capsys.readouterr().out
    assert "speed 2.000 of all" in out
    assert out.endswith("moved by more than a quarter: none\n")


def test_the_command_compares_what_has_moved_and_still_succeeds(baseline, capsys):
    save_baseline({"one": {"speed": 1.0, "same": True}}, baseline)
    assert command.main(["one", "--compare"]) == 0
    assert capsys.readouterr().out.endswith("moved by more than a quarter: speed\n")


def test_the_command_runs_without_a_baseline(baseline, capsys):
    assert command.main([]) == 0
    assert not baseline.exists()


def test_the_command_refuses_a_broken_baseline_before_it_runs(baseline, capsys):
    baseline.write_text("{")
    assert command.main(["one", "--save"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "restore it, or delete it" in err


def test_the_command_names_the_benchmarks_there_are(baseline, capsys):
    assert command.main(["three"]) == 2
    assert "no benchmark three; there are one, silent" in capsys.readouterr().err


def test_the_committed_baseline_can_be_read():
    for name, part in read_baseline(metrics.BASELINE).items():
        assert name in command.BENCHMARKS
        assert part["metrics"]
