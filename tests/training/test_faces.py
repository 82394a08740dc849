"""Lamps for faces: whether objects are faces, where a face lies among the landmarks, and what training makes of it."""

import numpy as np

from liaam.datasets import Sample
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.model.shape import scaled_mean
from liaam.photometry import CameraModel
from liaam.training import LearntLamps, train
from liaam.training.entries import read_entries
from liaam.training.faces import face_lamps
from scenes import Head, make_set


def heads(n: int, points=lambda shape: shape) -> list[Sample]:
    scenes = make_set(n, Head(5), size=(160, 120))
    return [Sample(f"head {i}", s.image, Landmarks(points(s.landmarks))) for i, s in enumerate(scenes)]


def found(samples: list[Sample]) -> LearntLamps | None:
    entries = read_entries(samples).entries
    mean = scaled_mean(np.array([entry.points for entry in entries]), 100.0)
    return face_lamps(entries, mean, CameraModel())


def test_faces_have_lamps_whatever_their_landmarks():
    """The right lamps darken the left of the image, for all landmarks and for a few in another order."""
    few = [44, 20, 6, 0, 12, 50]
    for points in (lambda shape: shape, lambda shape: shape[few]):
        lamps = found(heads(4, points))
        assert lamps is not None and len(lamps.mean) == len(points(np.zeros((58, 2))))
        sides = np.diff([[f[40:90, 30:60].mean(), f[40:90, 68:98].mean()] for f in lamps.fields.astype(np.float32)])
        assert (sides[::2] * np.sign(sides[0]) > 0).mean() > 0.8
        assert (sides[1::2] * np.sign(sides[0]) < 0).mean() > 0.8


def test_other_objects_have_none(rng):
    blots = []
    for i in range(6):
        image = rng.integers(0, 255, (12, 16, 3), np.uint8).repeat(10, axis=0).repeat(10, axis=1)
        blots.append(
            Sample(
                f"blot {i}",
                image,
                Landmarks(np.array([[40, 30], [120, 28], [118, 95], [42, 90]]) + rng.normal(0, 2, (4, 2))),
            )
        )
    assert found(blots) is None


def test_training_relights_faces_unless_told_otherwise():
    data, options = heads(4), {"diagonal": 40.0, "leave_out": False, "methods": "all"}
    lit, plain = train(data, **options), train(data, lamps=None, **options)
    assert (lit.n_lamps, lit.n_textures, plain.n_lamps) == (60, 16, 0)
    assert lit.light is not None and plain.light is None
    assert "varied" in lit.levels[0].appearances and "varied" not in plain.levels[0].appearances
    assert train(data, copies=0, **options).n_lamps == 0


def test_the_command_says_that_the_objects_are_faces(run, tmp_path):
    for sample in heads(4):
        write_image(tmp_path / f"{sample.name}.png", sample.read_image())
        write_landmarks(tmp_path / f"{sample.name}.pts", sample.landmarks)
    options = ("train", tmp_path, "-o", tmp_path / "m.liaam", "--diagonal", 40, "--no-leave-out", "--copies", 1)
    code, out, _ = run(*options)
    assert code == 0 and "4 images and 4 copies under 60 lamps" in out
    assert "the objects are faces, so the lamps are those of generated heads (--lamps none for none)" in out
    code, out, _ = run(*options, "--lamps", "none")
    assert code == 0 and "faces" not in out.replace(str(tmp_path), "")
