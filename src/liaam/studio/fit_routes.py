"""Endpoints of fits: they check requests and answer them. Slow work runs in threads."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.io import Landmarks
from liaam.photometry import srgb_to_linear
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient
from liaam.studio.fit_files import attachment, file_of
from liaam.studio.fits import LAYER_SIZE, Fits
from liaam.studio.pictures import Source, checked_size, jpeg_bytes, source_of
from liaam.studio.safety import Refusal
from liaam.studio.uploads import read_json

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response as Answer
    from starlette.routing import Route

MOST_LAMPS = 8
"""Maximum number of lamps of a relit picture."""


def routes(fits: Fits) -> list[Route]:
    """Return the endpoints of fits. Failures are raised as :class:`Refusal` with the status to answer."""
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
    """Turn a :class:`LiaamError` of an endpoint into a refusal with a status."""

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
    """Handlers of requests about fits."""

    def __init__(self, fits: Fits) -> None:
        import anyio

        self.fits = fits
        # A separate limit, so that the thumbnails of a large folder do not delay a fit.
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
        fit, light = self.fits.get(request.path_params["id"]), light_of(request.query_params)
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data = await self._work(lambda: jpeg_bytes(self.fits.relit(fit, *light, size)))
        return _answer(data, "image/jpeg", {"cache-control": "private, max-age=86400, immutable"})

    async def export(self, request: Request) -> Answer:
        fit, what = self.fits.get(request.path_params["id"]), request.query_params.get("what", "")
        light = light_of(request.query_params)
        name, kind, data = await self._work(file_of, self.fits, fit, what, light)
        return _answer(data, kind, {"content-disposition": attachment(name), "cache-control": "no-store"})

    def _fitted(self, body: Any) -> bytes:
        """Fit the requested picture and return JSON."""
        if not isinstance(body, dict):
            raise Refusal(422, "send an object with picture or upload, method and start")
        self.fits.project.check_id(body)
        source, of, truth = self._asked_for(body)
        method = body.get("method", DEFAULT_METHOD)
        if not isinstance(method, str):
            raise Refusal(422, "the method is not a string: send its name, such as 'soft-li'")
        fit = self.fits.fit(source, of, method, parse_start(body.get("start")), truth)
        return json.dumps(fit.as_json(), allow_nan=False, separators=(",", ":")).encode()

    def _asked_for(self, body: Mapping[str, Any]) -> tuple[Source, tuple[str, str], np.ndarray | None]:
        """Return the picture to fit, its reference, and its landmarks if it has any."""
        given = [(kind, body[kind]) for kind in ("picture", "upload") if body.get(kind) is not None]
        if len(given) != 1 or not isinstance(given[0][1], str):
            raise Refusal(422, "the picture to fit is unclear: send either picture, its name, or upload, its id")
        kind, name = given[0]
        if kind == "upload":
            return self.fits.uploads.source(name), (kind, name), None
        project = self.fits.project
        project.size_of(name)  # raises if the picture cannot be used
        source = source_of(project.path_of(name), self.fits.settings.pixels, name)
        return source, (kind, name), truth_of(project.landmarks(name))

    async def _work(self, call: Callable, *arguments: Any) -> Any:
        import anyio

        return await anyio.to_thread.run_sync(call, *arguments, limiter=self._threads)


def _answer(content: bytes, kind: str, headers: Mapping[str, str]) -> Answer:
    from starlette.responses import Response as Content

    return Content(content, media_type=kind, headers=dict(headers))


# Parsing ------------------------------------------------------------------------------------------


def parse_start(data: Any) -> Any:
    """Parse the start of a fit: null, a box, or a shape whose points may be null.

    Raises
    ------
    Refusal
        422 if it is none of these.
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
    # No pixel lies beyond this limit, and arithmetic may overflow.
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e9 < value < 1e9


def _is_point(value: Any) -> bool:
    return value is None or (isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)))


def light_of(query: Mapping[str, str]) -> tuple[list[Lamp], float]:
    """Parse a light: JSON with ``lamps``, the fields of each :class:`Lamp`, and ``ambient``; by default from the front.

    Colours are sRGB values.

    Raises
    ------
    Refusal
        422 if it is something else, or there are more than :data:`MOST_LAMPS`.
    """
    try:
        light = json.loads(query.get("light", '{"lamps": [{"direction": [0, 0, 1]}]}'))
        lamps = [Lamp(**{**lamp, "colour": _linear(lamp.get("colour", (1, 1, 1)))}) for lamp in light["lamps"]]
        ambient = light.get("ambient", AMBIENT)
        check_ambient(ambient)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as fault:
        raise Refusal(422, "the light is unclear: send JSON with lamps, each with a direction, and ambient") from fault
    if len(lamps) > MOST_LAMPS:
        raise Refusal(422, f"{len(lamps)} lamps are too many: send at most {MOST_LAMPS}")
    return lamps, ambient


def _linear(colour: Sequence[float]) -> tuple[float, ...]:
    return tuple(srgb_to_linear(np.array(colour, np.float64)).tolist())


def truth_of(landmarks: Landmarks | None) -> np.ndarray | None:
    """Return the landmarks to compare with, NaN where one is missing or invisible."""
    if landmarks is None:
        return None
    points = np.array(landmarks.points)
    points[list(landmarks.invisible)] = np.nan
    return points
