"""Learn to refine fits: regression from landmarks that are as far off as those of fits (:mod:`liaam.model.regressor`).

The objective's minimum lies where the whole image is like the model's; a regressor sees what each landmark's own
surroundings look like, such as the corner of a wide smile. It also learns from images of which the appearance model
need not know: relit copies, or faces that turn or speak.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from liaam.datasets import Sample
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.model.pca import components_by, gram_about
from liaam.model.regressor import OF_FITS, SIZE, USUAL_SHARE, LandmarkRegressor, OrientationHistograms
from liaam.model.shape import ShapeModel, align, diagonal_of, rotation, similarity_modes
from liaam.photometry import Response
from liaam.photometry.encoding import as_colour
from liaam.training.left_out_fits import LeftOutFit, LeftOutFits
from liaam.training.objects import groups_of
from liaam.training.regressor import LEAST_OBJECTS, RIDGE, Samples, learn_steps
from liaam.training.shrinkage import evidence_of

# Distances of the histograms around a landmark in each step, pixels of SIZE. A third step changes no error.
SPACINGS = (4.0, 1.5)
# Largest number of starts of an image. With 5 instead of 2, the errors of 40 shells and cephalograms are 1 % smaller;
# 10 gain as much as nothing more.
STARTS = 5
MOST_SAMPLES = 400  # Largest number of starts of all images, unless there are more images
MARGIN = 0.25  # Of what is seen around the true landmarks: room for starts
# Errors of starts, as those of fits: standard deviations of the position as a fraction of the diagonal, of the
# logarithm of the size, and of the rotation in degrees; and the share of the deviation of shapes. Half or twice as
# large errors change those of refined wings, cephalograms and shells by at most one per cent.
SHIFT = 0.008
SCALE = 0.02
TURN = 1.5
SHAPE = 0.35
VARIANCE = 0.99  # Fraction of the variance of shapes that their modes explain
MOST_SEEN = 200  # Largest number of images and copies to learn from: each takes up to half a megabyte
# Standard errors by which the mean of the logarithms of the errors of left-out fits must be smaller if few objects were
# learnt from; none if there were many. With 10 wings, refined fits are worse by 9 %, with 20 the same, with 40 better.
STANDARD_ERRORS = 1.0


class RefinerLearner:
    """Collects images, and learns refiners from all or some of them.

    Parameters
    ----------
    mean : (n, 2) float64
        Mean shape of the model, pixels of its reference frame.
    response
        Response of the images' camera.
    """

    def __init__(self, mean: np.ndarray, response: Response = "srgb") -> None:
        self.mean = mean
        self.response: Response = response
        self._at_size = mean * (SIZE / diagonal_of(mean))
        self._histograms: list[OrientationHistograms] = []
        self._truths: list[np.ndarray] = []
        self._known: list[np.ndarray] = []

    def add(self, image: np.ndarray, points: np.ndarray, known: np.ndarray | None = None) -> None:
        """Add an image in colour and its landmarks (n, 2), of which some may be ``known`` (n,) and others estimates."""
        sight = OF_FITS._replace(margin=MARGIN)
        pose = align(self._at_size, points)
        self._histograms.append(OrientationHistograms(image, self.response, points, pose, sight, keep_counts=False))
        self._truths.append(points)
        self._known.append(np.ones(len(points), bool) if known is None else known)

    def learn(self, groups: Sequence[np.ndarray]) -> LandmarkRegressor | None:
        """Learn a refiner from some of the images; None if they show too few objects, or a landmark in none.

        ``groups`` are the images of each object, by the order in which they were added. Those of an object are left out
        together to measure errors.
        """
        used = np.concatenate(groups) if groups else np.zeros(0, int)
        if len(groups) < LEAST_OBJECTS or not np.array(self._known)[used].any(axis=0).all():
            return None
        truths = np.array(self._truths)[used]
        shapes = _shapes(truths, self.mean)
        n_starts = int(np.clip(MOST_SAMPLES // len(used), 1, STARTS))
        starts = []
        for i, truth in zip(used.tolist(), truths, strict=True):
            rng = np.random.default_rng([12, i])
            starts += [_like_a_fit(truth, shapes, rng) for _ in range(n_starts)]
        owners = np.repeat(used, n_starts)
        samples = Samples(
            histograms=[self._histograms[i] for i in owners.tolist()],
            truths=np.repeat(truths, n_starts, axis=0),
            shapes=np.array(starts),
            blocks=[np.flatnonzero(np.isin(owners, group)) for group in groups],
            known=np.array(self._known)[owners],
        )
        return learn_steps(samples, shapes, SPACINGS, RIDGE * n_starts)


@dataclass(frozen=True, eq=False)
class Refinement:
    """Learns the refiner of a model, and says whether it helps.

    Attributes
    ----------
    learner : RefinerLearner
        Sees some training images and copies of these.
    seen : (k,) int
        Which textures these are, by index.
    owners : (n_textures,) int
        Index of the image of each texture.
    groups : list of arrays of int
        Training images of one object, by index.
    forced : bool
        Whether the model gets a refiner in any case.
    """

    learner: RefinerLearner
    seen: np.ndarray
    owners: np.ndarray
    groups: Sequence[np.ndarray]
    forced: bool = False

    def see(self, texture: int, image: np.ndarray, points: np.ndarray, known: np.ndarray | None) -> None:
        """See the image of a texture, by index in turn, with its landmarks, if it is one to learn from."""
        if texture in self.seen:
            self.learner.add(image, points, known)

    def learn(self, without: np.ndarray | None = None, textures: np.ndarray | None = None) -> LandmarkRegressor | None:
        """Learn from all images, or ``without`` some, and of these from some ``textures``, all by index."""
        used = np.ones(len(self.seen), bool) if textures is None else np.isin(self.seen, textures)
        if without is not None:
            used &= ~np.isin(self.owners[self.seen], without)
        of_objects = [np.flatnonzero(used & np.isin(self.owners[self.seen], group)) for group in self.groups]
        return self.learner.learn([group for group in of_objects if len(group)])

    def best_share(self, fits: Mapping[str, Sequence[LeftOutFits]]) -> float:
        """Return the share of the way to where refiners lead at which right fits to left-out images are nearest.

        That is the share with the least squared errors, of all landmarks and weights of the prior.
        """
        wanted = 0.0
        squares = 0.0
        for candidate in fits.get(DEFAULT_METHOD, ()):
            for fit in candidate.near_right:
                if fit.refinement is None:
                    continue
                way = fit.refinement[fit.known] / (USUAL_SHARE * diagonal_of(fit.truth))
                to_truth = (fit.truth - fit.unrefined().landmarks)[fit.known] / diagonal_of(fit.truth)
                wanted += float((way * to_truth).sum())
                squares += float(np.square(way).sum())
        return float(np.clip(wanted / squares, 0.0, 1.0)) if squares > 0.0 else USUAL_SHARE

    def helps(self, fits: Mapping[str, LeftOutFits]) -> bool:
        """Return whether right fits to left-out images are nearer refined than not, by more than chance if few."""
        method = fits.get(DEFAULT_METHOD)
        if self.forced or method is None:
            return self.forced
        ratios = np.log([_ratio_of_errors(fit) for fit in method.near_right])
        if len(ratios) < LEAST_OBJECTS:
            return False
        doubt = STANDARD_ERRORS * (1.0 - evidence_of(len(self.groups)))
        return bool(ratios.mean() + doubt * ratios.std(ddof=1) / np.sqrt(len(ratios)) < 0.0)


def seen_of(owners: np.ndarray) -> np.ndarray:
    """Return which textures a refiner learns from, by index, given the image of each: images, and copies of these.

    At most :data:`MOST_SEEN`, half of which are images, at even distances if there are more.
    """
    n_images = int(owners[-1]) + 1
    count = min(n_images, MOST_SEEN // 2)
    images = np.linspace(0, n_images - 1, count).astype(int)
    return np.concatenate([np.flatnonzero(owners == i)[: MOST_SEEN // count] for i in images])


def learn_refiner(data: Iterable[Sample], mean: np.ndarray, response: Response = "srgb") -> LandmarkRegressor | None:
    """Learn a refiner of fits; None if the images show too few objects.

    Parameters
    ----------
    data : iterable of Sample
        Images and all of their landmarks. Those of one object, by their names, are left out together to measure errors.
    mean : (n, 2) float64
        Mean shape of the model, pixels of its reference frame.
    response
        Response of the images' camera.
    """
    learner = RefinerLearner(mean, response)
    names = []
    for sample in data:
        image = as_colour(sample.read_image(), sample.name)
        learner.add(image, np.asarray(sample.landmarks.points))
        names.append(sample.name)
    return learner.learn(groups_of(names))


def _ratio_of_errors(fit: LeftOutFit) -> float:
    """Return the ratio of the errors of a fit that is refined and of the same fit without that.

    The distance from the mean shape stays as it is: the factor on it was chosen for refined fits.
    """
    as_fitted = fit.expanded(1.0)
    least = np.finfo(np.float64).tiny
    return max(as_fitted.error, least) / max(as_fitted.unrefined().error, least)


def _shapes(truths: np.ndarray, mean: np.ndarray) -> ShapeModel:
    """Return the shapes (m, n, 2) as modes about the mean shape of a model, which may be of other images."""
    deviations = np.array([align(truth, mean)(truth) - mean for truth in truths]).reshape(len(truths), -1)
    rigid = similarity_modes(mean)
    deviations -= deviations @ rigid.T @ rigid
    centre = np.zeros(deviations.shape[1])
    components = components_by(deviations, centre, gram_about(deviations, centre), VARIANCE)
    left = deviations - deviations @ components.modes.T @ components.modes
    left = left.reshape(len(truths), -1, 2)
    unexplained = np.einsum("mna,mnb->nab", left, left) / len(left)
    return ShapeModel(mean, components.modes, components.eigenvalues, unexplained)


def _like_a_fit(truth: np.ndarray, shapes: ShapeModel, rng: np.random.Generator) -> np.ndarray:
    """Return landmarks (n, 2) that are off as those of a fit are."""
    weights = rng.normal(0.0, SHAPE * np.sqrt(shapes.eigenvalues))
    off = (weights @ shapes.modes).reshape(-1, 2) @ align(shapes.mean, truth).matrix.T
    shape = truth + off
    centre = shape.mean(axis=0)
    turn = rotation(np.deg2rad(rng.normal(0.0, TURN)))
    scale = np.exp(rng.normal(0.0, SCALE))
    return centre + scale * (shape - centre) @ turn.T + diagonal_of(truth) * rng.normal(0.0, SHIFT, 2)
