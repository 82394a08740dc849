"""The studio's web application: it wires the parts together, defines the routes, and returns errors as JSON.

Errors for the user have the form ``{"error": sentence}``.
"""

import json
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, cast

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import Receive, Scope, Send

from liaam import __version__
from liaam.errors import ImageError, LiaamError
from liaam.fitting.methods import DEFAULT_METHOD, METHODS
from liaam.fitting.sides import AUTO
from liaam.io.images import PICTURE_SUFFIXES, VIDEO_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.model import load_model
from liaam.photometry import CameraModel
from liaam.relighting.lamp import AMBIENT
from liaam.studio import contract, live, picture_files, shapes
from liaam.studio.agreement import model_agreement
from liaam.studio.background import Background
from liaam.studio.fits import LAYER_SIZE, Fit, Fits, truth_of
from liaam.studio.folder import Folder, checked_folder, plain_name, status_of
from liaam.studio.found_scale import found_scale
from liaam.studio.live import LiveVideos
from liaam.studio.model_store import ModelStore, load_dropped_model, load_studio_model, model_json
from liaam.studio.pictures import Pictures, PictureSource, Uploads, jpeg_bytes
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.routes import (
    Events,
    attachment,
    checked_size,
    light_of,
    maybe_json,
    parse_side,
    parse_start,
    read_json,
    route,
)
from liaam.studio.safety import FILES, FITS, GUEST, HEADERS, UPLOADS, Guard
from liaam.studio.sets import agreement, make_set, observers, others
from liaam.studio.settings import StudioSettings
from liaam.studio.static_files import Page
from liaam.studio.store import folder_locked
from liaam.studio.tiles import Tiles
from liaam.studio.training import Trainer

IMAGE_SIZE = 2048  # default longest side of an image, pixels
CHROMA_SIZE = 640  # of its invariant
KEPT = {"cache-control": "private, max-age=86400, immutable"}  # headers of answers that never change
OVERVIEW_SECONDS = 0.2  # how long a request for the project may read files; the rest is read in the background

OfSet = tuple["Studio", str]


class Studio:
    """The parts of a studio on one folder, or on a further set of its landmarks, and how it answers requests.

    Parameters
    ----------
    folder : path-like
        Folder of the pictures; may be empty.
    model : Path, optional
        Model to use instead of the one that the studio trained in this folder before.
    settings : StudioSettings, optional
    of : tuple, optional
        The studio that has the folder open, and a further set of landmarks of that folder, by name.

    Raises
    ------
    LiaamError
        If the folder or the model cannot be used, or another studio has the folder open.
    """

    def __init__(
        self,
        folder: str | Path,
        model: Path | None = None,
        settings: StudioSettings | None = None,
        of: OfSet | None = None,
    ) -> None:
        self.settings = settings or StudioSettings()
        with ExitStack() as lock:
            if of is None:
                lock.enter_context(
                    folder_locked(Folder(checked_folder(folder)), self.settings.address.partition("?")[0])
                )
            self.project: Project = of[0].project.of_set(of[1]) if of else Project(folder, self.settings)
            self.project.store.prepare()
            self._others: dict[str, Studio] = {}  # of further sets of landmarks
            self._making = threading.Lock()
            self.models, self.events = ModelStore(), Events(self.settings.heartbeat_seconds)
            self.pictures = of[0].pictures if of else Pictures()
            self.tiles = of[0].tiles if of else Tiles(self.pictures)
            self.uploads = Uploads(self.pictures, self.settings)
            self.training = Trainer(self.project, self.models, self.events.publish)
            self.background = Background(self.project, self.models, self.training, self.events.publish)
            self.fits = Fits(self.settings, self.models, self.pictures)
            self.live = LiveVideos(self.models, self.settings)
            self.models.listeners.append(lambda _: self.events.publish("project", {}))
            if model is None:
                load_studio_model(self.project, self.models)
            else:
                self.models.publish(load_model(model), {"source": "file", "trained": None, "pictures": {}})
            self._lock = lock.pop_all()

    def of_set(self, name: str) -> "Studio":
        """Return the studio of a further set of landmarks, which is made when it is first asked for."""
        with self._making:
            if name not in self._others:
                self._others[name] = Studio(self.project.root, None, self.settings, (self, name))
                self._others[name].background.start()
            return self._others[name]

    def end_events(self) -> None:
        """Close the event streams of all sets of landmarks."""
        for each in (*self._others.values(), self):
            each.events.close()

    def close(self) -> None:
        """Close the event streams, stop a running training, and release the folder."""
        for each in self._others.values():
            each.close()
        self.events.close()
        self.background.stop()
        self.training.stop()
        self.project.store.close()
        self._lock.close()

    def routes(self) -> list[Route]:
        """Return the endpoints, whose handlers run in threads."""
        project = self.project
        data = Request.body
        # Separate limits, so that the thumbnails of a large folder do not delay fits or landmarks.
        shown = CapacityLimiter(2)
        models = CapacityLimiter(1)
        fits = CapacityLimiter(4)
        of_picture = "/api/pictures/{name:path}/"
        return [
            route("GET", "/api/project", self._overview),
            route("GET", of_picture + "image", self._image, limiter=shown),
            route("GET", of_picture + "chroma", self._chroma, limiter=shown),
            route("GET", of_picture + "tiles/{level:int}/{column:int}/{row:int}", self._tile, limiter=shown),
            route("GET", of_picture + "landmarks", lambda asked: project.marks(asked.path_params["name"])),
            route("PUT", of_picture + "landmarks", self._save_landmarks, read_json),
            route("GET", of_picture + "history", lambda asked: project.history(asked.path_params["name"])),
            route("POST", "/api/review", self._review, read_json),
            route("PUT", "/api/sides", self._save_sides, read_json),
            route("POST", "/api/removed", partial(self._change_files, picture_files.remove), read_json),
            route("POST", "/api/restored", partial(self._change_files, picture_files.restore), read_json),
            route("POST", "/api/renamed", self._rename, read_json),
            route("GET", "/api/export/{kind}", lambda it: attachment(*project.export(it.path_params["kind"]))),
            route("GET", "/api/measurements", self._measurements),
            route("GET", "/api/shapes", lambda asked: shapes.shapes(project, asked.query_params)),
            route("PUT", "/api/groups", self._save_groups, read_json),
            route("GET", of_picture + "scale", self._found_scale, limiter=fits),
            route("GET", of_picture + "others", lambda asked: others(project, asked.path_params["name"])),
            route("POST", "/api/sets", lambda _, data: make_set(project, data), read_json, status=201),
            route("GET", "/api/agreement", lambda _: agreement(project)),
            route("GET", "/api/agreement/model", lambda _: model_agreement(project)),
            route("PUT", "/api/template", self._save_template, read_json),
            route("POST", "/api/template/file", lambda it, raw: project.read_template(_name(it), raw).as_json(), data),
            route("POST", "/api/training", self._train, maybe_json, status=202),
            route("DELETE", "/api/training", self._stop_training, maybe_json),
            Route("/api/events", self._events, methods=["GET"]),
            route("POST", FILES, self._take_in, data, status=201),
            route("DELETE", "/api/model/face", lambda _: self.background.decline()),
            route("POST", UPLOADS, self._upload, data, status=201),
            route("GET", UPLOADS + "/{id}/image", self._image, limiter=shown),
            route("GET", UPLOADS + "/{id}/chroma", self._chroma, limiter=shown),
            route("GET", UPLOADS + "/{id}/tiles/{level:int}/{column:int}/{row:int}", self._tile, limiter=shown),
            route("GET", "/api/model/file", self._model_file),
            route("POST", GUEST, self._receive_guest, data, models),
            route("DELETE", GUEST, lambda _: self.models.publish(None, place="guest")),
            route("POST", FITS, self._fit, read_json, fits),
            route("POST", FITS + "/all", self._fit_all, read_json, fits),
            route("GET", FITS + "/table", self._table_of_fits, limiter=fits),
            route("GET", FITS + "/{id}/layers/{layer}", self._layer, limiter=fits),
            route("GET", FITS + "/{id}/relit", self._relit, limiter=fits),
            route("GET", FITS + "/{id}/export", self._export_fit, limiter=fits),
        ]

    def _overview(self, request: Request) -> contract.Project | contract.Unchanged:
        project = self.project
        training = self.training
        model = self.models.current
        stamp = request.query_params.get("stamp", "")
        # Read before the data: a change in between shows up in the next request.
        sets = project.sets
        suffix = f"-{0 if model is None else model.number}-{training.state.state}-{self.background.checks}-{len(sets)}"
        overview = project.overview(stamp.removesuffix(suffix) if stamp.endswith(suffix) else None, OVERVIEW_SECONDS)
        if overview is None:
            return {"unchanged": True, "stamp": stamp}
        training.follow_template()
        return {
            "id": project.store.id,
            "stamp": overview.stamp + suffix,
            "folder": project.root.name or str(project.root),
            "read_only": project.folder.is_read_only,
            "set": project.set_name,
            "sets": sets,
            "observers": observers(project),
            "version": __version__,
            "pictures": overview.pictures,
            "template": project.templates.as_json(),
            "offered": project.templates.is_offered,
            "model": model_json(self.models.current, overview.done, overview.unread, overview.sides),
            "checked": self.background.has_checked(overview.done),
            "training": cast(contract.Training, asdict(training.state)),
            "versions": training.versions.as_json(project.templates.order),
            "methods": [
                {"name": each.name, "summary": each.summary, "needs_colour": each.needs_colour}
                for each in METHODS.values()
            ],
            "default_method": DEFAULT_METHOD,
            "default_ambient": AMBIENT,
            "fitting": self.background.progress,
            "formats": {
                "pictures": [*PICTURE_SUFFIXES],
                "landmarks": [*LANDMARK_SUFFIXES],
                "videos": [*VIDEO_SUFFIXES],
            },
            "limits": {"upload_bytes": self.settings.upload_bytes, "pixels": self.settings.pixels},
            "problems": project.problems,
        }

    def _save_landmarks(self, request: Request, data: Any) -> contract.Saved:
        name = request.path_params["name"]
        answer = self.project.save_marks(name, data)
        changed: contract.LandmarksChanged = {
            "name": name,
            "revision": answer["revision"],
            "beside": answer["beside"],
        }
        self.events.publish("landmarks", changed)
        self.background.woken.set()
        return answer

    def _found_scale(self, request: Request) -> contract.FoundScale:
        source = self.project.source(request.path_params["name"])
        with self.pictures.at_work(source) as pixels:
            return found_scale(pixels, source.size, request.query_params)

    def _review(self, request: Request, data: Any) -> dict[str, Any]:
        answer = self.project.review(data)
        # One event, because a page that falls behind is disconnected. "" means that there is no file any more.
        written: list[contract.LandmarksChanged] = [
            {"name": name, "revision": now or ""} for name, now in answer.pop("revisions").items()
        ]
        self.events.publish("landmarks", written)
        self.background.woken.set()
        self.events.publish("project", {})
        return answer

    def _save_sides(self, request: Request, data: Any) -> contract.SidesBefore:
        answer = self.project.save_sides(data)
        self.background.woken.set()
        self.events.publish("project", {})
        return answer

    def _change_files(self, change: Callable[[Project, Any], Any], request: Request, data: Any) -> Any:
        try:
            return change(self.project, data)
        finally:
            self.background.woken.set()
            self.events.publish("project", {})

    def _rename(self, request: Request, data: Any) -> contract.Renamed:
        answer = self._change_files(picture_files.rename, request, data)
        self.training.rename(answer["before"], answer["name"])
        return answer

    def _measurements(self, request: Request) -> Response:
        return attachment(*shapes.table(self.project, request.query_params))

    def _save_groups(self, request: Request, data: Any) -> dict[str, int]:
        answer = shapes.save_groups(self.project, data)
        self.events.publish("project", {})
        return answer

    def _save_template(self, request: Request, data: Any) -> contract.Template | None:
        try:
            self.project.save_template(data)
            template = self.project.templates.as_json()
        finally:  # even if this change is refused, since an earlier one may have been finished
            self.training.follow_template()
        self.events.publish("project", {})
        return template

    async def _events(self, request: Request) -> Response:
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self.events.stream(), media_type="text/event-stream", headers=headers)

    def _train(self, request: Request, data: Any) -> dict[str, Any]:
        asked = self.project.checked(data or {}, "slips")
        return asdict(self.training.start(asked.get("slips") is True))

    def _stop_training(self, request: Request, data: Any) -> dict[str, Any]:
        self.project.checked(data or {}, "nothing")
        return asdict(self.training.stop())

    def _model_file(self, request: Request) -> Response:
        if (current := self.models.current) is None:
            raise Refusal(404, "there is no model yet: train one")
        return attachment(f"{plain_name(current.model.name or 'model')}.liaam", current.model.to_bytes())

    def _receive_guest(self, request: Request, data: bytes) -> None:
        name = plain_name(_name(request))
        model = load_dropped_model(data, name, self.settings.points)
        facts = {"source": "guest", "trained": None, "pictures": {}, "name": name.removesuffix(".liaam")}
        self.models.publish(model, facts, "guest")

    def _take_in(self, request: Request, data: bytes) -> dict[str, Any]:
        answer = self.project.take_in(_name(request), data)
        self.background.woken.set()
        return answer

    def _upload(self, request: Request, data: bytes) -> dict[str, Any]:
        """Keep a dropped picture; with a ``method``, also fit it. If that fails, asking for the fit will say why."""
        asked = request.query_params
        fit = None
        upload = self.uploads.add(data, asked.get("name", ""))
        if "method" in asked:
            with suppress(LiaamError):
                fit = self.fits.fit(self.uploads.source(upload.id), ("upload", upload.id), asked["method"]).as_json()
        return {"id": upload.id, "name": upload.name, "width": upload.width, "height": upload.height, "fit": fit}

    def _image(self, request: Request) -> Response:
        size = checked_size(request.query_params.get("size"), IMAGE_SIZE)
        return self._cached(request, f"{size}", lambda picture: self.pictures.image(picture, size), "image/jpeg")

    def _tile(self, request: Request) -> Response:
        asked = request.path_params
        level, column, row = asked["level"], asked["column"], asked["row"]

        def make(picture: PictureSource) -> bytes:
            return self.tiles.get(picture, level, column, row)

        return self._cached(request, f"tile-{level}-{column}-{row}", make, "image/jpeg")

    def _chroma(self, request: Request) -> Response:
        size = checked_size(request.query_params.get("size"), CHROMA_SIZE)
        current = self.models.current
        camera = CameraModel() if current is None else current.model.camera
        kind = f"chroma-{size}-{hash(camera.response) & 0xFFFFFFFF:x}"

        def make(picture: PictureSource) -> bytes:
            return self.pictures.chroma(picture, size, camera.suited_to(raw=picture.raw).response)

        return self._cached(request, kind, make, "application/octet-stream")

    def _cached(self, request: Request, kind: str, make: Callable[[PictureSource], bytes], media: str) -> Response:
        """Return bytes computed from a picture, or 304 if the browser has them; remember JPEGs that cannot be made."""
        asked = request.path_params
        picture = self.uploads.source(asked["id"]) if "id" in asked else self.project.source(asked["name"])
        headers = {"etag": f'"{picture.tag}-{kind}"', "cache-control": "private, no-cache"}
        if media == "image/jpeg" and request.query_params.get("tag") == picture.tag:
            headers |= KEPT  # at this address, which names the content of the file, it never changes
        tags = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
        if headers["etag"] in tags:
            return Response(status_code=304, headers=headers)
        try:
            return Response(make(picture), media_type=media, headers=headers)
        except ImageError as fault:
            if media == "image/jpeg":
                self.project.mark_unreadable(picture, fault)
            raise

    def _layer(self, request: Request) -> Response:
        fit = self.fits.get(request.path_params["id"])
        what = request.path_params["layer"]
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        data, scale = self.fits.layer(fit, what, size)
        return Response(data, media_type="image/png", headers={**KEPT, "x-scale": json.dumps(scale)})

    def _relit(self, request: Request) -> Response:
        fit = self.fits.get(request.path_params["id"])
        light = light_of(request.query_params)
        size = checked_size(request.query_params.get("size"), LAYER_SIZE)
        image, _ = self.fits.draw(fit, "relit", size, light)
        return Response(jpeg_bytes(image), media_type="image/jpeg", headers=KEPT)

    def _export_fit(self, request: Request) -> Response:
        fit = self.fits.get(request.path_params["id"])
        what = request.query_params.get("what", "")
        name, kind, data = self.fits.export(fit, what, light_of(request.query_params), self._pixel_of(fit))
        return attachment(name, data, kind)

    def _fit(self, request: Request, body: Any) -> dict[str, Any]:
        body, of, source, method = self._to_fit(body)
        truth = None if of[0] == "upload" else truth_of(self.project.landmarks(of[1]))
        start = parse_start(body.get("start"))
        side = parse_side(body.get("side", AUTO))
        return self.fits.fit(source, of, method, start, truth, side).as_json()

    def _fit_all(self, request: Request, body: Any) -> dict[str, Any]:
        body, of, source, method = self._to_fit(body)
        fits, faults = self.fits.fit_all(source, of, method, parse_side(body.get("side", AUTO)))
        return {"fits": [fit.as_json() for fit in fits], "faults": faults}

    def _to_fit(self, body: Any) -> tuple[dict[str, Any], tuple[str, str], PictureSource, str]:
        """Return a request for fits, what its picture is of and which it is, the picture, and the method."""
        body = self.project.checked(body, "picture or upload, method and start")
        given = [(kind, body[kind]) for kind in ("picture", "upload") if body.get(kind) is not None]
        if len(given) != 1 or not isinstance(given[0][1], str):
            raise Refusal(422, "the picture to fit is unclear: send either picture, its name, or upload, its id")
        method = body.get("method", DEFAULT_METHOD)
        if not isinstance(method, str):
            raise Refusal(422, "the method is not a string: send its name, such as 'soft-li'")
        kind, name = given[0]
        source = self.uploads.source(name) if kind == "upload" else self.project.source(name)
        return body, (kind, name), source, method

    def _table_of_fits(self, request: Request) -> Response:
        ids = request.query_params.get("fits", "").split(",")
        fits = [self.fits.get(each) for each in ids]
        if len({fit.of for fit in fits}) > 1:
            raise Refusal(422, "the fits are of several pictures: send those of one")
        stem = plain_name(fits[0].source.name).rpartition(".")[0] or "fits"
        return attachment(f"{stem}.csv", self.fits.table(fits, self._pixel_of(fits[0])), "text/csv")

    def _pixel_of(self, fit: Fit) -> tuple[float, str] | None:
        """Return the length of a pixel of the picture of a fit, and its unit, if they are known."""
        return self.project.pixel_length(fit.of[1]) if fit.of[0] == "picture" else None

    async def on_fault(self, request: Request, fault: Exception) -> Response:
        """Return the error message; if the disk refused to write, use a status that makes the page retry."""
        answer = {"error": self.project.folder.plain(fault)}
        status = 422
        cause = fault.__cause__
        if isinstance(fault, Refusal):
            answer = answer | fault.details
            status = fault.status
        elif isinstance(cause, OSError) and not (request.method in ("GET", "HEAD") or request.url.path.endswith(FITS)):
            status = status_of(cause)
        return JSONResponse(answer, status)


def make_app(studio: Studio) -> Starlette:
    """Create the web application of a studio. That of a further set of landmarks is below ``/set/NAME/``."""
    apps: dict[str, Starlette] = {}

    async def of_set(scope: Scope, receive: Receive, send: Send) -> None:
        name = scope["path_params"]["set"]
        if name not in apps:
            apps[name] = _app_of(await run_sync(studio.of_set, name))
        await apps[name](scope, receive, send)

    return _app_of(studio, [Mount("/set/{set}", of_set)], [Middleware(Guard, settings=studio.settings)])


def _app_of(studio: Studio, sets: Sequence[Mount] = (), middleware: Sequence[Middleware] = ()) -> Starlette:
    faults = {LiaamError: studio.on_fault, HTTPException: _on_http_fault, Exception: _on_bug}
    routes = [*studio.routes(), *live.routes(studio.live), *sets, *Page(studio.settings.static).routes()]
    return Starlette(routes=routes, middleware=middleware, exception_handlers=faults)


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
