"""Batched fits come to what single fits come to, on every array library, and do not disturb each other."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.errors import ImageError, MethodError, StartError
from liaam.fitting import METHODS, FitStatus, Fitter, SolverOptions
from liaam.fitting.batched import BatchFitter, fit_many
from liaam.fitting.batched.objective import BatchObjective, recurring
from liaam.fitting.batched.solver import BatchSolver
from liaam.fitting.solver import solve
from liaam.kernels.backends import BACKENDS, get_backend
from setups import disturb, finest_objective, make_problem, train_on

SUPPORTED = tuple(name for name in METHODS if name != "grey-norm")
ANGLED = ("li", "li-lit", "li-pc", "li-pcs", "soft-li")
SAME = 0.02
"""Pixels; pixels in single precision agree to less than that where fits settle."""


@pytest.fixture(scope="module")
def one_level(model):
    """Give the model at its sharpest level alone: JAX compiles for every level."""
    return replace(model, levels=model.levels[-1:], soft_levels=model.soft_levels[-1:])


@pytest.fixture(scope="module")
def pictures(scenes, same_light_scene):
    """Give images and starts: different scales and shifts of pictures under the training light."""
    images = [same_light_scene.image, scenes[2].image, scenes[3].image, same_light_scene.image]
    truth = [same_light_scene.landmarks, scenes[2].landmarks, scenes[3].landmarks, same_light_scene.landmarks]
    moves = [(1.03, (0.02, -0.015)), (0.97, (0.0, 0.01)), (1.0, (0.01, 0.02)), (1.02, (-0.02, 0.0))]
    return images, [disturb(shape, *move) for shape, move in zip(truth, moves, strict=True)]


def assert_same(many, one):
    assert many.statuses == tuple(result.status for result in one)
    np.testing.assert_allclose(many.shapes, [result.shape for result in one], atol=SAME)
    np.testing.assert_allclose(many.costs, [result.cost for result in one], rtol=1e-2)
    np.testing.assert_allclose(many.thetas, [result.theta for result in one], atol=0.01)


@pytest.mark.parametrize("method", SUPPORTED)
def test_batched_fits_are_those_of_the_fitter(model, pictures, method):
    fitter = Fitter(model, method)
    one = [fitter.fit(image, start) for image, start in zip(*pictures, strict=True)]
    many = fit_many(model, *pictures, method, batch_size=3)
    assert_same(many, one)
    spread = np.array([result.landmark_covariances for result in one])
    np.testing.assert_allclose(many.landmark_covariances, spread, rtol=0.05, atol=1e-4 * spread.max())
    assert many.method == method and len(many) == 4 and many.ok.tolist() == [result.status.ok for result in one]


@pytest.mark.parametrize("method", ["soft-li", "li", "li-lit", "rgb"])
def test_batched_fits_are_those_of_the_fitter_under_another_light(model, lit_scene, method):
    starts = [disturb(lit_scene.landmarks), disturb(lit_scene.landmarks, 0.98, (0.0, 0.01))]
    one = [Fitter(model, method).fit(lit_scene.image, start) for start in starts]
    assert_same(fit_many(model, [lit_scene.image] * 2, starts, method), one)


@pytest.mark.parametrize("freedom", [3.0, np.inf])
def test_batched_fits_find_the_scale_of_shapes_that_the_fitter_finds(model, lit_scene, freedom):
    shapes = replace(model.shape_of("soft"), freedom=freedom)
    model = replace(model, soft_shape=shapes)
    starts = [disturb(lit_scene.landmarks), disturb(lit_scene.landmarks, 0.98, (0.0, 0.01))]
    one = [Fitter(model).fit(lit_scene.image, start) for start in starts]
    many = fit_many(model, [lit_scene.image] * 2, starts)
    assert_same(many, one)
    spread = np.array([result.landmark_covariances for result in one])
    np.testing.assert_allclose(many.landmark_covariances, spread, rtol=0.05, atol=1e-4 * spread.max())


def test_batched_fits_are_those_of_the_fitter_with_smooth_shapes(scenes, pictures):
    model = train_on(scenes, diagonal=80.0, soft_prior="smooth")
    one = [Fitter(model).fit(image, start) for image, start in zip(*pictures, strict=True)]
    assert_same(fit_many(model, *pictures), one)


def test_a_picture_that_hardly_tells_anything_leaves_the_batch_alone(scenes, pictures):
    """Without a prior, half an object leaves directions whose curvature is rounding."""
    model = train_on(scenes, diagonal=80.0, soft_prior="smooth")
    images, starts = pictures[0][:2], pictures[1][:2]
    images = [images[0], images[1][: int(starts[1][:, 1].mean())]]
    fitter = Fitter(model, options=SolverOptions(shape_prior=0.0))
    one = [fitter.fit(image, start) for image, start in zip(images, starts, strict=True)]
    many = fit_many(model, images, starts, shape_prior=0.0)
    assert np.isfinite(many.shapes).all()
    assert many.statuses == tuple(result.status for result in one)
    np.testing.assert_allclose(many.shapes[0], one[0].shape, atol=SAME)


@pytest.mark.parametrize("backend", ["torch", "jax"])
@pytest.mark.parametrize("method", ["soft-li", "li-pc"])
def test_every_library_gives_the_same(one_level, pictures, method, backend):
    pytest.importorskip(backend, reason=f"{BACKENDS[backend]} is an extra")
    expected = fit_many(one_level, *pictures, method)
    found = fit_many(one_level, *pictures, method, backend=backend, device="cpu")
    assert found.statuses == expected.statuses
    np.testing.assert_allclose(found.shapes, expected.shapes, atol=SAME)
    assert f"on {backend}" in repr(found)


@pytest.mark.parametrize("method", ["grey", "li-pc", "soft-li"])
@pytest.mark.parametrize(
    "options",
    [{}, {"elimination": "joint"}, {"damping": 0.0, "max_iterations": 6}, {"max_iterations": 0}],
    ids=["default", "joint", "undamped", "start only"],
)
def test_the_batched_solver_goes_the_solvers_way_state_by_state(model, pictures, method, options):
    options, objective = SolverOptions(**options), finest_objective(model, method, "reference")
    prepared = []
    for image, start in zip(*pictures, strict=True):
        problem, p = make_problem(model, image, start, objective)
        prepared.append((problem, objective.start(p)))
    problems, starts = zip(*prepared, strict=True)
    batched = BatchObjective(objective, get_backend(), scores=True)
    found = BatchSolver(batched, options).solve(problems, starts)
    for problem, start, many in zip(problems, starts, found, strict=True):
        one = solve(objective, problem, start, options)
        assert (many.settled, many.flat, many.angles_held) == (one.settled, one.flat, one.angles_held)
        # Rounding decides whether weights count as changed, or a step as small: one step more or less at the end.
        assert abs(many.n_iterations - one.n_iterations) <= 2
        assert abs(len(many.path) - len(one.path)) <= 2
        if method != "soft-li":
            assert len(many.path) == len(one.path)
        n = 4 if method == "soft-li" else len(one.path)
        pairs = zip((*many.path[:n], many.path[-1]), (*one.path[:n], one.path[-1]), strict=True)
        for (cost, state), (own_cost, own) in pairs:
            assert cost == pytest.approx(own_cost, rel=0.05 if method == "soft-li" else 1e-2)  # its weights move
            np.testing.assert_allclose(state.p, own.p, atol=0.02 * np.sqrt(model.n_points))
        np.testing.assert_array_equal(many.last.weights, one.last.weights)


@pytest.mark.parametrize("method", ["li", "li-pc", "grey", "li-lit"])
def test_scoring_is_taken_as_asked(one_level, pictures, method):
    fitter = Fitter(one_level, method, SolverOptions(scoring=3))
    one = [fitter.fit(*picture) for picture in zip(*pictures, strict=True)]
    assert_same(fit_many(one_level, *pictures, method, scoring=3), one)


def test_a_fit_that_fails_leaves_the_others_alone(model, same_light_scene):
    image, start = same_light_scene.image, disturb(same_light_scene.landmarks)
    grey = np.full_like(image, 0.4)
    holes = np.full_like(image, np.nan)
    far = start + np.array([0.9 * (image.shape[1] - start[:, 0].min()), 0.0])  # a few landmarks left inside
    far = np.where(np.arange(len(start))[:, None] < len(start) // 4, start, far)
    bad = [(grey, start), (holes, start), (image, far), (np.zeros_like(image), start)]
    for method in ("soft-li", "grey"):
        alone = fit_many(model, [image], [start], method)
        images, starts = zip(*bad, strict=True)
        many = fit_many(model, [*images[:2], image, *images[2:]], [*starts[:2], start, *starts[2:]], method)
        assert alone.statuses[0] == many.statuses[2] == FitStatus.CONVERGED
        np.testing.assert_allclose(many.shapes[2], alone.shapes[0], atol=1e-3)
        assert not many.ok[[0, 1, 3, 4]].any()
        expected = [Fitter(model, method).fit(*picture).status for picture in bad]
        assert [many.statuses[i] for i in (0, 1, 3, 4)] == expected
        assert len(many.messages) == 5


def test_pictures_of_different_sizes_share_a_batch(model, same_light_scene):
    image, truth = same_light_scene.image, same_light_scene.landmarks
    low, high = truth.min(axis=0).astype(int) - 12, truth.max(axis=0).astype(int) + 14
    crop = image[low[1] : high[1], low[0] : high[0]]
    images, starts = [image, crop], [disturb(truth), disturb(truth) - low]
    one = [Fitter(model, "li").fit(*picture) for picture in zip(images, starts, strict=True)]
    assert_same(fit_many(model, images, starts, "li"), one)


@pytest.mark.parametrize("method", ["grey-norm", "grey+tukey", "li+noise"])
def test_methods_that_cannot_be_batched_are_refused_with_a_remedy(model, pictures, method):
    with pytest.raises(MethodError, match=r"batched fits cannot do .*; fit one by one with Fitter"):
        fit_many(model, *pictures, method)


def test_bad_input_is_named(model, pictures):
    images, starts = pictures
    with pytest.raises(StartError, match="there are 4 images but 3 starts; give one start for each image"):
        fit_many(model, images, starts[:3])
    with pytest.raises(StartError, match="image 2: the start has 3 landmarks"):
        fit_many(model, images, [*starts[:2], np.zeros((3, 2)), starts[3]], batch_size=2)
    with pytest.raises(ImageError, match="image 1: the picture is grey"):
        fit_many(model, [images[0], images[1].mean(axis=2)], starts[:2], "li")
    with pytest.raises(MethodError, match="batch_size of 0"):
        fit_many(model, images, starts, batch_size=0)
    with pytest.raises(MethodError, match="option 'iterations' does not exist"):
        fit_many(model, images, starts, iterations=3)
    with pytest.raises(MethodError, match="backend 'tensorflow' does not exist"):
        BatchFitter(Fitter(model), "tensorflow")


def test_no_pictures_give_no_results(model):
    assert fit_many(model, [], []).shapes.shape == (0, model.n_points, 2)


@pytest.mark.parametrize(("size", "rounded"), [(1, 1), (2, 2), (3, 3), (5, 6), (7, 8), (97, 128), (65, 96), (64, 64)])
def test_sizes_recur(size, rounded):
    assert recurring(size) == rounded
