"""Fits for the page: made with the model in use, kept for a while with what they can show, and given away as files.

:class:`Fits` does the work and knows nothing of HTTP; :func:`routes` gives its endpoints. Whatever takes time runs in
threads.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from liaam.errors import LiaamError
from liaam.evaluation import finite_or_none, point_error
from liaam.fitting.angles import angle_degrees
from liaam.fitting.fitter import Fitter
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.result import FitResult
from liaam.fitting.search import Candidate
from liaam.io import Contour, Landmarks, fit_text
from liaam.io.landmarks import FORMATS
from liaam.model import AAM
from liaam.relighting import Relighter
from liaam.relighting.relighter import AMBIENT
from liaam.shape import diagonal_of
from liaam.studio import layers
from liaam.studio.pictures import (
    Kept,
    Pictures,
    Source,
    averaged,
    checked_size,
    fitted_size,
    jpeg_bytes,
    png_bytes,
    shown,
    source_of,
)
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings
from liaam.studio.uploads import Uploads, plain_name, read_json

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response as Answer
    from starlette.routing import Route

    from liaam.studio.project import Project
    from liaam.studio.training import ModelInUse, ModelStore

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

FILES = ("pts", "ljson", "csv", "json", "overlay", "flat", "shading", "relit")
"""What a fit is given away as."""

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
        if not np.isfinite(self.result.shape).all():
            return []
        return ["residual"] if self.no_flat else list(layers.LAYERS)

    def as_json(self) -> dict[str, Any]:
        """What the page is told."""
        result, model = self.result, self.model
        return {
            "id": self.id,
            "method": result.method,
            "status": str(result.status),
            "ok": result.status.ok,
            "message": result.message,
            "quality": finite_or_none(result.quality),
            "seconds": {"search": round(self.search_seconds, 4), "fit": round(self.fit_seconds, 4)},
            "shape": numbers(result.shape, 3),
            "covariances": numbers(result.landmark_covariances, 4),
            "deviations": numbers(result.deviations, 3),
            "theta_deg": angle_degrees(result),
            "cost": finite_or_none(result.cost),
            "found": None if result.found is None else _found(result.found),
            "iterations": [
                {
                    "shape": numbers(step.shape, 2),
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
        layers.residual_of(current.model, result)
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
            layers.residual_of(current.model, result),
            layers.why_not_flat(fitter, image, result),
            error_of(result.shape, truth),
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
        return layers.scaled_points(fit.result.shape, (fit.source.width, fit.source.height), to)

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


def truth_of(landmarks: Landmarks | None) -> np.ndarray | None:
    """Landmarks to compare with: NaN where one is missing, or a person could not see it."""
    if landmarks is None:
        return None
    points = np.array(landmarks.points)
    points[list(landmarks.invisible)] = np.nan
    return points


def parse_start(data: Any) -> Any:
    """Start of a fit as JSON gives it: nothing, a box, or a shape whose points may be null.

    Raises
    ------
    Refusal
        422 if it is neither.
    """
    if data is None:
        return None
    if isinstance(data, dict) and len(data) == 1:
        if isinstance(data.get("box"), list) and len(data["box"]) == 4 and all(map(_is_number, data["box"])):
            return tuple(float(value) for value in data["box"])
        points = data.get("shape")
        if isinstance(points, list) and 0 < len(points) <= 100_000 and all(map(_is_point, points)):
            return np.array([[np.nan, np.nan] if point is None else point for point in points], np.float64)
    raise Refusal(422, "the start is unclear: send null, {box: [left, top, right, bottom]} or {shape: [[x, y], ...]}")


def _is_number(value: Any) -> bool:
    # Beyond this is no pixel, and arithmetic may overflow.
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e9 < value < 1e9


def _is_point(value: Any) -> bool:
    return value is None or (isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)))


# Files --------------------------------------------------------------------------------------------


def file_of(fits: Fits, fit: Fit, what: str, light: tuple[tuple[float, float, float], float]) -> tuple[str, str, bytes]:
    """Name, type and content of a file that a fit is given away as.

    Parameters
    ----------
    fits : Fits
    fit : Fit
    what : str
        One of :data:`FILES`.
    light : (direction, ambient)
        For ``relit``.
    """
    stem = plain_name(fit.source.name).rpartition(".")[0] or plain_name(fit.source.name)
    contours = tuple(Contour(indices, closed) for indices, closed in fit.model.contours)
    if what in ("pts", "ljson", "csv", "json"):
        landmarks = Landmarks(fit.result.shape, contours)
        if what == "json":
            return f"{stem}.json", "application/json", fit_text(landmarks, fit.result.facts(fit.source.name)).encode()
        dump = FORMATS[f".{what}"].dump
        assert dump is not None
        kind = "application/json" if what == "ljson" else "text/csv" if what == "csv" else "text/plain"
        return f"{stem}.{what}", kind, dump(landmarks).encode()
    if what not in FILES:
        raise Refusal(422, f"a fit cannot be given away as '{what[:40]}': there are {', '.join(FILES)}")
    return (
        f"{stem}_{'fit' if what == 'overlay' else what}.png",
        "image/png",
        png_bytes(_picture(fits, fit, what, light)),
    )


def _picture(fits: Fits, fit: Fit, what: str, light: tuple[tuple[float, float, float], float]) -> np.ndarray:
    """Picture to give away, in full size."""
    size = fit.source.width, fit.source.height
    if what == "relit":
        return fits.whole_light(fit).under(*light)
    if what == "flat":
        return fits.whole_light(fit).flat()
    if what == "shading":
        return layers.shading_layer(fits.whole_light(fit), size)
    from liaam.plotting import overlay

    image = shown(fits.pictures.pixels(fit.source), size, fit.source.raw)
    return overlay(image, fit.result.shape, fit.model, covariances=fit.result.landmark_covariances)


def attachment(name: str) -> str:
    """Content-Disposition of a file to be saved under a name of any letters (RFC 6266)."""
    plain = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._- ") else "_" for letter in name)
    return f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(name, safe='')}"


# Endpoints ----------------------------------------------------------------------------------------


def routes(fits: Fits) -> list[Route]:
    """Endpoints of fits; failures leave them as :class:`Refusal`, with the status to answer."""
    from starlette.routing import Route

    endpoints = _Endpoints(fits)
    table: list[tuple[str, str, Callable[[Request], Awaitable[Answer]]]] = [
        ("POST", "/api/fits", endpoints.fit),
        ("GET", "/api/fits/{id}/layers/{layer}", endpoints.layer),
        ("GET", "/api/fits/{id}/relit", endpoints.relit),
        ("GET", "/api/fits/{id}/export", endpoints.export),
    ]
    return [Route(path, _refusing(endpoint), methods=[verb]) for verb, path, endpoint in table]


def _refusing(endpoint: Callable[[Request], Awaitable[Answer]]) -> Callable[[Request], Awaitable[Answer]]:
    """Turn errors about what was asked into refusals with a status."""

    @wraps(endpoint)
    async def refusing(request: Request) -> Answer:
        try:
            return await endpoint(request)
        except Refusal:
            raise
        except LiaamError as fault:
            raise Refusal(422, str(fault)) from fault

    return refusing


class _Endpoints:
    """Requests to calls of functions, in threads."""

    def __init__(self, fits: Fits) -> None:
        import anyio

        self.fits = fits
        # Its own: the thumbnails of a large folder must not keep a fit waiting.
        self._threads = anyio.CapacityLimiter(4)

    async def fit(self, request: Request) -> Answer:
        text = await self._work(self._fitted, await read_json(request, self.fits.settings.json_bytes))
        return _answer(text, "application/json", {"cache-control": "no-store"})

    async def layer(self, request: Request) -> Answer:
        fit, what = self.fits.get(request.path_params["id"]), request.path_params["layer"]
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data = await self._work(self.fits.layer, fit, what, size)
        return _answer(data, "image/png", {"cache-control": "private, max-age=86400, immutable"})

    async def relit(self, request: Request) -> Answer:
        fit, light = self.fits.get(request.path_params["id"]), _light_of(request.query_params)
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data = await self._work(lambda: jpeg_bytes(self.fits.relit(fit, *light, size)))
        return _answer(data, "image/jpeg", {"cache-control": "private, max-age=86400, immutable"})

    async def export(self, request: Request) -> Answer:
        fit, what = self.fits.get(request.path_params["id"]), request.query_params.get("what", "")
        light = _light_of(request.query_params)
        name, kind, data = await self._work(file_of, self.fits, fit, what, light)
        return _answer(data, kind, {"content-disposition": attachment(name), "cache-control": "no-store"})

    def _fitted(self, body: Any) -> bytes:
        """Fit what the page asks for; JSON."""
        if not isinstance(body, dict):
            raise Refusal(422, "send an object with picture or upload, method and start")
        source, of, truth = self._asked_for(body)
        method = body.get("method", DEFAULT_METHOD)
        if not isinstance(method, str):
            raise Refusal(422, "the method is no text: send its name, such as 'soft-li'")
        fit = self.fits.fit(source, of, method, parse_start(body.get("start")), truth)
        return json.dumps(fit.as_json(), allow_nan=False, separators=(",", ":")).encode()

    def _asked_for(self, body: Mapping[str, Any]) -> tuple[Source, tuple[str, str], np.ndarray | None]:
        """Picture to fit, what to call it, and its landmarks if it has any."""
        asked = [(kind, body[kind]) for kind in ("picture", "upload") if body.get(kind) is not None]
        if len(asked) != 1 or not isinstance(asked[0][1], str):
            raise Refusal(422, "say what to fit: either picture, the name of one, or upload, the id of one")
        kind, name = asked[0]
        if kind == "upload":
            return self.fits.uploads.source(name), (kind, name), None
        project = self.fits.project
        project.size_of(name)  # says why a picture cannot be used
        source = source_of(project.path_of(name), self.fits.settings.pixels)
        return source, (kind, name), truth_of(project.landmarks(name))

    async def _work(self, call: Callable, *arguments: Any) -> Any:
        import anyio

        return await anyio.to_thread.run_sync(call, *arguments, limiter=self._threads)


def _answer(content: bytes, kind: str, headers: Mapping[str, str]) -> Answer:
    from starlette.responses import Response as Content

    return Content(content, media_type=kind, headers=dict(headers))


def _light_of(query: Mapping[str, str]) -> tuple[tuple[float, float, float], float]:
    """Direction of a light (x right, y down, z to the viewer) and share of ambient light, as the page gives them."""
    try:
        x, y, z, ambient = (
            float(query.get(key, otherwise)) for key, otherwise in (("x", 0), ("y", 0), ("z", 1), ("ambient", AMBIENT))
        )
    except ValueError:
        x = y = z = ambient = np.nan
    length = float(np.hypot(np.hypot(x, y), z))
    if not (np.isfinite(length) and length > 1e-6 and 0.0 <= ambient <= 1.0):
        raise Refusal(422, "the light is unclear: give its direction x, y, z in numbers, and ambient from 0 to 1")
    return (x / length, y / length, z / length), ambient
