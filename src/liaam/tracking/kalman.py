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
LEAST_DRIVE = 1e-4  # Minimum density of acceleration, divided by the noise, so that no object counts as exactly steady
# Initial values. They smooth a little, and lose their influence within a second.
FIRST_SHARE = 0.2  # The fraction of a fit's variance that changes from frame to frame
FIRST_DRIVE = 0.05  # The density of acceleration divided by the fit's variance


@dataclass(frozen=True, eq=False)
class Belief:
    """Gaussian estimate of k positions and of their velocities per frame."""

    position: np.ndarray  # (k,)
    velocity: np.ndarray  # (k,)
    pp: np.ndarray  # (k, k): covariance of the positions
    pv: np.ndarray  # (k, k): covariance of the positions with the velocities
    vv: np.ndarray  # (k, k): covariance of the velocities


def first_belief(position: np.ndarray, noise: np.ndarray, speed: np.ndarray) -> Belief:
    """Return the estimate after a first measurement of covariance ``noise``; ``speed`` (k,) deviates from rest."""
    k = len(position)
    return Belief(position, np.zeros(k), noise, np.zeros((k, k)), np.diag(np.square(speed)))


def predict(belief: Belief, drive: np.ndarray) -> Belief:
    """Return the estimate one frame later. ``drive`` (k,) is the spectral density of the acceleration."""
    # White-noise acceleration over one frame adds 1/3, 1/2 and 1 times its density.
    added = np.diag(drive)
    pv = belief.pv + belief.vv
    pp = belief.pp + (belief.pv + pv.T) + added / 3.0
    return Belief(
        position=belief.position + belief.velocity,
        velocity=belief.velocity,
        pp=pp,
        pv=pv + added / 2.0,
        vv=belief.vv + added,
    )


def update(belief: Belief, measured: np.ndarray, noise: np.ndarray) -> Belief:
    """Return the estimate after another measurement, from the prediction.

    ``noise`` (k, k) is positive definite. The new ``pp`` is at most ``noise`` and at most the prediction's.
    """
    total = belief.pp + noise
    # Gains of the positions, then of the velocities.
    gains = np.linalg.solve(total, np.concatenate([belief.pp, belief.pv.T]).T).T
    k = len(measured)
    innovation = measured - belief.position
    step = gains @ innovation
    pp = gains[:k] @ noise
    pv = belief.pv - gains[:k] @ belief.pv
    vv = belief.vv - gains[k:] @ belief.pv
    return Belief(
        position=belief.position + step[:k],
        velocity=belief.velocity + step[k:],
        pp=0.5 * (pp + pp.T),  # symmetric, whatever the rounding
        pv=pv,
        vv=0.5 * (vv + vv.T),
    )


def gain(predicted: Belief, updated: Belief, which: slice) -> float:
    """Return the share of the way from the prediction to the measurement, of some coordinates on average, 0 to 1."""
    before = float(np.trace(predicted.pp[which, which]))
    after = float(np.trace(updated.pp[which, which]))
    return 1.0 - after / before if before > 0.0 else 0.0


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
    ``last`` holds up to three measurements of consecutive frames, the newest last; it is empty after a frame without a
    measurement.
    """

    mean_square: np.ndarray
    mean_product: np.ndarray
    weight: float
    last: tuple[np.ndarray, ...] = ()


def first_moments(variances: np.ndarray) -> Moments:
    """Return the initial moments of a track, from the fit's variances (k,)."""
    noise = FIRST_SHARE * variances
    drive = FIRST_DRIVE * variances
    return Moments(
        mean_square=6.0 * noise + 2.0 / 3.0 * drive,
        mean_product=-4.0 * noise + drive / 6.0,
        weight=STEADY,
    )


def observed(moments: Moments, measured: np.ndarray) -> Moments:
    """Return the moments after the measurement (k,) of the next frame."""
    last = (*moments.last, measured)
    if len(last) < 4:
        return replace(moments, last=last)
    # Two neighbouring second differences.
    before = last[0] - 2 * last[1] + last[2]
    now = last[1] - 2 * last[2] + last[3]
    weight = min(moments.weight + 1.0, MEMORY)
    share = 1.0 / weight
    return Moments(
        mean_square=moments.mean_square + share * (0.5 * (before**2 + now**2) - moments.mean_square),
        mean_product=moments.mean_product + share * (before * now - moments.mean_product),
        weight=weight,
        last=last[1:],
    )


def noise_and_drive(moments: Moments, variances: np.ndarray) -> tuple[float, np.ndarray]:
    """Estimate the scatter of the measurements and the acceleration of the coordinates from the fit's variances (k,).

    Return the fraction of these variances that changes from frame to frame, median over the coordinates, and the
    density of each coordinate's acceleration (k,). The rest is constant, such as the error of the model.
    """
    # The mean square is 6 r + 2/3 q and the mean product -4 r + q / 6. So q cancels in the first less four times the
    # second, 22 r.
    scatter = (moments.mean_square - 4.0 * moments.mean_product) / 22.0
    median = float(np.sort(scatter / variances)[len(scatter) // 2])
    share = min(max(median, LEAST_SHARE), 1.0)
    # A coordinate may scatter more than that share: what its neighbouring differences tell is no acceleration either.
    noise = np.maximum(share * variances, scatter)
    drive = 1.5 * (moments.mean_square - 6.0 * noise)
    least_drive = LEAST_DRIVE * share * variances
    return share, np.maximum(drive, least_drive)
