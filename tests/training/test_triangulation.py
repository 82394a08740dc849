"""Meshes of objects whose parts cross, by shapes of known poses."""

import numpy as np
import pytest

import liaam
from liaam.datasets import Sample
from liaam.io import Landmarks
from liaam.model.mesh import barycentric, folded_share, pieces_of, signed_areas, surroundings, surroundings_of_pieces
from liaam.model.shape import align, rotation, scaled_mean
from liaam.training.entries import read_entries
from liaam.training.triangulation import FAULTY, mesh_of, steady_triangles

BAR = np.array([[0, -3], [30, -3], [30, 3], [0, 3], [15, 6]], float)


def jointed(angle: float, noise: float = 0.0, rng: np.random.Generator | None = None) -> np.ndarray:
    """Two bars: the second turns on the end of the first, to both of its sides."""
    second = BAR @ rotation(angle).T + [27.0, 0.0]
    shape = np.concatenate([BAR, second]) + 60.0
    return shape if rng is None else shape + rng.normal(0.0, noise, shape.shape)


@pytest.fixture
def poses(rng) -> np.ndarray:
    return np.array([jointed(angle, 0.2, rng) for angle in np.linspace(-1.8, 1.8, 20)])


def entries_of(shapes: np.ndarray):
    image = np.zeros((120, 120, 3), np.uint8)
    return read_entries([Sample(f"animal {i}", image, Landmarks(shape)) for i, shape in enumerate(shapes)], None, False)


def test_no_pose_turns_a_triangle_over(poses):
    mean = scaled_mean(poses, 60.0)
    aligned = np.array([align(shape, mean)(shape) for shape in poses])
    triangles = steady_triangles(aligned, mean)
    assert (signed_areas(mean, triangles) > 0).all()
    turned = np.array([signed_areas(shape, triangles) <= 0 for shape in aligned])
    assert turned.mean(axis=0).max() <= 0.05
    # Both bars have triangles of their own.
    assert (triangles < len(BAR)).all(axis=1).any() and (triangles >= len(BAR)).all(axis=1).any()


def test_parts_that_share_a_joint_have_triangles_of_their_own(rng):
    # The corners of two bars are nearly the same where they meet, so that the triangulation of all mixes them up.
    bar = np.array([[0, -3], [0, 3], [30, 3], [30, -3]], float)
    shapes = []
    for angles in rng.normal(0.0, 1.0, (40, 2)):
        joints = [np.zeros(2)]
        corners = []
        for angle in np.cumsum([0.0, *angles]):
            corners.append(bar @ rotation(angle).T + joints[-1])
            joints.append(joints[-1] + rotation(angle) @ [30.0, 0.0])
        shapes.append(np.concatenate(corners))
    mean = scaled_mean(np.array(shapes), 60.0)
    triangles = steady_triangles(np.array([align(shape, mean)(shape) for shape in shapes]), mean)
    assert [int((triangles // 4 == part).all(axis=1).sum()) for part in range(3)] == [2, 2, 2]


def test_triangles_hardly_overlap(poses):
    mean = scaled_mean(poses, 60.0)
    triangles = steady_triangles(np.array([align(shape, mean)(shape) for shape in poses]), mean)
    at = np.random.default_rng(1).uniform(mean.min(axis=0), mean.max(axis=0), (2000, 2))
    counts = sum((barycentric(at, triangle) > 0).all(axis=1).astype(int) for triangle in mean[triangles])
    assert 0.0 < (counts > 1).mean() < 0.1 * (counts > 0).mean() or counts.max() == 1


def test_poses_that_fold_the_mesh_are_kept(poses):
    data = entries_of(poses)
    mean = scaled_mean(poses, 60.0)
    mesh = mesh_of(data, mean, None)
    assert mesh.in_pieces and len(mesh.folding) >= 2
    assert max(folded_share(align(shape, mean)(shape), mesh.triangles) for shape in poses) < 0.15
    text = mesh.describe(20, (), len(mean))
    assert f"{len(mesh.folding)} of 20 images would fold a mesh of all landmarks (animal" in text


def test_faults_are_no_poses(rng):
    """Neither some mirrored images, nor one with two points exchanged, nor few images, change the mesh."""
    rigid = np.array([jointed(0.5, 0.2, rng) for _ in range(20)])
    faulty = rigid.copy()
    faulty[:3] = faulty[:3] * [-1.0, 1.0] + [120.0, 0.0]
    mean = scaled_mean(rigid, 60.0)
    assert folded_share(align(faulty[0], mean)(faulty[0]), mesh_of(entries_of(rigid), mean, None).triangles) > FAULTY
    assert not mesh_of(entries_of(faulty), mean, None).in_pieces
    one = rigid.copy()
    one[0, [1, 3]] = one[0, [3, 1]]
    assert not mesh_of(entries_of(one), mean, None).in_pieces
    few = np.array([jointed(angle, 0.2, rng) for angle in (-0.8, 0.0, 0.8)])
    assert not mesh_of(entries_of(few), mean, None).in_pieces


def test_given_triangles_stay(poses):
    mean = scaled_mean(poses, 60.0)
    given = np.array([[0, 1, 2], [5, 6, 7]])
    mesh = mesh_of(entries_of(poses), mean, given)
    assert mesh.triangles.tolist() == given.tolist() and not mesh.in_pieces


def test_each_piece_has_its_surroundings(poses):
    mean = scaled_mean(poses, 60.0)
    triangles = steady_triangles(np.array([align(shape, mean)(shape) for shape in poses]), mean)
    pieces = pieces_of(triangles)
    assert len(pieces) >= 2 and sorted(np.concatenate(pieces).tolist()) == list(range(len(triangles)))
    extension, wider = surroundings_of_pieces(mean, triangles)
    np.testing.assert_allclose(extension.sum(axis=1), 1.0, atol=1e-12)
    assert (signed_areas(extension @ mean, wider) > 0).all()
    # Vertices of a ring follow the landmarks of one piece.
    members = [set(np.unique(triangles[piece]).tolist()) for piece in pieces]
    for row in extension[len(mean) :]:
        assert any(set(np.flatnonzero(row).tolist()) <= of_piece for of_piece in members)


def test_a_mesh_of_one_piece_has_one_ring(poses):
    mean = scaled_mean(poses[10:11], 60.0)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 4, 3]])
    assert len(pieces_of(triangles)) == 1
    extension, wider = surroundings(mean, triangles)
    assert len(extension) > len(mean) and (wider[: len(triangles)] == triangles).all()


def jointed_image(shape: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw the bars of a shape with stripes along them."""
    image = np.full((120, 120, 3), 60.0)
    grid = np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1)
    for bar, colour in ((shape[:5], (220, 120, 60)), (shape[5:], (90, 160, 230))):
        pose = align(BAR, bar)
        x, y = np.moveaxis(pose.inverse()(grid.reshape(-1, 2)).reshape(grid.shape), 2, 0)
        inside = (x > 0) & (x < 30) & (np.abs(y) < 5)
        stripes = 0.6 + 0.4 * np.cos(x * 0.8)
        image = np.where(inside[..., None], np.array(colour) * stripes[..., None], image)
    return np.clip(image + rng.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.filterwarnings("ignore:.*would fold a mesh of all landmarks")
def test_a_model_in_pieces_is_trained_fitted_and_stored(poses, rng, tmp_path):
    images = [jointed_image(shape, rng) for shape in poses]
    pairs = list(zip(images, poses, strict=True))
    image, truth = pairs.pop(8)
    model = liaam.train(pairs, lamps=None, copies=0, leave_out=False, diagonal=60.0)
    assert model.in_pieces and model.n_images == 19
    model.save(tmp_path / "jointed.liaam")
    loaded = liaam.load_model(tmp_path / "jointed.liaam")
    assert loaded.in_pieces and loaded.poses is not None and model.poses is not None
    np.testing.assert_array_equal(loaded.poses, model.poses)
    first, second = (liaam.fit(each, image, truth + 1.5) for each in (model, loaded))
    np.testing.assert_allclose(second.landmarks, first.landmarks, atol=0.05)
    assert np.linalg.norm(first.landmarks - truth, axis=1).mean() < 1.0
    # From a box, fits start from poses: the mean shape is straight.
    for image, truth in (pairs[3], pairs[-3]):
        box = np.concatenate([truth.min(axis=0), truth.max(axis=0)])
        from_box = liaam.fit(loaded, image, box)
        assert from_box.n_starts >= 19 and np.linalg.norm(from_box.landmarks - truth, axis=1).mean() < 2.0
