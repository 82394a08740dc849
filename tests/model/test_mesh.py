"""The mesh over the mean shape and the pixels of the reference frame."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial import ConvexHull

from liaam.errors import TrainingError
from liaam.model.mesh import (
    ReferenceFrame,
    barycentric,
    delaunay,
    folded_share,
    model_frame,
    signed_areas,
    surroundings,
    triangles_from_edges,
)

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def cloud(seed: int, n: int = 20) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-40, 40, (n, 2))


def edges_of(triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


@given(seed=st.integers(0, 99))
def test_delaunay_turns_one_way_and_fills_the_hull(seed):
    from scipy.spatial import ConvexHull

    points = cloud(seed)
    areas = signed_areas(points, delaunay(points))
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(ConvexHull(points).volume, rel=1e-3)


@given(seed=st.integers(0, 99))
def test_edges_give_the_triangulation_back(seed):
    points = cloud(seed)
    triangles = delaunay(points)
    edges = np.random.default_rng(seed).permutation(edges_of(triangles))
    found = triangles_from_edges(points, edges)
    assert found is not None
    assert {tuple(sorted(t)) for t in found.tolist()} == {tuple(sorted(t)) for t in triangles.tolist()}
    assert (signed_areas(points, found) > 0).all()


@pytest.mark.parametrize(
    "edges",
    [
        np.zeros((0, 2), int),
        [[0, 1], [1, 2], [2, 3], [3, 0]],  # a contour
        [[0, 1], [1, 2], [2, 0]],  # a mesh of some of the points
        [[0, 0], [1, 1]],
    ],
)
def test_edges_that_are_no_mesh_give_none(edges):
    assert triangles_from_edges(SQUARE, np.array(edges)) is None


@pytest.mark.parametrize("points", [np.outer(np.arange(5.0), [1, 2]), np.ones((5, 2))], ids=["line", "point"])
def test_landmarks_that_span_no_mesh_are_refused(points):
    with pytest.raises(TrainingError, match="lie on one line or at one point"):
        delaunay(points)


@given(seed=st.integers(0, 99))
def test_barycentric_weights_rebuild_the_points(seed):
    points = cloud(seed)
    weights = barycentric(points, points[:3])
    np.testing.assert_allclose(weights @ points[:3], points, atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)


def test_a_mirrored_shape_is_wholly_folded():
    triangles = delaunay(SQUARE)
    assert folded_share(SQUARE, triangles) == 0
    assert folded_share(SQUARE * [-1, 1], triangles) == 1
    assert folded_share(SQUARE * 0, triangles) == 1
    known = np.array([True, True, True, False])
    whole = known[triangles].all(axis=1)
    assert folded_share(SQUARE * [-1, 1], triangles, known) == pytest.approx(whole.mean())
    assert folded_share(SQUARE * [-1, 1], triangles, ~known) == 0


def test_folded_share_is_a_share_of_area():
    shape = np.array([[0, 0], [4, 0], [0, 4], [1, 1.0]])  # point 3 lies inside: three triangles
    triangles = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert folded_share(shape, triangles) == 0
    shape[3] = [2, -1]  # across the first triangle's base
    areas = signed_areas(shape, triangles)
    assert folded_share(shape, triangles) == pytest.approx(-areas.min() / np.abs(areas).sum())
    assert 0.1 < folded_share(shape, triangles) < 0.2


def test_a_folded_mesh_on_the_mean_is_refused():
    with pytest.raises(TrainingError, match=r"folded on the mean shape \(triangle of points \[0, 3, 2\]"):
        ReferenceFrame(SQUARE, np.array([[0, 1, 2], [0, 3, 2]], np.int32))


@given(seed=st.integers(0, 30))
def test_every_pixel_of_the_frame_lies_in_its_triangle(seed):
    points = cloud(seed)
    frame = ReferenceFrame(points - points.mean(axis=0), delaunay(points))
    carried = np.einsum("nv,nva->na", frame.weights, frame.points[frame.vertices])
    np.testing.assert_allclose(carried, frame.pixels[:, ::-1] + frame.origin, atol=1e-9)
    assert frame.weights.min() >= -1e-9
    assert len(np.unique(frame.pixels, axis=0)) == frame.n_pixels
    assert frame.n_pixels == pytest.approx(signed_areas(points, frame.triangles).sum(), rel=0.05)


def test_pixels_on_shared_edges_and_corners_count_once():
    frame = ReferenceFrame(SQUARE, delaunay(SQUARE))
    assert frame.n_pixels == 11 * 11


def test_a_picture_lays_values_where_their_pixels_are():
    frame = ReferenceFrame(SQUARE, delaunay(SQUARE))
    picture = frame.picture(np.arange(frame.n_pixels) + 1.0, fill=-1)
    assert picture.shape == frame.size[::-1]
    np.testing.assert_array_equal(picture[frame.pixels[:, 0], frame.pixels[:, 1]], np.arange(frame.n_pixels) + 1)
    assert (picture == -1).sum() == picture.size - frame.n_pixels
    assert frame.picture(np.zeros((frame.n_pixels, 3))).shape == (*frame.size[::-1], 3)


def test_the_gradient_is_that_of_smooth_values(model):
    """A cubic is differentiated exactly away from the border, a wave of six pixels nearly."""
    frame = model.frame
    x, y = (frame.pixels[:, ::-1] + frame.origin).T / 10
    gradient = frame.gradient(np.stack([x**3 - x * y, np.sin(2 * np.pi * 10 * y / 6)], axis=1))
    inside = frame.picture(np.ones(frame.n_pixels)) > 0
    deep = inside.copy()
    for _ in range(6):  # a spline forgets its ends within a few pixels
        padded = np.pad(deep, 1)
        deep = padded[1:-1, 1:-1] & padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    deep = deep[frame.pixels[:, 0], frame.pixels[:, 1]]
    assert deep.sum() > 100
    np.testing.assert_allclose(gradient[deep, 0, 0], (3 * x**2 - y)[deep] / 10, atol=1e-3)
    np.testing.assert_allclose(gradient[deep, 1, 0], -x[deep] / 10, atol=1e-3)
    wave = 2 * np.pi / 6 * np.cos(2 * np.pi * 10 * y / 6)
    np.testing.assert_allclose(gradient[deep, 1, 1], wave[deep], atol=0.03)
    assert np.isfinite(gradient).all()
    assert gradient.shape == (frame.n_pixels, 2, 2)


def test_surroundings_follow_every_affine_map_of_the_landmarks(rng):
    points = rng.normal(size=(12, 2)) * 30
    extension, _ = surroundings(points, delaunay(points), 0.1)
    matrix, offset = rng.normal(size=(2, 2)), rng.normal(size=2)
    moved = extension @ (points @ matrix.T + offset)
    np.testing.assert_allclose(moved, (extension @ points) @ matrix.T + offset)
    np.testing.assert_array_equal(extension[:12], np.eye(12))


def test_surroundings_widen_the_mesh_all_around(rng):
    points = rng.normal(size=(12, 2)) * 30
    triangles = delaunay(points)
    extension, wider = surroundings(points, triangles, 0.1)
    wide = ReferenceFrame(extension @ points, wider)
    plain = ReferenceFrame(points, triangles)
    hull = points[ConvexHull(points).vertices] - points.mean(axis=0)
    own = 0.5 * np.abs(np.cross(np.c_[hull, 0 * hull[:, :1]], np.c_[np.roll(hull, -1, 0), 0 * hull[:, :1]])[:, 2]).sum()
    assert wide.n_pixels == pytest.approx(1.21 * own, rel=0.05)
    assert plain.n_pixels < wide.n_pixels
    own_pixels = {tuple(p) for p in plain.pixels + plain.origin[::-1].astype(int)}
    assert own_pixels <= {tuple(p) for p in wide.pixels + wide.origin[::-1].astype(int)}


def test_a_fan_of_long_triangles_is_refused_before_hours_are_spent_on_its_pixels():
    away = np.linspace(0.0, 20.0, 900)
    fan = np.concatenate([[[0.0, 0.0]], np.column_stack([1400 - away, 1380 + away])])
    i = np.arange(1, len(fan) - 1)
    with pytest.raises(TrainingError, match=r"899 triangles, too many long ones.*smaller diagonal"):
        model_frame(fan, np.column_stack([0 * i, i, i + 1]).astype(np.int32))


def test_frames_of_large_pictures_are_not_refused(model):
    # Relighting paints in a frame of the picture's own pixels.
    ReferenceFrame(60.0 * model.shape_model.mean, model.triangles)


@pytest.mark.parametrize("width", [0.0, 1e-300])
def test_surroundings_of_points_on_one_line_are_refused(width):
    line = np.column_stack([np.linspace(0, 50, 6), width * np.arange(6)])
    with pytest.raises(TrainingError, match="lie on one line"):
        surroundings(line, np.array([[0, 1, 2]]))


# In a process of its own: what other tests leave behind moves the memory of theirs.
RESIDENT_AFTER_FRAMES = """
import os, threading
from pathlib import Path
import numpy as np
from liaam.model.mesh import ReferenceFrame, delaunay
points = np.array([[0.0, 0.0], [120.0, 0.0], [120.0, 120.0], [0.0, 120.0]])
for _ in range(15):
    frame = ReferenceFrame(points, delaunay(points))
    thread = threading.Thread(target=frame.gradient, args=(np.ones((frame.n_pixels, 1)),))
    thread.start()
    thread.join()
    del frame
    print(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="this system does not report resident memory")
def test_a_frame_used_in_one_thread_is_freed_in_another():
    run = subprocess.run([sys.executable, "-c", RESIDENT_AFTER_FRAMES], check=True, capture_output=True, text=True)
    resident = [int(line) for line in run.stdout.split()]
    assert resident[-1] - resident[1] < 10e6  # 28 MB where frames stay
