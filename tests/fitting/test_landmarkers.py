"""Landmarkers of others by name, with a stand-in for MediaPipe, whose wheels need an older NumPy than the tests."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from liaam.errors import StartError
from liaam.fitting import landmarkers as module
from liaam.fitting.landmarkers import face_mesh
from liaam.fitting.search.starts import check_start, read_start
from liaam.io import write_image

SHARES = [(0.25, 0.5), (0.5, 0.5), (0.75, 1.0)]


@pytest.fixture
def seen(monkeypatch):
    """Stand in for MediaPipe: it finds three points in bright images, and keeps what it was shown."""
    shown = []

    class FaceMesh:
        def __init__(self, **options):
            assert options == {"static_image_mode": True, "max_num_faces": 1, "refine_landmarks": True}

        def process(self, image):
            shown.append(image)
            points = [SimpleNamespace(x=x, y=y, z=0.0) for x, y in SHARES]
            return SimpleNamespace(multi_face_landmarks=[SimpleNamespace(landmark=points)] if image.any() else None)

    for name in ("mediapipe", "mediapipe.python", "mediapipe.python.solutions", "mediapipe.python.solutions.face_mesh"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules["mediapipe.python.solutions.face_mesh"].FaceMesh = FaceMesh  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "_OWN", SimpleNamespace())
    return shown


@pytest.mark.parametrize(("dtype", "bright"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1.0)])
def test_the_face_mesh_is_in_pixels_of_the_image(seen, dtype, bright):
    points = face_mesh(np.full((40, 80, 3), bright, dtype))
    np.testing.assert_allclose(points, np.array(SHARES) * [80, 40] - 0.5)
    assert seen[0].dtype == np.uint8
    assert (seen[0] == 255).all()


def test_a_start_by_the_name_of_a_landmarker(seen, tmp_path):
    write_image(tmp_path / "face.png", np.full((40, 80, 3), 200, np.uint8))
    write_image(tmp_path / "dark.png", np.zeros((40, 80, 3), np.uint8))
    check_start("mediapipe")
    start = read_start("mediapipe", tmp_path / "face.png", (80, 40))
    np.testing.assert_allclose(start.points, np.array(SHARES) * [80, 40] - 0.5)
    with pytest.raises(StartError, match=r"dark.png: mediapipe finds nothing in this image; give a box"):
        read_start("mediapipe", tmp_path / "dark.png", (80, 40))


def test_training_asks_the_landmarker(seen, scenes):
    from liaam.training.entries import read_entries
    from liaam.training.points import map_of_points

    entries = read_entries((scene.image, scene.landmarks) for scene in scenes).entries
    assert map_of_points("mediapipe", entries, scenes[0].landmarks).n_theirs == 3
    assert len(seen) == len(scenes)


def test_without_the_package_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    monkeypatch.setattr(module, "_OWN", SimpleNamespace())
    with pytest.raises(StartError, match=r'install it with pip install "\.\[mediapipe\]"'):
        face_mesh(np.zeros((40, 80, 3), np.uint8))
