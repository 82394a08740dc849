"""The Kalman filter of a track: positions that move with a velocity which white acceleration changes.

Nothing here knows of shapes or pictures. Time counts in frames. How far measurements scatter from frame to frame, and
how strongly each coordinate accelerates, is learnt from the measurements' second differences, in which a steady motion
cancels out: noise of variance r leaves them a variance of 6 r and a covariance of -4 r with their neighbours, and
acceleration of density q leaves 2/3 q and 1/6 q.
"""

from dataclasses import dataclass, replace

import numpy as np

GATE = 9.0
"""Square of an innovation, in variances, beyond which the prediction is believed less: three standard deviations."""

MEMORY = 25.0
"""Second differences that the running moments look back on."""

STEADY = 8.0
"""Second differences that the first guess of the moments counts as."""

LEAST_SHARE = 1e-3
"""Of a fit's covariance that changes from frame to frame at least."""

FIRST_SHARE, FIRST_DRIVE = 0.2, 0.05
"""First guesses: share of a fit's variance that changes from frame to frame, and density of acceleration as a share of
the fit's variance. They smooth a little, and are unlearnt in a second."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Gaussian belief in k positions and their velocities.

    Attributes
    ----------
    position, velocity : (k,) float64
    pp, pv, vv : (k, k) float64
        Covariances of positions, of positions with velocities, and of velocities.
    """

    position: np.ndarray
    velocity: np.ndarray
    pp: np.ndarray
    pv: np.ndarray
    vv: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Of positions and velocities together, (2 k, 2 k) float64."""
        return np.block([[self.pp, self.pv], [self.pv.T, self.vv]])


def first_belief(position: np.ndarray, noise: np.ndarray, speed: np.ndarray) -> Belief:
    """Belief after one measurement.

    Parameters
    ----------
    position : (k,) float
        Measured.
    noise : (k, k) float
        Covariance of the measurement.
    speed : (k,) float
        Standard deviation of the velocity, which nothing has been seen of.
    """
    k = len(position)
    return Belief(position, np.zeros(k), noise, np.zeros((k, k)), np.diag(np.square(speed)))


def predict(belief: Belief, drive: np.ndarray, frames: float = 1.0) -> Belief:
    """Belief some frames later, nothing seen in between.

    Parameters
    ----------
    belief : Belief
    drive : (k,) float
        Spectral density of each coordinate's acceleration.
    frames : float
        How much later.
    """
    t, each = frames, np.arange(len(belief.position))
    pv = belief.pv + t * belief.vv
    pp = belief.pp + t * (belief.pv + pv.T)
    vv = belief.vv.copy()
    pp[each, each] += drive * t**3 / 3.0
    pv[each, each] += drive * t**2 / 2.0
    vv[each, each] += drive * t
    return Belief(belief.position + t * belief.velocity, belief.velocity, pp, pv, vv)


def update(belief: Belief, measured: np.ndarray, noise: np.ndarray) -> Belief:
    """Belief after another measurement.

    Parameters
    ----------
    belief : Belief
        The prediction.
    measured : (k,) float
    noise : (k, k) float
        Covariance of the measurement, positive definite.

    Returns
    -------
    Belief
        Its ``pp`` is at most ``noise`` and at most the prediction's.
    """
    total = belief.pp + noise
    # One solution for both gains: rows of positions, then of velocities.
    gains = np.linalg.solve(total, np.concatenate([belief.pp, belief.pv.T]).T).T
    k, innovation = len(measured), measured - belief.position
    step = gains @ innovation
    pp = gains[:k] @ noise
    return Belief(
        belief.position + step[:k],
        belief.velocity + step[k:],
        0.5 * (pp + pp.T),
        belief.pv - gains[:k] @ belief.pv,
        _symmetric(belief.vv - gains[k:] @ belief.pv),
    )


def widened(belief: Belief, measured: np.ndarray, noise: np.ndarray, gate: float = GATE) -> Belief:
    """Belief that holds a measurement possible: coordinates that it surprises are believed less.

    What moves off suddenly is so followed at once, rather than with the lag of a filter that expects nothing of the
    kind: a coordinate alone stays within the root of gate times its noise of the measurement.
    """
    innovation = measured - belief.position
    excess = np.square(innovation) / gate - np.diag(belief.pp) - np.diag(noise)
    if not (excess > 0).any():
        return belief
    more = np.diag(np.maximum(excess, 0.0))
    # Whoever is in the wrong place has the wrong speed, too.
    return replace(belief, pp=belief.pp + more, pv=belief.pv + 0.5 * more, vv=belief.vv + 0.5 * more)


def slowed(belief: Belief, factor: float) -> Belief:
    """Belief with less velocity: what was seen last moves on, but not for ever."""
    return replace(belief, velocity=factor * belief.velocity)


@dataclass(frozen=True, eq=False)
class Moments:
    """Running moments of a track's second differences.

    Attributes
    ----------
    own, neighbour : (k,) float64
        Mean square of second differences, and mean product of one with the next.
    weight : float
        Differences that they stand for.
    last : tuple of (k,) float64
        Up to three measurements of consecutive frames, the newest last.
    """

    own: np.ndarray
    neighbour: np.ndarray
    weight: float
    last: tuple[np.ndarray, ...] = ()


def first_moments(variances: np.ndarray) -> Moments:
    """Moments that a track begins with, by the fit's variances (k,)."""
    noise, drive = FIRST_SHARE * variances, FIRST_DRIVE * variances
    return Moments(6.0 * noise + 2.0 / 3.0 * drive, -4.0 * noise + drive / 6.0, STEADY)


def observed(moments: Moments, measured: np.ndarray) -> Moments:
    """Moments after one more measurement (k,), of the frame after the last."""
    last = (*moments.last, measured)
    if len(last) < 4:
        return replace(moments, last=last)
    before, now = last[0] - 2 * last[1] + last[2], last[1] - 2 * last[2] + last[3]
    weight = min(moments.weight + 1.0, MEMORY)
    share = 1.0 / weight
    return Moments(
        moments.own + share * (0.5 * (before**2 + now**2) - moments.own),
        moments.neighbour + share * (before * now - moments.neighbour),
        weight,
        last[1:],
    )


def interrupted(moments: Moments) -> Moments:
    """Moments after a frame without a measurement: differences begin anew."""
    return replace(moments, last=())


def noise_and_drive(moments: Moments, variances: np.ndarray) -> tuple[float, np.ndarray]:
    """How far measurements scatter, and how strongly the coordinates accelerate.

    Parameters
    ----------
    moments : Moments
    variances : (k,) float
        The fit's own.

    Returns
    -------
    share : float
        Of the fit's variances that changes from frame to frame, in the middle of all coordinates; the rest is the same
        in each, such as what the model cannot show, and no filter can take it off.
    drive : (k,) float64
        Density of each coordinate's acceleration.
    """
    scatter = (moments.own - 4.0 * moments.neighbour) / 22.0
    middle = float(np.sort(scatter / variances)[len(scatter) // 2])
    share = min(max(middle, LEAST_SHARE), 1.0)
    drive = 1.5 * (moments.own - 6.0 * share * variances)
    return share, np.maximum(drive, 1e-4 * share * variances)


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)
