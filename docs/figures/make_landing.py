"""Make the figures of the first page: ``python -m docs.figures.make_landing``.

They show the CC0 photograph that comes with liaam (LICENSE-DATA), fitted and relit by the face model.
"""

import os
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
from PIL import Image

import liaam
from liaam.datasets import load_face
from liaam.fitting import Fitter
from liaam.relighting import Relighter

HERE = Path(__file__).parent

FRAMES, MILLISECONDS = 24, 90
"""Positions of the lamp on its way around the face, and the time that each is shown."""

WIDTH = 384
"""Of the pictures, pixels."""


def main() -> None:
    """Write the pictures beside this script."""
    picture = load_face().read_image()
    fitter = Fitter(liaam.load_model("face"))
    result = fitter.fit(picture)
    relighter = Relighter.of(fitter, picture, result)
    save(HERE / "taken.webp", [picture])
    save(HERE / "relit.webp", [relighter.under(direction, ambient=0.1) for direction in around()])


def around() -> list[tuple[float, float, float]]:
    """Return directions to a lamp that goes around the face once."""
    angles = np.linspace(0, 2 * np.pi, FRAMES, endpoint=False)
    return [(float(np.sin(angle)), float(-0.25 - 0.35 * np.cos(angle)), 0.4) for angle in angles]


def save(path: Path, frames: list[np.ndarray]) -> None:
    """Write an image, or one that moves for ever."""
    height = round(WIDTH * frames[0].shape[0] / frames[0].shape[1])
    small = [Image.fromarray(frame).resize((WIDTH, height), Image.Resampling.LANCZOS) for frame in frames]
    small[0].save(path, save_all=True, append_images=small[1:], duration=MILLISECONDS, loop=0, quality=71, method=6)


if __name__ == "__main__":
    main()
