"""The pure parts of the Live tab, by Node, on rows as the server writes them."""

import numpy as np
from by_node import run_by_node

from liaam.fitting import FitStatus
from liaam.tracking import TrackedFrame, TrackStatus
from liaam.tracking.files import TrackRows

TURNED = np.array([[-1.125, 0.75], [1.125, -0.75]])
"""A mean shape: the points before a quarter turn clockwise, about their centre."""


def test_pure_parts_of_the_page_by_node(tmp_path):
    points, spread = (
        np.array([[1.5, 2.0], [3.0, 4.25]]),
        np.array([[[0.5, 0.1], [0.1, 0.25]], [[2.0, 0.0], [0.0, 1.0]]]),
    )
    seen, gone = (points, points, spread, spread, TURNED), (points * np.nan, points * np.nan, spread, spread, TURNED)
    found = TrackedFrame(7, 0.25, TrackStatus.FOUND, FitStatus.CONVERGED, 0.875, np.nan, *seen)
    lost = TrackedFrame(8, 0.5, TrackStatus.LOST, None, np.nan, np.nan, *gone)
    rows = TrackRows(2)
    path = tmp_path / "rows.csv"
    path.write_text(rows.header + rows.of(found) + rows.of(lost))
    run_by_node("live.test.mjs", tmp_path, {"LIAAM_ROWS": str(path)})
