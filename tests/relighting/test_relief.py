"""Models with a relief: lamps shine on its surface, and files and mirror images keep it."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save

import liaam
from liaam.datasets import load_face
from liaam.errors import ModelFileError
from liaam.fitting import Fitter
from liaam.model.light_basis import HALF, SIDE
from liaam.relighting import Relighter
from liaam.relighting.lamp import normals_of, surface_of


def ball() -> np.ndarray:
    """Relief of a ball around the mean shape."""
    steps = np.linspace(-HALF, HALF, SIDE)
    x, y = np.meshgrid(steps, steps)
    across = np.stack([x, y], axis=-1)
    return (across / np.maximum(1.3 * HALF, np.linalg.norm(across, axis=-1, keepdims=True))).astype(np.float32)


@pytest.fixture(scope="module")
def face():
    return replace(liaam.load_model("face").parts[0], relief=ball())


@pytest.fixture(scope="module")
def relighter(face):
    image = load_face().read_image()
    fitter = Fitter(face)
    return Relighter.of(fitter, image, fitter.fit(image))


def test_normals_are_those_of_the_relief(face):
    normals = surface_of(face)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    mean = face.shape_model.mean
    middle = 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    away = (face.frame.pixels[:, ::-1] + face.frame.origin - middle) / face.diagonal
    np.testing.assert_allclose(normals[:, :2], away / (1.3 * HALF), atol=0.02)
    flat = replace(face, relief=None)
    np.testing.assert_array_equal(surface_of(flat), normals_of(flat.frame))


def test_normals_go_on_beyond_the_mesh(relighter):
    """There is no step of the light at the mesh's border."""
    x = relighter.normals[..., 0]
    border = relighter.inside[:, 1:] != relighter.inside[:, :-1]
    steps = np.abs(np.diff(x, axis=1))
    assert border.any()
    assert steps[border].max() < 0.1
    assert x[:, 0].mean() < -0.1 < 0.1 < x[:, -1].mean()


def test_a_lamp_lights_the_side_that_it_is_on(relighter):
    left = relighter.under("left").astype(float)
    right = relighter.under("right").astype(float)
    rows, columns = relighter.region.box
    middle = (columns.start + columns.stop) // 2
    brighter = (left - right)[rows].mean(axis=2)
    assert brighter[:, columns.start : middle].mean() > 1.0 > -1.0 > brighter[:, middle : columns.stop].mean()


def test_mirror_images_have_a_mirrored_relief(face):
    lopsided = ball()
    lopsided[..., 0] = 0.3
    mirrored = replace(face, relief=lopsided).reflected
    assert mirrored.relief is not None
    np.testing.assert_allclose(mirrored.relief[..., 0], -0.3)
    np.testing.assert_array_equal(mirrored.relief[..., 1], lopsided[:, ::-1, 1])


def test_files_hold_the_relief(face, tmp_path):
    face.save(tmp_path / "face.liaam")
    loaded = liaam.load_model(tmp_path / "face.liaam")
    assert loaded.relief is not None
    np.testing.assert_allclose(loaded.relief, face.relief, atol=0.5 / 127)
    assert loaded.to_bytes() == face.to_bytes()


@pytest.mark.parametrize("relief", [np.full((SIDE, SIDE, 2), 127, np.int8), np.zeros((SIDE, SIDE, 3), np.int8)])
def test_a_forged_relief_is_refused(face, tmp_path, relief):
    path = tmp_path / "forged.liaam"
    face.save(path)
    with safe_open(path, "np") as file:
        header = file.metadata()
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    path.write_bytes(save(tensors | {"relief": relief}, header))
    with pytest.raises(ModelFileError, match="relief"):
        liaam.load_model(path)
