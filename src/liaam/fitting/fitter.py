"""Fitting a model to an image: the check of image and start, the search, and what follows a fit of low quality."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np

from liaam.errors import ImageError, StartError, check_options
from liaam.fitting.detection import DOUBTFUL, Detection, are_as_large, are_beside, choose, is_beside_or_larger
from liaam.fitting.loop.encoded_image import MARGIN
from liaam.fitting.loop.levels import LinearImage, Target
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.low_quality import fit_elsewhere, searched_region
from liaam.fitting.methods import DEFAULT_METHOD, Method
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.fitting.result import LEAST_PRESENT, FitResult, likeliness
from liaam.fitting.search.finder import Finder, likeliest_first
from liaam.fitting.search.other_places import PlacedFit
from liaam.fitting.search.parts import fit_likeliest_part, targets_at
from liaam.fitting.search.poses import fit_from_poses
from liaam.fitting.search.starts import is_box, mapped_points, part_of_start, start_shape
from liaam.fitting.sides import (
    AUTO,
    find_on_sides,
    is_clear,
    likelier_side,
    one_at_each_place,
    reflected_detection,
    reflected_result,
    reflected_start,
    reflections_of,
    reflections_of_start,
    sides_of,
    with_detections,
)
from liaam.formatting import changed_repr
from liaam.model import AAM
from liaam.model.aam import named_model
from liaam.model.file_format import ALL_ROTATIONS
from liaam.model.sides import Sides, reflected_image
from liaam.photometry import CameraModel, is_grey
from liaam.photometry.camera import check_camera
from liaam.photometry.encoding import refuse_unscaled, stored_values
from liaam.photometry.picture import load_picture, path_of
from liaam.trays.order import is_inside, reading_order

OWN_SETTINGS = ("camera", "rotations", "restarts", "margin", "side")  # Fields of a fitter that users set by name

NEARLY = 0.9
"""Score of a detection, as a fraction of the best one in the image, from which it counts although it is uncertain."""


WHAT_TO_DO = "give a start (--init), or search for rotated objects (--rotations all)"
"""What to do about an image in which nothing was found."""


def _score_of_like(detection: Detection, found: Sequence[Detection]) -> float:
    """Return the lowest score of those found objects that are about as large; infinite if none is."""
    return min((each.score for each in found if are_as_large(detection.scale, each.scale)), default=np.inf)


def _likely(detections: Sequence[Detection]) -> list[Detection]:
    """Return the certain ones of detections, and those like the best of these; none if none is certain."""
    best = next((each for each in detections if not each.doubtful), None)
    if best is None:
        return []
    return [each for each in detections if not each.doubtful or each.score >= NEARLY * _score_of_like(each, [best])]


def _best_score(detections: Sequence[Detection]) -> str:
    """Return what is said of the best score where no detection is certain."""
    best = max(detection.score for detection in detections)
    return f"(the best score is {best:.2f}, {DOUBTFUL:g} is needed)"


def _is_believed(fit: FitResult) -> bool:
    """Return whether a fit may be used, and its detection or its quality says that the object is there."""
    return fit.status.ok and not fit.detection_doubtful


@dataclass(frozen=True, eq=False)
class _FirstFit:
    """A fit from the first start, before other places and starts are tried.

    Attributes
    ----------
    fitter : Fitter
        Of the model, or of the part to which the start belongs.
    fit : PlacedFit
    init : start, optional
        In the image as it is fitted.
    reflected : bool
        Whether that is the image reversed left to right.
    part : int, optional
        Index of the part to which the start belongs; None if it may be any.
    """

    fitter: "Fitter"
    fit: PlacedFit
    init: Any
    reflected: bool
    part: int | None = None

    @property
    def detection(self) -> Detection | None:
        """The detection that the fit started from, in the image as it is."""
        detection = self.fit.detection
        if detection is None or not self.reflected:
            return detection
        return reflected_detection(detection, self.fit.target.image.shape[1])

    def completed(self) -> FitResult:
        """Look elsewhere if the fit has low quality, and return the result in the image as it is."""
        result = self.fitter._completed(self.fit, self.init)
        if self.part is not None:
            result = replace(result, part=self.part)
        return reflected_result(result, self.fit.target.image.shape[1]) if self.reflected else result


@dataclass(frozen=True, eq=False)
class Fitter(OneShapeFitter):
    """A model and a method, prepared for fitting many images.

    Attributes
    ----------
    model : AAM
    method : str or Method
        A name of :data:`liaam.fitting.METHODS`, or a custom row.
    options : SolverOptions
    camera : CameraModel, optional
        Camera of the images to be fitted: response, vignetting, noise, and the angle if the method does not estimate
        it. By default the training camera.
    margin : float
        Margin around a start that fits may use, as a fraction of the object's diagonal; less for accurate starts.
    restarts : bool
        Restart fits that are doubtful, or slow and of low quality (:attr:`liaam.model.Reliability.low`), from other
        shapes (:func:`liaam.fitting.search.restarts.other_starts`), and keep the fit of highest quality. This finds
        more turned heads, at about ten times the time of a fit. It has no effect for methods and models without a
        quality, or if ``max_iterations`` is at most 25.
    rotations : {"upright", "all"}, optional
        Rotations to search for: about upright, or any. By default as the objects are turned in the training images
        (:attr:`liaam.AAM.rotations`). If any, the mean shape in a box that is given is turned as well.
    side : str
        Side of the objects. ``"auto"``: both are tried if the model knows of two (:attr:`liaam.AAM.sides`).
        ``"both"``: both are tried in any case. Or one of the model's sides, such as ``"left"``.

    Examples
    --------
    >>> fitter = Fitter(model)                                          # doctest: +SKIP
    >>> results = [fitter.fit(image, box) for image, box in pictures]   # doctest: +SKIP
    """

    camera: CameraModel | None = None
    margin: float = MARGIN
    restarts: bool = True
    rotations: str | None = None
    side: str = AUTO

    __repr__ = changed_repr

    def __dir__(self) -> list[str]:
        """List what is for users: fields and these methods; the other attributes are for the rest of liaam."""
        return [*(each.name for each in fields(self)), "find", "find_all", "fit", "fit_all", "of"]

    @classmethod
    def of(
        cls, model: AAM | str, method: str | Method = DEFAULT_METHOD, *, caller: Callable | None = None, **settings
    ) -> "Fitter":
        """Make a fitter from its own fields and those of :class:`SolverOptions`, all by name.

        ``model`` may be the name of one that comes with liaam. An unknown setting raises an error that also suggests
        the parameters of the function ``caller``, to which the settings were given.
        """
        fitter_settings = {name: settings.pop(name) for name in OWN_SETTINGS if name in settings}
        solver_settings = [field.name for field in fields(SolverOptions)]
        if not settings.keys() <= set(solver_settings):
            parameters = () if caller is None else signature(caller).parameters.values()
            of_function = [each.name for each in parameters if each.kind != each.VAR_KEYWORD]
            check_options(settings, [*dict.fromkeys([*of_function, *OWN_SETTINGS, *solver_settings])])
        return cls(named_model(model), method, SolverOptions(**settings), **fitter_settings)

    def __post_init__(self) -> None:
        """Raise errors now, not at the first image, where these attributes are first needed."""
        self.finder  # noqa: B018
        self._reflections  # noqa: B018
        if self.camera is not None:
            check_camera(self.camera)
        for part in self.parts:
            part.objectives  # noqa: B018

    @cached_property
    def finder(self) -> Finder:
        """The model's detector (see :mod:`liaam.fitting.search.finder`)."""
        return Finder(self.model, self.rotations)

    @property
    def searched_rotations(self) -> str:
        """Rotations that are searched for: those given, or else those of the training images."""
        return self.model.rotations if self.rotations is None else self.rotations

    def find(self, image, *, limit: int | None = 1, least: float = 0.0, name: str = "image") -> list[Detection]:
        """Find the object in an image (see :func:`liaam.fitting.search.finder.find`).

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        limit : int or None
            Largest number of objects; None for all.
        least : float
            Minimum score.
        name : str
            Name of the image in errors; for a path its file name is used.

        Returns
        -------
        list of Detection
            Starts for :meth:`fit`, the best first.
        """
        pixels, _ = load_picture(image, name)

        def search(pixels: np.ndarray) -> list[Detection]:
            return self.finder.find_in(self.linear(pixels), limit=limit, least=least)

        return find_on_sides(pixels, search, self._reflections, limit)

    def linear(self, image: np.ndarray) -> LinearImage:
        """Return an image in linear light, without the vignetting of its camera."""
        return LinearImage(self.image_camera.flatten(image), self.image_camera.response)

    def find_all(self, image, name: str = "image") -> list[Detection]:
        """Find all objects in an image, the best first, without uncertain detections.

        Those that score nearly as high as the best, and are about as large, are kept even if they are slightly
        uncertain: objects of one photograph score alike.

        Raises
        ------
        StartError
            If there are none; the message has the best score.
        """
        image, name = load_picture(image, name)
        detections = self.find(image, limit=None, name=name)
        likely = _likely(detections)
        if not likely:
            raise StartError(f"{name}: no object was found {_best_score(detections)}; {WHAT_TO_DO}")
        return likely

    def fit(self, image, init=None, name: str = "image") -> FitResult:
        """Fit the model to one image.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        init : (n, 2) shape, (m, 2) points, (x0, y0, x1, y1) box, (x, y, diagonal), or Detection, optional
            Start, image pixels (see :func:`liaam.fitting.search.starts.start_shape`). By default the object is searched
            for, and ``result.found`` has the score. A box may be approximate: if the fit from it has low quality, the
            object is searched for around it. The m points of another landmarker, if the model was trained with such
            points, are mapped to the landmarks, and weighed in with the covariance of their errors.
        name : str
            Name of the image in errors; for a path its file name is used.

        Returns
        -------
        FitResult
            Also if the fit fails: see its ``status``.

        Raises
        ------
        ImageError, StartError
            For invalid input.
        """
        path = path_of(image)
        if self._sides is None:
            return replace(self._begun(image, init, name).completed(), image=path)
        return replace(self._likeliest_of_sides(*load_picture(image, name), init), image=path)

    def fit_where_found(self, image, detection: Detection, name: str = "image") -> FitResult:
        """Fit an image as :meth:`fit` does without a start, after a search in it that was made before.

        It is for a search that several methods share. If a side is chosen, the detection is a start.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array
        detection : Detection
            The best place that the search found in the whole image.
        name : str
            Name of the image in errors.
        """
        if self._sides is not None:
            return self.fit(image, detection, name)
        return self._completed(self._first_fit(image, None, name, detection), None)

    def _likeliest_of_sides(self, image: np.ndarray, name: str, init) -> FitResult:
        """Fit an image as it is and reversed left to right, unless the start says of which side the object is."""
        width = image.shape[1]
        of_start = reflections_of_start(self.model, init, width)
        asked = [is_reflected for is_reflected in self._reflections if is_reflected in of_start]
        begun: list[_FirstFit] = []
        for is_reflected in asked or self._reflections:  # a start of another side leaves the choice open
            if is_reflected:
                start = reflected_start(self.model, init, width)
                begun.append(self._begun(reflected_image(image), start, name, is_reflected=True))
            else:
                begun.append(self._begun(image, init, name))
        begun.sort(key=lambda each: likeliness(each.fit.result), reverse=True)
        best = begun[0].completed()
        for other in begun[1:]:
            if not is_clear(best, replace(other.fit.result, found=other.fit.detection)):
                best = likelier_side(best, other.completed(), self.model)
        right = [each for each in begun if each.reflected != best.reflected and each.fit.result.status.ok]
        best = with_detections(best, [each.detection for each in right if each.detection is not None])
        assert self._sides is not None
        return replace(best, side=self._sides.of(best.reflected))

    def _begun(self, image, init, name: str, *, is_reflected: bool = False) -> _FirstFit:
        """Fit from the first start, with the part of the model to which it belongs if it is a whole shape."""
        start = init.landmarks if isinstance(init, Detection) else init
        part = part_of_start(self.model, start, name)
        fitter = self if part is None else self.parts[part]
        return _FirstFit(fitter, fitter._first_fit(image, init, name), init, is_reflected, part)

    def fit_all(self, image, name: str = "image") -> list[FitResult]:
        """Fit every object that the search finds in an image, in reading order: at least that of :meth:`fit`.

        Raises
        ------
        ImageError, StartError
            For invalid input, and if no object is found.
        """
        path = path_of(image)
        image, name = load_picture(image, name)
        return [replace(fit, image=path) for fit in self.fit_objects(image, name)]

    def fit_objects(self, image: np.ndarray, name: str = "image", codes: Sequence[np.ndarray] = ()) -> list[FitResult]:
        """Fit the objects of an image that is read already, in reading order; see :meth:`fit_all`.

        Of several fits in one place, as where the search found parts of an object, that which explains most is kept. If
        the fit to the best place may not be used, or no place is certain, the likeliest one is fitted as :meth:`fit`
        does: that fit judges places by their quality, too. Uncertain places count if they are like an object that was
        found, and their fits are right.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array
        name : str
            Name of the image in errors.
        codes : sequence of (k, 2) arrays
            Corners of codes that name objects, pixels: what lies on one is no object.

        Raises
        ------
        ImageError, StartError
            For invalid input, and if no object is found.
        """

        def is_object(place: np.ndarray) -> bool:
            return not any(is_inside(place, corners) for corners in codes)

        found = self._places(image)
        places = [place for place in found if is_object(place.landmarks)]
        fits = self._fits_of_certain(image, places, name)
        if not fits or not _is_believed(fits[0]):
            likeliest = self._alone(image, name)
            is_needed = not any(map(_is_believed, fits)) and not likeliest.status.lost
            if (_is_believed(likeliest) or is_needed) and is_object(likeliest.place):
                fits.append(likeliest)
        if not fits:
            where = " beside the codes" if codes else ""
            raise StartError(f"{name}: no object was found{where} {_best_score(found)}; {WHAT_TO_DO}")
        kept = one_at_each_place([*fits, *self._fits_of_similar(image, places, fits, name)], self.model)
        return [kept[i] for i in reading_order([fit.place for fit in kept])]

    def _places(self, image: np.ndarray) -> list[Detection]:
        """Find places of objects, of all sides, the likeliest first; some lie on others."""

        def search(pixels: np.ndarray) -> list[Detection]:
            return self.finder.places_in(self.linear(pixels))

        return likeliest_first(find_on_sides(image, search, self._reflections, None))

    def _fits_of_certain(self, image: np.ndarray, places: Sequence[Detection], name: str) -> list[FitResult]:
        """Fit the certain ones of some places; of those that lie on likelier ones, those that are clearly larger."""
        certain = [place for place in places if not place.doubtful]
        return [self.fit(image, place, name) for place in choose(certain, is_beside_or_larger)]

    def _fits_of_similar(
        self, image: np.ndarray, places: Sequence[Detection], fits: Sequence[FitResult], name: str
    ) -> list[FitResult]:
        """Return the right fits to uncertain places beside the objects found, as large and with a part of their score.

        An object of which a part is absent has about the share of what is left in the score of a whole one. Others must
        score nearly as high as the objects found.
        """
        right = [fit for fit in fits if _is_believed(fit)]
        detections = [fit.found for fit in right if fit.found is not None]
        similar: list[FitResult] = []
        for place in places:
            whole = _score_of_like(place, detections)
            taken = (fit.landmarks for fit in [*right, *similar])
            is_similar = place.doubtful and place.score >= LEAST_PRESENT * whole
            if is_similar and all(are_beside(place.landmarks, shape) for shape in taken):
                fit = self.fit(image, place, name)
                least = LEAST_PRESENT if fit.absent.any() else NEARLY
                if fit.status.ok and place.score >= least * whole:
                    similar.append(fit)
        return similar

    def _alone(self, image: np.ndarray, name: str) -> FitResult:
        """Fit the likeliest place of an image, and leave out which further objects its search has seen."""
        fit = self.fit(image, None, name)
        return fit if fit.found is None else replace(fit, found=replace(fit.found, others=()))

    @cached_property
    def _sides(self) -> Sides | None:
        """The sides that objects may have; None if the model knows of one, and no other was asked for."""
        return sides_of(self.model, self.side)

    @cached_property
    def _reflections(self) -> tuple[bool, ...]:
        """Whether images are fitted as they are, reversed left to right, or both."""
        return reflections_of(self.model, self.side)

    @property
    def parts(self) -> tuple["Fitter", ...]:
        """A fitter for each shape of the model: in general only this one."""
        return self._several or (self,)

    @cached_property
    def _several(self) -> tuple["Fitter", ...]:
        """A fitter for each shape of a model of several shapes; empty for other models."""
        if not self.model.others:
            return ()
        return tuple(replace(self, model=part) for part in self.model.parts)

    def part_for(self, fit: FitResult | np.ndarray) -> "Fitter":
        """Return the fitter of the model's part that made a fit, or to which a shape (n, 2) belongs."""
        if not self._several:
            return self
        part = fit.part if isinstance(fit, FitResult) else self.model.part_of(fit)
        return self.parts[part]

    def lit_part_for(self, fit: FitResult) -> "Fitter":
        """Return the part that relights a fit: that which made it, or the first one if only that has learnt light."""
        part = self.part_for(fit)
        first = self.parts[0]
        only_first_has_light = part.model.light is None and first.model.light is not None
        return first if only_first_has_light else part

    def _first_fit(self, image, init, name: str, found: Detection | None = None) -> PlacedFit:
        """Fit from the first start; see :meth:`fit`. Without a start, it is searched for, or was ``found`` before."""
        image, name = load_picture(image, name)  # once for all parts
        target, detection = self.target(image, init if found is None else found, name)
        if self._starts_from_poses(init):
            result = fit_from_poses(self, target, self.searched_rotations)
            return PlacedFit(result, target._replace(start=result.history[0].landmarks), detection)
        rotated = self._targets_in_rotations(target, init)  # empty if one start is enough
        fits = []
        if not self._several:
            for each in rotated or [target]:
                fits.append(PlacedFit(self.fit_target(each), each, detection))
            return max(fits, key=lambda fit: likeliness(fit.result))
        targets_of_starts = [targets_at(each, self.finder.parts) for each in rotated]  # by start, then by part
        if not rotated:
            targets_of_starts = [self._targets_of_parts(target, image, init, name)]
        is_last = self.judge.is_limited or searched_region(init, target.image, restarts=self.restarts) is None
        for targets in targets_of_starts:
            part, result = fit_likeliest_part(self.parts, targets, self.options, is_last)
            fits.append(PlacedFit(result, targets[part], detection, part))
        return max(fits, key=lambda fit: likeliness(fit.result))

    def _starts_from_poses(self, init) -> bool:
        """Return whether a fit starts from the poses of the model: where only the object's place is known."""
        is_place = init is None or isinstance(init, Detection) or is_box(init)
        return is_place and self.model.poses is not None and not self._several

    def _targets_of_parts(self, target: Target, image: np.ndarray, init, name: str) -> list[Target]:
        """Return the targets of all parts for the target of the first; the noise is measured once for all places."""
        target = target.measured(self.objectives[-1].method)
        if init is None:
            return targets_at(target, self.finder.parts)
        others = [part.target(image, init, name)[0] for part in self._several[1:]]
        return [target, *(other._replace(linear=target.linear, noise=target.noise) for other in others)]

    def _targets_in_rotations(self, target: Target, init) -> list[Target]:
        """Return the target with each start of an object in a box that may be turned in any direction; else nothing."""
        if not is_box(init) or self.searched_rotations != ALL_ROTATIONS:
            return []
        return [target._replace(start=start) for start in self.finder.starts_in_box(target.linear, target.start)]

    def _completed(self, first: PlacedFit, init) -> FitResult:
        """Look elsewhere if a first fit has low quality; see :meth:`fit`."""
        result = fit_elsewhere(self.parts, self.finder, first, init, restarts=self.restarts)
        return replace(result, contours=self.model.contours, landmark_names=self.model.landmark_names)

    def target(self, image, init=None, name: str = "image") -> tuple[Target, Detection | None]:
        """Check image and start (see :meth:`fit`); return them as a target, and the detection if there was a search."""
        image, name = load_picture(image, name)
        camera = self.image_camera
        refuse_unscaled(image, name, camera.response)
        self._refuse_grey(image, name)
        linear = self.linear(image)
        if init is None:
            init = self.finder.first_in(linear)
        detection = init if isinstance(init, Detection) else None
        points = init if detection is None else detection.landmarks
        mapped = mapped_points(self.model, points, name)
        height, width = image.shape[:2]
        start = start_shape(self.model, points if mapped is None else mapped, (width, height), name)
        target = Target(linear, start, noise=camera.noise, theta=camera.theta, margin=self.margin)
        point_map = self.model.points
        if mapped is not None and point_map is not None:
            target = self.weighing_in(target, mapped, self._pull, point_map.deviation)
        return target, detection

    def _refuse_grey(self, image: np.ndarray, name: str) -> None:
        """Raise an error if an image is grey and the method needs colours.

        An image of one value (black, white) is not refused: the status of its fit is more specific.
        """
        method = self.objectives[0].method
        if method.needs_colour and is_grey(image) and np.ptp(stored_values(image)) > 0:
            raise ImageError(
                f"{name}: the image is grey (three equal channels), but method {method.name} "
                "compares colours; use method 'soft-li' or 'grey'"
            )

    @cached_property
    def _pull(self) -> np.ndarray | None:
        """Precision of the parameters of landmarks that are mapped from another landmarker's points, (n_p, n_p)."""
        return None if self.model.points is None else self.model.points.left_out.precision(self.shapes)

    @property
    def image_camera(self) -> CameraModel:
        """The camera of the images: :attr:`camera`, or else that of the training images."""
        return self.model.camera if self.camera is None else self.camera
