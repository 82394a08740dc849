"""Write fit results: landmarks as .pts and .csv, and all values as .json."""

import json
import math
from pathlib import Path

import numpy as np

from liaam.io.atomic import write_text_atomically
from liaam.io.landmarks import Landmarks, write_landmarks


def write_fit(folder: Path, stem: str, landmarks: Landmarks, facts: dict) -> list[Path]:
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

    Returns
    -------
    list of Path
        ``stem.pts`` (counts from 1), ``stem.csv`` and ``stem.json`` (both count from 0).
    """
    paths = [folder / f"{stem}{suffix}" for suffix in (".pts", ".csv", ".json")]
    write_landmarks(paths[0], landmarks)
    write_landmarks(paths[1], landmarks)
    write_text_atomically(paths[2], fit_text(landmarks, facts))
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
