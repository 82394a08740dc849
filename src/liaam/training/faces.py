"""Lamps for faces: a bank learnt from rendered heads, for training images whose objects turn out to be faces.

The face model that comes with liaam is fitted to some of the training images. If the fits agree on where a face lies
among the landmarks, whatever these are, the bank is carried there. ``making/face_lamps.py`` makes the bank.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from liaam.fitting import Fitter
from liaam.model import load_model
from liaam.model.light_basis import SIDE
from liaam.model.shape import align
from liaam.models import FACE, model_file
from liaam.photometry import CameraModel
from liaam.training.entries import Entry
from liaam.training.lamps import LearntLamps
from liaam.training.lamps.bank import carried
from liaam.training.lamps.learning import unit_shape
from liaam.training.reliability import OPTIONS

LAMPS = Path(__file__).with_name("faces") / "lamps.safetensors"

N_LAMPS = 10  # Number of lamps of each head, in this order in the file
MOST = 16  # Number of images that are fitted
# Largest distance of fits from their median, as a fraction of the object's diagonal, and smallest quality, medians over
# the images. Faces of five sets have 0.011 to 0.023, and 0.99 to 1; generated heads 0.012 to 0.019, and 0.94 to 0.98.
# Fly wings, cephalograms, shells and blots of colour have 0.011 to 0.051, and 0.01 to 0.16.
AGREEMENT = 0.04
LEAST_QUALITY = 0.5
LEVELS = 255  # Largest stored value of a field; its steps, about 0.015, are finer than the noise of photographs
# The fields are stored as one JPEG picture, of which they are tiles, one head a row. Its errors are 0.01 on average.
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


def face_lamps(entries: Sequence[Entry], mean: np.ndarray, camera: CameraModel) -> LearntLamps | None:
    """Return lamps for training images of faces with a mean shape (n, 2); None if the objects are no faces."""
    front = load_model(model_file(FACE)).parts[0]
    fitter = Fitter(front, options=OPTIONS, camera=camera, restarts=False)
    mean = unit_shape(mean)
    shapes = []
    qualities = []
    tried = np.unique(np.linspace(0, len(entries) - 1, MOST).astype(int))
    for i in tried:
        points = entries[i].points
        box = np.concatenate([points.min(axis=0), points.max(axis=0)])
        fit = fitter.fit(entries[i].read_image(), box, entries[i].name)
        shapes.append(align(points, mean)(fit.landmarks))
        qualities.append(fit.quality)
        n_low = sum(not quality >= LEAST_QUALITY for quality in qualities)  # also those that have none
        if n_low > len(tried) / 2:
            return None  # whatever the others have, the median is less
    middle = np.median(shapes, axis=0)
    apart = np.linalg.norm(shapes - middle, axis=2).mean(axis=1)
    if not (np.median(apart) <= AGREEMENT and np.median(qualities) >= LEAST_QUALITY):
        return None
    return carried_lamps(mean, middle)


def carried_lamps(mean: np.ndarray, face: np.ndarray) -> LearntLamps:
    """Return the lamps for a mean shape (n, 2), where the landmarks of the face model lie at ``face`` (90, 2)."""
    from safetensors.numpy import load_file

    bank = load_file(LAMPS)
    fields = carried(bank["mean"], stored_fields(bank), face)
    names = tuple(f"head{1 + i // N_LAMPS}-{1 + i:03d}" for i in range(len(fields)))  # no two heads share a lamp
    return LearntLamps(mean, fields, names)


def bank_tensors(mean: np.ndarray, fields: np.ndarray) -> dict[str, np.ndarray]:
    """Return what a bank's file holds of a mean shape (n, 2) and fields (k, SIDE, SIDE, 3) on it."""
    ends = np.array([fields.min(), fields.max()], np.float32)
    tiles = np.rint(LEVELS * (fields - ends[0]) / (ends[1] - ends[0])).astype(np.uint8)
    rows = tiles.reshape(-1, N_LAMPS, SIDE, SIDE, 3).swapaxes(1, 2).reshape(-1, N_LAMPS * SIDE, 3)
    _, encoded = cv2.imencode(".jpg", rows[..., ::-1], JPEG)
    return {"mean": mean, "fields": encoded, "ends": ends}


def stored_fields(bank: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the fields (k, SIDE, SIDE, 3) float32 of a bank's file."""
    rows = cv2.imdecode(bank["fields"], cv2.IMREAD_COLOR)
    assert rows is not None  # the file comes with liaam
    tiles = rows[..., ::-1].reshape(-1, SIDE, N_LAMPS, SIDE, 3).swapaxes(1, 2).reshape(-1, SIDE, SIDE, 3)
    low, high = bank["ends"]
    return low + (high - low) / np.float32(LEVELS) * tiles
