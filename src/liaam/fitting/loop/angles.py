"""Initial angle of the image's camera: for fixed p, theta_2 and lambda have a joint closed-form optimum."""

import numpy as np

from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import RIDGE, Objective, State

SEARCH = np.deg2rad(60.0)
"""Largest distance of the initial angle from the model's. Physical cameras have 90-135 degrees. Far from the object,
the global minimum over the full circle is often an inverted image."""


def best_image_angle(objective: Objective, image: EncodedImage, state: State) -> float:
    """Find the angle theta_2 that minimises the cost of eq 10 over theta_2 and lambda, at the state's shape.

    With u = (cos theta_2, sin theta_2) the cost is u'Su - 2 b'u + const. S and b hold inner products of the
    two log-chromaticity columns log R - log B and log G - log B with the appearance projected out. On the unit circle
    the cost has at most four stationary points, the roots of a quartic. The best within :data:`SEARCH` of theta_1 is
    returned, radians, or the state's own theta_2 if no pixel is usable.
    """
    seen = objective.evaluate(image, state)
    root = seen["masked"].astype(np.float64)
    log_r, log_g, log_b = seen["values"][:, :3].astype(np.float64).T
    columns = np.stack([log_r - log_b, log_g - log_b, seen["modes"][0]]) * root
    modes = seen["modes"][1:] * root
    gram = modes @ modes.T
    cross = modes @ columns.T
    gram += RIDGE * max(gram.diagonal().max(initial=0.0), 1e-300) * np.eye(len(gram))
    inner = columns @ columns.T - cross.T @ np.linalg.solve(gram, cross)
    if not np.isfinite(inner).all() or inner[0, 0] + inner[1, 1] <= 0:
        return float(state.angles[1])
    return _minimise_on_arc(inner[:2, :2], inner[:2, 2], float(state.angles[0]), SEARCH)


def _minimise_on_arc(S: np.ndarray, b: np.ndarray, centre: float, reach: float) -> float:
    """Find the angle t within ``reach`` of ``centre`` that minimises u'Su - 2b'u over u = (cos t, sin t)."""
    # With z = exp(it) the cost is Re(second z^2) - 2 Re(first z). Its stationary points are roots of a quartic on
    # the unit circle.
    second = complex(0.5 * (S[0, 0] - S[1, 1]), -S[0, 1])
    first = complex(b[0], -b[1])
    roots = np.roots([second, -first, 0.0, np.conj(first), -np.conj(second)])
    around = np.angle(np.exp(1j * (np.angle(roots[np.abs(roots) > 0]) - centre)))
    offsets = np.concatenate([around[np.abs(around) <= reach], [-reach, 0.0, reach]])
    u = np.stack([np.cos(centre + offsets), np.sin(centre + offsets)])
    cost = np.einsum("it,ij,jt->t", u, S, u) - 2 * b @ u
    return centre + float(offsets[cost.argmin()])
