"""The scale of the shape prior's variances, estimated in each picture."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from liaam.fitting.prior import next_scale, next_scale_of_one


def picture(rng, scale, n=30, rigid=4):
    """Give what a picture tells of parameters: Hessian, unit, precision of the prior, and where alone it would end."""
    root = rng.normal(size=(n + rigid, n + rigid)) / 6
    hessian, unit = root @ root.T + 0.01 * np.eye(n + rigid), 0.3
    prior = np.concatenate([rng.uniform(0.5, 20.0, n), np.zeros(rigid)])
    truth = np.concatenate([rng.normal(size=n) * np.sqrt(scale / prior[:n]), rng.normal(size=rigid)])
    seen = truth + np.linalg.cholesky(unit * np.linalg.inv(hessian)) @ rng.normal(size=n + rigid)
    return hessian, unit, prior, seen


def settled(hessian, unit, prior, seen, freedom):
    scale = np.asarray(1.0)
    for _ in range(3000):
        p = np.linalg.solve(hessian / unit + np.diag(prior / scale), hessian @ seen / unit)
        scale = next_scale(hessian, p, prior, np.asarray(unit), freedom, scale)
    return float(scale)


@pytest.mark.parametrize("scale", [0.1, 1.0, 8.0])
@pytest.mark.parametrize("freedom", [3.0, 20.0])
def test_the_scale_is_the_most_probable_one(rng, scale, freedom):
    hessian, unit, prior, seen = picture(rng, scale)
    n = int((prior > 0).sum())
    spread = (unit * np.linalg.inv(hessian))[:n, :n]  # the similarity may be anything

    def unlikely(log_scale):
        s = np.exp(log_scale)
        whole = np.diag(s / prior[:n]) + spread
        y = seen[:n]
        return 0.5 * (y @ np.linalg.solve(whole, y) + np.linalg.slogdet(whole)[1] + freedom * (np.log(s) + 1 / s))

    best = np.exp(minimize_scalar(unlikely, bounds=(-6, 6), method="bounded", options={"xatol": 1e-9}).x)
    assert settled(hessian, unit, prior, seen, freedom) == pytest.approx(best, rel=1e-3)


def test_many_degrees_of_freedom_leave_the_variances_as_they_are(rng):
    assert settled(*picture(rng, 8.0), 1e9) == pytest.approx(1.0, abs=1e-6)


def test_a_picture_that_tells_nothing_leaves_the_scale_alone(rng):
    hessian, unit, prior, p = picture(rng, 1.0)
    last = np.asarray(0.7)
    for bad in (np.full_like(hessian, np.nan), np.full_like(hessian, np.inf)):
        assert next_scale(bad, p, prior, np.asarray(unit), 3.0, last) == 0.7
    for unit in (0.0, np.nan, np.inf):
        assert next_scale(hessian, p, prior, np.asarray(unit), 3.0, last) == 0.7
    # A flat picture: nothing is told, so that the squares alone count.
    assert next_scale(0 * hessian, 0 * p, prior, np.asarray(1.0), 3.0, last) == pytest.approx(1.0, abs=1e-3)


def test_pictures_of_a_batch_do_not_see_each_other(rng):
    several = [picture(rng, scale) for scale in (0.1, 1.0, 9.0)]
    prior = several[0][2]
    hessians, ps = np.array([each[0] for each in several]), np.array([each[3] for each in several])
    units, scales = np.array([0.3, 0.2, 0.5]), np.array([1.0, 0.5, 2.0])
    together = next_scale(hessians, ps, prior, units, 5.0, scales)
    alone = [next_scale(h, p, prior, u, 5.0, s) for h, p, u, s in zip(hessians, ps, units, scales, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-9)


@pytest.mark.parametrize("unit", [0.3, 0.0, np.nan, np.inf])
@pytest.mark.parametrize("spoilt", [1.0, 0.0, np.nan])
def test_one_picture_has_the_scale_that_it_has_in_a_batch(rng, unit, spoilt):
    hessian, _, prior, p = picture(rng, 2.0)
    hessian = spoilt * hessian
    expected = next_scale(hessian, p, prior, np.asarray(unit), 5.0, np.asarray(0.7))
    assert next_scale_of_one(hessian, p, prior, unit, 5.0, 0.7) == pytest.approx(float(expected), rel=1e-6)
