"""Steps are what their formulas say, in both kernels; and what cannot be told does not move."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from liaam.fitting import METHODS
from liaam.fitting.kernel import KERNELS
from liaam.fitting.level import LEAST_CURVATURE, PULL, ROTATIONS, SCALE, Picture, Row, Template, Work
from liaam.fitting.steps import DAMPING_FLOOR, OBSERVABLE_APART, ROUNDING, TO_AND_FRO
from setups import Kernel

seeds, dampings = st.integers(0, 999), st.sampled_from([0.0, 1e-3, 1.0, 1e4])
free_entries = st.lists(st.booleans(), min_size=8, max_size=8).map(np.array)


@pytest.fixture(params=KERNELS, scope="module")
def kernel(request) -> Kernel:
    return Kernel(request.param)


def symmetric(rng: np.random.Generator, eigenvalues: np.ndarray) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(len(eigenvalues), len(eigenvalues))))[0]
    return (turn * eigenvalues) @ turn.T


def damped(kernel, hessian, gradient, free, damping) -> tuple[bool, np.ndarray]:
    step = np.full(len(free), np.nan)
    work = kernel.record(
        Work, hessian=hessian, gradient=gradient, free=free, small=np.empty((1, *hessian.shape)), step=step
    )
    return kernel.damped(work, damping), step


def raised(kernel, base, hessian, gradient, free, damping, least=LEAST_CURVATURE) -> tuple[bool, np.ndarray]:
    step = np.full(len(free), np.nan)
    room = {
        "small": np.empty((2, *base.shape)),
        "spectrum": np.empty((4, len(free))),
        "rotations": np.empty((ROTATIONS * len(free) ** 2, 3)),
    }
    given = {"damper": base, "hessian": hessian, "gradient": gradient, "free": free, "scales": np.full(7, least)}
    return kernel.raised(kernel.record(Work, **given, **room, step=step), damping), step


@given(n=st.integers(1, 8), rank=st.integers(1, 8), free=free_entries, damping=dampings, seed=seeds)
def test_a_damped_step_solves_its_system(kernel, n, rank, free, damping, seed):
    """(H + damping diag H) step = -gradient, with a floor that only a flat direction feels."""
    rng, free = np.random.default_rng(seed), free[:n]
    half = rng.normal(size=(n, min(rank, n)))
    hessian, gradient = half @ half.T, half @ rng.normal(size=half.shape[1])
    found, step = damped(kernel, hessian.copy(), gradient, free, damping)
    assert found == free.any()
    assert not step[~free].any()
    if not found:
        return
    own, floor = hessian[np.ix_(free, free)], DAMPING_FLOOR * hessian.diagonal()[free].max()
    system = own + np.diag(damping * np.maximum(own.diagonal(), floor) + floor)
    scale = np.abs(gradient).max()
    np.testing.assert_allclose(system @ step[free], -gradient[free], atol=1e-6 * scale)


@pytest.mark.parametrize("hessian", [np.zeros((2, 2)), np.full((2, 2), np.nan), -np.eye(2), np.diag([1.0, -1.0])])
def test_a_system_without_a_solution_gives_no_step(kernel, hessian):
    free = np.ones(2, bool)
    found, step = damped(kernel, hessian, np.ones(2), free, 0.0)
    assert not found and not step.any()
    assert not raised(kernel, hessian, -np.eye(2), np.ones(2), free, 0.0)[0]


def formula(base, hessian, gradient, damping, least) -> np.ndarray:
    """With H v = rho B v: rho becomes max(rho, least) + damping."""
    rho, axes = eigh(hessian, base + ROUNDING * base.diagonal().max() * np.eye(len(base)))
    return axes @ ((axes.T @ -gradient) / (np.maximum(rho, least) + damping))


@given(
    n=st.integers(1, 8),
    flattest=st.sampled_from([-5.0, -0.1, 0.0, 0.3, 0.49, 0.51, 2.0]),
    free=free_entries,
    least=st.sampled_from([LEAST_CURVATURE, 2.0]),
    damping=dampings,
    seed=seeds,
)
def test_a_raised_step_is_nowhere_flatter_than_a_share_of_what_is_expected(
    kernel, n, flattest, free, least, damping, seed
):
    rng, free = np.random.default_rng(seed), free[:n]
    base, gradient = symmetric(rng, np.geomspace(1.0, 1e3, n)), rng.normal(size=n)
    root = np.linalg.cholesky(base)
    hessian = root @ symmetric(rng, rng.uniform(flattest, flattest + 2.0, n)) @ root.T
    hessian = 0.5 * (hessian + hessian.T)
    found, step = raised(kernel, base.copy(), hessian.copy(), gradient, free, damping, least)
    assert found == free.any()
    assert np.abs(step[~free]).max(initial=0.0) < 1e-12
    if found:
        own = np.ix_(free, free)
        expected = formula(base[own], hessian[own], gradient[free], damping, least)
        np.testing.assert_allclose(step[free], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@given(seed=seeds)
def test_a_step_is_the_same_just_above_and_just_below_the_least_curvature(kernel, seed):
    """Where all is steep enough the system is solved as it is, else by its axes: one formula."""
    rng = np.random.default_rng(seed)
    base, gradient, free = symmetric(rng, np.geomspace(1.0, 50.0, 5)), rng.normal(size=5), np.ones(5, bool)
    root = np.linalg.cholesky(base)
    above, below = (
        raised(kernel, base.copy(), root @ np.diag([0.5 + by, 0.9, 1.0, 1.5, 3.0]) @ root.T, gradient, free, 0.1)[1]
        for by in (1e-6, -1e-6)
    )
    np.testing.assert_allclose(above, below, rtol=1e-4, atol=1e-7)


def test_a_base_that_is_flat_somewhere_is_no_fault(kernel, rng):
    base, gradient = symmetric(rng, np.array([3.0, 2.0, 1.0, 0.0])), rng.normal(size=4)
    gradient = base @ gradient  # nothing is asked for along what is flat
    found, step = raised(kernel, base, 0.8 * base, gradient, np.ones(4, bool), 0.0)
    assert found
    np.testing.assert_allclose(base @ step, -gradient / 0.8, rtol=1e-4, atol=1e-4)


def test_what_is_steep_by_rounding_only_is_lifted(kernel):
    """A base that is flat but for rounding is lifted out of it, whatever the Hessian says there."""
    gradient = np.array([0.0, 1e-6])
    for least, slope in ((1e-9, 2e-9), (0.0, 1e-14)):
        step = raised(kernel, np.diag([1.0, least]), np.diag([1.0, slope]), gradient, np.ones(2, bool), 0.0)[1]
        assert np.abs(step).max() <= 20.0 + 1e-6


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_raised_step_is_made_of_what_is_no_number(kernel, bad):
    free = np.ones(3, bool)
    for of_base in (False, True):
        base, hessian = np.eye(3), 0.1 * np.eye(3)
        (base if of_base else hessian)[1, 0] = bad
        (base if of_base else hessian)[0, 1] = bad
        found, step = raised(kernel, base, hessian, np.ones(3), free, 0.0)
        assert not found or not np.isfinite(step).all()


@pytest.mark.parametrize("fault", ["no gradient is expected", "what is expected is no number", "no number", "no pixel"])
def test_no_step_is_made_of_nothing(kernel, rng, fault):
    own, base, sums = symmetric(rng, np.arange(1.0, 6.0)), np.eye(5), np.array([3.0, 40.0])
    work = kernel.record(Work, hessian=own, base=base, sums=sums, p=np.zeros(4))  # the last is an angle
    assert kernel.has_texture(work)
    if fault == "no gradient is expected":
        base[:4] = 0.0
    elif fault == "what is expected is no number":
        base[0, 1] = np.nan
    elif fault == "no number":
        own[0, 1] = np.inf
    else:
        sums[1] = 0.0
    assert not kernel.has_texture(work)


def test_neither_an_angle_nor_a_prior_makes_up_for_a_flat_picture(kernel):
    rest = {"base": np.eye(3), "sums": np.array([1.0, 100.0]), "p": np.zeros(2)}
    assert not kernel.has_texture(kernel.record(Work, hessian=np.diag([1e-9, 1e-9, 5.0]), **rest))
    assert kernel.has_texture(kernel.record(Work, hessian=np.diag([1e-3, 0.0, 0.0]), **rest))


@given(n=st.integers(1, 6), back=st.floats(-2.0, 2.0), seed=seeds)
def test_steps_to_and_fro_are_told(kernel, n, back, seed):
    """By their scalar product in a metric: what lies across the last step does not count."""
    rng = np.random.default_rng(seed)
    metric, last, other = symmetric(rng, np.geomspace(1.0, 50.0, n)), *rng.normal(size=(2, n))
    across = other - last * (other @ metric @ last) / (last @ metric @ last)
    found = kernel.goes_back(across - back * last, last, metric)
    assert found == (back > TO_AND_FRO) or back == pytest.approx(TO_AND_FRO)
    assert not kernel.goes_back(other, np.zeros(n), metric)  # no step before


def test_lengths_are_told_by_a_metric(kernel, rng):
    metric, step = symmetric(rng, np.arange(1.0, 5.0)), rng.normal(size=4)
    assert kernel.squared_length(step, metric) == pytest.approx(step @ metric @ step)


def test_a_step_is_taken_and_undone(kernel, rng):
    directions = np.array([[1.0, 0.0], [1.0, 1.0]])
    p, angles, lam = rng.normal(size=3), rng.normal(size=2), rng.normal(size=4)
    step, lam_step, before = rng.normal(size=5), rng.normal(size=4), np.empty(9)
    there = p.copy(), angles.copy(), lam.copy()
    state = dict(zip(("p", "angles", "lam"), there, strict=True))
    work = kernel.record(Work, **state, step=step, lam_step=lam_step, before=before)
    kernel.move(kernel.record(Row, directions=directions), work)
    expected = p + step[:3], angles + directions @ step[3:], lam + lam_step
    for found, wanted in zip(there, expected, strict=True):
        np.testing.assert_allclose(found, wanted)
    kernel.go_back(work)
    for found, wanted in zip(there, (p, angles, lam), strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_a_prior_is_part_of_the_system_and_of_the_cost(kernel, rng):
    prior, p, base = rng.random(3), rng.normal(size=3), symmetric(rng, np.arange(1.0, 5.0))
    precision, metric, hessian, gradient = np.empty(3), base.copy(), 2 * base, rng.normal(size=4)
    bare = gradient.copy()
    system = {"damper": metric, "hessian": hessian, "gradient": gradient}
    kernel.add_prior(
        kernel.record(Template, prior=prior), kernel.record(Work, p=p, precision=precision, **system), 2.0 * 0.3
    )
    np.testing.assert_allclose(precision, 0.6 * prior)
    wide = np.diag([*precision, 0.0])
    np.testing.assert_allclose(metric, base + wide)
    np.testing.assert_allclose(hessian, 2 * base + wide)
    np.testing.assert_allclose(gradient[:3], bare[:3] + precision * p)
    assert gradient[3] == bare[3]
    lam, ridge = rng.normal(size=2), rng.random(2)

    def merit(sums: list[float]) -> float:
        state = {"p": p, "precision": precision, "lam": lam, "scales": np.zeros(7), "sums": np.array(sums)}
        return kernel.merit_of(
            kernel.record(Template, ridge=ridge), kernel.record(Picture), kernel.record(Work, **state)
        )

    assert merit([5.0, 10.0]) == pytest.approx((5.0 + precision @ p**2 + ridge @ lam**2) / 10.0)
    assert merit([0.0, 0.0]) == np.inf  # no pixel counts


def test_points_of_another_landmarker_are_part_of_the_system_and_of_the_cost(kernel, rng):
    pull, towards, p = symmetric(rng, np.arange(1.0, 4.0)), rng.normal(size=3), rng.normal(size=3)
    metric, hessian, gradient = np.zeros((4, 4)), np.ones((4, 4)), np.ones(4)
    their, scales = kernel.record(Picture, pull=pull, towards=towards), np.zeros(7)
    scales[PULL] = 0.3
    system = {"damper": metric, "hessian": hessian, "gradient": gradient}
    kernel.add_points(their, kernel.record(Work, p=p, scales=scales, **system))
    wide = np.zeros((4, 4))
    wide[:3, :3] = 0.3 * pull
    np.testing.assert_allclose(metric, wide)
    np.testing.assert_allclose(hessian, 1.0 + wide)
    np.testing.assert_allclose(gradient, [*(1.0 + 0.3 * pull @ (p - towards)), 1.0])

    def merit(p: np.ndarray) -> float:
        state = {"p": p, "precision": np.zeros(3), "scales": scales, "sums": np.array([5.0, 10.0])}
        return kernel.merit_of(kernel.record(Template), their, kernel.record(Work, **state))

    assert merit(towards) == pytest.approx(0.5)
    slope = [(merit(p + step) - merit(p - step)) / 2e-4 for step in 1e-4 * np.eye(3)]  # of squares / 10: twice J'r / 10
    np.testing.assert_allclose(slope, 0.2 * (gradient[:3] - 1.0), rtol=1e-6)


# What angles can be told.


def told(kernel, free_angles: str, hessian: np.ndarray, noise: float, observable: float = 25.0) -> list[bool]:
    """Which of (a parameter, the free angles) may move; noise as much as ``noise`` times an angle's unit curvature."""
    directions = np.ascontiguousarray(METHODS[free_angles].angle_directions, dtype=np.float64)
    whole = np.eye(1 + len(hessian))
    whole[1:, 1:] = hessian
    free = np.zeros(len(whole), bool)
    metric, slope = np.ones(8, np.float32), np.ones(8, np.float32)  # |L'|^2 / |L|^2 = 1
    seen = {"metric": metric, "slope": slope, "hessian": whole, "sums": np.array([noise, 1.0])}
    row, work = kernel.record(Row, directions=directions), kernel.record(Work, **seen, free=free)
    all_free = kernel.free_entries(row, work, observable)
    assert all_free == free.all()
    return free.tolist()


@pytest.mark.parametrize(("curvature", "free"), [(24.0, False), (26.0, True), (np.nan, False)])
def test_a_shared_angle_is_held_where_noise_would_turn_it(kernel, curvature, free):
    assert told(kernel, "li-pcs", np.array([[curvature]]), 1.0) == [True, free]


@pytest.mark.parametrize(("curvature", "free"), [(0.9 * OBSERVABLE_APART, False), (1.1 * OBSERVABLE_APART, True)])
def test_an_angle_of_the_picture_alone_is_told_sooner(kernel, curvature, free):
    assert told(kernel, "li", np.array([[curvature]]), 1.0) == [True, free]
    assert told(kernel, "li", np.array([[curvature]]), 1.0, observable=0.0) == [True, True]  # the paper holds none


@pytest.mark.parametrize(
    ("together", "apart", "free"),
    [(30.0, 30.0, (True, True)), (20.0, 30.0, (False, True)), (30.0, 1.0, (False, False))],
)
def test_of_two_angles_the_picture_s_is_told_first(kernel, together, apart, free):
    """In (both turned together, theta_2 alone), without cross terms; the Hessian is of (theta_1, theta_2)."""
    hessian = np.array([[together + apart, -apart], [-apart, apart]])
    assert told(kernel, "li-pc", hessian, 1.0) == [True, *free]


def test_without_angles_all_may_move(kernel):
    assert told(kernel, "grey", np.zeros((0, 0)), 1.0) == [True]


# The scale of the shape prior's variances, estimated in each picture.


def picture(rng, scale, n=30, rigid=4):
    """Give what a picture tells of parameters: Hessian, unit, precision of the prior, and where alone it would end."""
    root = rng.normal(size=(n + rigid, n + rigid)) / 6
    hessian, unit = root @ root.T + 0.01 * np.eye(n + rigid), 0.3
    prior = np.concatenate([rng.uniform(0.5, 20.0, n), np.zeros(rigid)])
    truth = np.concatenate([rng.normal(size=n) * np.sqrt(scale / prior[:n]), rng.normal(size=rigid)])
    seen = truth + np.linalg.cholesky(unit * np.linalg.inv(hessian)) @ rng.normal(size=n + rigid)
    return hessian, unit, prior, seen


def next_scale(kernel, hessian, p, prior, unit, freedom, scale, strength=1.0):
    scales, small = np.zeros(7), np.empty((2, *hessian.shape))
    scales[SCALE] = scale
    template = kernel.record(Template, prior=prior, freedom=freedom)
    return kernel.next_scale(
        template, kernel.record(Work, damper=hessian, p=p, scales=scales, small=small), strength, unit
    )


def converged(kernel, hessian, unit, prior, seen, freedom, strength=1.0):
    scale = 1.0
    for _ in range(3000 if kernel.name == "fast" else 300):
        p = np.linalg.solve(hessian / unit + np.diag(strength * prior / scale), hessian @ seen / unit)
        new = next_scale(kernel, hessian, p, prior, unit, freedom, scale, strength)
        if abs(new / scale - 1) < 1e-9:
            break
        scale = new
    return scale


@pytest.mark.parametrize("scale", [0.1, 1.0, 8.0])
@pytest.mark.parametrize("freedom", [3.0, 20.0])
def test_the_scale_is_the_most_probable_one(kernel, rng, scale, freedom):
    hessian, unit, prior, seen = picture(rng, scale)
    n = int((prior > 0).sum())
    spread = (unit * np.linalg.inv(hessian))[:n, :n]  # the similarity may be anything

    def unlikely(log_scale):
        s = np.exp(log_scale)
        whole = np.diag(s / prior[:n]) + spread
        y = seen[:n]
        return 0.5 * (y @ np.linalg.solve(whole, y) + np.linalg.slogdet(whole)[1] + freedom * (np.log(s) + 1 / s))

    best = np.exp(minimize_scalar(unlikely, bounds=(-6, 6), method="bounded", options={"xatol": 1e-9}).x)
    assert converged(kernel, hessian, unit, prior, seen, freedom) == pytest.approx(best, rel=1e-2)


def test_the_strength_of_a_prior_is_part_of_it(kernel, rng):
    hessian, unit, prior, seen = picture(rng, 1.0)
    stronger = converged(kernel, hessian, unit, 4.0 * prior, seen, 3.0)
    assert converged(kernel, hessian, unit, prior, seen, 3.0, strength=4.0) == pytest.approx(stronger, rel=1e-6)


def test_angles_do_not_count_for_the_scale(kernel, rng):
    hessian, unit, prior, p = picture(rng, 1.0)
    wider = np.zeros((len(p) + 1, len(p) + 1))
    wider[:-1, :-1], wider[-1, -1] = hessian, 1e6
    wider[-1, 0] = wider[0, -1] = 3.0
    expected = next_scale(kernel, hessian, p, prior, unit, 3.0, 0.7)
    assert next_scale(kernel, wider, p, prior, unit, 3.0, 0.7) == pytest.approx(expected)


def test_many_degrees_of_freedom_leave_the_variances_as_they_are(kernel, rng):
    assert converged(kernel, *picture(rng, 8.0), 1e9) == pytest.approx(1.0, abs=1e-6)


def test_a_picture_that_tells_nothing_leaves_the_scale_alone(kernel, rng):
    hessian, unit, prior, p = picture(rng, 1.0)
    for bad in (np.full_like(hessian, np.nan), np.full_like(hessian, np.inf)):
        assert next_scale(kernel, bad, p, prior, unit, 3.0, 0.7) == 0.7
    for unit in (0.0, np.nan, np.inf):
        assert next_scale(kernel, hessian, p, prior, unit, 3.0, 0.7) == 0.7
    # A flat picture: nothing is told, so that the squares alone count.
    assert next_scale(kernel, 0 * hessian, 0 * p, prior, 1.0, 3.0, 0.7) == pytest.approx(1.0, abs=1e-3)
