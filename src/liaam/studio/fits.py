"""Fits for the page: computed with the current model, cached together with their layers, and exported as files."""

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
from liaam.errors import LiaamError, MethodError
from liaam.fitting.detection import Detection
from liaam.fitting.fitter import Fitter
from liaam.fitting.methods import DEFAULT_METHOD, methods_of
from liaam.fitting.result import FitResult
from liaam.formatting import finite_list, finite_or_none
from liaam.io import Contour, Landmarks
from liaam.io.fit_files import fit_text
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.photometry import linear_to_srgb
from liaam.relighting import Lamp, Relighter, paint
from liaam.studio import layers
from liaam.studio.folder import plain_name
from liaam.studio.model_store import ModelInUse, ModelStore
from liaam.studio.pictures import Kept, Pictures, PictureSource, averaged, fitted_size, png_bytes, shown
from liaam.studio.safety import Refusal
from liaam.studio.settings import StudioSettings
from liaam.studio.template import text_of

LAYER_SIZE = 1280  # default longest side of a layer in pixels
LIGHT_SIZE = 2048
"""Longest side in pixels of a relit picture on the page. Splitting a picture into appearance and shading takes about a
second per megapixel. Exported files have the full size."""

LAYER_BYTES = 30_000_000  # bytes of encoded layers in the cache
LIGHT_BYTES = 200_000_000  # maximum bytes of relighters in the cache: a few at 1280 pixels, one at 2048
MODELS_KEPT = 2  # models whose fits are cached: the current and the previous one, each with tens of megabytes
FITTERS_KEPT = 16
Lighting = tuple[Sequence[Lamp], float]  # lamps, and the fraction of ambient light
SHARP = 2.0
"""Diagonal of the object on the copy of a large picture, relative to the model's, from which its fit is kept. The
finest level compares at the model's resolution: on pictures of 12 megapixels, fits differ by 0.04 % of the diagonal."""

FILES = {"pts": "text/plain", "ljson": "application/json", "csv": "text/csv", "json": "application/json"}
FILES |= dict.fromkeys(("overlay", "flat", "shading", "relit"), "image/png")
"""Kinds of files of a fit, and their media types."""

WARM_UP = (480, 640)  # height and width of the image that a new model is fitted to, so that the first real fit is fast


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

    @property
    def model(self) -> AAM:
        """The model of this fit."""
        return self.fitter.model

    def as_json(self) -> dict[str, Any]:
        """Return the fit as JSON for the page. ``objects`` are boxes (left, top, right, bottom), its own first."""
        result, model, detection = self.result, self.model, self.result.found
        is_finite = bool(np.isfinite(result.landmarks).all())
        shapes = [result.landmarks, *(each.landmarks for each in result.beside)] if result.beside and is_finite else []
        boxes = [np.concatenate([shape.min(axis=0), shape.max(axis=0)]) for shape in shapes]
        return {
            "id": self.id,
            "method": result.method.name,
            "status": str(result.status),
            "ok": result.status.ok,
            # The page has no such setting.
            "message": result.message.replace(" or allow more iterations", ""),
            "quality": finite_or_none(result.quality),
            "seconds": {"search": round(self.search_seconds, 4), "fit": round(self.fit_seconds, 4)},
            "shape": numbers(result.landmarks, 3),
            "covariances": numbers(result.landmark_covariances, 4),
            "deviations": numbers(result.sd, 3),
            "theta_deg": result.theta_degrees,
            "cost": finite_or_none(result.cost),
            "found": None
            if detection is None
            else {"score": round(detection.score, 4), "doubtful": detection.doubtful},
            "n_found": result.n_found,
            "objects": [numbers(box, 1) for box in boxes],
            "iterations": [
                {
                    "shape": numbers(step.landmarks, 2),
                    "level": step.level,
                    "cost": finite_or_none(step.cost),
                    "theta_deg": finite_or_none(np.rad2deg(step.theta)),
                }
                for step in result.history
            ],
            "trained_on": self.trained_on,
            "error": None if self.error is None else dict(zip(("pixels", "percent"), self.error, strict=True)),
            "triangles": model.triangles.tolist(),
            "contours": [{"indices": list(indices), "closed": closed} for indices, closed in model.contours],
            "width": self.source.size[0],
            "height": self.source.size[1],
            "layers": [] if not is_finite else ["residual"] if self.no_flat else layers.LAYERS,
            "no_flat": self.no_flat,
            self.of[0]: self.of[1],
        }


def numbers(values: np.ndarray, digits: int) -> list:
    """Return rounded values as nested lists for JSON, with None for those that are not finite."""
    return finite_list(np.round(values, digits))


class Fits:
    """Fits pictures with the current model; thread-safe. A new model is warmed up when it is published."""

    def __init__(self, settings: StudioSettings, models: ModelStore, pictures: Pictures) -> None:
        self.settings, self.models, self.pictures = settings, models, pictures
        self._fits: Kept[str, Fit] = Kept(settings.fits_kept)
        self._fitters: Kept[tuple[int, str, bool], Fitter] = Kept(FITTERS_KEPT)
        self._found: Kept[tuple[str, str, tuple[int, ...], int], Sequence[Detection]] = Kept(settings.fits_kept)
        self._layers: Kept[tuple[str, str, int], tuple[bytes, Any]] = Kept(LAYER_BYTES, lambda layer: len(layer[0]))
        self._lights: Kept[tuple[str, tuple[int, int]], Relighter] = Kept(LIGHT_BYTES, lambda light: light.nbytes)
        self._recent: deque[ModelInUse] = deque(maxlen=MODELS_KEPT)
        self._forgetting, self._large = threading.Lock(), threading.Lock()
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
            if current is None or self._fitters.peek((id(current.model), DEFAULT_METHOD, False)) is not None:
                return
            with suppress(LiaamError):  # the request that needs the result will report it
                image = example(current.model, WARM_UP)
                searcher, fitter = self._searcher(current, False), self._fitter(current, DEFAULT_METHOD, False)
                result = fitter.fit(image, searcher.find(image)[0])
                if layers.why_not_flat(fitter, image, result) is None:
                    layers.taken_apart(fitter, image, result, (image.shape[1], image.shape[0]))

        # It is no daemon: one that is in compiled code when the interpreter ends aborts the process.
        thread = threading.Thread(target=warm_up, name="warm-up")
        thread.start()
        return thread

    def fit(
        self,
        source: PictureSource,
        of: tuple[str, str],
        method: str = DEFAULT_METHOD,
        start: Any = None,
        truth: np.ndarray | None = None,
    ) -> Fit:
        """Fit a picture (``of``: ``picture`` or ``upload``, and its name or id) and cache the result.

        ``start`` is as for :meth:`Fitter.fit`; by default the object is searched for. ``truth`` are the
        picture's landmarks (n, 2), NaN where they are to be ignored.
        """
        if (current := self.models.current) is None:
            raise Refusal(409, "there is no model yet: train one first, or drop a model file on the page")
        fitter = self._fitter(current, method, source.raw)
        small = start is None and source.has_copy  # tried first: it will do for an object that is large on it
        while True:
            with self.pictures.at_work(source, small) as image:
                began = time.perf_counter()
                begin = start
                if start is None:  # all methods share one search
                    key = (source.name, source.tag, image.shape, current.number)
                    searcher = self._searcher(current, source.raw)
                    begin = self._found.get(key, partial(searcher.find, image, name=source.name))[0]
                searched = time.perf_counter()
                result = fitter.fit(image, begin, source.name)
                if start is None and result.quality < result.least_quality:  # try the search's other places
                    result = max(result, fitter.fit(image, None, source.name), key=lambda fit: fit.quality)
                seconds = searched - began, time.perf_counter() - searched
                no_flat = layers.why_not_flat(fitter, image, result)
                result = layers.scaled(result, (image.shape[1], image.shape[0]), source.size)
            # Landmarks on the copy are coarser by the ratio of the widths.
            least = SHARP * fitter.model.diagonal * source.size[0] / image.shape[1]
            if not small or (result.status.ok and diagonal_of(result.landmarks) >= least):
                break
            small = False
        facts, error = current.facts, error_of(result.landmarks, truth)
        trained_on = of[0] == "picture" and of[1] in facts.get("pictures", {}).keys() - facts.get("left_out", {})
        fit = Fit(secrets.token_urlsafe(9), source, fitter, result, *seconds, no_flat, error, of, trained_on)
        self._fits.put(fit.id, fit)
        return fit

    def get(self, number: str) -> Fit:
        """Return the fit with an id."""
        return self._fits.found(number, "this fit is no longer kept: fit again")

    def layer(self, fit: Fit, what: str, size: int) -> tuple[bytes, dict[str, Any] | None]:
        """Return :meth:`draw` as PNG."""
        if what not in layers.LAYERS:
            raise Refusal(404, f"there is no layer '{what[:40]}': choose one of {', '.join(layers.LAYERS)}")

        def make() -> tuple[bytes, dict[str, Any] | None]:
            image, facts = self.draw(fit, what, size)
            return png_bytes(image), facts

        return self._layers.get((fit.id, what, size), make)

    def draw(
        self, fit: Fit, what: str, size: int | None, light: Lighting | None = None
    ) -> tuple[np.ndarray, dict[str, Any] | None]:
        """Draw a layer of the whole picture as (h, w, 4) or (h, w, 3) uint8, its longest side at most ``size``.

        Also return the limit of its colours and what they show, or its place, as JSON for the page. The ``light`` is
        for ``relit``.
        """
        if what == "overlay":
            from liaam.plotting import overlay

            with self.pictures.at_work(fit.source) as pixels:
                image = shown(pixels, fit.source.size, fit.source.raw)
            return overlay(image, fit.result.landmarks, fit.model, covariances=fit.result.landmark_covariances), None
        if what == "residual":
            to = fitted_size(*fit.source.size, size or max(fit.source.size))
            with self.pictures.at_work(fit.source) as image:
                return layers.residual_layer(fit.fitter, image, fit.result, to)
        relighter, to = self._relighter(fit, size)
        if what == "normals":
            layer, box = layers.normals_layer(relighter)
            return layer, {"box": box}
        if what == "shading":
            return layers.shading_layer(relighter, to), {"limit": layers.SHADING_LIMIT, "what": "light"}
        return averaged(relighter.under(*light) if what == "relit" and light else relighter.flat(), to), None

    def export(self, fit: Fit, what: str, light: Lighting) -> tuple[str, str, bytes]:
        """Return the name, media type and content of a file, one of :data:`FILES`; the light is for ``relit``."""
        if what not in FILES:
            raise Refusal(422, f"a fit cannot be exported as '{what[:40]}': choose one of {', '.join(FILES)}")
        stem, kind = plain_name(fit.source.name).rpartition(".")[0] or plain_name(fit.source.name), FILES[what]
        if kind == "image/png":
            content = png_bytes(self.draw(fit, what, None, light)[0])
            return f"{stem}_{'fit' if what == 'overlay' else what}.png", kind, content
        landmarks = Landmarks(fit.result.landmarks, Contour.all_of(fit.model.contours), fit.model.landmark_names)
        if what == "json":
            text = fit_text(landmarks, fit.result.to_dict() | {"image": fit.source.name, "image_size": fit.source.size})
        else:
            text = text_of(landmarks, f".{what}")
        return f"{stem}.{what}", kind, text.encode()

    def _relighter(self, fit: Fit, size: int | None) -> tuple[Relighter, tuple[int, int]]:
        """Return a relighter, computed at no less than :data:`LAYER_SIZE`, and the output size; None: the picture's."""
        whole = fit.source.size

        def make(to: tuple[int, int]) -> Relighter:
            if fit.no_flat is not None:
                raise MethodError(fit.no_flat)
            with self.pictures.at_work(fit.source) as image:
                return layers.taken_apart(fit.fitter, image, fit.result, to, fit.source.raw)

        if size is None and prod(whole) > self.settings.whole_pixels:
            text = f"{fit.source.name} has {whole[0]} x {whole[1]} pixels, more than the {self.settings.whole_pixels:,}"
            raise Refusal(
                422, f"{text} that the studio relights in full size: use 'liaam relight', or a smaller picture"
            )
        if size is None and max(whole) > LIGHT_SIZE:  # not cached: it takes 100 bytes per pixel
            with self._large:
                return make(whole), whole
        size = min(size or LIGHT_SIZE, LIGHT_SIZE)
        at = fitted_size(*whole, max(size, LAYER_SIZE))
        return self._lights.get((fit.id, at), partial(make, at)), fitted_size(*whole, size)

    def _searcher(self, current: ModelInUse, raw: bool) -> Fitter:
        return self._fitter(current, (*methods_of(current.model), DEFAULT_METHOD)[0], raw)

    def _fitter(self, current: ModelInUse, method: str, raw: bool) -> Fitter:
        # A fitter holds its model, so that the id is not used again. A model may be prepared before it has a number.
        model = current.model
        camera = model.camera.suited_to(raw=raw)
        return self._fitters.get((id(model), method, raw), lambda: Fitter(model, method, camera=camera))


def example(model: AAM, size: tuple[int, int]) -> np.ndarray:
    """Return an image of a model's mean appearance on grey, (h, w, 3) uint8."""
    mean = linear_to_srgb(np.clip(np.exp(model.levels[-1].appearances["log"].mean), 0.0, 1.0))
    height, width = size
    shape = model.shape_model.mean * (0.6 * height / diagonal_of(model.shape_model.mean)) + (width / 2, height / 2)
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
