"""Leave-one-out without a change of light, on generated persons."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow


def test_every_diffuse_picture_is_left_out_in_turn(done):
    summary, rows, _ = done("unchanged")
    assert len({row["picture"] for row in rows}) == 15
    for method, cells in summary["methods"].items():
        errors = [float(row["nme"]) for row in rows if row["method"] == method]
        assert cells["all"]["nme_median"] == pytest.approx(np.median(errors), abs=1e-6)
