"""The parts of the Annotate tab that need no page, by Node."""

import pytest
from by_node import run_by_node


@pytest.mark.parametrize("file", ["annotate.test.mjs", "curve.test.mjs", "editing.test.mjs", "strip.test.mjs"])
def test_pure_parts_of_the_annotate_tab_by_node(file, tmp_path):
    run_by_node(file, tmp_path)


@pytest.mark.parametrize("seed", ["1", "2"])
def test_random_steps_agree_with_a_plain_model_by_node(seed, tmp_path):
    run_by_node("sequences.test.mjs", tmp_path, {"LIAAM_STEPS": "500", "LIAAM_SEED": seed})


@pytest.mark.slow
def test_twenty_thousand_random_steps_agree_with_a_plain_model_by_node(tmp_path):
    run_by_node("sequences.test.mjs", tmp_path, {"LIAAM_STEPS": "20000", "LIAAM_SEED": "3"})
