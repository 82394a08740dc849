"""Make the lamps for faces: ``python -m making.face_lamps HEADS``, from the checkout's root. Takes a minute.

HEADS is ``ict-face.safetensors``, heads from light-stage scans. Random ones of them, with skin, hair and clothes, are
rendered under lamps that span light: from all directions in front, low and high, near and far, small and large, warm
and cold, alone and in pairs, in dark and bright rooms. The lamps are stored on the landmarks of the face model, whose
mean shape is all that they need of it. On one machine, the file is always the same, byte for byte. Embree follows the
rays (``pip install embreex``); liaam itself does not need it.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from liaam.datasets import Sample
from liaam.io import write_bytes_atomically
from liaam.model import load_model
from liaam.models import FACE, model_file
from liaam.morphometry.schemes import in_scheme
from liaam.training import learn_lamps
from liaam.training.faces import LAMPS, N_LAMPS, bank_tensors
from liaam.training.lamps.bank import carried
from liaam.training.lamps.learning import unit_shape
from making.head.casting import under_lamps
from making.head.geometry import ScannedHeads, load_heads
from making.head.sampled_lights import spread_lights, training_light

N_HEADS = 30
"""Heads, each under N_LAMPS lamps."""

SIZE = 160
"""Width and height of pictures, pixels."""

NOTICE = {"licence": "MIT, Copyright (c) 2020 USC Institute for Creative Technologies; see LICENSE-DATA"}


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("heads", type=Path, help="ict-face.safetensors")
    parser.add_argument("-o", "--output", type=Path, default=LAMPS, help="file to write")
    given = parser.parse_args()
    lamps = learn_lamps(pictures(load_heads(given.heads)), "00")
    mean, places = on_face_model()
    fields = carried(lamps.mean, lamps.fields, places)
    write_bytes_atomically(given.output, save(bank_tensors(mean, fields.astype(np.float32)), NOTICE))


def pictures(heads: ScannedHeads) -> Iterator[Sample]:
    """Yield random heads, each under the light of training images and under lamps of its own."""
    lights = spread_lights(N_HEADS * N_LAMPS)
    for i in range(N_HEADS):
        rng = np.random.default_rng([1, i])
        own = lights[i * N_LAMPS :][:N_LAMPS]
        yield from under_lamps(heads, f"{i:03d}", training_light(rng), own, rng, SIZE)


def on_face_model() -> tuple[np.ndarray, np.ndarray]:
    """Return the mean shape (90, 2) of the face model, and where iBUG's 68 landmarks lie on it, (68, 2)."""
    front = load_model(model_file(FACE)).parts[0]
    own = unit_shape(front.shape_model.mean)
    return own, in_scheme(own, front.landmark_names, "ibug-68")


if __name__ == "__main__":
    main()
