"""Lamps for faces: whether objects are faces, where a face lies among the landmarks, and what training makes of it."""

from pathlib import Path

import cv2
import numpy as np
from safetensors import safe_open

from liaam.datasets import Sample
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.model.light_basis import SIDE
from liaam.model.shape import scaled_mean
from liaam.photometry import CameraModel
from liaam.training import LearntLamps, train
from liaam.training.entries import read_entries
from liaam.training.faces import LAMPS, N_LAMPS, bank_tensors, carried_lamps, face_lamps, stored_fields
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
    assert (lit.n_lamps, lit.n_textures, plain.n_lamps) == (300, 16, 0)
    assert lit.light is not None and plain.light is None
    assert "varied" in lit.levels[0].appearances and "varied" not in plain.levels[0].appearances
    assert train(data, copies=0, **options).n_lamps == 0


def test_the_command_says_that_the_objects_are_faces(run, tmp_path):
    for sample in heads(4):
        write_image(tmp_path / f"{sample.name}.png", sample.read_image())
        write_landmarks(tmp_path / f"{sample.name}.pts", sample.landmarks)
    options = ("train", tmp_path, "-o", tmp_path / "m.liaam", "--diagonal", 40, "--no-leave-out", "--copies", 1)
    code, out, _ = run(*options)
    assert code == 0 and "4 images and 4 copies in other light (300 lamps)" in out
    assert "the objects are faces, so liaam also trained on copies in the light of lamps that it knows" in out
    code, out, _ = run(*options, "--lamps", "none")
    assert code == 0 and "faces" not in out.replace(str(tmp_path), "")


def test_the_bank_of_lamps_is_stored_with_small_errors_and_names_its_licence(rng):
    smooth = [cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE, 3)), (0, 0), 6.0) for _ in range(2 * N_LAMPS)]
    fields = np.array(smooth, np.float32) * 10.0 - 0.4
    bank = bank_tensors(np.zeros((4, 2)), fields)
    assert len(bank["fields"]) < fields.astype(np.uint8).size / 5
    assert np.sqrt(np.square(stored_fields(bank) - fields).mean()) < 0.01 * np.ptp(fields)
    with safe_open(LAMPS, "np") as file:
        assert "MIT, Copyright (c) 2020 USC" in file.metadata()["licence"]
        n_lamps = len(stored_fields({"fields": file.get_tensor("fields"), "ends": file.get_tensor("ends")}))
    notice = (Path(__file__).parents[2] / "LICENSE-DATA").read_text("utf-8")
    assert "Permission is hereby granted" in notice
    assert n_lamps % N_LAMPS == 0


def test_lamps_on_the_landmarks_of_the_face_model_are_those_of_the_file():
    with safe_open(LAMPS, "np") as file:
        mean = file.get_tensor("mean")
        fields = stored_fields({"fields": file.get_tensor("fields"), "ends": file.get_tensor("ends")})
    lamps = carried_lamps(mean, mean)
    assert len(set(lamps.names)) == len(lamps)
    np.testing.assert_allclose(lamps.fields.astype(np.float32), fields, atol=0.01)
