"""Make the picture of the guide to hard sets: ``python -m docs.figures.make_hard_sets``. Needs no data.

Its objects are generated. For each problem, it shows what goes wrong on the left, and the remedy on the right. The
script also prints the errors, and what training says.
"""

import warnings
from pathlib import Path

import cv2
import numpy as np

import liaam
from liaam.fitting import FitResult, Fitter
from liaam.io import write_image
from liaam.model import AAM
from liaam.model.mesh import delaunay
from liaam.model.shape import diagonal_of
from liaam.plotting.overlays import overlay_of_fit
from scenes.varied import AnimalFromAbove, Fish, JointedBars, Picture

HERE = Path(__file__).parent

SIZE = (400, 320)
N_TRAINING = 40
N_OF_LOT = 5
N_TRIED = 9  # other pictures, of which that with the median error is shown
TEXT = (40, 40, 40)
FOLDED = (230, 60, 60)
STEADY = (40, 170, 90)


def trained(pictures: list[Picture]) -> AAM:
    """Train a model, and print what training says."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = liaam.train(pictures, progress=False)
    for warning in said:
        print("training:", warning.message)
    return model


def fitted(model: AAM, picture: Picture, what: str, rotations: str | None = None) -> np.ndarray:
    """Draw the fit of a model from a box, and print its error."""
    result, error = fit_of(model, picture, rotations)
    print(f"{what}: {result.status}, quality {result.quality_text}, {error:.1%} off")
    return captioned(overlay_of_fit(picture[0], result, model), what)


def fit_of(model: AAM, picture: Picture, rotations: str | None = None) -> tuple[FitResult, float]:
    """Fit a picture from the box of its landmarks; return the fit and its error as a fraction of the diagonal."""
    image, truth = picture
    box = np.concatenate([truth.min(axis=0), truth.max(axis=0)])
    result = Fitter(model, rotations=rotations).fit(image, box)
    return result, float(np.linalg.norm(result.landmarks - truth, axis=1).mean()) / diagonal_of(truth)


def typical(model: AAM, pictures: list[Picture]) -> Picture:
    """Return the picture whose fit has the median error."""
    errors = [fit_of(model, picture)[1] for picture in pictures]
    print("errors:", " ".join(f"{error:.1%}" for error in sorted(errors)))
    return pictures[int(np.argsort(errors)[len(errors) // 2])]


def captioned(image: np.ndarray, text: str) -> np.ndarray:
    """Resize an image, and write a line below it."""
    picture = np.full((SIZE[1] + 36, SIZE[0], 3), 255, np.uint8)
    scale = min(SIZE[0] / image.shape[1], SIZE[1] / image.shape[0])
    resized = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    left = (SIZE[0] - resized.shape[1]) // 2
    picture[: resized.shape[0], left : left + resized.shape[1]] = resized
    cv2.putText(picture, text, (8, SIZE[1] + 24), cv2.FONT_HERSHEY_SIMPLEX, 0.52, TEXT, 1, cv2.LINE_AA)
    return picture


def turned() -> list[np.ndarray]:
    """Objects in any direction: fits that search for upright ones, and fits as models do by themselves."""
    rng = np.random.default_rng(4)
    kind = AnimalFromAbove.drawn(rng)
    model = trained([kind.picture(rng) for _ in range(N_TRAINING)])
    picture = typical(model, [kind.picture(rng) for _ in range(N_TRIED)])
    return [
        fitted(model, picture, "upright ones are searched for", rotations="upright"),
        fitted(model, picture, "all rotations, as in training"),
    ]


def crossing() -> list[np.ndarray]:
    """Poses that fold a mesh of all landmarks, and the mesh that a model has."""
    rng = np.random.default_rng(4)
    kind = JointedBars.drawn(rng)
    pictures = [kind.picture(rng) for _ in range(N_TRAINING)]
    model = trained(pictures)
    image, landmarks = pictures[3]
    whole = delaunay(model.shape_model.mean)
    return [
        captioned(with_mesh(image, landmarks, whole), "a mesh of all landmarks folds (red)"),
        captioned(with_mesh(image, landmarks, model.triangles), "the mesh of the model, in pieces"),
    ]


def with_mesh(image: np.ndarray, landmarks: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Draw a mesh, its folded triangles in red."""
    drawn = image.copy()
    for triangle in triangles:
        a, b, c = landmarks[triangle]
        is_folded = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0] < 0
        corners = np.rint(16 * landmarks[triangle]).astype(np.int32)
        cv2.polylines(drawn, [corners], True, FOLDED if is_folded else STEADY, 2, cv2.LINE_AA, 4)
    return drawn


def of_one_lot() -> list[np.ndarray]:
    """Few fish of one lot, and fish of many lots."""
    rng = np.random.default_rng(8)
    lot = Fish.drawn(rng)
    one_lot = trained([lot.varied(rng, 0.02).picture(rng) for _ in range(N_OF_LOT)])
    many_lots = trained([Fish.drawn(rng).picture(rng) for _ in range(N_TRAINING)])
    picture = typical(many_lots, [Fish.drawn(rng).picture(rng) for _ in range(N_TRIED)])
    return [
        fitted(one_lot, picture, "trained on 5 fish of one other lot"),
        fitted(many_lots, picture, "trained on a fish of each of 40 lots"),
    ]


def make() -> None:
    """Draw the picture."""
    rows = [np.hstack(panels) for panels in (turned(), crossing(), of_one_lot())]
    write_image(HERE / "hard-sets.png", np.vstack(rows))


if __name__ == "__main__":
    make()
