"""Make the face of the studio's first screen: ``python -m making.first_screen 45cm.jpg``, for minutes.

The photograph is ``zoom/45cm.jpg`` of webmorphR.stim (CC0). Its shading is removed. A generated head under one lamp
after the other, which casts shadows, is warped to it, and the light of all lamps is reduced to a few layers. The page
adds these up for the direction of its lamp, and multiplies the photograph with the sum.
"""

import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import RBFInterpolator

import liaam.studio
from liaam.fitting import Fitter
from liaam.io import read_image, write_bytes_atomically, write_text_atomically
from liaam.model import load_model
from liaam.models import FACE
from liaam.relighting import Relighter
from liaam.relighting.extrapolation import averaged
from scenes import Ambient, Expression, Head, PointLight, Pose, render
from scenes.render import landmarks_of

HEADS_MODEL = Path(__file__).parents[1] / "tests/training/heads-of-schema-4.liaam"
"""A model of generated heads, whose landmarks a photograph gets."""

FOLDER = Path(liaam.studio.__file__).parent / "static" / "first"

HEAD, POSE, RENDERED = Head(40), Pose(scale=0.62), (600, 450)
"""The generated head whose landmarks are nearest to those of the photograph."""

CORNER, SIDE = (110, 215), 740
"""The square of the photograph that is shown, pixels."""

SHOWN, OF_LIGHT, N_LAYERS = 640, 256, 12
"""Side of the face and of the layers of light, pixels, and number of layers."""

# Where the top of the head, sides, ears, neck and shoulders lie, in the photograph and in a rendering (1200 x 900).
PHOTOGRAPHED = [
    *((480, 275), (390, 300), (570, 300), (322, 430), (642, 430), (330, 600), (648, 590)),
    *((372, 790), (590, 790), (335, 880), (640, 880), (100, 940), (840, 950), (480, 960)),
]
GENERATED = [
    *((450, 100), (280, 160), (620, 160), (152, 400), (748, 400), (140, 620), (760, 620)),
    *((308, 975), (592, 975), (290, 1070), (610, 1070), (0, 1190), (900, 1190), (450, 1150)),
]

OUTLINE = [
    *((480, 272), (410, 285), (350, 335), (320, 400), (314, 500), (318, 560), (328, 640), (350, 740), (368, 790)),
    *((360, 840), (310, 870), (200, 905), (100, 940), (60, 1000), (900, 1000), (850, 950), (720, 905), (655, 878)),
    *((610, 840), (592, 790), (612, 740), (638, 640), (652, 560), (650, 500), (646, 400), (615, 335), (550, 285)),
]
"""Outline of the person in the photograph; beyond it is a wall."""

CHIN = 815
"""Row of the photograph below which the head's collar, which the person does not wear, is blurred away."""

RINGS = ((0.0, 1), (0.3, 6), (0.55, 10), (0.78, 14), (0.93, 18))
"""Distances of the lamps from the camera's axis over a ball of radius 1, and their number."""

AMBIENT, FROM_FRONT = 0.45, 0.6
"""Strengths of the light under which the photograph is shown without its shading."""

LEAST, MOST = 0.4, 1.35
"""Least light to divide by, and most light relative to it."""


def main(path: str) -> None:
    """Write the face, the layers of light, and their coefficients for each lamp."""
    flat, shape = without_shading(Path(path))
    lamps = np.array([(r * np.cos(a), r * np.sin(a)) for r, n in RINGS for a in 2 * np.pi * (np.arange(n) + r / 2) / n])
    light = near_edges(light_on(shape, lamps), part_of(flat, OF_LIGHT), lamps)
    ambient, by_lamp = light[..., :1], light[..., 1:].reshape(-1, len(lamps))
    layers, sizes, coefficients = np.linalg.svd(by_lamp, full_matrices=False)
    layers = (layers * sizes)[:, : N_LAYERS - 1].reshape(OF_LIGHT, OF_LIGHT, -1)
    layers = np.concatenate([ambient, layers], axis=2)
    low, high = layers.min(axis=(0, 1)), layers.max(axis=(0, 1))
    whole = np.rint(255 * (layers - low) / (high - low)).astype(np.uint8)
    FOLDER.mkdir(exist_ok=True)
    write(FOLDER / "face.jpg", part_of(flat, SHOWN)[..., ::-1], 70)
    write(FOLDER / "light.jpg", np.vstack(list(np.moveaxis(whole, 2, 0))), 82)
    facts = {
        "low": low.round(4).tolist(),
        "high": high.round(4).tolist(),
        "lamps": lamps.round(3).tolist(),
        "coefficients": coefficients[: N_LAYERS - 1].T.round(4).tolist(),
    }
    write_text_atomically(FOLDER / "light.json", json.dumps(facts))


def without_shading(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph without its shading, and the landmarks of a generated head in it."""
    image = read_image(path)
    fitter = Fitter(load_model(FACE))
    fit = fitter.fit(image)
    box = (*fit.landmarks.min(axis=0), *fit.landmarks.max(axis=0))
    head = Fitter(load_model(HEADS_MODEL), restarts=False).fit(image, box)
    return Relighter.of(fitter, image, fit).flat(), head.landmarks


def part_of(image: np.ndarray, side: int) -> np.ndarray:
    """Return the part that is shown at a size."""
    (x, y), s = CORNER, SIDE
    return cv2.resize(image[y : y + s, x : x + s], (side, side), interpolation=cv2.INTER_AREA)


def light_on(shape: np.ndarray, lamps: np.ndarray) -> np.ndarray:
    """Return ambient light, and that of each lamp, relative to the light that the photograph is shown under."""
    middle = 0.5 * (np.array(RENDERED[::-1]) - 1) * (1.0, 0.94)
    generated = (np.array(GENERATED) - (449.5, 563.5)) * (POSE.scale * RENDERED[0] / 1200) + middle
    head = landmarks_of(HEAD, POSE, Expression(), RENDERED)
    points = np.vstack([shape, PHOTOGRAPHED]), np.vstack([head, generated])
    warp = RBFInterpolator(*points, kernel="thin_plate_spline", smoothing=50.0)
    pixels = np.indices((OF_LIGHT, OF_LIGHT))[::-1].reshape(2, -1).T
    at = warp((pixels + 0.5) * SIDE / OF_LIGHT - 0.5 + CORNER).reshape(OF_LIGHT, OF_LIGHT, 2).astype(np.float32)

    def field(*lights: Ambient | PointLight) -> np.ndarray:
        shading = render(HEAD, POSE, Expression(), lights, size=RENDERED).shading
        return cv2.remap(shading, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    front = field(Ambient(strength=AMBIENT), PointLight((0, 0.3, 1), strength=FROM_FRONT, softness=0.5))
    fields = [field(PointLight((x, -y, math.sqrt(1 - x * x - y * y)), softness=0.12)) for x, y in lamps]
    return np.stack([field(Ambient()), *fields], axis=2) / np.maximum(front, LEAST)[..., None]


def near_edges(light: np.ndarray, photograph: np.ndarray, lamps: np.ndarray) -> np.ndarray:
    """Fit light (h, w, c) to the edges of the photograph: its person and the wall behind, without a collar."""
    scale = OF_LIGHT / SIDE
    chin = (CHIN - CORNER[1]) * scale
    below = np.clip((np.arange(OF_LIGHT) - chin) * 320 / OF_LIGHT / 30 - 0.27, 0.0, 1.0)[:, None, None]
    soft = np.dstack([cv2.GaussianBlur(each, (0, 0), 28 * scale * SIDE / 1000) for each in np.moveaxis(light, 2, 0)])
    light = light + (soft - light) * below * below * (3 - 2 * below)
    light = np.where(light > 1, 1 + (MOST - 1) * np.tanh((light - 1) / (MOST - 1)), light)
    log = np.log(np.maximum((photograph / 255.0) ** 2.2, 0.02) + 0.03).astype(np.float32)
    seen = cv2.GaussianBlur(log, (0, 0), 1.0)
    person = np.zeros((OF_LIGHT, OF_LIGHT), np.uint8)
    cv2.fillPoly(person, [np.rint((np.array(OUTLINE) - CORNER) * scale).astype(np.int32)], 1)
    belongs = np.clip(2 * averaged(person[..., None].astype(np.float32), seen, 3.2) - 0.5, 0.0, 1.0)
    wall = np.array([1.0, *np.sqrt(1 - np.square(lamps).sum(axis=1))]) / (AMBIENT + FROM_FRONT / math.hypot(1, 0.3))
    return wall + (averaged(light.astype(np.float32), seen, 1.6) - wall) * belongs


def write(path: Path, image: np.ndarray, quality: int) -> None:
    """Write a JPEG."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    print(path.name, len(data), "bytes")
    write_bytes_atomically(path, data)


if __name__ == "__main__":
    main(sys.argv[1])
