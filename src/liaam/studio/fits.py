"""Fits for the page: made with the model in use, and kept for a while with what they can show.

:class:`Fits` knows nothing of HTTP (:mod:`liaam.studio.fit_routes`), nor of files that are given away
(:mod:`liaam.studio.fit_files`).
"""

from __future__ import annotations

import secrets
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError
from liaam.evaluation import finite_or_none, point_error
from liaam.fitting.fitter import Fitter
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.result import FitResult
from liaam.fitting.search import Candidate
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.relighting import Relighter
from liaam.studio import layers
from liaam.studio.pictures import (
    Kept,
    Pictures,
    Source,
    averaged,
    fitted_size,
    png_bytes,
)
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings
from liaam.studio.uploads import Uploads

if TYPE_CHECKING:
    from liaam.studio.model_store import ModelInUse, ModelStore
    from liaam.studio.project import Project

LAYER_SIZE = 1280
"""Longest side of a layer where the page does not say, pixels."""

LIGHT_SIZE = 2048
"""Longest side at which the page is shown a picture under another light, pixels: to take a picture apart costs about
a second a megapixel. Files that are given away are of the picture's own size."""

LAYER_BYTES = 100_000_000
"""Of encoded layers that are kept."""

LIGHTS_KEPT = 6
"""Fits that are ready to be put under another light at once."""

FITTERS_KEPT = 16

SEARCHED_AHEAD = 4_000_000
"""Pixels of a dropped picture that is searched before anybody asks."""

WARM_UP = (480, 640)
"""Height and width of the picture that is fitted when a model comes into use, so that the first real fit is fast."""

_NO_MODEL = "there is no model yet: train one first, or start with --model FILE"
_GONE = "this fit is no longer kept: fit again"


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit that was made.

    Attributes
    ----------
    id : str
    source : Source
        The picture.
    fitter : Fitter
        With the model that was in use.
    result : FitResult
    search_seconds, fit_seconds : float
    residual : layers.Residual
    no_flat : str or None
        Why its shading cannot be told.
    error : (float, float) or None
        Distance from the picture's own landmarks, pixels and per cent of their diagonal.
    of : (str, str)
        ``picture`` or ``upload``, and its name or id.
    """

    id: str
    source: Source
    fitter: Fitter
    result: FitResult
    search_seconds: float
    fit_seconds: float
    residual: layers.Residual
    no_flat: str | None
    error: tuple[float, float] | None
    of: tuple[str, str]

    @property
    def model(self) -> AAM:
        """The model that was in use."""
        return self.fitter.model

    @property
    def layers(self) -> list[str]:
        """Layers that there are."""
        if not np.isfinite(self.result.landmarks).all():
            return []
        return ["residual"] if self.no_flat else list(layers.LAYERS)

    def as_json(self) -> dict[str, Any]:
        """What the page is told."""
        result, model = self.result, self.model
        return {
            "id": self.id,
            "method": result.method.name,
            "status": str(result.status),
            "ok": result.status.ok,
            "message": result.message,
            "quality": finite_or_none(result.quality),
            "seconds": {"search": round(self.search_seconds, 4), "fit": round(self.fit_seconds, 4)},
            "shape": numbers(result.landmarks, 3),
            "covariances": numbers(result.landmark_covariances, 4),
            "deviations": numbers(result.deviations, 3),
            "theta_deg": result.theta_degrees,
            "cost": finite_or_none(result.cost),
            "found": None if result.found is None else _found(result.found),
            "iterations": [
                {
                    "shape": numbers(step.landmarks, 2),
                    "level": step.level,
                    "cost": finite_or_none(step.cost),
                    "theta_deg": finite_or_none(np.rad2deg(step.theta)),
                }
                for step in result.history
            ],
            "error": None if self.error is None else dict(zip(("pixels", "percent"), self.error, strict=True)),
            "triangles": model.triangles.tolist(),
            "contours": [{"indices": list(indices), "closed": closed} for indices, closed in model.contours],
            "width": self.source.width,
            "height": self.source.height,
            "layers": self.layers,
            "scale": {
                "residual": {"limit": self.residual.limit, "what": self.residual.what},
                "shading": {"limit": layers.SHADING_LIMIT, "what": "natural logarithm of light"},
            },
            self.of[0]: self.of[1],
        }


def _found(candidate: Candidate) -> dict[str, Any]:
    return {"score": round(candidate.score, 4), "doubtful": candidate.doubtful}


def numbers(values: np.ndarray, digits: int) -> list:
    """Nested lists of an array, as JSON knows them: null for what is not finite."""
    rounded = np.round(values, digits)
    if np.isfinite(rounded).all():
        return rounded.tolist()
    return np.where(np.isfinite(rounded), rounded, None).tolist()  # type: ignore[arg-type]


class Fits:
    """Fits pictures with the model in use; may be used from any thread.

    Parameters
    ----------
    project : Project
    models : ModelStore
        Its next models are made ready as they come into use.
    uploads : Uploads
    pictures : Pictures
        Where decoded pictures are kept.
    settings : Settings, optional
    """

    def __init__(
        self,
        project: Project,
        models: ModelStore,
        uploads: Uploads,
        pictures: Pictures,
        settings: Settings | None = None,
    ) -> None:
        self.settings = settings = settings or Settings()
        self.project = project
        self.models = models
        self.uploads = uploads
        self.pictures = pictures
        self._fits: Kept[str, Fit] = Kept(settings.fits_kept)
        self._fitters: Kept[tuple[int, str, bool], Fitter] = Kept(FITTERS_KEPT)
        self._found: Kept[tuple[str, str, int], Candidate] = Kept(settings.fits_kept)
        self._layers: Kept[tuple[str, str, int], bytes] = Kept(LAYER_BYTES, len)
        self._lights: Kept[tuple[str, tuple[int, int]], Relighter] = Kept(LIGHTS_KEPT)
        self._large = threading.Lock()
        models.listeners.append(self.warm_up_soon)
        uploads.listeners.append(self.search_soon)

    def warm_up(self, current: ModelInUse | None) -> None:
        """Fit something, so that nothing has to be made ready at the first fit."""
        if current is None:
            return
        image = example(current.model, WARM_UP)
        searcher, fitter = self._fitter(current, "igo", False), self._fitter(current, DEFAULT_METHOD, False)
        result = fitter.fit(image, searcher.find(image)[0])
        layers.residual_of(fitter, image, result)
        if layers.why_not_flat(fitter, image, result) is None:
            layers.taken_apart(fitter, image, result, (image.shape[1], image.shape[0]))

    def warm_up_soon(self, current: ModelInUse | None) -> threading.Thread:
        """Do so in a thread: what :attr:`ModelStore.listeners` takes."""
        thread = threading.Thread(target=self._try_to_warm_up, args=(current,), name="warm-up", daemon=True)
        thread.start()
        return thread

    def _try_to_warm_up(self, current: ModelInUse | None) -> None:
        try:
            self.warm_up(current)
        except LiaamError:  # the first fit will say what there is to say
            return

    def search_soon(self, source: Source) -> threading.Thread | None:
        """Search a dropped picture while the page is still told of it; the fit that follows has less to do."""
        current = self.models.current
        if current is None or source.width * source.height > SEARCHED_AHEAD:
            return None
        thread = threading.Thread(target=self._try_to_search, args=(current, source), name="search", daemon=True)
        thread.start()
        return thread

    def _try_to_search(self, current: ModelInUse, source: Source) -> None:
        try:
            self._search(current, source, self.pictures.pixels(source))
        except LiaamError:  # the fit will say what there is to say
            return

    def fit(
        self,
        source: Source,
        of: tuple[str, str],
        method: str = DEFAULT_METHOD,
        start: Any = None,
        truth: np.ndarray | None = None,
    ) -> Fit:
        """Fit a picture and keep the result.

        Parameters
        ----------
        source : Source
        of : (str, str)
            ``picture`` or ``upload``, and its name or id.
        method : str
        start : optional
            As :meth:`Fitter.fit` takes it; searched for if left out.
        truth : (n, 2) float, optional
            The picture's landmarks, NaN where they do not count.

        Raises
        ------
        Refusal
            409 without a model.
        ImageError, StartError, MethodError
            For input that makes no sense. A fit that fails is a value.
        """
        current = self.models.current
        if current is None:
            raise Refusal(409, _NO_MODEL)
        fitter = self._fitter(current, method, source.raw)
        image = self.pictures.pixels(source)
        began = time.perf_counter()
        if start is None:
            start = self._search(current, source, image)
        searched = time.perf_counter()
        result = fitter.fit(image, start, source.name)
        fitted = time.perf_counter()
        fit = Fit(
            secrets.token_urlsafe(9),
            source,
            fitter,
            result,
            searched - began,
            fitted - searched,
            layers.residual_of(fitter, image, result),
            layers.why_not_flat(fitter, image, result),
            error_of(result.landmarks, truth),
            of,
        )
        self._fits.put(fit.id, fit)
        return fit

    def get(self, number: str) -> Fit:
        """Fit of an id.

        Raises
        ------
        Refusal
            404 for one that is not kept.
        """
        fit = self._fits.peek(number)
        if fit is None:
            raise Refusal(404, _GONE)
        return fit

    def layer(self, fit: Fit, what: str, size: int) -> bytes:
        """PNG of a layer, of the picture's extent, its longest side at most ``size``.

        Raises
        ------
        Refusal
            404 for a layer that does not exist.
        MethodError
            For one that this fit cannot have.
        """
        if what not in layers.LAYERS:
            raise Refusal(404, f"there is no layer '{what[:40]}': there are {', '.join(layers.LAYERS)}")
        return self._layers.get((fit.id, what, size), lambda: png_bytes(self.draw(fit, what, size)))

    def draw(self, fit: Fit, what: str, size: int) -> np.ndarray:
        """Draw a layer, (h, w, 4) or (h, w, 3) uint8."""
        if what == "residual":
            to = fitted_size(fit.source.width, fit.source.height, size)
            return layers.residual_layer(fit.model, self._shape(fit, to), fit.residual, to)
        light, to = self._light(fit, size)
        return averaged(light.flat(), to) if what == "flat" else layers.shading_layer(light, to)

    def relit(self, fit: Fit, direction: tuple[float, float, float], ambient: float, size: int) -> np.ndarray:
        """Picture with the object under a light from a direction, (h, w, 3) uint8."""
        light, to = self._light(fit, size)
        return averaged(light.under(direction, ambient), to)

    def _light(self, fit: Fit, size: int) -> tuple[Relighter, tuple[int, int]]:
        """Fitted picture taken apart, and the size to give it in: never a small one, which would say little."""
        layers.need_flat(fit.no_flat)
        width, height = fit.source.width, fit.source.height
        size = min(size, LIGHT_SIZE)
        to = fitted_size(width, height, max(size, LAYER_SIZE))

        return self._lights.get((fit.id, to), lambda: self._taken_apart(fit, to)), fitted_size(width, height, size)

    def whole_light(self, fit: Fit) -> Relighter:
        """Fitted picture taken apart in full size. Large ones are not kept: they take a hundred bytes a pixel.

        Raises
        ------
        Refusal
            422 for one that would take too much memory.
        """
        layers.need_flat(fit.no_flat)
        whole = fit.source.width, fit.source.height
        if whole[0] * whole[1] > self.settings.whole_pixels:
            raise Refusal(
                422,
                f"{fit.source.name} has {whole[0]} x {whole[1]} pixels, and the studio takes at most "
                f"{self.settings.whole_pixels:,} apart in full size: use 'liaam relight', or a smaller picture",
            )
        if max(whole) <= LIGHT_SIZE:
            return self._light(fit, max(whole))[0]
        with self._large:
            return self._taken_apart(fit, whole)

    def _taken_apart(self, fit: Fit, to: tuple[int, int]) -> Relighter:
        image = self.pictures.pixels(fit.source)
        return layers.taken_apart(fit.fitter, image, fit.result, to, fit.source.raw)

    def _shape(self, fit: Fit, to: tuple[int, int]) -> np.ndarray:
        return layers.scaled_points(fit.result.landmarks, (fit.source.width, fit.source.height), to)

    def _search(self, current: ModelInUse, source: Source, image: np.ndarray) -> Candidate:
        """Where the object is; one search serves all methods."""
        searcher = self._fitter(current, "igo", source.raw)
        key = (source.name, source.tag, current.number)
        return self._found.get(key, lambda: searcher.find(image, name=source.name)[0])

    def _fitter(self, current: ModelInUse, method: str, raw: bool) -> Fitter:
        return self._fitters.get((current.number, method, raw), lambda: _make_fitter(current.model, method, raw))


def _make_fitter(model: AAM, method: str, raw: bool) -> Fitter:
    return Fitter(model, method, camera=model.camera.suited_to(raw=raw))


def example(model: AAM, size: tuple[int, int]) -> np.ndarray:
    """Picture (h, w, 3) uint8 of a model's mean appearance on grey."""
    mean = np.clip(model.levels[-1].appearances["value"].mean, 0.0, 1.0)
    mean = np.broadcast_to(mean, (len(mean), 3))
    height, width = size
    shape = model.shape_model.mean * (0.6 * height / diagonal_of(model.shape_model.mean)) + (width / 2, height / 2)
    from liaam.relighting import paint

    painted, inside = paint(np.broadcast_to(0, (height, width, 3)), shape, model, mean)
    return np.rint(255 * np.where(inside[..., None], painted, 0.5)).astype(np.uint8)


def error_of(shape: np.ndarray, truth: np.ndarray | None) -> tuple[float, float] | None:
    """Mean distance from the true landmarks: pixels, and per cent of their diagonal; None where that says nothing."""
    if truth is None or truth.shape != shape.shape or not np.isfinite(shape).all():
        return None
    known = truth[np.isfinite(truth).all(axis=1)]
    if len(known) < 2 or not diagonal_of(known) > 0:
        return None
    error = point_error(shape, truth)
    return error, 100.0 * error / diagonal_of(known)
