"""Make the generated heads that come with liaam: ``python -m making.generated_heads``, from the root.

Heads under soft light, with landmarks, train the model. The same heads under hard light, with other poses and
expressions, are shown. Their pose and light were chosen among eight per head: with a model of 18 pictures, the search
misses about one face in four under hard light.
"""

import json
from pathlib import Path

import cv2
import numpy as np

from liaam.datasets.heads import HARD_LIGHT, SOFT_LIGHT, load_heads
from liaam.fitting import Fitter
from liaam.io import Contour, Landmarks, write_landmarks
from liaam.training import train
from scenes import (
    DIFFUSE,
    Ambient,
    Expression,
    Head,
    Lights,
    PointLight,
    Pose,
    Scene,
    lateral,
    make_set,
    render,
)

HEADS = (Head(0), Head(2), Head(11), Head(8, skin=0.8), Head(16), Head(5))
EACH = 3
"""Training pictures of each head."""

QUALITY = 90


def lamp(x: float, y: float, z: float, kelvin: float, strength: float = 1.2) -> PointLight:
    """Return a hard lamp."""
    return PointLight((x, y, z), kelvin, strength)


SHOWN: tuple[tuple[Pose, Expression, Lights], ...] = (
    (
        Pose(-0.036, -0.011, -0.030),
        Expression(smile=0.09, brow_raise=-0.13),
        (lamp(0.85, 0.4, 0.4, 3200), Ambient(9000, 0.08)),
    ),
    (
        Pose(-0.012, -0.013, -0.031),
        Expression(smile=0.53, brow_raise=0.39),
        (lamp(-0.9, 0.25, 0.45, 2600, 0.9), lamp(0.9, 0.15, 0.4, 12000, 0.8), Ambient(7000, 0.06)),
    ),
    (Pose(0.011, -0.016, -0.012), Expression(smile=0.3, brow_raise=0.16), lateral("left")),
    (
        Pose(-0.08, 0.0, -0.02),
        Expression(smile=0.6),
        (lamp(0.6, 0.6, 0.5, 6500), Ambient(6500, 0.1)),
    ),
    (Pose(-0.025, 0.016, -0.007), Expression(smile=0.2, brow_raise=0.24), lateral("right")),
    (
        Pose(-0.05, 0.03, 0.02),
        Expression(smile=0.4),
        (lamp(-0.35, 0.95, 0.55, 4200), Ambient(9000, 0.08)),
    ),
)
"""One picture of each head."""


def main() -> None:
    """Write the pictures, and report how well the model fits those that are shown."""
    for folder in (SOFT_LIGHT, HARD_LIGHT):
        folder.mkdir(parents=True, exist_ok=True)
    for i, head in enumerate(HEADS):
        for j in range(EACH):
            (scene,) = make_set(1, head, DIFFUSE, seed=10 * i + j, size=(320, 240))
            write(scene, SOFT_LIGHT / f"head-{i + 1}-{j + 1}")
    tests = [
        render(head, *shown, size=(640, 480), seed=900 + i)
        for i, (head, shown) in enumerate(zip(HEADS, SHOWN, strict=True))
    ]
    for i, scene in enumerate(tests):
        write(scene, HARD_LIGHT / f"head-{i + 1}")
    fitter = Fitter(train(load_heads()[0], lamps=None, methods="all", name="generated heads"))
    for i, scene in enumerate(tests):
        result = fitter.fit(scene.image)
        error = np.linalg.norm(result.landmarks - scene.landmarks, axis=1).mean()
        print(f"head-{i + 1}: {result.status}, quality {result.quality:.2f}, error {error:.2f} px")


def write(scene: Scene, name: Path) -> None:
    """Write an image and its landmarks, both small."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    name.with_suffix(".jpg").write_bytes(cv2.imencode(".jpg", scene.image[..., ::-1], quality)[1].tobytes())
    written = name.with_suffix(".ljson")
    write_landmarks(written, Landmarks(np.round(scene.landmarks, 2), Contour.all_of(scene.contours)))
    written.write_text(json.dumps(json.loads(written.read_text()), separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
