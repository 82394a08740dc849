"""Kalman filter of a track with a white-noise acceleration model, independent of shapes and images.

Time is in frames. The variance of the measurement noise and the density of the acceleration are estimated from second
differences of the measurements, in which constant velocity cancels. Noise of variance r contributes 6 r to their
variance and -4 r to the covariance of neighbours. Acceleration of density q contributes 2/3 q and 1/6 q.
"""

from dataclasses import dataclass, replace

import numpy as np

# Squared innovation, in variances, above which the prediction's covariance is inflated: three standard deviations
GATE = 9.0
MEMORY = 25.0  # Number of second differences that the running moments average
STEADY = 8.0  # Weight of the initial moments, in second differences
LEAST_SHARE = 1e-3  # Minimum fraction of a fit's covariance that changes from frame to frame
# Initial values: the fraction of a fit's variance that changes from frame to frame, and the density of acceleration
# divided by the fit's variance. They smooth a little, and lose their influence within a second.
FIRST_SHARE, FIRST_DRIVE = 0.2, 0.05


@dataclass(frozen=True, eq=False)
class Belief:
    """Gaussian estimate of k positions and their velocities, with their covariances pp, pv and vv, (k, k) each."""

    position: np.ndarray
    velocity: np.ndarray
    pp: np.ndarray
    pv: np.ndarray
    vv: np.ndarray


def first_belief(position: np.ndarray, noise: np.ndarray, speed: np.ndarray) -> Belief:
    """Return the estimate after a first measurement of covariance ``noise``; ``speed`` (k,) deviates from rest."""
    k = len(position)
    return Belief(position, np.zeros(k), noise, np.zeros((k, k)), np.diag(np.square(speed)))


def predict(belief: Belief, drive: np.ndarray) -> Belief:
    """Return the estimate one frame later. ``drive`` (k,) is the spectral density of the acceleration."""
    each = np.diag(drive)
    pv = belief.pv + belief.vv
    pp = belief.pp + (belief.pv + pv.T) + each / 3.0
    return Belief(belief.position + belief.velocity, belief.velocity, pp, pv + each / 2.0, belief.vv + each)


def update(belief: Belief, measured: np.ndarray, noise: np.ndarray) -> Belief:
    """Return the estimate after another measurement, from the prediction.

    ``noise`` (k, k) is positive definite. The new ``pp`` is at most ``noise`` and at most the prediction's.
    """
    total = belief.pp + noise
    # Gains of the positions, then of the velocities.
    gains = np.linalg.solve(total, np.concatenate([belief.pp, belief.pv.T]).T).T
    k, innovation = len(measured), measured - belief.position
    step = gains @ innovation
    pp, vv = gains[:k] @ noise, belief.vv - gains[k:] @ belief.pv
    return Belief(
        belief.position + step[:k],
        belief.velocity + step[k:],
        0.5 * (pp + pp.T),
        belief.pv - gains[:k] @ belief.pv,
        0.5 * (vv + vv.T),
    )


def widened(belief: Belief, measured: np.ndarray, noise: np.ndarray) -> Belief:
    """Inflate the covariance of coordinates with large innovations, so that the filter follows sudden motion at once.

    The updated estimate of a single coordinate is within sqrt(GATE) standard deviations of the measurement.
    """
    innovation = measured - belief.position
    excess = np.square(innovation) / GATE - np.diag(belief.pp) - np.diag(noise)
    if not (excess > 0).any():
        return belief
    more = np.diag(np.maximum(excess, 0.0))
    # A wrong position implies a wrong velocity.
    return replace(belief, pp=belief.pp + more, pv=belief.pv + 0.5 * more, vv=belief.vv + 0.5 * more)


@dataclass(frozen=True, eq=False)
class Moments:
    """Running moments of a track's second differences.

    ``mean_square`` (k,) is theirs, and ``mean_product`` (k,) that of one with the next, over ``weight`` differences.
    ``last`` holds up to three measurements of consecutive frames, the newest last; it is empty after a
    frame without a measurement.
    """

    mean_square: np.ndarray
    mean_product: np.ndarray
    weight: float
    last: tuple[np.ndarray, ...] = ()


def first_moments(variances: np.ndarray) -> Moments:
    """Return the initial moments of a track, from the fit's variances (k,)."""
    noise, drive = FIRST_SHARE * variances, FIRST_DRIVE * variances
    return Moments(6.0 * noise + 2.0 / 3.0 * drive, -4.0 * noise + drive / 6.0, STEADY)


def observed(moments: Moments, measured: np.ndarray) -> Moments:
    """Return the moments after the measurement (k,) of the next frame."""
    last = (*moments.last, measured)
    if len(last) < 4:
        return replace(moments, last=last)
    before, now = last[0] - 2 * last[1] + last[2], last[1] - 2 * last[2] + last[3]
    weight = min(moments.weight + 1.0, MEMORY)
    share = 1.0 / weight
    return Moments(
        moments.mean_square + share * (0.5 * (before**2 + now**2) - moments.mean_square),
        moments.mean_product + share * (before * now - moments.mean_product),
        weight,
        last[1:],
    )


def noise_and_drive(moments: Moments, variances: np.ndarray) -> tuple[float, np.ndarray]:
    """Estimate the scatter of the measurements and the acceleration of the coordinates from the fit's variances (k,).

    Return the fraction of these variances that changes from frame to frame, median over the coordinates, and the
    density of each coordinate's acceleration (k,). The rest is constant, such as the error of the model.
    """
    scatter = (moments.mean_square - 4.0 * moments.mean_product) / 22.0
    middle = float(np.sort(scatter / variances)[len(scatter) // 2])
    share = min(max(middle, LEAST_SHARE), 1.0)
    drive = 1.5 * (moments.mean_square - 6.0 * share * variances)
    return share, np.maximum(drive, 1e-4 * share * variances)
