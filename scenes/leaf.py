"""Generated leaves with seven landmarks, for the examples and guides on specimens."""

import cv2
import numpy as np

SIZE = (240, 180)
"""Height and width of the images, pixels."""

AXIS = np.linspace(0, 1, 60)


def draw_leaf(rng: np.random.Generator, width: float = 62.0) -> tuple[np.ndarray, np.ndarray]:
    """Draw a leaf of random length, width and bend, the mean width given in pixels.

    Returns
    -------
    image : (240, 180, 3) uint8
    landmarks : (7, 2) float64
        Base and tip, the point where the first pair of veins meets the midrib, and the ends of two pairs of veins.
    """
    length, width, bend = rng.normal((170, width, 0), (12, 6, 10))

    def at(t: float | np.ndarray, side: float) -> np.ndarray:
        """Return the point at a fraction of the midrib, and of the width to the side."""
        half = 0.5 * width * np.sin(np.pi * np.asarray(t) ** 0.8) * side
        sway = bend * np.sin(np.pi * np.asarray(t))
        x = 90 + sway + half
        y = 120 + length * (0.5 - np.asarray(t))
        return np.stack([x, y], axis=-1)

    def line(image: np.ndarray, points: np.ndarray | list, colour: tuple[int, int, int], thickness: int = 1) -> None:
        fixed = np.round(np.asarray(points) * 16).astype(np.int32)
        cv2.polylines(image, [fixed], False, colour, thickness, cv2.LINE_AA, 4)

    image = np.full((*SIZE, 3), (226, 222, 210), np.uint8)
    outline = np.concatenate([at(AXIS, 1), at(AXIS[::-1], -1)])
    green = tuple(int(v) for v in rng.normal((78, 124, 54), 6))
    cv2.fillPoly(image, [np.round(outline * 16).astype(np.int32)], green, cv2.LINE_AA, 4)
    line(image, at(AXIS, 0), (168, 190, 120), 2)
    for start, end in ((0.25, 0.4), (0.5, 0.65)):
        for side in (-1, 1):
            line(image, [at(start, 0), at(end, 0.95 * side)], (150, 176, 104))
    landmarks = [*(at(0, 0), at(1, 0), at(0.25, 0)), *(at(end, 0.95 * side) for end in (0.4, 0.65) for side in (-1, 1))]
    noise = rng.normal(0, 3, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), np.array(landmarks)
