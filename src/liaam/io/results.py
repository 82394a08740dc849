"""Write fit results: landmarks as .pts, .csv and .tps, and all values as .json."""

import json
import math
from pathlib import Path

import numpy as np

from liaam.io.atomic import write_text_atomically
from liaam.io.landmarks import Landmarks, write_landmarks

FIT_SUFFIXES = (".pts", ".csv", ".tps", ".json")
"""Suffixes of the files of a fit."""


def write_fit(folder: Path, stem: str, landmarks: Landmarks, facts: dict, image_size: tuple[int, int]) -> list[Path]:
    """Write the landmarks and values of a fit.

    Parameters
    ----------
    folder : Path
        An existing folder.
    stem : str
        File name without suffix.
    landmarks : Landmarks
        In pixels, with (0, 0) at the centre of the top-left pixel.
    facts : dict
        Further entries of the .json file. Numbers that are not finite become null.
    image_size : (int, int)
        Width and height of the image.

    Returns
    -------
    list of Path
        ``stem.pts`` (counts from 1), ``stem.csv``, ``stem.tps`` (y upwards) and ``stem.json`` (counts from 0).
    """
    paths = [folder / f"{stem}{suffix}" for suffix in FIT_SUFFIXES]
    for path in paths[:-1]:
        write_landmarks(path, landmarks, image_size)
    write_text_atomically(paths[-1], fit_text(landmarks, facts))
    return paths


def fit_text(landmarks: Landmarks, facts: dict) -> str:
    """Return the text of a fit's .json file; see :func:`write_fit`."""
    content = {**facts, "landmarks": landmarks.points}
    return json.dumps(_plain(content), indent=1, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    """Convert arrays and numbers to JSON types."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
