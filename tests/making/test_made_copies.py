"""What the face model is made from: mirror images, and parts that are small enough."""

import numpy as np
import pytest

import liaam
from making.face.build import other_side, with_modes


def test_the_names_tell_the_other_side():
    names = list(liaam.load_model("face").landmark_names)
    order = other_side(names)
    assert np.array_equal(order[order], np.arange(len(names)))
    assert names[order[names.index("mouth_left")]] == "mouth_right" and order[names.index("chin")] == names.index(
        "chin"
    )


def test_what_weak_modes_explain_becomes_unexplained():
    part = liaam.load_model("face").others[0]
    fewer = with_modes(part, [3, 3, 3])
    # At the sharpest level: others hold only some of the pixels.
    before, after = (each.views["surroundings"].levels[-1].appearances["soft"] for each in (part, fewer))
    total = [each.eigenvalues.sum() + np.trace(each.unexplained, 0, 1, 2).sum() for each in (before, after)]
    assert after.n_modes == 3 < before.n_modes
    assert total[0] == pytest.approx(total[1], rel=0.01)
