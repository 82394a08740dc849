"""Fits for the page: computed with the current model, cached together with their layers, and exported as files."""

import io
import secrets
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any

import numpy as np

from liaam.error_measures import point_error
from liaam.errors import LiaamError, MethodError, StartError
from liaam.fitting.detection import Detection
from liaam.fitting.fitter import Fitter
from liaam.fitting.methods import DEFAULT_METHOD, methods_of
from liaam.fitting.result import FitResult, FitStatus, Iteration
from liaam.fitting.sides import AUTO
from liaam.fitting.specimens import fit_specimens
from liaam.formatting import finite_list, finite_or_none
from liaam.io import Contour, Landmarks
from liaam.io.fit_files import fit_text
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.photometry import linear_to_srgb
from liaam.relighting import Lamp, Relighter, paint
from liaam.scale.lengths import Length, unit_of
from liaam.studio import contract, layers
from liaam.studio.folder import plain_name
from liaam.studio.model_store import ModelInUse, ModelStore
from liaam.studio.pictures import Kept, Pictures, PictureSource, averaged, fitted_size, png_bytes, shown
from liaam.studio.refusal import Refusal
from liaam.studio.scale_bars import with_scale_bar
from liaam.studio.settings import StudioSettings
from liaam.studio.template import text_of
from liaam.trays.crops import crop_box
from liaam.trays.naming import Named, in_sentences

LAYER_SIZE = 1280  # default longest side of a layer in pixels
LIGHT_SIZE = 2048
"""Longest side in pixels of a relit picture on the page. Splitting a picture into appearance and shading takes about a
second per megapixel. Exported files have the full size, or as many pixels as the settings allow."""

LAYER_BYTES = 30_000_000  # maximum bytes of encoded layers in the cache
LIGHT_BYTES = 200_000_000  # maximum bytes of relighters in the cache: a few at 1280 pixels, one at 2048
MODELS_KEPT = 2  # models whose fits are cached: the current and the previous one, each with tens of megabytes
FITTERS_KEPT = 16  # fitters in the cache, one for each model, method, kind of picture (RAW or not), and side
LayerFacts = contract.ColourScale | contract.LayerChange | contract.LayerPlace | None  # sent beside a layer
Lighting = tuple[Sequence[Lamp], float]  # lamps, and the fraction of ambient light
SHARP = 2.0
"""Diagonal of the object on the copy of a large picture, relative to the model's, from which its fit is kept. The
finest level compares at the model's resolution: on pictures of 12 megapixels, fits differ by 0.04 % of the diagonal."""

FILES = {
    "pts": "text/plain",
    "ljson": "application/json",
    "csv": "text/csv",
    "json": "application/json",
    "overlay": "image/png",
    "flat": "image/png",
    "balanced": "image/png",
    "shading": "image/png",
    "relit": "image/png",
    "crop": "image/png",
}
"""Kinds of files of a fit, and their media types."""

WARM_UP = (480, 640)  # height and width of the image that a new model is fitted to, so that the first real fit is fast
EXAMPLE_DIAGONAL = 0.6  # diagonal of the object on that image, as a fraction of its height


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit and its inputs."""

    id: str
    source: PictureSource
    fitter: Fitter
    result: FitResult
    search_seconds: float
    fit_seconds: float
    no_flat: str | None  # why its shading cannot be computed
    error: tuple[float, float] | None  # from the picture's landmarks, in pixels and in percent of their diagonal
    of: tuple[str, str]  # ``picture`` or ``upload``, and its name or id
    trained_on: bool = False  # whether the picture is one of those that the model was trained on
    specimen: Named | None = None  # of several that were fitted together
    number: int = 0  # of it, from 1 in reading order

    @property
    def model(self) -> AAM:
        """The model of this fit."""
        return self.fitter.model

    def as_json(self) -> contract.Fit:
        """Return the fit as JSON for the page. Positions have the decimals that drawing needs."""
        result = self.result
        model = self.model
        facts = result.facts()
        answer: contract.Fit = {
            "id": self.id,
            "method": facts["method"],
            "status": facts["status"],
            "quality": facts["quality"],
            "side": facts["side"],
            "theta_deg": facts["theta_deg"],
            "cost": facts["cost"],
            "n_found": facts["n_found"],
            "ok": result.status.ok,
            # The page has no such setting.
            "message": facts["message"].replace(" or allow more iterations", ""),
            "seconds": {"search": round(self.search_seconds, 4), "fit": round(self.fit_seconds, 4)},
            "shape": numbers(result.landmarks, 3),
            "absent": np.flatnonzero(result.absent).tolist(),
            "covariances": numbers(result.landmark_covariances, 4),
            "deviations": numbers(result.sd, 3),
            "found": self._detection_json(),
            "nothing_found": found_nothing(result),
            "objects": self._boxes(),
            "iterations": [_iteration_json(step) for step in result.history],
            "trained_on": self.trained_on,
            "error": self._error_json(),
            "triangles": model.triangles.tolist(),
            "contours": [{"indices": list(indices), "closed": closed} for indices, closed in model.contours],
            "width": self.source.size[0],
            "height": self.source.size[1],
            "layers": [*self._layer_names()],
            "no_flat": self.no_flat,
            "specimen": self._specimen_json(),
        }
        kind, name = self.of
        if kind == "picture":
            answer["picture"] = name
        else:
            answer["upload"] = name
        return answer

    @property
    def at_work(self) -> FitResult:
        """The result in the pixels at which the picture is worked on."""
        return layers.scaled(self.result, self.source.size, self.source.work_size)

    @property
    def _is_finite(self) -> bool:
        return bool(np.isfinite(self.result.landmarks).all())

    def _detection_json(self) -> contract.Found | None:
        """Return how the object was found; None if the fit had a start."""
        detection = self.result.found
        if detection is None:
            return None
        return {"score": round(detection.score, 4), "doubtful": self.result.detection_doubtful}

    def _boxes(self) -> list[list[float]]:
        """Return boxes (left, top, right, bottom) of all objects, this one first; none if it is the only one."""
        if not self.result.beside or not self._is_finite:
            return []
        shapes = [self.result.landmarks, *(other.landmarks for other in self.result.beside)]
        return [numbers(np.concatenate([shape.min(axis=0), shape.max(axis=0)]), 1) for shape in shapes]

    def _error_json(self) -> contract.FitError | None:
        if self.error is None:
            return None
        pixels, percent = self.error
        return {"pixels": pixels, "percent": percent}

    def _specimen_json(self) -> contract.Specimen | None:
        """Return which of several specimens it is; None if it was fitted alone."""
        if self.specimen is None:
            return None
        return {"number": self.number, "name": self.specimen.name, "fault": self.specimen.fault}

    @property
    def stem(self) -> str:
        """Name of files of this fit, without their endings."""
        name = plain_name(self.source.name)
        stem = name.rpartition(".")[0] or name
        return f"{stem}_{self.number}" if self.number else stem

    def _layer_names(self) -> Sequence[str]:
        """Return the layers that can be drawn: without shading only the residuals, and none of a lost object."""
        if not self._is_finite:
            return []
        return ["residual"] if self.no_flat else layers.LAYERS


def _iteration_json(step: Iteration) -> contract.Iteration:
    return {
        "shape": numbers(step.landmarks, 2),
        "level": step.level,
        "cost": finite_or_none(step.cost),
        "theta_deg": finite_or_none(np.rad2deg(step.theta)),
    }


def numbers(values: np.ndarray, digits: int) -> list:
    """Return rounded values as nested lists for JSON, with None for those that are not finite."""
    return finite_list(np.round(values, digits))


class Fits:
    """Fits pictures with the current model; thread-safe. A new model is warmed up when it is published."""

    def __init__(self, settings: StudioSettings, models: ModelStore, pictures: Pictures) -> None:
        self.settings = settings
        self.models = models
        self.pictures = pictures
        self._fits: Kept[str, Fit] = Kept(settings.fits_kept)
        self._fitters: Kept[tuple[int, str, bool, str], Fitter] = Kept(FITTERS_KEPT)
        self._found: Kept[tuple[str, str, tuple[int, ...], int], Sequence[Detection]] = Kept(settings.fits_kept)
        self._layers: Kept[tuple[str, str, int, bool], tuple[bytes, LayerFacts]] = Kept(
            LAYER_BYTES, lambda layer: len(layer[0])
        )
        self._lights: Kept[tuple[str, tuple[int, int]], Relighter] = Kept(LIGHT_BYTES, lambda light: light.nbytes)
        self._recent: deque[ModelInUse] = deque(maxlen=MODELS_KEPT)
        self._forgetting = threading.Lock()  # of _recent
        self._large = threading.Lock()  # one large relighter at a time, because of its memory
        models.listeners += [self.forget_former, self.warm_up_soon]

    def forget_former(self, current: ModelInUse | None) -> None:
        """Remove the results of earlier models from the caches; a listener of :class:`ModelStore`."""
        if current is None:
            return
        with self._forgetting:  # models may be published by two threads
            self._recent.append(current)
            numbers = {model.number for model in self._recent}
            models = {id(model.model) for model in self._recent}
        self._fitters.keep_only(lambda key, _: key[0] in models)
        self._found.keep_only(lambda key, _: key[-1] in numbers)
        self._fits.keep_only(lambda _, fit: id(fit.model) in models)
        self._lights.keep_only(lambda key, _: self._fits.peek(key[0]) is not None)

    def warm_up_soon(self, current: ModelInUse | None) -> threading.Thread:
        """Fit an example in a thread, unless the model has fitted, so that the first real fit does no set-up work."""

        def warm_up() -> None:
            if current is None or self._fitters.peek((id(current.model), DEFAULT_METHOD, False, AUTO)) is not None:
                return
            with suppress(LiaamError):  # the request that needs the result will report it
                image = example(current.model, WARM_UP)
                searcher = self._searcher(current, raw=False)
                fitter = self._fitter(current, DEFAULT_METHOD, raw=False)
                result = fitter.fit(image, searcher.find(image)[0])
                if layers.why_not_flat(fitter, image, result) is None:
                    layers.taken_apart(fitter, image, result, (image.shape[1], image.shape[0]))

        # It is no daemon, also if the thread that starts it is one: a daemon that is in compiled code when the
        # interpreter ends aborts the process.
        thread = threading.Thread(target=warm_up, name="warm-up", daemon=False)
        thread.start()
        return thread

    def fit(
        self,
        source: PictureSource,
        of: tuple[str, str],
        method: str = DEFAULT_METHOD,
        start: Any = None,
        truth: np.ndarray | None = None,
        side: str = AUTO,
    ) -> Fit:
        """Fit a picture (``of``: ``picture`` or ``upload``, and its name or id) and cache the result.

        ``start`` is as for :meth:`Fitter.fit`; by default the object is searched for. ``truth`` are the
        picture's landmarks (n, 2), NaN where they are to be ignored. ``side`` is that of :class:`Fitter`.
        """
        if (current := self.models.current) is None:
            raise Refusal(409, "there is no model yet: train one first, or drop a model file on the page")
        fitter = self._fitter(current, method, source.raw, side)
        computed = None
        if start is None and source.has_copy:  # tried first: it will do for an object that is large on it
            computed = self._compute(source, fitter, current, start=None, on_copy=True)
        if computed is None or not computed.is_sharp:
            computed = self._compute(source, fitter, current, start, on_copy=False)
        facts = current.facts
        trained_on = facts.get("pictures", {}).keys() - facts.get("left_out", {}).keys()
        fit = Fit(
            id=secrets.token_urlsafe(9),
            source=source,
            fitter=fitter,
            result=computed.result,
            search_seconds=computed.search_seconds,
            fit_seconds=computed.fit_seconds,
            no_flat=computed.no_flat,
            error=error_of(computed.result.landmarks, truth),
            of=of,
            trained_on=of[0] == "picture" and of[1] in trained_on,
        )
        self._fits.put(fit.id, fit)
        return fit

    def fit_all(
        self, source: PictureSource, of: tuple[str, str], method: str, side: str = AUTO
    ) -> tuple[list[Fit], list[str]]:
        """Fit all specimens of a picture, and cache the results, in reading order. Also return what is not clear.

        ``side`` is as for :meth:`fit`.
        """
        if (current := self.models.current) is None:
            raise Refusal(409, "there is no model yet: train one first, or drop a model file on the page")
        fitter = self._fitter(current, method, source.raw, side)
        stem = plain_name(source.name).rpartition(".")[0] or plain_name(source.name)
        began = time.perf_counter()
        with self.pictures.at_work(source) as image:
            try:
                fitted = fit_specimens(fitter, image, name=source.name, stem=stem)
            except StartError as fault:
                raise Refusal(422, f"{str(fault).partition(';')[0]}. Draw a box around each.") from fault
            no_flat = [layers.why_not_flat(fitter, image, result) for result in fitted.results]
            size = image.shape[1], image.shape[0]
        seconds = (time.perf_counter() - began) / len(fitted.results)
        fits = [
            Fit(
                id=secrets.token_urlsafe(9),
                source=source,
                fitter=fitter,
                result=layers.scaled(result, size, source.size),
                search_seconds=0.0,
                fit_seconds=seconds,
                no_flat=why_not,
                error=None,
                of=of,
                specimen=named,
                number=number,
            )
            for number, (result, named, why_not) in enumerate(
                zip(fitted.results, fitted.named, no_flat, strict=True), start=1
            )
        ]
        for fit in fits:
            self._fits.put(fit.id, fit)
        return fits, fitted.faults

    def crop(self, fit: Fit) -> np.ndarray:
        """Return the part of the picture around a specimen, (h, w, 3) uint8."""
        with self.pictures.at_work(fit.source) as pixels:
            image = shown(pixels, fit.source.work_size, fit.source.raw)
        box = crop_box(fit.at_work.landmarks, (image.shape[1], image.shape[0]))
        if box is None:
            raise Refusal(422, "the specimen was not found, so that there is nothing to crop")
        left, top, right, bottom = box
        return image[top:bottom, left:right]

    def table(self, fits: Sequence[Fit], pixel: tuple[float, str] | None) -> bytes:
        """Return fits as a table, one row each, with the columns of those of ``liaam batch``.

        ``pixel`` is the length of a pixel and its unit, if they are known.
        """
        from liaam.batch.tables import BatchTable, write_csv_rows  # heavy: imported when first needed
        from liaam.batch.work import fit_row

        length = None if pixel is None else Length(pixel[0], unit_of(pixel[1]))
        rows = []
        for fit in fits:
            row = fit_row(fit.result, fit.source.name, fit.source.size, length)
            named = fit.specimen or Named(plain_name(fit.source.name))
            facts = {"object": fit.number or None, "specimen": named.name, "code": named.code, "seconds": None}
            message = in_sentences(fit.result.message, named.fault)
            rows.append(("", row | facts | {"message": message}))
        model = fits[0].model
        text = io.StringIO(newline="")
        write_csv_rows(text, BatchTable(rows, model.n_points, True, {}, names=tuple(model.landmark_names or ())))
        return text.getvalue().encode()

    def _compute(
        self, source: PictureSource, fitter: Fitter, current: ModelInUse, start: Any, on_copy: bool
    ) -> "_Computed":
        """Fit a picture, or the small copy of a large one, from a start, or else where the search finds the object."""
        with self.pictures.at_work(source, on_copy) as image:
            began = time.perf_counter()
            begin = None
            if start is not None:
                begin = layers.start_at(start, source.size, (image.shape[1], image.shape[0]))
            elif fitter.model.sides is None:  # of two sides, fits search for both
                begin = self._detection(source, image, current)
            searched = time.perf_counter()
            if isinstance(begin, Detection):
                result = fitter.fit_where_found(image, begin, source.name)
            else:
                result = fitter.fit(image, begin, source.name)
            fitted = time.perf_counter()
            no_flat = layers.why_not_flat(fitter, image, result)
            result = layers.scaled(result, (image.shape[1], image.shape[0]), source.size)
        # Landmarks on the copy are coarser by the ratio of the widths.
        least_diagonal = SHARP * fitter.model.diagonal * source.size[0] / image.shape[1]
        return _Computed(
            result=result,
            search_seconds=searched - began,
            fit_seconds=fitted - searched,
            no_flat=no_flat,
            is_sharp=result.status.ok and diagonal_of(result.landmarks) >= least_diagonal,
        )

    def _detection(self, source: PictureSource, image: np.ndarray, current: ModelInUse) -> Detection:
        """Return the best place of the object in a picture; all methods share one search."""
        key = (source.name, source.tag, image.shape, current.number)
        searcher = self._searcher(current, source.raw)
        return self._found.get(key, partial(searcher.find, image, name=source.name))[0]

    def get(self, number: str) -> Fit:
        """Return the fit with an id."""
        return self._fits.found(number, "this fit is no longer kept: fit again")

    def layer(self, fit: Fit, what: str, size: int, balance: bool = True) -> tuple[bytes, LayerFacts]:
        """Return :meth:`draw` as PNG."""
        if what not in layers.LAYERS:
            raise Refusal(404, f"there is no layer '{what[:40]}': choose one of {', '.join(layers.LAYERS)}")

        def make() -> tuple[bytes, LayerFacts]:
            image, facts = self.draw(fit, what, size, balance=balance)
            return png_bytes(image), facts

        return self._layers.get((fit.id, what, size, balance), make)

    def draw(
        self,
        fit: Fit,
        what: str,
        size: int | None,
        light: Lighting | None = None,
        opacity: float = 1.0,
        balance: bool = True,
    ) -> tuple[np.ndarray, LayerFacts]:
        """Draw a layer of the whole picture as (h, w, 4) or (h, w, 3) uint8, its longest side at most ``size``.

        Also return its colours, or its place. The ``light`` is for ``relit``; the ``opacity`` over the picture
        itself is for ``relit``, ``flat`` and ``balanced``, and the ``balance`` of the colour of the light for the first
        two.
        """
        if what == "overlay":
            from liaam.plotting import overlay_of_fit  # heavy: imported when first needed

            with self.pictures.at_work(fit.source) as pixels:
                image = shown(pixels, fit.source.work_size, fit.source.raw)
            return overlay_of_fit(image, fit.at_work, fit.model, ellipses=True), None
        if what == "residual":
            to = fitted_size(*fit.source.size, size or max(fit.source.size))
            with self.pictures.at_work(fit.source) as image:
                return layers.residual_layer(fit.fitter, image, fit.at_work, to)
        relighter, to = self._relighter(fit, size)
        if what == "normals":
            layer, box = layers.normals_layer(relighter)
            return layer, {"box": box}
        if what == "shading":
            even = layers.is_even(relighter, relighter.flat(balance=False))
            return layers.shading_layer(relighter, to), {"limit": layers.SHADING_LIMIT, "what": "light", "even": even}
        facts: LayerFacts = None
        if what == "balanced":
            image = relighter.colour_corrected()
            facts = {"even": not relighter.colour.is_found, "colour": relighter.colour.name}
        elif what == "relit" and light:
            image = relighter.under(*light, balance=balance)
        else:
            image = relighter.flat(balance=balance)
            facts = {"even": layers.is_even(relighter, image), "colour": relighter.colour.name}
        if opacity < 1.0:  # as the page draws it: in stored values
            image = np.rint(relighter.picture + opacity * (image - np.float32(relighter.picture))).astype(np.uint8)
        return averaged(image, to), facts

    def export(
        self,
        fit: Fit,
        what: str,
        light: Lighting,
        pixel: tuple[float, str] | None = None,
        opacity: float = 1.0,
        balance: bool = True,
    ) -> tuple[str, str, bytes]:
        """Return the name, media type and content of a file, one of :data:`FILES`.

        The light, the opacity and the balance are those of :meth:`draw`. With the length of a ``pixel`` and its unit,
        the overlay has a scale bar.
        """
        if what not in FILES:
            raise Refusal(422, f"a fit cannot be exported as '{what[:40]}': choose one of {', '.join(FILES)}")
        media_type = FILES[what]
        stem = fit.stem
        if what == "crop":
            return f"{stem}_crop.png", media_type, png_bytes(self.crop(fit))
        if media_type == "image/png":
            image, _ = self.draw(fit, what, None, light, opacity, balance)
            if what == "overlay" and pixel is not None:
                length, unit = pixel
                image = with_scale_bar(image, length * fit.source.size[0] / image.shape[1], unit)
            ending = "fit" if what == "overlay" else what
            return f"{stem}_{ending}.png", media_type, png_bytes(image)
        points, _ = fit.result.reported()
        landmarks = Landmarks(points, Contour.all_of(fit.model.contours), fit.model.landmark_names)
        if what == "json":
            text = fit_text(landmarks, fit.result.to_dict() | {"image": fit.source.name, "image_size": fit.source.size})
        else:
            text = text_of(landmarks, f".{what}")
        return f"{stem}.{what}", media_type, text.encode()

    def _relighter(self, fit: Fit, size: int | None) -> tuple[Relighter, tuple[int, int]]:
        """Return a relighter of a fit, and the (width, height) to draw.

        The longest side is ``size``, at most :data:`LIGHT_SIZE`, or if None that of the picture, or less for one of
        more pixels than the settings allow. A relighter that is cached has at least :data:`LAYER_SIZE`, so that smaller
        layers share it.
        """
        whole = fit.source.size

        def make(to: tuple[int, int]) -> Relighter:
            """Compute the relighter at a (width, height)."""
            if fit.no_flat is not None:
                raise MethodError(fit.no_flat)
            with self.pictures.at_work(fit.source) as image:
                return layers.taken_apart(fit.fitter, image, fit.at_work, to, fit.source.raw)

        if size is None:
            share = min(1.0, (self.settings.whole_pixels / prod(whole)) ** 0.5)
            most = fitted_size(*whole, int(share * max(whole)))
            if max(most) > LIGHT_SIZE:  # not cached: it takes 100 bytes per pixel
                with self._large:
                    return make(most), most
            size = max(most)
        size = min(size, LIGHT_SIZE)
        at = fitted_size(*whole, max(size, LAYER_SIZE))
        return self._lights.get((fit.id, at), partial(make, at)), fitted_size(*whole, size)

    def _searcher(self, current: ModelInUse, raw: bool) -> Fitter:
        """Return the fitter whose search all methods share: that of the model's first method."""
        methods = (*methods_of(current.model), DEFAULT_METHOD)
        return self._fitter(current, methods[0], raw)

    def _fitter(self, current: ModelInUse, method: str, raw: bool, side: str = AUTO) -> Fitter:
        """Return the fitter of a model, a method and a side, for pictures that are ``raw`` (linear values) or not."""
        # A fitter holds its model, so that the id is not used again. A model may be prepared before it has a number.
        model = current.model
        camera = model.camera.suited_to(raw=raw)
        key = (id(model), method, raw, side)
        return self._fitters.get(key, lambda: Fitter(model, method, camera=camera, side=side))


@dataclass(frozen=True, eq=False)
class _Computed:
    """The result of a fit, in pixels of the picture, and how it was computed."""

    result: FitResult
    search_seconds: float
    fit_seconds: float
    no_flat: str | None  # why its shading cannot be computed
    is_sharp: bool  # whether the object is so large on the image that was fitted that a larger one adds no accuracy


MAY_BE_ELSEWHERE = (FitStatus.DOUBTFUL, FitStatus.MAX_ITERATIONS, FitStatus.DIVERGED)
"""Statuses that may be due to the place of a fit. Others name a fault of the picture, such as too dark."""


def found_nothing(result: FitResult) -> bool:
    """Whether neither the search nor the fit has found an object, so that the landmarks are a guess."""
    return result.detection_doubtful and result.status in MAY_BE_ELSEWHERE


def example(model: AAM, size: tuple[int, int]) -> np.ndarray:
    """Return an image of a model's mean appearance on grey, (h, w, 3) uint8, of a (height, width)."""
    mean = linear_to_srgb(np.clip(np.exp(model.levels[-1].appearances["log"].mean), 0.0, 1.0))
    height, width = size
    scale = EXAMPLE_DIAGONAL * height / diagonal_of(model.shape_model.mean)
    shape = model.shape_model.mean * scale + (width / 2, height / 2)
    painted, inside = paint(np.broadcast_to(0, (height, width, 3)), shape, model, mean)
    return np.rint(255 * np.where(inside[..., None], painted, 0.5)).astype(np.uint8)


def error_of(shape: np.ndarray, truth: np.ndarray | None) -> tuple[float, float] | None:
    """Return the mean distance from the true landmarks in pixels and in percent of their diagonal, if defined."""
    if truth is None or truth.shape != shape.shape or not np.isfinite(shape).all():
        return None
    present = truth[np.isfinite(truth).all(axis=1)]
    if len(present) < 2 or not diagonal_of(present) > 0:
        return None
    error = point_error(shape, truth)
    return error, 100.0 * error / diagonal_of(present)


def truth_of(landmarks: Landmarks | None) -> np.ndarray | None:
    """Return the landmarks to compare with, NaN where one is missing or invisible."""
    if landmarks is None:
        return None
    points = np.array(landmarks.points)
    points[list(landmarks.invisible)] = np.nan
    return points
