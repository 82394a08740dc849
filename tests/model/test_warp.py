"""The piecewise-affine warp."""

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.model import SURROUNDINGS
from liaam.model.shape import align
from liaam.model.warp import GROUPS, HomographyWarp, apply_homography


def test_jacobian_of_the_warp(model, rng):
    p = rng.normal(size=model.warp.n_parameters)
    jacobian = model.warp.jacobian(p).reshape(-1, model.warp.n_parameters)
    assert_jacobian(lambda q: model.warp.points(q).ravel(), jacobian, p, steps=1.0, tolerance=1e-6)


def test_at_rest_pixels_stay_in_place(model):
    points = model.warp.points(np.zeros(model.warp.n_parameters))
    np.testing.assert_allclose(points, model.frame.pixels[:, ::-1] + model.frame.origin, atol=1e-9)


def test_a_similarity_of_the_vertices_is_one_of_the_pixels(model):
    mean = model.shape_model.mean
    pose = align(mean, mean @ [[0, 2], [-2, 0]] + [7, 5])
    rest = model.warp.points(np.zeros(model.warp.n_parameters))
    np.testing.assert_allclose(model.warp.interpolate(pose(mean)), pose(rest), atol=1e-9)
    p = np.zeros(model.warp.n_parameters)
    np.testing.assert_allclose(model.warp.points(p, pose), pose(rest), atol=1e-9)


def test_movement_is_that_of_the_landmarks(model, rng):
    p, step = rng.normal(size=(2, model.warp.n_parameters))
    moved = model.shape_model.shape(p + step) - model.shape_model.shape(p)
    assert model.warp.movement(step) == pytest.approx(np.sqrt(np.square(moved).sum(axis=1).mean()))


def test_the_pulled_gradient_is_that_of_the_picture_it_came_from(model, rng):
    """V(W(x; p)) = values(x) for a plane V: its gradient is known, whatever the warp."""
    warp = model.warp
    p = rng.normal(0, 1, warp.n_parameters)
    slope = np.array([0.7, -0.3])
    gradient = warp.pulled(warp.slopes((warp.points(p) @ slope)[:, None]), p)
    pixels = {tuple(pixel) for pixel in model.frame.pixels}
    owner = dict(zip(map(tuple, model.frame.pixels), model.frame.owners, strict=True))
    # Where a pixel's neighbours lie in its own triangle; splines carry the kinks at edges a few pixels further.
    deep = [
        all((r + i, c + j) in pixels and owner[r + i, c + j] == owner[r, c] for i in range(-2, 3) for j in range(-2, 3))
        for r, c in model.frame.pixels
    ]
    assert sum(deep) > 30
    np.testing.assert_allclose(gradient[deep, 0], np.tile(slope, (sum(deep), 1)), atol=0.02)
    folded = warp.pulled(np.ones((model.n_pixels, 2, 1)), np.full(warp.n_parameters, -1e9))
    assert np.isfinite(folded).all()


@pytest.mark.parametrize(("spacing", "share"), [(1.0, 1.0), (1.5, 0.25), (2.0, 0.25), (3.0, 1 / 9)])
def test_pixels_so_far_apart_lie_in_the_order_of_their_triangles(model, rng, spacing, share):
    kept = model.warp.every(spacing)
    assert len(kept) == pytest.approx(share * model.n_pixels, rel=0.1)
    warp, p = model.warp.at(kept), rng.normal(size=model.warp.n_parameters)
    np.testing.assert_array_equal(warp.points(p), model.warp.points(p)[kept])
    np.testing.assert_allclose(warp.jacobian(p), model.warp.jacobian(p)[kept], atol=1e-6)
    assert (np.diff(model.frame.owners[kept]) >= 0).all()
    with pytest.raises(AssertionError):  # in raster order
        model.warp.mesh()


def test_a_mesh_says_what_the_warp_does(model, rng):
    warp, p, step = model.warp.at(model.warp.every(1.5)), *rng.normal(size=(2, model.warp.n_parameters))
    mesh = warp.mesh()
    vertices = mesh.rest + (mesh.basis @ p).reshape(-1, 2)
    np.testing.assert_allclose(vertices, warp.shape(p), atol=1e-9)
    owners = np.repeat(np.arange(len(mesh.triangles)), np.diff(mesh.starts))
    corners = mesh.triangles[owners]
    np.testing.assert_allclose(np.einsum("nv,nva->na", mesh.beta, vertices[corners]), warp.points(p), atol=1e-4)
    modes = mesh.basis.reshape(-1, 2, warp.n_parameters)[corners]
    np.testing.assert_allclose(np.einsum("nv,nvai->nai", mesh.beta, modes), warp.jacobian(p), atol=1e-5)
    assert mesh.movement * np.linalg.norm(step) == pytest.approx(warp.movement(step))


def test_a_mesh_has_vertices_that_are_no_landmarks(model, rng):
    warp = model.views[SURROUNDINGS].warp
    warp, p = warp.at(warp.every(1.5)), rng.normal(size=warp.n_parameters)
    mesh = warp.mesh()
    assert len(mesh.rest) > model.n_points
    vertices = mesh.rest + (mesh.basis @ p).reshape(-1, 2)
    owners = np.repeat(np.arange(len(mesh.triangles)), np.diff(mesh.starts))
    carried = np.einsum("nv,nva->na", mesh.beta, vertices[mesh.triangles[owners]])
    np.testing.assert_allclose(carried, warp.points(p), atol=1e-4)


@pytest.fixture(params=sorted(GROUPS))
def plane_warp(request) -> HomographyWarp:
    """Give each group of plane maps on a grid of which some points are left out."""
    kept = np.random.default_rng(3).random((20, 30)) > 0.2
    corners = np.array([[-0.5, -0.5], [60.0, -0.5], [60.0, 41.0], [-0.5, 41.0]])
    return HomographyWarp(kept, corners, 2.0, request.param)


def test_jacobian_of_the_homography(plane_warp, rng):
    p = rng.normal(0, 0.5, plane_warp.n_parameters)
    jacobian = plane_warp.jacobian(p).reshape(-1, plane_warp.n_parameters)
    assert_jacobian(lambda q: plane_warp.points(q).ravel(), jacobian, p, steps=1e-4, tolerance=1e-5)


def test_at_rest_a_homography_moves_nothing_and_a_step_by_its_length(plane_warp, rng):
    rest = np.zeros(plane_warp.n_parameters)
    np.testing.assert_allclose(plane_warp.points(rest), plane_warp.pixels, atol=1e-12)
    step = 1e-4 * rng.normal(size=len(rest))
    moved = np.sqrt(np.square(plane_warp.points(step) - plane_warp.pixels).sum(axis=1).mean())
    assert plane_warp.movement(step) == pytest.approx(moved, rel=1e-3)


def test_parameters_are_found_from_handles(plane_warp, rng):
    p = rng.normal(0, 1.0, plane_warp.n_parameters)
    np.testing.assert_allclose(plane_warp.parameters(plane_warp.shape(p)), p, atol=1e-8)


def test_the_gradient_under_a_homography_is_that_of_the_picture_it_came_from(plane_warp, rng):
    p, slope = rng.normal(0, 0.3, plane_warp.n_parameters), np.array([0.7, -0.3])
    gradient = plane_warp.pulled(plane_warp.slopes((plane_warp.points(p) @ slope)[:, None]), p)[:, 0]
    assert np.median(np.abs(gradient - slope)) < 0.03
    assert np.isfinite(plane_warp.pulled(np.ones((len(plane_warp.pixels), 2, 1)), 1e6 + p)).all()


def test_points_behind_the_picture_are_not_numbers():
    matrix = np.array([[1, 0, 0], [0, 1, 0], [-0.1, 0, 1]])
    carried = apply_homography(matrix, np.array([[0.0, 0.0], [20.0, 0.0]]))
    assert np.isfinite(carried[0]).all() and np.isnan(carried[1]).all()
