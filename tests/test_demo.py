"""The demo shows what it says: classical methods drift under lateral light, LI does not."""

import pytest

from liaam.demo import run_demo


@pytest.mark.slow
def test_li_holds_where_grey_and_rgb_drift(tmp_path):
    told = []
    rows, start_error = run_demo(tmp_path / "new", lambda done, total, what: told.append((done, total)))
    errors = {row.method: row.error for row in rows}
    assert errors["li"] < 1.0 < 2.0 < min(errors["grey"], errors["rgb"])
    assert errors["li"] < 0.2 * start_error
    assert (tmp_path / "new" / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert told[-1][0] == told[-1][1]
