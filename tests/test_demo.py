"""The demo shows what it says: classical methods drift under hard light, the default method does not."""

from liaam.demo import run_demo


def test_the_default_holds_where_grey_and_rgb_drift(tmp_path):
    told = []
    rows, start_errors = run_demo(tmp_path / "new", lambda done, total, what: told.append((done, total)))
    errors = {row.method: row.errors.mean() for row in rows}
    assert errors["soft-li"] < 0.2 * start_errors.mean()
    assert errors["soft-li"] < 0.5 * errors["li"] < errors["li"] < 0.5 * min(errors["grey"], errors["rgb"])
    assert (tmp_path / "new" / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert told[-1][0] == told[-1][1]
