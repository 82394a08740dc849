"""Endpoints of fits: they check requests and answer them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from anyio import CapacityLimiter
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from liaam.errors import LiaamError
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.io import Landmarks
from liaam.photometry import srgb_to_linear
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient
from liaam.studio.export import file_of
from liaam.studio.fits import LAYER_SIZE, Fits
from liaam.studio.pictures import Source, checked_size, jpeg_bytes
from liaam.studio.routes import attachment, read_json, route
from liaam.studio.safety import FITS, Refusal

MOST_LAMPS = 8
"""Maximum number of lamps of a relit picture."""


def routes(fits: Fits) -> list[Route]:
    """Return the endpoints of fits."""
    handlers, limiter = _Handlers(fits), CapacityLimiter(4)
    return [
        route("POST", FITS, handlers.fit, read_json, limiter),
        route("GET", FITS + "/{id}/layers/{layer}", handlers.layer, limiter=limiter),
        route("GET", FITS + "/{id}/relit", handlers.relit, limiter=limiter),
        route("GET", FITS + "/{id}/export", handlers.export, limiter=limiter),
    ]


KEPT = {"cache-control": "private, max-age=86400, immutable"}
"""Headers of answers that never change."""


@dataclass(frozen=True)
class _Handlers:
    """Handlers of requests about fits; each runs in a thread."""

    fits: Fits

    def layer(self, request: Request) -> Response:
        fit, what = self.fits.get(request.path_params["id"]), request.path_params["layer"]
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data, scale = self.fits.layer(fit, what, size), json.dumps(self.fits.scale(fit, what, size))
        return Response(data, media_type="image/png", headers={**KEPT, "x-scale": scale})

    def relit(self, request: Request) -> Response:
        fit, light = self.fits.get(request.path_params["id"]), light_of(request.query_params)
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        return Response(jpeg_bytes(self.fits.relit(fit, *light, size)), media_type="image/jpeg", headers=KEPT)

    def export(self, request: Request) -> Response:
        fit, what = self.fits.get(request.path_params["id"]), request.query_params.get("what", "")
        name, kind, data = file_of(self.fits, fit, what, light_of(request.query_params))
        return attachment(name, data, kind)

    def fit(self, request: Request, body: Any) -> Response:
        """Fit the requested picture."""
        if not isinstance(body, dict):
            raise Refusal(422, "send an object with picture or upload, method and start")
        self.fits.project.check_id(body)
        source, of, truth = self._asked_for(body)
        method = body.get("method", DEFAULT_METHOD)
        if not isinstance(method, str):
            raise Refusal(422, "the method is not a string: send its name, such as 'soft-li'")
        fit = self.fits.fit(source, of, method, parse_start(body.get("start")), truth)
        text = json.dumps(fit.as_json(), allow_nan=False, separators=(",", ":"))
        return Response(text, media_type="application/json")

    def _asked_for(self, body: Mapping[str, Any]) -> tuple[Source, tuple[str, str], np.ndarray | None]:
        """Return the picture to fit, its reference, and its landmarks if it has any."""
        given = [(kind, body[kind]) for kind in ("picture", "upload") if body.get(kind) is not None]
        if len(given) != 1 or not isinstance(given[0][1], str):
            raise Refusal(422, "the picture to fit is unclear: send either picture, its name, or upload, its id")
        kind, name = given[0]
        if kind == "upload":
            return self.fits.uploads.source(name), (kind, name), None
        project = self.fits.project
        return project.source(name), (kind, name), truth_of(project.landmarks(name))


def parse_start(data: Any) -> Any:
    """Parse the start of a fit: null, a box, or a shape whose points may be null."""
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
    """
    try:
        light = json.loads(query.get("light", '{"lamps": [{"direction": [0, 0, 1]}]}'))
        lamps = [Lamp(**{**lamp, "colour": _linear(lamp.get("colour", (1, 1, 1)))}) for lamp in light["lamps"]]
        ambient = light.get("ambient", AMBIENT)
        check_ambient(ambient)
    except LiaamError:
        raise
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
