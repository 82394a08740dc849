"""Make the lamps for faces: ``python -m making.face_lamps``, from the checkout's root. Takes a minute.

Lamps from the front to the far side, of daylight to tungsten, are learnt from generated heads. A small model of other
generated heads under these lamps finds where a face lies among the landmarks of training images.
"""

from dataclasses import replace

import cv2
import numpy as np
from safetensors.numpy import save

from liaam.datasets import Sample
from liaam.io import Landmarks, write_bytes_atomically
from liaam.model import MESH, SURROUNDINGS
from liaam.training import learn_lamps, train
from liaam.training.faces import FOLDER, LAMPS, MODEL, N_LAMPS
from scenes import DIFFUSE, Head, Lights, lateral, random_expression, random_pose, render

N_HEADS, N_FITTED = 6, 30
"""Heads under lamps, and other heads for the model."""

SIDE = 48
"""Resolution at which the fields are stored; they are smooth."""

AZIMUTHS = (0.35, 0.7, 1.0, 1.25, 1.5)
"""Angles of the lamps from the camera's axis, radians, on either side."""


def main() -> None:
    """Write both files."""
    FOLDER.mkdir(exist_ok=True)
    rng = np.random.default_rng(0)
    lamps = learn_lamps([sample for i in range(1, N_HEADS + 1) for sample in under_lamps(i, rng)], "00")
    fields = [
        cv2.resize(field.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA) for field in lamps.fields
    ]
    write_bytes_atomically(LAMPS, save({"mean": lamps.mean, "fields": np.array(fields, np.float16)}))
    model = train(
        [head(100 + i) for i in range(N_FITTED)],
        lamps=lamps,
        diagonal=60,
        blurs={MESH: (2.0,), SURROUNDINGS: (2.0, 0.8)},
        appearance_variance={MESH: 1, SURROUNDINGS: 15},
        name="generated heads",
    )
    replace(model, light=None).save(MODEL)


def under_lamps(i: int, rng: np.random.Generator) -> list[Sample]:
    """Render a head under soft light, and under one lamp after the other."""
    lights = [DIFFUSE, *(lamp(AZIMUTHS[k % len(AZIMUTHS)], k % 2 == 0, rng) for k in range(N_LAMPS))]
    return [head(i, light, f"{i:03d}-{k:02d}", 320) for k, light in enumerate(lights)]


def lamp(azimuth: float, left: bool, rng: np.random.Generator) -> Lights:
    """Return a hard lamp of a random height and colour, and weak light from everywhere."""
    return lateral(
        "left" if left else "right",
        temperature_K=rng.uniform(2800, 7000),
        azimuth=azimuth,
        elevation=rng.uniform(-0.1, 0.8),
        ambient_temperature_K=rng.uniform(5000, 9000),
        ambient_strength=rng.uniform(0.05, 0.25),
    )


def head(i: int, lights: Lights = DIFFUSE, name: str | None = None, size: int = 200) -> Sample:
    """Render head i, in its own pose and expression."""
    rng = np.random.default_rng(i)
    scene = render(Head(i), random_pose(rng, (size, size)), random_expression(rng), lights, size=(size, size))
    return Sample(name or f"head {i}", scene.image, Landmarks(scene.landmarks))


if __name__ == "__main__":
    main()
