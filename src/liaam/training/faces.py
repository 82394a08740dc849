"""Lamps for faces: a bank learnt from generated heads, for training images whose objects turn out to be faces.

A model of the generated heads is fitted to some of the training images. If the fits agree on where a face lies among
the landmarks, whatever these are, the bank is carried there. ``making/face_lamps.py`` makes both files.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from liaam.fitting import Fitter
from liaam.model import load_model
from liaam.model.shape import align
from liaam.photometry import CameraModel
from liaam.training.entries import Entry
from liaam.training.lamps import LearntLamps
from liaam.training.lamps.bank import carried
from liaam.training.lamps.learning import unit_shape
from liaam.training.reliability import OPTIONS

FOLDER = Path(__file__).with_name("faces")
MODEL = FOLDER / "heads.liaam"
LAMPS = FOLDER / "lamps.safetensors"

N_LAMPS = 10  # Number of lamps of each head, in this order in the file
MOST = 16  # Number of images that are fitted
# Largest distance of fits from their median, as a fraction of the object's diagonal, and smallest quality, medians over
# the images. Faces of five sets have 0.007 to 0.025, and 0.35 to 0.6; fly wings have 0.068 and 0.02.
AGREEMENT = 0.04
LEAST_QUALITY = 0.1


def face_lamps(entries: Sequence[Entry], mean: np.ndarray, camera: CameraModel) -> LearntLamps | None:
    """Return lamps for training images of faces with a mean shape (n, 2); None if the objects are no faces."""
    from safetensors.numpy import load_file

    fitter = Fitter(load_model(MODEL), options=OPTIONS, camera=camera, restarts=False)
    mean = unit_shape(mean)
    shapes = []
    qualities = []
    for i in np.unique(np.linspace(0, len(entries) - 1, MOST).astype(int)):
        points = entries[i].points
        box = np.concatenate([points.min(axis=0), points.max(axis=0)])
        fit = fitter.fit(entries[i].read_image(), box, entries[i].name)
        shapes.append(align(points, mean)(fit.landmarks))
        qualities.append(fit.quality)
    middle = np.median(shapes, axis=0)
    apart = np.linalg.norm(shapes - middle, axis=2).mean(axis=1)
    if not (np.median(apart) <= AGREEMENT and np.median(qualities) >= LEAST_QUALITY):
        return None
    bank = load_file(LAMPS)
    names = tuple(f"head{1 + i // N_LAMPS}-{i % N_LAMPS:02d}" for i in range(len(bank["fields"])))
    return LearntLamps(mean, carried(bank["mean"], bank["fields"], middle), names)
