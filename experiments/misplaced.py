"""How often ``liaam check`` finds misplaced landmarks, and reports those that are right.

Specimens: random outlines of few landmarks, which vary independently. Faces: those of a folder, some of whose points
are moved; without a move, what is reported are the annotators' own errors, and false reports.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from liaam.datasets import load_folder
from liaam.datasets.label_faults import LabelFault, find_label_faults
from liaam.model.shape import align, diagonal_of

NATURAL, MOVED = 0.015, 0.1
"""Largest natural deviation of a coordinate, and the distance of a move, as fractions of the diagonal."""

SHARE = 0.05
"""Share of the points of faces that are moved."""


def specimens(rng: np.random.Generator, n: int, count: int = 30) -> np.ndarray:
    """Return landmarks (count, n, 2) float64 of specimens of one kind, turned and scaled."""
    radius, angle = rng.uniform(0.4, 1.0, n), (np.arange(n) + rng.uniform(-0.3, 0.3, n)) * (2 * np.pi / n)
    outline = radius * np.exp(1j * angle)
    size = diagonal_of(np.stack([outline.real, outline.imag], axis=1))
    spread = NATURAL * size * rng.uniform(-1, 1, (2, count, n))
    pose = 100 * np.exp(rng.normal(scale=0.1, size=(count, 1)) + 1j * rng.normal(scale=0.2, size=(count, 1)))
    placed = pose * (outline + spread[0] + 1j * spread[1]) + 300 * (1 + 1j)
    return np.stack([placed.real, placed.imag], axis=2)


def found_in_specimens(n: int, n_sets: int, seed: int) -> dict[str, float]:
    """Return shares of sets: with a false report, and in which the moved specimen and its point are named."""
    false = named = pointed = 0
    for i in range(n_sets):
        rng = np.random.default_rng([seed, n, i])
        shapes = specimens(rng, n)
        false += bool(find_label_faults(list(shapes)))
        who, point, angle = rng.integers(len(shapes)), rng.integers(n), rng.uniform(0, 2 * np.pi)
        shapes[who, point] += MOVED * diagonal_of(shapes[who]) * np.array([np.cos(angle), np.sin(angle)])
        faults = [fault for fault in find_label_faults(list(shapes)) if fault.picture == who]
        named += bool(faults)
        pointed += any(fault.points[:1] == (point,) for fault in faults)
    return {"false": false / n_sets, "specimen": named / n_sets, "point": pointed / n_sets}


def found_in_faces(
    faces: np.ndarray, distance: Callable[[np.ndarray], float], n_sets: int, seed: int, count: int = 50
) -> dict[str, float]:
    """Return shares in sets of ``count`` of the ``faces`` (m, n, 2), some of whose points are moved by ``distance``.

    Of points that are moved by more than four standard deviations of their landmark, those that are named; of the
    other points, those that are named; of faces without a moved point, those that are reported, and without any move.
    """
    far_named = far_all = wrong = right_points = bare_reported = bare_all = clean = 0.0
    for i in range(n_sets):
        rng = np.random.default_rng([seed, i])
        shapes = faces[rng.permutation(len(faces))[:count]]
        lengths = np.array([distance(shape) for shape in shapes])[:, None]
        moved = rng.random(shapes.shape[:2]) < SHARE
        angle = rng.uniform(0, 2 * np.pi, moved.shape)
        away = (lengths * MOVED)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
        aligned = np.array([align(shape, shapes[0])(shape) for shape in shapes]) / lengths[0]
        far = moved & (4 * np.sqrt(aligned.var(axis=0).mean(axis=1)) < MOVED)
        named = _named(find_label_faults(list(shapes + away * moved[..., None])), moved.shape)
        bare = ~moved.any(axis=1)
        far_named, far_all = far_named + (far & named).sum(), far_all + far.sum()
        wrong, right_points = wrong + (named & ~moved).sum(), right_points + (~moved).sum()
        bare_reported, bare_all = bare_reported + named[bare].any(axis=1).sum(), bare_all + bare.sum()
        clean += _named(find_label_faults(list(shapes)), moved.shape).any(axis=1).mean() / n_sets
    return {
        "far points named": float(far_named / max(far_all, 1)),
        "right points named": float(wrong / right_points),
        "unmoved faces reported": float(bare_reported / max(bare_all, 1)),
        "without moves": float(clean),
    }


def _named(faults: list[LabelFault], shape: tuple[int, ...]) -> np.ndarray:
    named = np.zeros(shape, bool)
    for fault in faults:
        named[fault.picture, list(fault.points)] = True
    return named


def main(
    faces: Annotated[Path | None, typer.Argument(help="Folder of landmarked faces.")] = None,
    eyes: Annotated[str, typer.Option(help="Landmarks of both eyes, counted from 1, such as 14-21,22-29.")] = "1,2",
    sets: Annotated[int, typer.Option(help="Number of sets.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.")] = 0,
) -> None:
    """Print the shares for specimens of 4 to 9 landmarks, or for faces."""
    if faces is None:
        shares = {f"{n} landmarks": found_in_specimens(n, sets, seed) for n in range(4, 10)}
    else:
        bounds = [[int(number) for number in eye.split("-")] for eye in eyes.split(",")]
        left, right = (slice(each[0] - 1, each[-1]) for each in bounds)
        shapes = np.array([one.landmarks.points for one in load_folder(faces) if not one.landmarks.missing.any()])
        shares = {
            faces.name: found_in_faces(
                shapes, lambda face: float(np.linalg.norm(face[left].mean(0) - face[right].mean(0))), sets, seed
            )
        }
    for name, found in shares.items():
        print(f"{name}: {', '.join(f'{what} {share:.2%}' for what, share in found.items())}", flush=True)


if __name__ == "__main__":
    typer.run(main)
