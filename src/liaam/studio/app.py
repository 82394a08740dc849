"""The studio's web application: it wires the parts together, defines the routes, and returns errors as JSON.

A handler reads a request, calls one part in a thread to keep the event loop free, and answers. Errors for the user have
the form ``{"error": sentence}``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from liaam import __version__
from liaam.datasets.folder import PICTURE_SUFFIXES
from liaam.errors import ImageError, LiaamError
from liaam.io.images import VIDEO_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.photometry import CameraModel
from liaam.relighting.lamp import AMBIENT
from liaam.studio import fit_routes, live
from liaam.studio.background import Background
from liaam.studio.events import Events
from liaam.studio.export import attachment, export_of
from liaam.studio.fits import Fits
from liaam.studio.folder import checked_folder, status_of
from liaam.studio.live import LiveVideos
from liaam.studio.model_store import (
    ModelStore,
    follow_template,
    load_dropped_model,
    load_given_model,
    load_studio_model,
    model_json,
)
from liaam.studio.pictures import Pictures, Source, checked_size
from liaam.studio.project import Project
from liaam.studio.safety import FILES, GUEST, HEADERS, UPLOADS, Guard, Refusal
from liaam.studio.settings import Settings
from liaam.studio.store import FolderLock
from liaam.studio.training import Trainer
from liaam.studio.uploads import Uploads, plain_name, read_body, read_json

IMAGE_SIZE, CHROMA_SIZE = 2048, 640
"""Default longest sides in pixels."""

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
            load_given_model(model, models)
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
            *fit_routes.routes(studio.fits),
            *live.routes(studio.live),
            Route("/api/{rest:path}", _nothing),
            Mount("/", StaticFiles(directory=studio.settings.static, html=True)),
        ],
        middleware=[Middleware(Guard, settings=studio.settings)],
        exception_handlers={
            LiaamError: handlers.on_fault,
            HTTPException: _on_http_fault,
            ClientDisconnect: _on_gone,
            Exception: _on_bug,
        },
    )


class _Handlers:
    """Handlers of requests about the project, its training and its pictures."""

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        # A separate limit, so that the thumbnails of a large folder do not delay fits or landmarks.
        self._picture_threads = CapacityLimiter(2)
        self._model_threads = CapacityLimiter(1)

    def routes(self) -> list[Route]:
        get, put, post, delete = (["GET"], ["PUT"], ["POST"], ["DELETE"])
        return [
            Route("/api/project", self.project, methods=get),
            Route("/api/pictures/{name:path}/image", self.image, methods=get),
            Route("/api/pictures/{name:path}/thumbnail", self.thumbnail, methods=get),
            Route("/api/pictures/{name:path}/chroma", self.chroma, methods=get),
            Route("/api/pictures/{name:path}/landmarks", self.landmarks, methods=get),
            Route("/api/pictures/{name:path}/landmarks", self.save_landmarks, methods=put),
            Route("/api/pictures/{name:path}/history", self.history, methods=get),
            Route("/api/review", self.review, methods=post),
            Route("/api/export/{kind}", self.export, methods=get),
            Route("/api/template", self.save_template, methods=put),
            Route("/api/template/file", self.read_template, methods=post),
            Route("/api/training", self.train, methods=post),
            Route("/api/training", self.stop_training, methods=delete),
            Route("/api/events", self.events, methods=get),
            Route(FILES, self.take_in, methods=post),
            Route("/api/model/face", self.decline_face, methods=delete),
            Route(UPLOADS, self.upload, methods=post),
            Route(UPLOADS + "/{id}/image", self.image, methods=get),
            Route(UPLOADS + "/{id}/chroma", self.chroma, methods=get),
            Route("/api/model/file", self.model_file, methods=get),
            Route(GUEST, self.receive_guest, methods=post),
            Route(GUEST, self.dismiss_guest, methods=delete),
        ]

    async def _json(self, request: Request) -> Any:
        return await read_json(request, self.studio.settings.json_bytes)

    async def _in_folder(self, data: Any, act: Callable[..., Any], *arguments: Any) -> Any:
        """Act in a thread; refuse a request with data that names another folder."""

        def checked() -> Any:
            self.studio.project.check_id(data)
            return act(*arguments)

        return await run_sync(checked)

    # The project ----------------------------------------------------------------------------------

    async def project(self, request: Request) -> Response:
        return JSONResponse(await run_sync(self._project_json, request.query_params.get("stamp")))

    def _project_json(self, known: str | None) -> dict[str, Any]:
        from liaam.fitting import METHODS
        from liaam.fitting.methods import DEFAULT_METHOD

        studio, project = self.studio, self.studio.project
        suffix = self._stamp_suffix()  # read before the data: a change in between shows up in the next request
        of_folder = known.removesuffix(suffix) if known is not None and known.endswith(suffix) else None
        overview = project.overview_since(of_folder, OVERVIEW_SECONDS)
        if overview is None:
            return {"unchanged": True, "stamp": known}
        follow_template(project, studio.models, studio.training)
        return {
            "id": project.id,
            "stamp": overview.stamp + suffix,
            "folder": project.root.name or str(project.root),
            "version": __version__,
            "pictures": overview.pictures,
            "template": project.template_json(),
            "offered": project.is_offered,
            "model": model_json(studio.models.current, overview.done, overview.unread),
            "checked": studio.background.has_checked(overview.done),
            "training": asdict(studio.training.state),
            "versions": studio.training.versions.as_json(project.order),
            "methods": [
                {"name": method.name, "summary": method.summary, "needs_colour": method.needs_colour}
                for method in METHODS.values()
            ],
            "default_method": DEFAULT_METHOD,
            "default_ambient": AMBIENT,
            "fitting": studio.background.progress,
            "formats": _formats(),
            "limits": {"upload_bytes": studio.settings.upload_bytes, "pixels": studio.settings.pixels},
            "problems": project.problems,
        }

    def _stamp_suffix(self) -> str:
        """Return the part of a stamp that depends on the model and the training, not on the folder."""
        model = self.studio.models.current
        checks = self.studio.background.checks
        return f"-{0 if model is None else model.number}-{self.studio.training.state.state}-{checks}"

    async def landmarks(self, request: Request) -> Response:
        return JSONResponse(await run_sync(self.studio.project.marks, request.path_params["name"]))

    async def save_landmarks(self, request: Request) -> Response:
        name, data = request.path_params["name"], await self._json(request)
        answer = await self._in_folder(data, self.studio.project.save_marks, name, data)
        self.studio.events.publish("landmarks", {"name": name, "revision": answer["revision"]})
        self.studio.background.wake()
        return JSONResponse(answer)

    async def history(self, request: Request) -> Response:
        return JSONResponse(await run_sync(self.studio.project.history, request.path_params["name"]))

    async def review(self, request: Request) -> Response:
        data = await self._json(request)
        answer = await self._in_folder(data, self.studio.project.review, data)
        # One event, because a page that falls behind is disconnected. "" means that there is no file any more.
        written = [{"name": name, "revision": now or ""} for name, now in answer.pop("revisions").items()]
        self.studio.events.publish("landmarks", written)
        self.studio.background.wake()
        self.studio.events.publish("project", {})
        return JSONResponse(answer)

    async def export(self, request: Request) -> Response:
        name, data = await run_sync(export_of, self.studio.project, request.path_params["kind"])
        headers = {"content-disposition": attachment(name)}
        return Response(data, media_type="application/octet-stream", headers=headers)

    async def save_template(self, request: Request) -> Response:
        data = await self._json(request)
        template = await self._in_folder(data, self._save_template, data)
        self.studio.events.publish("project", {})
        return JSONResponse(template)

    def _save_template(self, data: Any) -> dict[str, Any]:
        studio = self.studio
        try:
            studio.project.save_template(data)
            return studio.project.template_json() or {}
        finally:  # even if this change is refused, since an earlier one may have been finished
            follow_template(studio.project, studio.models, studio.training)

    async def read_template(self, request: Request) -> Response:
        data = await read_body(request, self.studio.settings.json_bytes)
        name = request.query_params.get("name", "")
        template = await run_sync(self.studio.project.read_template, name, data)
        return JSONResponse(template.as_json())

    async def train(self, request: Request) -> Response:
        return JSONResponse(await self._control_training(request, self.studio.training.start), 202)

    async def stop_training(self, request: Request) -> Response:
        return JSONResponse(await self._control_training(request, self.studio.training.stop))

    async def _control_training(self, request: Request, action: Callable[[], Any]) -> dict[str, Any]:
        """Start or stop the training. The request may have a body."""
        body = await self._json(request) if request.headers.get("content-type") else None
        return asdict(await self._in_folder(body, action))

    async def events(self, request: Request) -> Response:
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self.studio.events.stream(), media_type="text/event-stream", headers=headers)

    async def model_file(self, request: Request) -> Response:
        current = self.studio.models.current
        if current is None:
            raise Refusal(404, "there is no model yet: train one")
        data = await run_sync(current.model.to_bytes)
        headers = {"content-disposition": attachment(f"{plain_name(current.model.name or 'model')}.liaam")}
        return Response(data, media_type="application/octet-stream", headers=headers)

    # A model of someone else ----------------------------------------------------------------------

    async def receive_guest(self, request: Request) -> Response:
        settings, name = self.studio.settings, plain_name(request.query_params.get("name", ""))
        data = await read_body(request, settings.upload_bytes)
        model = await run_sync(load_dropped_model, data, name, settings.points, limiter=self._model_threads)
        await run_sync(self.studio.models.receive, model, name.removesuffix(".liaam"))
        return self._changed()

    async def dismiss_guest(self, request: Request) -> Response:
        await run_sync(self.studio.models.dismiss)
        return self._changed()

    def _changed(self) -> Response:
        self.studio.events.publish("project", {})
        return Response(status_code=204)

    async def decline_face(self, request: Request) -> Response:
        await run_sync(self.studio.background.decline)
        return Response(status_code=204)

    # Pictures -------------------------------------------------------------------------------------

    async def take_in(self, request: Request) -> Response:
        data = await read_body(request, self.studio.settings.upload_bytes)
        answer = await run_sync(self.studio.project.take_in, request.query_params.get("name", ""), data)
        self.studio.background.wake()
        return JSONResponse(answer, 201)

    async def upload(self, request: Request) -> Response:
        data = await read_body(request, self.studio.settings.upload_bytes)
        upload = await run_sync(self.studio.uploads.add, data, request.query_params.get("name", ""))
        return JSONResponse({"id": upload.id, "name": upload.name, "width": upload.width, "height": upload.height}, 201)

    async def image(self, request: Request) -> Response:
        size = checked_size(request.query_params.get("size"), IMAGE_SIZE)
        pictures = self.studio.pictures
        return await self._shown(request, f"{size}", lambda picture: pictures.image(picture, size))

    async def thumbnail(self, request: Request) -> Response:
        return await self._shown(request, "thumbnail", self.studio.pictures.thumbnail)

    async def chroma(self, request: Request) -> Response:
        size, current = checked_size(request.query_params.get("size"), CHROMA_SIZE), self.studio.models.current
        camera = CameraModel() if current is None else current.model.camera

        def chroma(picture: Source) -> bytes:
            return self.studio.pictures.chroma(picture, size, camera.suited_to(raw=picture.raw).response)

        kind = f"chroma-{size}-{hash(camera.response) & 0xFFFFFFFF:x}"
        return await self._cached(request, kind, "application/octet-stream", chroma)

    async def _shown(self, request: Request, kind: str, make: Callable[[Source], bytes]) -> Response:
        """Return a JPEG of a picture; remember if it cannot be decoded."""

        def show(picture: Source) -> bytes:
            try:
                return make(picture)
            except ImageError as fault:
                self.studio.project.mark_unreadable(picture, fault)
                raise

        return await self._cached(request, kind, "image/jpeg", show)

    async def _cached(self, request: Request, kind: str, media: str, make: Callable[[Source], bytes]) -> Response:
        """Return bytes computed from a picture, or 304 if the browser has them already."""
        picture = await run_sync(self._source, request)
        headers = {"etag": f'"{picture.tag}-{kind}"', "cache-control": "private, no-cache"}
        known = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
        if headers["etag"] in known:
            return Response(status_code=304, headers=headers)
        content = await run_sync(make, picture, limiter=self._picture_threads)
        return Response(content, media_type=media, headers=headers)

    def _source(self, request: Request) -> Source:
        """Return the picture of the folder, or the dropped one, that a request names."""
        if "id" in request.path_params:
            return self.studio.uploads.source(request.path_params["id"])
        return self.studio.project.source(request.path_params["name"])

    # Errors ---------------------------------------------------------------------------------------

    async def on_fault(self, request: Request, fault: Exception) -> Response:
        """Return the error message; if the disk refused to write, use a status that makes the page retry."""
        text = self.studio.project.plain(fault)
        if isinstance(fault, Refusal):
            return JSONResponse({"error": text, **fault.details}, fault.status)
        refused_write = isinstance(fault.__cause__, OSError) and request.method not in ("GET", "HEAD")
        return JSONResponse({"error": text}, status_of(fault.__cause__) if refused_write else 422)


def _formats() -> dict[str, list[str]]:
    """Return the suffixes of the files that can be added."""
    return {"pictures": list(PICTURE_SUFFIXES), "landmarks": list(LANDMARK_SUFFIXES), "videos": list(VIDEO_SUFFIXES)}


async def _nothing(request: Request) -> Response:
    raise Refusal(404, "this address does not exist")


async def _on_http_fault(request: Request, fault: Exception) -> Response:
    assert isinstance(fault, HTTPException)
    text = "this address does not exist" if fault.status_code == 404 else fault.detail
    return JSONResponse({"error": text}, fault.status_code, fault.headers)


async def _on_gone(request: Request, fault: Exception) -> Response:
    return Response(status_code=400)  # the client has disconnected


async def _on_bug(request: Request, fault: Exception) -> Response:
    text = f"the studio failed ({type(fault).__name__}): see its terminal for details"
    return JSONResponse({"error": text}, 500, {**HEADERS, "connection": "close"})  # the server closes it anyway
