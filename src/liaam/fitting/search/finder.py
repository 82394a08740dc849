"""Detection of the object, for fits without a given start.

Templates of gradient orientations (:mod:`liaam.fitting.search.templates`) are correlated with the orientations in the
image at many sizes. The best places are fitted with the reduced model by method ``igo``, and scored by how well it
explains the orientations there. If one object is wanted, small ones are searched for only if no large one is certain.

Where the first fit has low quality, and for one object of a model of several parts, the learnt filters take the place
of the templates. Those of all parts are correlated in one search, and the place of a filter is fitted with its part.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import ref

import numpy as np

from liaam.errors import MethodError, ModelFileError
from liaam.fitting.detection import DOUBTFUL, Detection, are_apart, are_beside, choose, is_inside
from liaam.fitting.loop.levels import CoarseToFine, FittedLevel, LinearImage, Target
from liaam.fitting.loop.objective import make_objectives
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.methods import get_method
from liaam.fitting.search.responses import Bank, Peaks, joined, strongest
from liaam.fitting.search.starts import region_in
from liaam.fitting.search.templates import (
    TEMPLATE,
    TURNS,
    Field,
    Grey,
    OrientationTemplate,
    make_templates,
    rotated_filters,
    shrink,
)
from liaam.model import AAM
from liaam.model.aam import named_model
from liaam.model.shape import Similarity, align, corners_of, diagonal_of, in_box, rotation
from liaam.model.warp import THINNING
from liaam.photometry import Response
from liaam.photometry.picture import described, load_picture
from liaam.workers import in_threads

# What was measured for these is in experiments/notes/engine.md.

SMALLEST = 0.15  # smallest diagonal searched, as a fraction of the image's shorter side
LARGEST = 1.25  # largest one
LEAST_PIXELS = 20.0  # smallest diagonal, pixels of the image
STEP = 1.2  # ratio of consecutive sizes
PADDING = 0.25  # largest distance that an object may extend beyond the image, as a fraction of its diagonal
# Pixels of all fields of a search together, with their padding. Images of up to 11 to 1 need fewer. In longer ones the
# smallest objects, which take most of the time, are not searched for: below 0.5 of the shorter side at 100 to 1.
MOST_PIXELS = 3_000_000
SETTINGS = SolverOptions(max_iterations=10, tolerance=0.1)  # of the fits of places
VISITED = 0.25  # margin around a place that its fit may use, as a fraction of the object's diagonal
# Sizes searched where the object is known to be, from its box: that of an object depends on its rotation and its pose.
SIZES_NEAR = (-3, -2, -1, 0, 1, 2)  # powers of STEP, of the box's diagonal
TURNED_STARTS = 3  # number of rotations of the mean shape in a box that fits start from
TURNED_APART = np.deg2rad(40.0)  # least difference of two of these, radians
GROWTH = (0.5, 2.0)  # limits on the change of size in the fit of a place; beyond them it has diverged
SHAPE_PENALTY = 0.05  # on the score, per unit of the mean squared shape mode in standard deviations
MOST = 20  # objects in an image
# Largest number of places that are fitted: so many, and so many more for each object that is wanted.
PLACES = 6
PLACES_PER_OBJECT = 4
# Distance, in diagonals, and fraction of its size, within which a place is the same as a stronger one.
APART = 0.2

# Diagonal of large objects as a fraction of the image's shorter side. Small ones are searched for only if no large
# place is certain: they take three quarters of the time.
LARGE = 0.3


@dataclass(frozen=True)
class Limits:
    """What the score of a place and the response there say, of one kind of templates.

    Attributes
    ----------
    worth : float
        Fraction of the strongest response below which places are left out.
    of_response : float
        Factor of the response in the sum with the score by which places are compared.
    least_score : float
        Least score of a certain place.
    sure : float
        That sum at which the search for one object stops.
    n_large : int
        Number of places of large objects that are fitted before small ones are searched for.
    sure_beside : float
        Least sum of further objects where one is wanted.
    clear : float
        Least response of the places that are fitted for them.
    """

    worth: float
    of_response: float
    least_score: float
    sure: float
    n_large: int
    sure_beside: float
    clear: float


# Right places have at least 0.77 of the strongest response. Seven of ten have more than 1.25, and no wrong place of 861
# images more than 1.18. Of 12 pairs of faces, 10 have more than 1.15 both; places without a face have at most 1.12.
OF_TEMPLATES = Limits(
    worth=0.75, of_response=1.0, least_score=DOUBTFUL, sure=1.25, n_large=2, sure_beside=1.15, clear=0.45
)
# Of 166 images of faces, 19 of 20 right places have at least 0.83 of the strongest response. Eight of ten have a sum of
# 0.95 or more, which five wrong ones reach first, four of them other persons. Of wrong places in images of one face,
# one in a hundred has 0.99 or more, and a response of 0.78.
OF_FILTERS = Limits(worth=0.7, of_response=0.5, least_score=0.0, sure=0.95, n_large=8, sure_beside=1.05, clear=0.7)
WEAK = 0.3  # Fraction of the strongest response of filters below which none is among the twelve strongest places

# Further objects, where one is wanted:
MOST_BESIDE = 4  # number of places that are fitted for them
LEAST_BESIDE = 0.5  # least diagonal of these places, relative to the best detection

# Other places to fit if the first is not the object: their number, and that of places scored for each. With twice as
# many, the search takes 1.6 times as long and sees no more faces.
OTHERS = 12
LOOKED = 2
# The same for models of several parts, which are all fitted at each place at the coarsest level, and the number of
# large places that come first.
OTHERS_OF_PARTS = 6
AT_FIRST = 4
SIZE_WORTH = 0.05  # bonus on their score per unit of log size: there are more wrong places of small sizes

# Objects that fill the frame: diagonals as fractions of its shorter side, and rotations, degrees, of those in TURNS.
FILLING = (0.95, 1.1)
FILLING_TURNS: dict[str, tuple[float, ...]] = {"upright": (0.0,), "all": (-180.0, -90.0, 0.0, 90.0)}
IN_THE_MIDDLE = 0.8  # diagonal of the mean shape that stands for no detection, as a fraction of the shorter side


@dataclass(frozen=True, eq=False)
class Finder:
    """A detector for a model, to be used on many images.

    Attributes
    ----------
    model : AAM
    rotations : {"upright", "all"}, optional
        Rotations searched: up to about 25 degrees, or all, at four times the time. By default as the objects are turned
        in the training images (:attr:`liaam.AAM.rotations`).

    Examples
    --------
    >>> finder = Finder(model)                              # doctest: +SKIP
    >>> best = [finder.find(image)[0] for image in images]  # doctest: +SKIP
    """

    model: AAM
    rotations: str | None = None

    def __post_init__(self) -> None:
        """Raise an error if the model is not one, or the rotations are unknown."""
        if not isinstance(self.model, AAM):
            raise ModelFileError(
                f"{described(self.model)} is not a model; give a model first; of a file, give liaam.load_model(path)"
            )
        if self.searched_rotations not in TURNS:
            raise MethodError(f"unknown rotations {self.rotations!r}; choose from {', '.join(TURNS)}")

    @property
    def searched_rotations(self) -> str:
        """Rotations that are searched: those given, or else those of the training images."""
        return self.model.rotations if self.rotations is None else self.rotations

    @cached_property
    def small(self) -> AAM:
        """The reduced model: the coarsest level on a smaller frame."""
        return shrink(self.model)

    @cached_property
    def parts(self) -> tuple["Finder", ...]:
        """A detector for each shape of the model: in general only this one."""
        if not self.model.others:
            return (self,)
        return tuple(replace(self, model=part, rotations=self.searched_rotations) for part in self.model.parts)

    @cached_property
    def templates(self) -> Bank:
        """All templates of the reduced model."""
        return Bank(make_templates(self.small, self.searched_rotations), self._padding)

    @cached_property
    def filters(self) -> Bank:
        """The learnt filters of all parts in several rotations; the templates if a part has none."""
        has_filters = all(part.search_filter is not None for part in self.model.parts)
        if not (has_filters or self.model.others):
            return self.templates
        templates: list[OrientationTemplate] = []
        for i, part in enumerate(self.parts):
            of_part = part._rotated_filters() if has_filters else part.templates.templates
            templates += [replace(template, part=i) for template in of_part]
        return Bank(templates, self._padding, normalised=has_filters)

    def _rotated_filters(self) -> tuple[OrientationTemplate, ...]:
        """Return the learnt filter of a part in several rotations."""
        assert self.model.search_filter is not None
        return rotated_filters(self.model.search_filter, self.searched_rotations, self.small)

    @property
    def _padding(self) -> int:
        """Pixels of a field that an object may extend beyond it."""
        return int(PADDING * self.small.diagonal)

    @cached_property
    def level(self) -> CoarseToFine:
        """The level of the fits of places."""
        # The limits on scores were set with this thinning. All pixels find no more, and take longer.
        return CoarseToFine(make_objectives(self.small, get_method("igo"), thinning=THINNING), keeps_samples=True)

    def find(
        self,
        image,
        *,
        limit: int | None = 1,
        least: float = 0.0,
        response: Response | None = None,
        name: str = "image",
    ) -> list[Detection]:
        """Find the object in an image; see :func:`find`."""
        if limit is not None and limit < 1:
            raise MethodError(f"limit {limit} is too small; give 1 or more, or None for all objects")
        response = self.model.response if response is None else response
        return self.find_in(LinearImage(load_picture(image, name)[0], response), limit=limit, least=least)

    def find_in(self, linear: LinearImage, *, limit: int | None = 1, least: float = 0.0) -> list[Detection]:
        """Find the object in an image that is checked already; see :func:`find`."""
        most = MOST if limit is None else min(limit, MOST)
        if most > 1:
            chosen = _best_first(choose(self.places_in(linear, most), are_beside, most))
        else:
            search = self._search_for_one(linear)
            chosen = [self._with_others(search, search.for_one(least))]
        return [detection for detection in chosen if detection.score >= least]

    def places_in(self, linear: LinearImage, most: int = MOST) -> list[Detection]:
        """Find places of at most so many objects, the likeliest first.

        Some lie on others, as where a part of an object resembles a small one: their fits say which is right.
        """
        detections = []
        for i, part in enumerate(self.parts):
            detections += [replace(each, part=i) for each in part._find_all(linear, most)]
        return choose(likeliest_first(detections), are_apart)

    def first_in(self, linear: LinearImage) -> Detection:
        """Find where the first fit of an image starts.

        The filters of a model of several parts are compared with large sizes only: small ones follow if the fit is
        doubtful.
        """
        if not self.model.others:
            return self.find_in(linear)[0]
        search = self._search_for_one(linear)
        return self._with_others(search, search.for_one(only_large=True))

    def _with_others(self, search: "_Search", detections: Sequence[Detection]) -> Detection:
        """Return the first of the detections of one object, with the further objects that its search has seen.

        Without any detection, it is the mean shape in the middle of the image.
        """
        best = detections[0] if detections else self._in_the_middle(search.image)
        return replace(best, others=search.beside(best))

    def _search_for_one(self, linear: LinearImage, known: float = 0.0) -> "_Search":
        """Return the search for one object; that of several parts goes on where it stopped."""
        if not self.model.others:
            return _Search(self, linear, count=PLACES + PLACES_PER_OBJECT, bank=self.templates, known=known)
        if id(self) not in linear.searches:
            count = LOOKED * OTHERS_OF_PARTS
            linear.searches[id(self)] = _Search(self, linear, count, bank=self.filters, known=known)
        return linear.searches[id(self)]

    def _find_all(self, linear: LinearImage, most: int) -> list[Detection]:
        """Find objects of this part."""
        search = _Search(self, linear, count=PLACES + PLACES_PER_OBJECT * most, bank=self.templates)
        return search.for_all() or [self._in_the_middle(linear.image)]

    def others_in(self, linear: LinearImage, most: int = OTHERS, known: float = 0.0) -> list[Detection]:
        """Find other places to fit if the first is not the object: the next best, and some that fill the frame.

        The best come first, ``most`` at most, then those that fill the frame. Their shapes are the aligned mean shape,
        because deformations of the reduced model are a bad start. ``known`` is about the diagonal of the object in
        pixels, if there is a box around it.
        """
        if self.model.others:
            search = self._search_for_one(linear, known)
        else:
            search = _Search(self, linear, count=LOOKED * most, bank=self.filters, known=known)
        best = choose(search.ranked(), are_apart, most)
        return self._with_means(choose([*best, *search.filling()], are_apart))

    def others_in_turn(self, linear: LinearImage, known: float = 0.0) -> Iterator[list[Detection]]:
        """Yield other places in turn, for as long as none of those before is the object; see :meth:`others_in`.

        Those of a model of several parts are a few large ones, and then those of all sizes. Others come at once.
        """
        if not self.model.others:
            yield self.others_in(linear, known=known)
            return
        search = self._search_for_one(linear, known)
        large = choose(search.ranked(only_large=True), are_apart, AT_FIRST)
        yield self._with_means(large)
        best = choose([*large, *search.ranked()], are_apart, OTHERS_OF_PARTS)
        yield self._with_means(choose([*best, *search.filling()], are_apart)[len(large) :])

    def _with_means(self, places: Sequence[Detection]) -> list[Detection]:
        """Return places with the aligned mean shapes of their parts."""
        return [replace(place, landmarks=self.parts[place.part].mean_at(place.landmarks)) for place in places]

    def mean_at(self, shape: np.ndarray) -> np.ndarray:
        """Return the mean shape, aligned to a shape (n, 2)."""
        mean = self.model.shape_model.mean
        return align(mean, shape)(mean)

    def starts_in_box(self, linear: LinearImage, start: np.ndarray) -> list[np.ndarray]:
        """Return starts (n, 2) for an object that may be turned in any direction, in the box of a start.

        The object is searched for around the box, at about its size. The other starts are the mean shape in the box in
        those of the searched rotations from which the reduced model's fits have the highest scores.
        """
        low, high = corners_of(start)
        diagonal = diagonal_of(start)
        first, last = region_in(linear.image, low - VISITED * diagonal, high + VISITED * diagonal)
        around = linear.crop(first, last)
        sizes = diagonal * STEP ** np.array(SIZES_NEAR)
        search = _Search(self, around, count=PLACES + PLACES_PER_OBJECT, bank=self.templates, sizes=sizes)
        starts = [detection.landmarks for detection in _best_first(search.for_all())[:1]]
        starts += search.turned(around, start - first, TURNED_STARTS)
        return [shape + first for shape in starts]  # in pixels of the whole image

    def _fit_place(self, linear: LinearImage, place: "_Place") -> Detection:
        """Fit the reduced model at a place, and score the result; 0 if the fit diverges."""
        warp = self.level.objectives[0].warp
        pose = Similarity(rotation(place.template.turn) * place.scale, place.centre)
        return self._fit_start(linear, pose(warp.shape(place.template.p)), place.field)

    def _fit_start(self, linear: LinearImage, start: np.ndarray, field: Field) -> Detection:
        """Fit the reduced model from a shape (n, 2), and score the result; 0 if the fit diverges."""
        warp = self.level.objectives[0].warp
        (level,) = self.level.fit(Target(linear, start, margin=VISITED), SETTINGS)
        shape = level.reached
        growth = diagonal_of(shape) / diagonal_of(start)
        if not (np.isfinite(shape).all() and GROWTH[0] < growth < GROWTH[1]):
            return self._detection(start, 0.0)
        strength = field.strength(level.pose(warp.points(level.solution.p)))
        return self._detection(shape, self._score(level, strength))

    def _score(self, level: FittedLevel, strength: np.ndarray) -> float:
        """Return the mean cosine between image and fitted appearance, minus a penalty for an unusual shape.

        ``strength`` (n_pixels,) is that of the gradients at the model's pixels.
        """
        solution = level.solution
        weights = level.objective.appearance.usable[:, None].astype(np.float64)
        seen = solution.samples.reshape(-1, 2).astype(np.float64)
        expected = seen - solution.residual.reshape(-1, 2)
        # Pixels outside the image count as unexplained: otherwise half an object at the border scores as a whole one.
        product = float((weights * (solution.usable * strength)[:, None] * seen * expected).sum())
        power = float((weights * np.square(expected)).sum() * weights.sum())
        if not power > 0:
            return 0.0
        variances = np.maximum(self.small.shape_model.eigenvalues, 1e-12)
        modes = solution.p[:-4]  # the last four are the similarity
        unusual = float((np.square(modes) / variances).mean()) if len(variances) else 0.0
        score = product / np.sqrt(power) - SHAPE_PENALTY * unusual
        return float(np.clip(score, 0.0, 1.0)) if np.isfinite(score) else 0.0

    def _detection(self, shape: np.ndarray, score: float) -> Detection:
        """Return a detection with the rotation and the scale of a shape relative to the mean."""
        pose = align(self.model.shape_model.mean, shape)
        return Detection(shape, score, pose.angle, pose.scale)

    def _in_the_middle(self, image: np.ndarray) -> Detection:
        """Return the mean shape in the middle of the image with score 0, for images without any detection."""
        size = np.array(image.shape[1::-1])
        mean = self.model.shape_model.mean
        scale = IN_THE_MIDDLE * size.min() / diagonal_of(mean)
        return self._detection(mean * scale + 0.5 * (size - 1), 0.0)


def likeliest_first(detections: Sequence[Detection]) -> list[Detection]:
    """Sort the detections of an image, certain ones before the others, by score and size: small wrong ones are many."""
    return sorted(detections, key=lambda each: (each.doubtful, -_sized_score(each)))


def _sized_score(detection: Detection) -> float:
    """Return the score of a detection with the bonus on its size, to compare those of one image."""
    return detection.score + SIZE_WORTH * np.log(detection.scale)


def _best_first(detections: list[Detection]) -> list[Detection]:
    """Sort detections by their score, the highest first."""
    return sorted(detections, key=lambda detection: -detection.score)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where to fit the reduced model, and from which template's shape."""

    centre: np.ndarray  # (2,): of the shape, image pixels
    scale: float  # image pixels per pixel of the reduced model
    template: OrientationTemplate
    field: Field


class _Search:
    """The search of one image, with its fields, responses and fits so far.

    Parameters
    ----------
    finder : Finder
    linear : LinearImage
    count : int
        Largest number of places to fit.
    bank : Bank
        Templates that the image is compared with.
    sizes : (k,) float64, optional
        Diagonals of objects to search for, pixels, from small to large; by default those of :func:`search_sizes`.
    known : float
        About the diagonal of the object, pixels; 0 if it is not known.
    """

    def __init__(
        self,
        finder: Finder,
        linear: LinearImage,
        count: int,
        bank: Bank,
        sizes: np.ndarray | None = None,
        known: float = 0.0,
    ) -> None:
        self.finder = finder
        self.limits = OF_FILTERS if bank.normalised else OF_TEMPLATES
        self._linear = ref(linear)  # which keeps its searches: a cycle would keep both until garbage is collected
        self.image = linear.image
        self.count = count
        self.bank = bank
        diagonal = finder.small.diagonal
        self.sizes = search_sizes(self.image.shape[:2], diagonal, known) if sizes is None else sizes
        # Some are large: the largest size exceeds the image.
        self.is_large = self.sizes >= LARGE * min(self.image.shape[:2])
        self.grey = Grey.of(self.image, linear.response, self.sizes[0] / diagonal)
        self.looked_at: list[float] = []  # sizes, of the fields
        self.fields: list[Field] = []
        self.peaks_of_fields: list[Peaks] = []
        self.peaks: Peaks  # of all fields; a place is known by its index in these
        self.strongest: np.ndarray  # places without those near a stronger one, the strongest first
        self.fits: dict[int, Detection] = {}  # by place

    def for_one(self, least: float = 0.0, only_large: bool = False) -> list[Detection]:
        """Fit the best places until one is certain and scores at least ``least``; return the likeliest first.

        Large objects come first, and the others if none of these is certain, unless ``only_large``.
        """
        is_large = self.is_large
        worth = self.limits.worth
        places = self._look(self.sizes[is_large], worth)
        if is_large.all():
            fits, _ = self._fit_in_turn(places, least)
        else:
            fits, is_certain = self._fit_in_turn(places[: self.limits.n_large], least)
            if not (is_certain or only_large):
                fits, _ = self._fit_in_turn(self._look(self.sizes[~is_large], worth), least)
        if not fits and self.fits:  # the best places all lie outside the image, and weaker ones were left out
            fits = self._fit_all()
        return self._ranked(fits) if self.bank.normalised else _best_first([detection for detection, _ in fits])

    def for_all(self) -> list[Detection]:
        """Fit the best places of all sizes."""
        return [detection for detection, _ in self._fit_all()]

    def ranked(self, only_large: bool = False) -> list[Detection]:
        """Fit the best places of all or of large sizes, the likeliest first."""
        if not only_large:
            return self._ranked(self._fit_all())
        places = self._look(self.sizes[self.is_large])[: self.limits.n_large]
        return self._ranked(self._fit_those(places))

    def _ranked(self, fits: list[tuple[Detection, float]]) -> list[Detection]:
        """Sort detections, which come with the responses at their places, the likeliest first.

        They are compared by score, size and, of learnt filters, the response.
        """
        of_response = self.limits.of_response if self.bank.normalised else 0.0

        def rank(detection: Detection, response: float) -> float:
            return _sized_score(detection) + of_response * response

        return [detection for detection, _ in sorted(fits, key=lambda each: -rank(*each))]

    def _fit_all(self) -> list[tuple[Detection, float]]:
        """Fit the best places of all sizes; return detections inside the image, with the responses at their places."""
        if not self.bank.normalised:
            # Begin anew: weak responses may be left out of fields that were searched for one object.
            self.looked_at = []
            self.fields = []
            self.peaks_of_fields = []
            self.fits = {}
        return self._fit_those(self._look(self.sizes))

    def _fit_those(self, places: np.ndarray) -> list[tuple[Detection, float]]:
        """Fit places; return detections inside the image, with the responses at their places."""
        fits = [(self._fit(place), float(self.peaks.responses[place])) for place in places]
        return [(detection, response) for detection, response in fits if is_inside(detection.landmarks, self.image)]

    def beside(self, best: Detection) -> tuple[Detection, ...]:
        """Return further certain objects, from the responses that the search for one object has seen."""
        centres = self.peaks.centres[self.strongest]
        diagonals = self.peaks.scales[self.strongest] * self.finder.small.diagonal
        responses = self.peaks.responses[self.strongest]
        low = best.landmarks.min(axis=0)
        high = best.landmarks.max(axis=0)
        is_outside = ((centres < low) | (centres > high)).any(axis=1)
        is_large = diagonals >= LEAST_BESIDE * diagonal_of(best.landmarks)
        places = self.strongest[is_outside & is_large & (responses >= self.limits.clear)][:MOST_BESIDE]
        certain = [self._fit(place) for place in places if self._sum(place) >= self.limits.sure_beside]
        return tuple(choose([best, *_best_first(certain)], are_beside)[1:])

    def filling(self) -> list[Detection]:
        """Fit objects in the middle that fill the frame, as in images cropped around an object.

        Templates respond little there, because they extend beyond the image.
        """
        size = np.array(self.image.shape[1::-1])
        rotations = self.finder.searched_rotations
        templates = [self.bank.templates[TURNS[rotations].index(turn)] for turn in FILLING_TURNS[rotations]]
        places = []
        for template in templates:
            for fraction in FILLING:
                scale = fraction * size.min() / self.finder.small.diagonal
                places.append(_Place(0.5 * (size - 1.0), scale, template, self._field_of(scale)))
        return [self._fit_at(place) for place in places]

    def turned(self, linear: LinearImage, start: np.ndarray, count: int) -> list[np.ndarray]:
        """Return the mean shape in the box of a start (n, 2) in the likeliest rotations, at most so many.

        ``linear`` is the image of the search.
        """
        low, high = corners_of(start)
        mean = self.finder.model.shape_model.mean
        reduced_mean = self.finder.small.shape_model.mean
        turns = np.deg2rad(TURNS[self.finder.searched_rotations])
        starts = [in_box(mean @ rotation(turn).T, 0.5 * (low + high), diagonal_of(start)) for turn in turns]
        fields = [self._field_of(align(reduced_mean, shape).scale) for shape in starts]
        scores = [
            self.finder._fit_start(linear, shape, field).score for shape, field in zip(starts, fields, strict=True)
        ]
        chosen: list[int] = []
        for i in np.argsort(np.negative(scores), kind="stable").tolist():  # the highest score first
            are_apart_from_chosen = np.cos(turns[i] - turns[chosen]) < np.cos(TURNED_APART)
            if len(chosen) < count and are_apart_from_chosen.all():
                chosen.append(i)
        return [starts[i] for i in chosen]

    def _field_of(self, scale: float) -> Field:
        """Return the field whose scale is nearest."""
        return min(self.fields, key=lambda field: abs(np.log(field.scale / scale)))

    def _look(self, sizes: np.ndarray, worth: float = 0.0) -> np.ndarray:
        """Search these sizes; return the places of the strongest responses, also of those searched before.

        Responses below the fraction ``worth`` of the strongest may be left out. Those of filters are kept for later
        calls, so that only responses below :data:`WEAK` are left out, whatever this one needs.
        """
        if self.bank.normalised:
            worth = WEAK
        small = self.finder.small
        n_before = len(self.fields)
        sizes = np.setdiff1d(sizes, self.looked_at)

        def look_at(i: int) -> tuple[Field, Peaks]:
            field = self.grey.field(sizes[i], small)
            return field, self.bank.peaks(field, n_before + i, self.count, worth)

        # The largest field comes first, so that no thread starts a long task at the end.
        for field, peaks in in_threads(look_at, range(len(sizes))):
            self.fields.append(field)
            self.peaks_of_fields.append(peaks)
        self.looked_at += sizes.tolist()
        self.peaks = joined(self.peaks_of_fields)
        self.strongest = strongest(self.peaks, APART * small.diagonal, self.count)
        return self.strongest

    def _fit_in_turn(self, places: np.ndarray, least: float) -> tuple[list[tuple[Detection, float]], bool]:
        """Fit places, the strongest first, until one is certain or responses are low; return whether one is certain.

        The detections come with the responses at their places.
        """
        fits: list[tuple[Detection, float]] = []
        for place in places:
            response = float(self.peaks.responses[place])
            if response < self.limits.worth * self.peaks.responses[places[0]]:
                break
            detection = self._fit(place)
            if not is_inside(detection.landmarks, self.image):
                continue
            fits.append((detection, response))
            if detection.score >= max(least, self.limits.least_score) and self._sum(place) >= self.limits.sure:
                return fits, True
        return fits, False

    def _sum(self, place: int) -> float:
        """Return the sum of score and response that is compared with the limits."""
        return self._fit(place).score + self.limits.of_response * self.peaks.responses[place]

    def _fit(self, place: int) -> Detection:
        """Fit a place, once."""
        if place not in self.fits:
            at = _Place(
                centre=self.peaks.centres[place],
                scale=self.peaks.scales[place],
                template=self.bank.templates[self.peaks.templates[place]],
                field=self.fields[self.peaks.fields[place]],
            )
            self.fits[place] = self._fit_at(at)
        return self.fits[place]

    def _fit_at(self, place: _Place) -> Detection:
        """Fit the reduced model of the part whose template was found."""
        part = place.template.part
        linear = self._linear()
        assert linear is not None  # the caller has it
        detection = self.finder.parts[part]._fit_place(linear, place)
        return replace(detection, part=part) if part else detection


def find(
    model: AAM | str, image, *, limit: int | None = 1, least: float = 0.0, response: Response | None = None
) -> list[Detection]:
    """Find the model's object in an image. For many images make a :class:`Finder` once.

    Parameters
    ----------
    model : AAM or "face"
    image : (h, w, 3) or (h, w) uint8, uint16 or float array, or path
    limit : int or None
        Largest number of objects; None for all, up to 20.
    least : float
        Minimum score, such as 0.52.
    response : Response, optional
        Response of the image's camera; by default the training camera's.

    Returns
    -------
    list of Detection
        Detections without overlap, the best first. With ``limit=1``, the search goes from large to small and stops at
        the first certain detection. Empty only if ``least`` is above 0: without any detection, the result is the mean
        shape in the middle of the image with score 0.

    Raises
    ------
    ImageError
        For an array or a file that is not an image.
    MethodError
        For a model of an early version, without orientations.
    """
    return Finder(named_model(model)).find(image, limit=limit, least=least, response=response)


def search_sizes(size: tuple[int, ...], diagonal: float, known: float = 0.0) -> np.ndarray:
    """Return the diagonals of objects to search for in an image (height, width), pixels, in ratios of ``STEP``.

    ``diagonal`` is that of templates, to which fields are scaled. ``known`` is about the diagonal of the object, where
    a box was given: that of an elongated one is larger than the shorter side of its surroundings. Fields of all sizes
    have :data:`MOST_PIXELS` at most. Long images are therefore searched for fewer small objects, and extremely long
    ones for a single larger size.
    """
    shorter_side = min(size)
    smallest = max(SMALLEST * shorter_side, LEAST_PIXELS)
    largest = max(LARGEST * shorter_side, STEP * known)
    while _field_pixels(size, diagonal / largest) > MOST_PIXELS:  # extremely long: not even one field is allowed
        largest *= STEP
    if smallest >= largest:
        return np.array([largest])
    n_sizes = int(np.log(largest / smallest) / np.log(STEP)) + 1
    sizes = smallest * STEP ** np.arange(n_sizes)
    pixels_from_large = [_field_pixels(size, diagonal / each) for each in sizes[::-1]]
    n_affordable = int((np.cumsum(pixels_from_large) <= MOST_PIXELS).sum())
    return sizes[-n_affordable:] if n_affordable else np.array([largest])


def _field_pixels(size: tuple[int, ...], scale: float) -> float:
    """Return the number of pixels of a field of an image (height, width), with its padding."""
    height, width = size
    around = 2.0 * PADDING * TEMPLATE  # TEMPLATE is the diagonal of templates, pixels of fields
    return (height * scale + around) * (width * scale + around)
