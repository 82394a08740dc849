"""Calibration of the quality and the covariances of fits, on images left out of training.

A fit that converges need not be correct. Correct fits explain more of the image, with a less unusual shape. The
threshold depends on the object and the model. Training therefore fits models to left-out images from near and distant
starts, and at the best wrong places that a search finds.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from liaam.fitting import Fitter
from liaam.fitting.detection import Detection
from liaam.fitting.loop.levels import LinearImage
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.methods import Method
from liaam.fitting.quality import FEATURES
from liaam.fitting.search.finder import Finder
from liaam.fitting.search.templates import is_searchable
from liaam.model import AAM, Reliability
from liaam.model.contours import outline_errors
from liaam.model.shape import align, corners_of, diagonal_of, in_box, rotation, shifted_into
from liaam.model.sides import reflected_image, reflected_points
from liaam.photometry import is_grey
from liaam.training.covariances import Alike, learn_covariances, shrunk, variance_factor
from liaam.training.left_out_fits import RIGHT, LeftOutFit, LeftOutFits
from liaam.training.presence import agreement_of, can_be_judged, learn_presence
from liaam.training.shrinkage import least_shrunk, prior_weights

OPTIONS = SolverOptions(max_iterations=20)  # Right fits converge sooner; wrong ones need not converge
PLACES = 3  # Places of the search that are fitted in an image, besides those that fill the frame
RARE = 0.05  # Fraction of right fits whose quality is below typical
# Precision of the prior on the slopes of the quality's regression, whose features have a standard deviation of 1. Right
# and wrong fits to left-out images hardly overlap, so that the prior decides where between them the quality is 0.5:
# with a strong one halfway between their means. Of right fits to persons under real flashes, with neither persons nor
# lamps of the tests, 9.0 % are refused with 0.5, 6.8 with 0.1 and 4.8 with 0.02, and of wrong ones 0.3, 0.3 and 0.4 %
# pass.
RIDGE = 0.1
# Largest odds of right to wrong fits that are assumed before an image is seen. Left-out images are like those of
# training, and others are not: of the face model's fits to photographs in the wild, a quarter are wrong.
MOST_ODDS = 9.0


@dataclass(frozen=True, eq=False)
class LeftOutImage:
    """An image, its landmarks, and a model trained without it, on the reference frame of the full model.

    ``known`` (n,) says which landmarks are known, with which alone fits are compared; None if all are. ``relit`` marks
    images whose light was changed; their background is then not valid. ``has_sides`` says that fits of the model to be
    will try both sides of objects. ``name`` is that of the image.
    """

    model: AAM
    image: np.ndarray
    points: np.ndarray
    known: np.ndarray | None = None
    relit: bool = False
    has_sides: bool = False
    name: str = ""

    @property
    def reflection(self) -> "LeftOutImage":
        """The image and its landmarks reversed left to right: an object of the other side."""
        points = reflected_points(self.points, self.image.shape[1])
        return replace(self, image=reflected_image(self.image), points=points)


def fits_near(
    model: AAM, pictures: Iterable[LeftOutImage], methods: Sequence[Method]
) -> dict[str, Sequence[LeftOutFits]]:
    """Fit left-out images from starts near the object.

    Each method fits with several weights of the prior on the shape at the finest level, all of it first.

    Parameters
    ----------
    model : AAM
        Model trained on all images.
    pictures : iterable of LeftOutImage
        Those with the same model follow each other.
    methods : sequence of Method

    Returns
    -------
    dict of sequences of LeftOutFits
        By the names of the methods, with each weight, for :func:`least_shrunk_of_each`.
    """
    fits = {method.name: [LeftOutFits(weight) for weight in prior_weights(model)] for method in methods}
    candidates = list(chain.from_iterable(fits.values()))
    weighted = [(method, candidate.final_prior) for method in methods for candidate in fits[method.name]]
    for i, (picture, fitters) in enumerate(_with_fitters(pictures, weighted)):
        start, _ = starts_of(picture, number=i)
        for fitter, candidate in zip(fitters, candidates, strict=True):
            if _can_fit(fitter, picture):
                candidate.n_near += 1
                fit = _fit(picture, fitter, start, near=True)
                if fit is None:
                    candidate.lost.append(picture.name)
                else:
                    candidate.fits.append(fit)
    return dict(fits)


def least_shrunk_of_each(fits: Mapping[str, Sequence[LeftOutFits]], *, refined: bool) -> dict[str, LeftOutFits]:
    """Return the best of each method's fits with several weights of the prior, with or without their refiners."""
    best = {}
    for name, candidates in fits.items():
        best[name] = least_shrunk(candidates if refined else [each.unrefined() for each in candidates])
    return best


def with_distant_and_wrong_fits(
    model: AAM, pictures: Iterable[LeftOutImage], methods: Sequence[Method], near: Mapping[str, LeftOutFits]
) -> dict[str, LeftOutFits]:
    """Fit left-out images from distant starts too, and at the best wrong places that a search finds.

    Of objects of two sides, the wrong one is fitted too: reversed left to right, the image has an object of the other
    side.

    Parameters
    ----------
    model, pictures, methods
        As of :func:`fits_near`.
    near : mapping of str to LeftOutFits
        The fits from near the objects, by the names of the methods.

    Returns
    -------
    dict of LeftOutFits
        By the names of the methods: the fits from near the objects, followed by the others with the same weight of the
        prior and the same factor on the shape.
    """
    finder = Finder(model)
    fits: dict[str, list[LeftOutFit]] = {method.name: [] for method in methods}
    weighted = [(method, near[method.name].final_prior) for method in methods]
    for i, (picture, fitters) in enumerate(_with_fitters(pictures, weighted)):
        _, distant = starts_of(picture, number=i)
        elsewhere = _elsewhere(picture, finder)
        for fitter, of_method in zip(fitters, fits.values(), strict=True):
            if _can_fit(fitter, picture):
                wrong = [_most_explaining_wrong(each, fitter, starts) for each, starts in elsewhere]
                of_method.extend(filter(None, [_fit(picture, fitter, distant), *wrong]))
    return {name: near[name].with_others(others) for name, others in fits.items()}


def _with_fitters(
    pictures: Iterable[LeftOutImage], methods: Sequence[tuple[Method, float]]
) -> Iterator[tuple[LeftOutImage, list[Fitter]]]:
    """Yield each image with a fitter of its model for each method and weight of the prior at the finest level."""
    fitters = []
    for picture in pictures:
        if not fitters or fitters[0].model is not picture.model:
            fitters = [
                Fitter(picture.model, method, replace(OPTIONS, final_prior=weight), restarts=False)
                for method, weight in methods
            ]
        yield picture, fitters


def _can_fit(fitter: Fitter, picture: LeftOutImage) -> bool:
    """Return whether the image has the colours that the method compares."""
    return not (fitter.objectives[0].method.needs_colour and is_grey(picture.image))


def _elsewhere(picture: LeftOutImage, finder: Finder) -> list[tuple[LeftOutImage, Sequence[np.ndarray | Detection]]]:
    """Return where wrong fits start: elsewhere in the image, and at the object reversed left to right if it has sides.

    Each image is given with its starts.
    """
    places = []
    if not picture.relit and is_searchable(finder.model):
        places = finder.others_in(LinearImage(picture.image, finder.model.response), PLACES)
        if finder.model.poses is not None:  # other places are fitted from the mean shape alone
            places = [place.landmarks for place in places]
    if not picture.has_sides:
        return [(picture, places)]
    reflection = picture.reflection
    return [(picture, places), (reflection, _starts_of_other_side(reflection, finder))]


def _starts_of_other_side(reflection: LeftOutImage, finder: Finder) -> list[np.ndarray | Detection]:
    """Return where fits of the wrong side start: from the mean shape in the object's box, and where a search leads."""
    low, high = corners_of(reflection.points)
    mean = in_box(reflection.model.shape_model.mean, 0.5 * (low + high), diagonal_of(reflection.points))
    if reflection.model.poses is not None:
        return [np.concatenate([low, high])]
    if not is_searchable(reflection.model):
        return [mean]
    return [mean, finder.first_in(LinearImage(reflection.image, reflection.model.response))]


def _most_explaining_wrong(
    picture: LeftOutImage, fitter: Fitter, starts: Sequence[np.ndarray | Detection]
) -> LeftOutFit | None:
    """Return of the wrong fits from some starts the one that explains most; None if there is no wrong one."""
    fits = [_fit(picture, fitter, start) for start in starts]
    wrong = [fit for fit in fits if fit is not None and fit.wrong]
    return max(wrong, key=lambda fit: fit.evidence[0], default=None)


def calibrate(model: AAM, fits: Mapping[str, LeftOutFits], methods: Sequence[Method]) -> dict[str, Reliability]:
    """Learn the quality of fits and the errors of right fits from those to left-out images.

    Return the calibrations by the names of the methods, without those that have too few right fits to learn from.
    """
    views = {method.name: method.view for method in methods}
    learnt = {name: learnt_from(model, of_method, views[name]) for name, of_method in fits.items()}
    return {name: each for name, each in learnt.items() if each is not None}


def _fit(picture: LeftOutImage, fitter: Fitter, start: np.ndarray | Detection, near: bool = False) -> LeftOutFit | None:
    """Fit a left-out image; None if the fit is lost by its status."""
    result = fitter.fit(picture.image, start)
    model = picture.model
    if result.status.lost or not (np.isfinite(result.landmarks).all() and np.isfinite(result.evidence).all()):
        return None
    known = np.ones(model.n_points, bool) if picture.known is None else picture.known
    error = outline_errors(result.landmarks, picture.points, model.contours)[known].mean()
    share = float(error / diagonal_of(picture.points))
    agreement = None
    if near and share <= RIGHT and can_be_judged(result.method):
        agreement = agreement_of(fitter, picture.image, result, known, has_background=not picture.relit)
    to_frame = result.pose.inverse()
    return LeftOutFit(
        near=near,
        error=share,
        evidence=result.evidence,
        unit=result.residual_variance,
        shapes=fitter.shapes,
        contours=model.contours,
        truth=to_frame(picture.points),
        known=known,
        p=result.p,
        covariance=result.covariance,
        agreement=agreement,
        # Models without an image are not calibrated, so that nothing else has moved the landmarks.
        refinement=None if result.shift is None else result.shift @ to_frame.matrix.T,
        name=picture.name,
    )


def learnt_from(model: AAM, left_out: LeftOutFits, view: str) -> Reliability | None:
    """Learn the quality and the errors of a method's fits from those to left-out images; None if too few are right."""
    fits = left_out.fits
    judged = [fit for fit in fits if fit.right or fit.wrong]
    near_fits = [fit for fit in fits if fit.near and not fit.wrong]
    evidence = np.array([fit.evidence for fit in judged])
    right = np.array([fit.right for fit in judged], bool)
    if right.sum() < 3 or not near_fits:
        return None
    weights = _weights(evidence, right)
    if not weights[1] > 0:  # quality must increase with the explained contrast
        return None
    alike = Alike.of(model.shape_model.mean, model.contours)
    # The covariance of left-out shapes: a lower bound, because lost fits are not among the errors.
    unexplained = model.views[view].shape_model.unexplained
    nothing = np.zeros((model.n_points, 2, 2))
    covariances = learn_covariances(
        np.array([fit.errors for fit in near_fits]),
        np.array([fit.spreads for fit in near_fits]),
        variance_factor(np.array([fit.surprise for fit in near_fits])),
        np.array([fit.unit for fit in near_fits]),
        nothing if unexplained is None else shrunk(unexplained, _n_known(model), alike),
        alike,
    )
    presence = learn_presence([fit.agreement for fit in near_fits if fit.agreement is not None])
    made = Reliability(weights=weights, presence=presence, **covariances)
    qualities = [made.quality(fit.evidence) for fit in judged if fit.right]
    near = [fit.right for fit in fits if fit.near]
    prior = min((sum(near) + 1) / (len(near) - sum(near) + 1), MOST_ODDS)  # as if there were one more of each
    return replace(
        made,
        typical=float(np.quantile(qualities, RARE)),
        prior=prior,
        final_prior=left_out.final_prior,
        expansion=left_out.expansion,
    )


def _n_known(model: AAM) -> int | np.ndarray:
    """Return the number of images in which landmarks are known: of all, or (n, 1, 1) of each."""
    if model.n_missing is None:
        return model.n_images
    return (model.n_images - model.n_missing)[:, None, None]


def starts_of(picture: LeftOutImage, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a start near the object and a distant one in the image: shapes (n, 2), or boxes of a model with poses.

    They are drawn by the number of the image.
    """
    rng = np.random.default_rng([7, number])
    near = _near(picture, rng)
    far = _moved(_near(picture, rng), rng, turn=30.0, shift=0.4)
    far = shifted_into(far, (picture.image.shape[1], picture.image.shape[0]))
    if picture.model.poses is None:
        return near, far
    # Fits start from poses in the box, and not from the mean shape.
    near = _moved_little(picture.points, rng)
    return np.concatenate(corners_of(near)), np.concatenate(corners_of(far))


def _near(picture: LeftOutImage, rng: np.random.Generator) -> np.ndarray:
    mean = picture.model.shape_model.mean
    return _moved_little(align(mean, picture.points)(mean), rng)


def _moved_little(shape: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return _moved(shape, rng, turn=4.0, shift=0.02)


def _moved(shape: np.ndarray, rng: np.random.Generator, turn: float, shift: float) -> np.ndarray:
    centre = shape.mean(axis=0)
    towards = rng.uniform(0.0, 2.0 * np.pi)
    angle = np.deg2rad(rng.choice([-1, 1]) * turn * rng.uniform(0.5, 1.0))
    step = shift * diagonal_of(shape) * np.array([np.cos(towards), np.sin(towards)])
    return (shape - centre) @ rotation(angle).T + centre + step


def _weights(evidence: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return weights (1 + k,) of the log odds by the evidence (m, k).

    Features that would speak for a fit where they may only speak against it, or the other way round, have the weight 0.
    The first one, what a fit explains, is left to the caller.
    """
    # Add a fit that explains nothing as an example of a wrong one.
    explains_nothing = np.median(evidence, axis=0)
    explains_nothing[0] = 0.0
    evidence = np.concatenate([evidence, explains_nothing[None]])
    right = np.append(right, False)
    n_features = evidence.shape[1]
    signs = np.array([feature.sign for feature in FEATURES[:n_features]])
    used = np.arange(n_features)
    while True:
        weights = np.zeros(1 + n_features)
        weights[np.append(0, 1 + used)] = _logistic(np.take(evidence, used, axis=1), right)
        contradicts = weights[1:] * signs < 0
        contradicts[0] = False
        if not contradicts.any():
            return weights
        used = np.setdiff1d(used, np.flatnonzero(contradicts))


def _logistic(features: np.ndarray, right: np.ndarray, ridge: float = RIDGE, steps: int = 50) -> np.ndarray:
    """Return weights (1 + k,) of a ridge logistic regression on features (m, k), with both classes balanced."""
    middle = features.mean(axis=0)
    scale = features.std(axis=0) + 1e-6
    x = np.column_stack([np.ones(len(right)), (features - middle) / scale])
    balance = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1)) * len(right)
    w = np.zeros(x.shape[1])
    penalty = ridge * np.diag([1e-3] + [1.0] * features.shape[1])
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ w, -30, 30)))
        hessian = (x * (balance * p * (1 - p) + 1e-9)[:, None]).T @ x + penalty
        w = w - np.linalg.solve(hessian, x.T @ (balance * (p - right)) + penalty @ w)
    slopes = w[1:] / scale
    return np.concatenate([[w[0] - slopes @ middle], slopes])
