"""The parts of the Annotate tab that need no page, by Node."""

import pytest
from by_node import run_by_node


@pytest.mark.parametrize("file", ["annotate.test.mjs", "curve.test.mjs", "editing.test.mjs", "strip.test.mjs"])
def test_pure_parts_of_the_annotate_tab_by_node(file, tmp_path):
    run_by_node(file, tmp_path)
