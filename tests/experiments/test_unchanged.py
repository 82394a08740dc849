"""Leave-one-out without a change of light, on generated persons."""

import pytest

from experiments import unchanged

pytestmark = pytest.mark.slow


def test_unchanged_compares_with_the_best_plain_method(done):
    summary, rows, _ = done("unchanged")
    assert len({row["picture"] for row in rows}) == 15
    assert summary["reference"] == "rgb"
    assert summary["methods"]["rgb"]["to_reference"] == 1.0
    medians = [summary["methods"][method]["nme_median"] for method in ("li", "rgb")]
    assert summary["methods"]["li"]["to_reference"] == pytest.approx(medians[0] / medians[1])
    alone = unchanged.summarise(["li"], [row | {"nme": 0.1, "bound": 0.05, "seconds": 1.0} for row in rows[1:2]])
    assert alone["reference"] is None
    assert alone["methods"]["li"]["to_reference"] is None
