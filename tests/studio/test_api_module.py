"""How the page asks the server again, by Node."""

from by_node import run_by_node


def test_requests_to_a_busy_server(tmp_path):
    run_by_node("api.test.mjs", tmp_path)
