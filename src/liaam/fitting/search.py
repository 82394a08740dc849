"""Detection of the object, for fits without a given start.

Templates of gradient orientations (:mod:`liaam.fitting.templates`) are correlated with the orientations in the image at
many sizes. The best places are fitted with the reduced model by method ``igo``, and scored by how well it explains the
orientations there. If one object is wanted, small ones are searched for only if no large one is certain.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from liaam.errors import MethodError, ModelFileError
from liaam.fitting.detection import DOUBTFUL, Detection, are_apart, are_beside, choose, is_inside
from liaam.fitting.levels import FittedLevel, Levels, LinearImage, Target
from liaam.fitting.methods import get_method
from liaam.fitting.objective import THINNING, make_objectives
from liaam.fitting.picture import described, load_picture
from liaam.fitting.responses import Bank, Peaks, strongest
from liaam.fitting.solver import SolverOptions
from liaam.fitting.templates import TEMPLATE, TURNS, Field, Grey, Template, make_templates, rotated_filters, shrink
from liaam.model import AAM
from liaam.model.aam import named_model
from liaam.model.shape import Similarity, align, diagonal_of, rotation
from liaam.photometry import Response
from liaam.workers import in_threads

# What was measured for these is in experiments/notes/engine.md.
SMALLEST, LARGEST = 0.15, 1.25  # diagonals searched, as fractions of the image's shorter side
LEAST_PIXELS = 20.0  # smallest diagonal, pixels of the image
STEP = 1.2  # ratio of consecutive sizes
PADDING = 0.25  # largest distance that an object may extend beyond the image, as a fraction of its diagonal
# Pixels of all fields of a search together, with their padding. Images of up to 11 to 1 need fewer. In longer ones the
# smallest objects, which take most of the time, are not searched for: below 0.5 of the shorter side at 100 to 1.
MOST_PIXELS = 3_000_000
SETTINGS = SolverOptions(max_iterations=10, tolerance=0.1)  # of the fits of places
VISITED = 0.25  # margin around a place that its fit may use, as a fraction of the object's diagonal
GROWTH = (0.5, 2.0)  # limits on the change of size in the fit of a place; beyond them it has diverged
SHAPE_PENALTY = 0.05  # on the score, per unit of the mean squared shape mode in standard deviations
MOST = 20  # objects in an image

# One object: the sum of score and response at which the search stops, and the fraction of the strongest response below
# which places are left out. Small objects (diagonal as a fraction of the image's shorter side) are searched for only if
# none of the best places of large ones is sure: they take three quarters of the time.
SURE, WORTH = 1.25, 0.75
LARGE, LARGE_PLACES = 0.3, 2

# Further objects: the sum of score and response, the smallest response of places that are fitted, and their number.
SURE_BESIDE, CLEAR, MOST_BESIDE = 1.15, 0.45, 4

# Other places to fit if the first is not the object: their number, and that of places scored for each. Bonus on their
# score per unit of the learnt filter's response, which is 1 at the mean, and per unit of log size: there are more wrong
# places of small sizes.
OTHERS, LOOKED = 12, 2
RESPONSE_WORTH, SIZE_WORTH = 0.5, 0.05

# Objects that fill the frame: diagonals as fractions of its shorter side, and rotations, degrees, of those in TURNS.
FILLING = (0.95, 1.1)
FILLING_TURNS: dict[str, tuple[float, ...]] = {"upright": (0.0,), "all": (-180.0, -90.0, 0.0, 90.0)}


@dataclass(frozen=True, eq=False)
class Finder:
    """A detector for a model, to be used on many images.

    Attributes
    ----------
    model : AAM
    rotations : {"upright", "all"}
        Rotations searched: up to about 25 degrees, or all, at four times the time.

    Examples
    --------
    >>> finder = Finder(model)                              # doctest: +SKIP
    >>> best = [finder.find(image)[0] for image in images]  # doctest: +SKIP
    """

    model: AAM
    rotations: str = "upright"

    def __post_init__(self) -> None:
        """Raise an error if the model is not one, or the rotations are unknown."""
        if not isinstance(self.model, AAM):
            raise ModelFileError(
                f"{described(self.model)} is not a model; give a model first; of a file, give liaam.load_model(path)"
            )
        if self.rotations not in TURNS:
            raise MethodError(f"unknown rotations {self.rotations!r}; choose from {', '.join(TURNS)}")

    @cached_property
    def small(self) -> AAM:
        """The reduced model: the coarsest level on a smaller frame."""
        return shrink(self.model)

    @cached_property
    def parts(self) -> tuple["Finder", ...]:
        """A detector for each shape of the model."""
        return tuple(replace(self, model=part) for part in self.model.parts)

    @cached_property
    def templates(self) -> Bank:
        """All templates of the reduced model."""
        return Bank(make_templates(self.small, self.rotations), int(PADDING * self.small.diagonal))

    @cached_property
    def filters(self) -> Bank:
        """The model's learnt filter in several rotations; the templates if it has none."""
        if self.model.search_filter is None:
            return self.templates
        rotated = rotated_filters(self.model.search_filter, self.rotations, self.small)
        return Bank(rotated, int(PADDING * self.small.diagonal), normalised=True)

    @cached_property
    def level(self) -> Levels:
        """The level of the fits of places."""
        # The limits on scores were set with this thinning. All pixels find no more, and take longer.
        return Levels(make_objectives(self.small, get_method("igo"), thinning=THINNING), keeps_samples=True)

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
        if self.model.others:
            found = [detection for part in self.parts for detection in part.find_in(linear, limit=limit, least=least)]
            return choose(sorted(found, key=lambda detection: -detection.score), are_beside, most)
        search = _Search(self, linear, 6 + 4 * most, self.templates)
        seen = search.for_one(least) if most == 1 else search.for_all()
        seen = seen or [self._in_the_middle(linear.image)]
        chosen = choose(sorted(seen, key=lambda detection: -detection.score), are_beside, most)
        if most == 1:
            chosen = [replace(chosen[0], others=search.beside(chosen[0]))]
        return [detection for detection in chosen if detection.score >= least]

    def others_in(self, linear: LinearImage, most: int = OTHERS) -> list[Detection]:
        """Find other places to fit if the first is not the object: the next best, and some that fill the frame.

        The best come first, ``most`` at most, then those that fill the frame. Their shapes are the aligned mean shape,
        because deformations of the reduced model are a bad start.
        """
        search = _Search(self, linear, LOOKED * most, self.filters)
        worth = 0.0 if self.model.search_filter is None else RESPONSE_WORTH
        mean, places = self.model.shape_model.mean, choose(search.ranked(worth), are_apart, most) + search.filling()
        return [replace(place, landmarks=align(mean, place.landmarks)(mean)) for place in choose(places, are_apart)]

    def _fitted(
        self, linear: LinearImage, centre: np.ndarray, scale: float, template: Template, field: Field
    ) -> Detection:
        """Fit the reduced model at a place of a field, from a template's shape, and score the result."""
        warp = self.level.objectives[0].warp
        start = Similarity(rotation(template.turn) * scale, centre)(warp.shape(template.p))
        (level,) = self.level.fit(Target(linear, start, margin=VISITED), SETTINGS)
        shape, growth = level.reached, diagonal_of(level.reached) / diagonal_of(start)
        if not (np.isfinite(shape).all() and GROWTH[0] < growth < GROWTH[1]):
            return self._detection(start, 0.0)
        strength = field.strength(level.pose(warp.points(level.solution.p)))
        return self._detection(shape, self._score(level, strength))

    def _score(self, level: FittedLevel, strength: np.ndarray) -> float:
        """Return the mean cosine between image and fitted appearance, minus a penalty for an unusual shape."""
        solution, weights = level.solution, level.objective.appearance.usable[:, None].astype(np.float64)
        seen = solution.samples.reshape(-1, 2).astype(np.float64)
        expected = seen - solution.residual.reshape(-1, 2)
        # Pixels outside the image count as unexplained: otherwise half an object at the border scores as a whole one.
        product = float((weights * (solution.usable * strength)[:, None] * seen * expected).sum())
        power = float((weights * np.square(expected)).sum() * weights.sum())
        variance = np.maximum(self.small.shape_model.eigenvalues, 1e-12)
        unusual = float((np.square(solution.p[:-4]) / variance).mean()) if len(variance) else 0.0
        score = product / np.sqrt(power) - SHAPE_PENALTY * unusual if power > 0 else 0.0
        return float(np.clip(score, 0.0, 1.0)) if np.isfinite(score) else 0.0

    def _detection(self, shape: np.ndarray, score: float) -> Detection:
        pose = align(self.model.shape_model.mean, shape)
        return Detection(shape, score, float(np.arctan2(pose.matrix[1, 0], pose.matrix[0, 0])), pose.scale)

    def _in_the_middle(self, image: np.ndarray) -> Detection:
        """Return the mean shape in the middle of the image with score 0, for images without any detection."""
        size = np.array(image.shape[1::-1])
        mean = self.model.shape_model.mean
        return self._detection(mean * (0.8 * size.min() / diagonal_of(mean)) + 0.5 * (size - 1), 0.0)


class _Search:
    """The search of one image, with its fields, maxima and fits so far; ``count`` is the most places to fit."""

    def __init__(self, finder: Finder, linear: LinearImage, count: int, bank: Bank) -> None:
        self.finder, self.linear, self.image, self.count, self.bank = finder, linear, linear.image, count, bank
        self.sizes = search_sizes(self.image.shape[:2], finder.small.diagonal)
        self.grey = Grey.of(self.image, linear.response, self.sizes[0] / finder.small.diagonal)
        self.fields: list[Field] = []
        self.found: list[Peaks] = []
        self.peaks: Peaks  # of all sizes looked at
        self.strongest: np.ndarray  # their indices, without those near a stronger one
        self.fits: dict[int, Detection] = {}  # by these indices

    def for_one(self, least: float) -> list[Detection]:
        """Fit the best places until one is certain and scores at least ``least``, large objects first."""
        large = self.sizes >= LARGE * min(self.image.shape[:2])  # never empty: the largest size exceeds the image
        most = None if large.all() else LARGE_PLACES
        seen, sure = self._in_turn(self._look(self.sizes[large], WORTH)[:most], least)
        if not sure and not large.all():
            seen, _ = self._in_turn(self._look(self.sizes[~large], WORTH), least)
        if not seen and self.fits:  # the best places all lie outside the image, and weaker ones were left out
            return self.for_all()
        return seen

    def for_all(self) -> list[Detection]:
        """Fit the best places of all sizes."""
        return [detection for detection, _ in self._seen()]

    def ranked(self, worth: float) -> list[Detection]:
        """Fit the best places of all sizes, and sort them by score, size and ``worth`` times the response."""
        places = [(d, d.score + worth * r + SIZE_WORTH * np.log(d.scale)) for d, r in self._seen()]
        return [detection for detection, _ in sorted(places, key=lambda each: -each[1])]

    def _seen(self) -> list[tuple[Detection, float]]:
        self.fields, self.found, self.fits = [], [], {}
        seen = [(self._fitted(i), float(self.peaks.responses[i])) for i in self._look(self.sizes)]
        return [(detection, each) for detection, each in seen if is_inside(detection.landmarks, self.image)]

    def beside(self, best: Detection) -> tuple[Detection, ...]:
        """Return further certain objects, from the responses that the search for one object has seen."""
        centres, scales, responses = (
            column[self.strongest] for column in (self.peaks.centres, self.peaks.scales, self.peaks.responses)
        )
        low, high = best.landmarks.min(axis=0), best.landmarks.max(axis=0)
        outside = ((centres < low) | (centres > high)).any(axis=1)
        large = scales * self.finder.small.diagonal >= 0.5 * diagonal_of(best.landmarks)
        clear = self.strongest[outside & large & (responses >= CLEAR)][:MOST_BESIDE]
        sure = [self._fitted(i) for i in clear if self._fitted(i).score + self.peaks.responses[i] >= SURE_BESIDE]
        return tuple(choose([best, *sorted(sure, key=lambda each: -each.score)], are_beside)[1:])

    def filling(self) -> list[Detection]:
        """Fit objects in the middle that fill the frame, as in images cropped around an object.

        Templates respond little there, because they extend beyond the image.
        """
        size, small, rotations = np.array(self.image.shape[1::-1]), self.finder.small, self.finder.rotations
        scales = [fraction * size.min() / small.diagonal for fraction in FILLING]
        nearest = [min(self.fields, key=lambda field: abs(np.log(field.scale / scale))) for scale in scales]
        templates = [self.bank.templates[TURNS[rotations].index(turn)] for turn in FILLING_TURNS[rotations]]
        return [
            self.finder._fitted(self.linear, 0.5 * (size - 1.0), scale, template, field)
            for template in templates
            for scale, field in zip(scales, nearest, strict=True)
        ]

    def _look(self, sizes: np.ndarray, worth: float = 0.0) -> np.ndarray:
        """Search these sizes; return the places of the strongest responses, also of those searched before."""
        small, first = self.finder.small, len(self.fields)

        def look(i: int) -> tuple[Field, Peaks]:
            field = self.grey.field(sizes[i], small)
            return field, self.bank.peaks(field, first + i, self.count, worth)

        # The largest field comes first, so that no thread starts a long task at the end.
        for field, peaks in in_threads(look, range(len(sizes))):
            self.fields.append(field)
            self.found.append(peaks)
        self.peaks = Peaks(*map(np.concatenate, zip(*self.found, strict=True)))
        self.strongest = strongest(self.peaks, 0.2 * small.diagonal, self.count)
        return self.strongest

    def _in_turn(self, places: np.ndarray, least: float) -> tuple[list[Detection], bool]:
        """Fit places, the strongest first, until one is certain or responses are low; return whether one is certain."""
        seen: list[Detection] = []
        for place in places:
            response = self.peaks.responses[place]
            if response < WORTH * self.peaks.responses[places[0]]:
                break
            detection = self._fitted(place)
            if not is_inside(detection.landmarks, self.image):
                continue
            seen.append(detection)
            if detection.score >= max(least, DOUBTFUL) and detection.score + response >= SURE:
                return seen, True
        return seen, False

    def _fitted(self, place: int) -> Detection:
        if place not in self.fits:
            centre, scale, field, template, _ = (column[place] for column in self.peaks)
            about = self.bank.templates[template], self.fields[field]
            self.fits[place] = self.finder._fitted(self.linear, centre, scale, *about)
        return self.fits[place]


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


def search_sizes(size: tuple[int, ...], diagonal: float) -> np.ndarray:
    """Return the diagonals of objects to search for in an image (height, width), pixels, in ratios of ``STEP``.

    ``diagonal`` is that of templates, to which fields are scaled. Fields of all sizes have :data:`MOST_PIXELS` at most.
    Long images are therefore searched for fewer small objects, and extremely long ones for a single larger size.
    """
    low, high = max(SMALLEST * min(size), LEAST_PIXELS), LARGEST * min(size)
    while _field_pixels(size, diagonal / high) > MOST_PIXELS:
        high *= STEP
    if low >= high:
        return np.array([high])
    sizes = low * STEP ** np.arange(int(np.log(high / low) / np.log(STEP)) + 1)
    from_large = [_field_pixels(size, diagonal / each) for each in sizes[::-1]]
    affordable = int((np.cumsum(from_large) <= MOST_PIXELS).sum())
    return sizes[-affordable:] if affordable else np.array([high])


def _field_pixels(size: tuple[int, ...], scale: float) -> float:
    """Return the number of pixels of a field of an image (height, width), with its padding."""
    height, width = size
    around = 2.0 * PADDING * TEMPLATE
    return (height * scale + around) * (width * scale + around)
