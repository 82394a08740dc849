"""The pure parts of the Fit and Compare tabs, by Node; and that invariant images and colours of fits are liaam's."""

import json
from pathlib import Path

import numpy as np
import pytest
from by_node import run_by_node

from liaam.drawing import DOUBTFUL, LANDMARK, LOST
from liaam.fitting import FitStatus
from liaam.photometry import CameraModel, invariant_image
from liaam.studio.pictures import chroma_bytes

KINDS = {LANDMARK: "good", DOUBTFUL: "warn", LOST: "bad"}
ANGLES = (0.0, 90.0, 118.0, 171.5)


@pytest.fixture
def invariants(rng, tmp_path) -> Path:
    """Give a folder with the chroma of a picture, as the server sends it, its invariant images, and kinds of status."""
    folder = tmp_path / "invariants"
    folder.mkdir()
    image = rng.integers(20, 235, (24, 40, 3)).astype(np.uint8)
    image[:4, :6], image[10:14, 20:30, 0] = 0, 255  # dark, and saturated
    (folder / "chroma.bin").write_bytes(chroma_bytes(image, 40))
    expected = []
    for angle in ANGLES:
        theta = float(np.deg2rad(angle))
        values = invariant_image(image, CameraModel(theta=theta)).ravel()
        expected.append({"theta": theta, "values": [float(v) if np.isfinite(v) else None for v in values]})
    (folder / "expected.json").write_text(json.dumps(expected))
    kinds = {str(status): {"kind": KINDS[status.colour], "ok": status.ok} for status in FitStatus}
    (folder / "kinds.json").write_text(json.dumps(kinds))
    return folder


def test_pure_parts_of_the_page_by_node(invariants, tmp_path):
    run_by_node("fit.test.mjs", tmp_path, {"LIAAM_INVARIANT": str(invariants)})
