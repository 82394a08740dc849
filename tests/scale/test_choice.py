"""Which length of a pixel an image that is fitted has."""

from pathlib import Path

import numpy as np
from PIL import Image, TiffImagePlugin

from liaam.io import Landmarks
from liaam.scale.choice import TRAINING, facts_of, length_for, shared_length
from liaam.scale.lengths import Length

POINTS = np.zeros((1, 2))
TRAINED = Length(0.1, "mm", source=TRAINING)


def test_the_start_goes_before_the_tags_and_these_before_the_training_images(tmp_path: Path) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[270] = "ImageJ=1.53t\nunit=mm\n"
    tags[282] = tags[283] = 20.0
    path = tmp_path / "a.tif"
    Image.fromarray(np.zeros((40, 30, 3), np.uint8)).save(path, tiffinfo=tags)
    start = Landmarks(POINTS, scale=3.0, unit="um")
    assert length_for(path, start, TRAINED) == Length(3, "um")
    assert length_for(path, Landmarks(POINTS), TRAINED) == Length(0.05, "mm", source="ImageJ's calibration")
    assert length_for(tmp_path / "a.png", None, TRAINED) == TRAINED
    assert length_for(tmp_path / "a.png", "1,2,3,4", None) is None


def test_training_images_share_a_length_only_if_all_have_the_same() -> None:
    same = [Length(0.1), Length(0.10001), Length(0.1)]
    assert shared_length(same) == Length(0.1, source=TRAINING)
    assert shared_length([*same, Length(0.11)]) is None
    assert shared_length([*same, Length(0.1, "mm")]) is None
    assert shared_length([*same, None]) is None
    assert shared_length([]) is None


def test_facts_hold_what_is_known() -> None:
    assert facts_of(None) == {"scale": None}
    assert facts_of(Length(0.1)) == {"scale": 0.1}
    assert facts_of(TRAINED) == {"scale": 0.1, "scale_unit": "mm", "scale_from": TRAINING}
