"""The studio's web application: it wires the parts together, defines the routes, and returns errors as JSON.

Errors for the user have the form ``{"error": sentence}``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from liaam import __version__
from liaam.errors import ImageError, LiaamError
from liaam.fitting.methods import DEFAULT_METHOD, METHODS
from liaam.io.images import PICTURE_SUFFIXES, VIDEO_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.model import load_model
from liaam.photometry import CameraModel
from liaam.relighting.lamp import AMBIENT
from liaam.studio import live
from liaam.studio.background import Background
from liaam.studio.events import Events
from liaam.studio.export import export_of, file_of, measurements_of
from liaam.studio.fits import LAYER_SIZE, Fits, truth_of
from liaam.studio.folder import checked_folder, status_of
from liaam.studio.live import LiveVideos
from liaam.studio.model_store import (
    ModelStore,
    load_dropped_model,
    load_studio_model,
    model_json,
)
from liaam.studio.pictures import Pictures, Source, jpeg_bytes
from liaam.studio.project import Project
from liaam.studio.routes import attachment, checked_size, light_of, maybe_json, parse_start, read_json, route
from liaam.studio.safety import FILES, FITS, GUEST, HEADERS, UPLOADS, Guard, Refusal
from liaam.studio.settings import Settings
from liaam.studio.store import FolderLock
from liaam.studio.training import Trainer
from liaam.studio.uploads import Uploads, plain_name

IMAGE_SIZE, CHROMA_SIZE = 2048, 640
"""Default longest sides in pixels."""

FORMATS = {"pictures": PICTURE_SUFFIXES, "landmarks": LANDMARK_SUFFIXES, "videos": VIDEO_SUFFIXES}
"""Suffixes of the files that can be added."""

KEPT = {"cache-control": "private, max-age=86400, immutable"}
"""Headers of answers that never change."""

OVERVIEW_SECONDS = 0.2
"""How long a request for the project may read files; the rest is read in the background."""


@dataclass(frozen=True, eq=False)
class Studio:
    """The parts of a studio on one folder."""

    settings: Settings
    project: Project
    models: ModelStore
    events: Events
    training: Trainer
    background: Background
    pictures: Pictures
    uploads: Uploads
    fits: Fits
    live: LiveVideos
    lock: FolderLock

    def close(self) -> None:
        """Close the event streams, stop a running training, and release the folder."""
        self.events.close()
        self.background.stop()
        self.training.stop()
        self.project.store.close()
        self.lock.release()


def make_studio(folder: str | Path, model: Path | None = None, settings: Settings | None = None) -> Studio:
    """Create the studio of a folder.

    Parameters
    ----------
    folder : path-like
        Folder of the pictures; may be empty.
    model : Path, optional
        Model to use instead of the one that the studio trained in this folder before.
    settings : Settings, optional

    Raises
    ------
    LiaamError
        If the folder or the model cannot be used, or another studio has the folder open.
    """
    settings = settings or Settings()
    lock = FolderLock(checked_folder(folder), settings.address.partition("?")[0])
    try:
        project, models, events = Project(folder, settings), ModelStore(), Events(settings.heartbeat_seconds)
        project.prepare()
        pictures = Pictures()
        uploads = Uploads(pictures, settings)
        trainer = Trainer(project, models, events.publish)
        background = Background(project, models, trainer, events.publish)
        fits, videos = Fits(project, models, uploads, pictures), LiveVideos(models, settings)
        if model is not None:
            models.publish(load_model(model), {"source": "file", "trained": None, "pictures": {}})
        else:
            load_studio_model(project, models)
        return Studio(settings, project, models, events, trainer, background, pictures, uploads, fits, videos, lock)
    except BaseException:
        lock.release()
        raise


def make_app(studio: Studio) -> Starlette:
    """Create the web application of a studio."""
    handlers = _Handlers(studio)
    return Starlette(
        routes=[
            *handlers.routes(),
            *live.routes(studio.live),
            Mount("/", StaticFiles(directory=studio.settings.static, html=True)),
        ],
        middleware=[Middleware(Guard, settings=studio.settings)],
        exception_handlers={
            LiaamError: handlers.on_fault,
            HTTPException: _on_http_fault,
            Exception: _on_bug,
        },
    )


class _Handlers:
    """Handlers of requests about the project, its training and its pictures; each runs in a thread."""

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        self.project = studio.project

    def routes(self) -> list[Route]:
        act, project, training, data = self._in_folder, self.project, self.studio.training, Request.body
        # Separate limits, so that the thumbnails of a large folder do not delay fits or landmarks.
        shown, models, fits = CapacityLimiter(2), CapacityLimiter(1), CapacityLimiter(4)
        of_picture = "/api/pictures/{name:path}/"
        return [
            route("GET", "/api/project", self.overview),
            route("GET", of_picture + "image", self.image, limiter=shown),
            route("GET", of_picture + "chroma", self.chroma, limiter=shown),
            route("GET", of_picture + "landmarks", lambda asked: project.marks(asked.path_params["name"])),
            route("PUT", of_picture + "landmarks", act(self.save_landmarks), read_json),
            route("GET", of_picture + "history", lambda asked: project.history(asked.path_params["name"])),
            route("POST", "/api/review", act(self.review), read_json),
            route("GET", "/api/export/{kind}", lambda it: attachment(*export_of(project, it.path_params["kind"]))),
            route("GET", "/api/measurements", self.measurements),
            route("PUT", "/api/template", act(self.save_template), read_json),
            route("POST", "/api/template/file", self.read_template, data),
            route("POST", "/api/training", act(self.train), maybe_json, status=202),
            route("DELETE", "/api/training", act(lambda *_: asdict(training.stop())), maybe_json),
            Route("/api/events", self.events, methods=["GET"]),
            route("POST", FILES, self.take_in, data, status=201),
            route("DELETE", "/api/model/face", lambda _: self.studio.background.decline()),
            route("POST", UPLOADS, self.upload, data, status=201),
            route("GET", UPLOADS + "/{id}/image", self.image, limiter=shown),
            route("GET", UPLOADS + "/{id}/chroma", self.chroma, limiter=shown),
            route("GET", "/api/model/file", self.model_file),
            route("POST", GUEST, self.receive_guest, data, models),
            route("DELETE", GUEST, self.dismiss_guest),
            route("POST", FITS, act(self.fit), read_json, fits),
            route("GET", FITS + "/{id}/layers/{layer}", self.layer, limiter=fits),
            route("GET", FITS + "/{id}/relit", self.relit, limiter=fits),
            route("GET", FITS + "/{id}/export", self.export_fit, limiter=fits),
        ]

    def _in_folder(self, act: Callable[[Request, Any], Any]) -> Callable[[Request, Any], Any]:
        """Refuse a request with data that names another folder."""

        def checked(request: Request, data: Any) -> Any:
            self.project.check_id(data)
            return act(request, data)

        return checked

    def _changed(self) -> None:
        self.studio.events.publish("project", {})

    def overview(self, request: Request) -> dict[str, Any]:
        studio, project, known = self.studio, self.project, request.query_params.get("stamp")
        model, training = studio.models.current, studio.training
        # Read before the data: a change in between shows up in the next request.
        suffix = f"-{0 if model is None else model.number}-{training.state.state}-{studio.background.checks}"
        of_folder = known.removesuffix(suffix) if known is not None and known.endswith(suffix) else None
        overview = project.overview(of_folder, OVERVIEW_SECONDS)
        if overview is None:
            return {"unchanged": True, "stamp": known}
        training.follow_template()
        return {
            "id": project.id,
            "stamp": overview.stamp + suffix,
            "folder": project.root.name or str(project.root),
            "version": __version__,
            "pictures": overview.pictures,
            "template": project.templates.as_json(),
            "offered": project.templates.is_offered,
            "model": model_json(studio.models.current, overview.done, overview.unread),
            "checked": studio.background.has_checked(overview.done),
            "training": asdict(training.state),
            "versions": training.versions.as_json(project.templates.order),
            "methods": [
                {"name": method.name, "summary": method.summary, "needs_colour": method.needs_colour}
                for method in METHODS.values()
            ],
            "default_method": DEFAULT_METHOD,
            "default_ambient": AMBIENT,
            "fitting": studio.background.progress,
            "formats": FORMATS,
            "limits": {"upload_bytes": studio.settings.upload_bytes, "pixels": studio.settings.pixels},
            "problems": project.problems,
        }

    def save_landmarks(self, request: Request, data: Any) -> dict[str, Any]:
        name = request.path_params["name"]
        answer = self.project.save_marks(name, data)
        self.studio.events.publish("landmarks", {"name": name, "revision": answer["revision"]})
        self.studio.background.wake()
        return answer

    def review(self, request: Request, data: Any) -> dict[str, Any]:
        answer = self.project.review(data)
        # One event, because a page that falls behind is disconnected. "" means that there is no file any more.
        written = [{"name": name, "revision": now or ""} for name, now in answer.pop("revisions").items()]
        self.studio.events.publish("landmarks", written)
        self.studio.background.wake()
        self._changed()
        return answer

    def measurements(self, request: Request) -> Response:
        asked = request.query_params
        return attachment(*measurements_of(self.project, asked.get("measures", ""), asked.get("scale", "")))

    def save_template(self, request: Request, data: Any) -> dict[str, Any]:
        studio = self.studio
        try:
            self.project.save_template(data)
            template = self.project.templates.as_json() or {}
        finally:  # even if this change is refused, since an earlier one may have been finished
            studio.training.follow_template()
        self._changed()
        return template

    def read_template(self, request: Request, data: bytes) -> dict[str, Any]:
        return self.project.read_template(_name(request), data).as_json()

    async def events(self, request: Request) -> Response:
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self.studio.events.stream(), media_type="text/event-stream", headers=headers)

    def train(self, request: Request, data: Any) -> dict[str, Any]:
        return asdict(self.studio.training.start(isinstance(data, dict) and data.get("slips") is True))

    def model_file(self, request: Request) -> Response:
        current = self.studio.models.current
        if current is None:
            raise Refusal(404, "there is no model yet: train one")
        return attachment(f"{plain_name(current.model.name or 'model')}.liaam", current.model.to_bytes())

    def receive_guest(self, request: Request, data: bytes) -> None:
        name = plain_name(_name(request))
        model = load_dropped_model(data, name, self.studio.settings.points)
        facts = {"source": "guest", "trained": None, "pictures": {}, "name": name.removesuffix(".liaam")}
        self.studio.models.publish(model, facts, "guest")
        self._changed()

    def dismiss_guest(self, request: Request) -> None:
        self.studio.models.withdraw("guest")
        self._changed()

    def take_in(self, request: Request, data: bytes) -> dict[str, Any]:
        answer = self.project.take_in(_name(request), data)
        self.studio.background.wake()
        return answer

    def upload(self, request: Request, data: bytes) -> dict[str, Any]:
        """Keep a dropped picture; with a ``method``, also fit it. If that fails, asking for the fit will say why."""
        asked, studio, fit = request.query_params, self.studio, None
        upload = studio.uploads.add(data, asked.get("name", ""))
        if "method" in asked:
            with suppress(LiaamError):
                source = studio.uploads.source(upload.id)
                fit = studio.fits.fit(source, ("upload", upload.id), asked["method"]).as_json()
        return {"id": upload.id, "name": upload.name, "width": upload.width, "height": upload.height, "fit": fit}

    def image(self, request: Request) -> Response:
        size = checked_size(request.query_params.get("size"), IMAGE_SIZE)
        return self._cached(request, f"{size}", lambda picture: self.studio.pictures.image(picture, size))

    def chroma(self, request: Request) -> Response:
        size, current = checked_size(request.query_params.get("size"), CHROMA_SIZE), self.studio.models.current
        camera = CameraModel() if current is None else current.model.camera

        def chroma(picture: Source) -> bytes:
            return self.studio.pictures.chroma(picture, size, camera.suited_to(raw=picture.raw).response)

        kind = f"chroma-{size}-{hash(camera.response) & 0xFFFFFFFF:x}"
        return self._cached(request, kind, chroma, "application/octet-stream")

    def _cached(
        self, request: Request, kind: str, make: Callable[[Source], bytes], media: str = "image/jpeg"
    ) -> Response:
        """Return bytes computed from a picture, or 304 if the browser has them; remember JPEGs that cannot be made."""
        asked, studio = request.path_params, self.studio
        picture = studio.uploads.source(asked["id"]) if "id" in asked else self.project.source(asked["name"])
        headers = {"etag": f'"{picture.tag}-{kind}"', "cache-control": "private, no-cache"}
        known = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
        if headers["etag"] in known:
            return Response(status_code=304, headers=headers)
        try:
            return Response(make(picture), media_type=media, headers=headers)
        except ImageError as fault:
            if media == "image/jpeg":
                self.project.mark_unreadable(picture, fault)
            raise

    def layer(self, request: Request) -> Response:
        fit, what = self.studio.fits.get(request.path_params["id"]), request.path_params["layer"]
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data, scale = self.studio.fits.layer(fit, what, size), json.dumps(self.studio.fits.scale(fit, what, size))
        return Response(data, media_type="image/png", headers={**KEPT, "x-scale": scale})

    def relit(self, request: Request) -> Response:
        fit, light = self.studio.fits.get(request.path_params["id"]), light_of(request.query_params)
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        return Response(jpeg_bytes(self.studio.fits.relit(fit, *light, size)), media_type="image/jpeg", headers=KEPT)

    def export_fit(self, request: Request) -> Response:
        fit, what = self.studio.fits.get(request.path_params["id"]), request.query_params.get("what", "")
        name, kind, data = file_of(self.studio.fits, fit, what, light_of(request.query_params))
        return attachment(name, data, kind)

    def fit(self, request: Request, body: Any) -> dict[str, Any]:
        if not isinstance(body, dict):
            raise Refusal(422, "send an object with picture or upload, method and start")
        given = [(kind, body[kind]) for kind in ("picture", "upload") if body.get(kind) is not None]
        if len(given) != 1 or not isinstance(given[0][1], str):
            raise Refusal(422, "the picture to fit is unclear: send either picture, its name, or upload, its id")
        method = body.get("method", DEFAULT_METHOD)
        if not isinstance(method, str):
            raise Refusal(422, "the method is not a string: send its name, such as 'soft-li'")
        kind, name = given[0]
        truth = None if kind == "upload" else truth_of(self.project.landmarks(name))
        source = self.studio.uploads.source(name) if kind == "upload" else self.project.source(name)
        return self.studio.fits.fit(source, (kind, name), method, parse_start(body.get("start")), truth).as_json()

    async def on_fault(self, request: Request, fault: Exception) -> Response:
        """Return the error message; if the disk refused to write, use a status that makes the page retry."""
        text = self.project.plain(fault)
        if isinstance(fault, Refusal):
            return JSONResponse({"error": text, **fault.details}, fault.status)
        writes = request.method not in ("GET", "HEAD") and request.url.path != FITS
        refused_write = isinstance(fault.__cause__, OSError) and writes
        return JSONResponse({"error": text}, status_of(fault.__cause__) if refused_write else 422)


def _name(request: Request) -> str:
    """Return the name of the file in the body of a request."""
    return request.query_params.get("name", "")


async def _on_http_fault(request: Request, fault: Exception) -> Response:
    assert isinstance(fault, HTTPException)
    text = "this address does not exist" if fault.status_code == 404 else fault.detail
    return JSONResponse({"error": text}, fault.status_code, fault.headers)


async def _on_bug(request: Request, fault: Exception) -> Response:
    text = f"the studio failed ({type(fault).__name__}): see its terminal for details"
    return JSONResponse({"error": text}, 500, {**HEADERS, "connection": "close"})  # the server closes it anyway
