"""The times of the README files are those of one run of ``python -m benchmarks peers``, the saved one."""

import pytest

from benchmarks.metrics import BASELINE, BaselineError, read_baseline
from benchmarks.tables import PLACES, README, ROOT, TABLE, as_precise_as, row, with_times

FASTER = {"peers_a_ms": 2.345, "peers_b_ms": 12.6}


@pytest.fixture(scope="module")
def saved():
    return read_baseline(BASELINE)["peers"]["metrics"]


@pytest.mark.parametrize("place", PLACES, ids=lambda place: "-".join(place.metrics))
def test_times_are_those_of_the_saved_run(place, saved):
    text = (ROOT / place.file).read_text()
    assert place.with_times(text, saved) == text


@pytest.mark.parametrize("file", [README, TABLE])
def test_times_of_another_run_can_be_written_and_written_back(file, saved):
    text = (ROOT / file).read_text()
    slower = {metric: 3.0 * time if metric.endswith("_ms") else time for metric, time in saved.items()}
    other = with_times(file, text, slower)
    assert other != text
    assert with_times(file, other, saved) == text


def test_the_numbers_of_a_row_keep_what_stands_around_them():
    place = row("any", "row", 1, ["a"], ["b", "b / a"])
    table = "| row | 7 | **1.0 ms** | 5; 3.0 |\n| another row | 7 | 1 | 2; 3 |"
    assert place.with_times(table, FASTER) == "| row | 7 | **2.3 ms** | 13; 5.4 |\n| another row | 7 | 1 | 2; 3 |"


def test_a_row_that_is_gone_is_named():
    with pytest.raises(ValueError, match="any has no"):
        row("any", "gone", 0, ["a"]).with_times("| row | 7 |", FASTER)


def test_numbers_keep_their_decimals():
    assert [as_precise_as(shown, 2.345) for shown in ("1", "1.0", "0.00")] == ["2", "2.3", "2.35"]


@pytest.mark.parametrize("metric", ["a", "a / c", "c / a"])
def test_a_time_that_was_not_measured_is_named(metric):
    saved = {"peers_a_ms": None, "peers_c_ms": 1.0}
    for times in (saved, {"peers_c_ms": 1.0}):
        with pytest.raises(BaselineError, match="no peers_a_ms"):
            row("any", "row", 0, [metric]).with_times("| row | 7 |", times)
