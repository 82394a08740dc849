"""The studio's web application: it wires the parts together, defines the routes, and returns errors as JSON.

Errors for the user have the form ``{"error": sentence}``.
"""

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

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
from liaam.io.images import PICTURE_SUFFIXES, VIDEO_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.model import load_model
from liaam.photometry import CameraModel
from liaam.relighting.lamp import AMBIENT
from liaam.studio import contract, live, picture_files, shapes
from liaam.studio.agreement import model_agreement
from liaam.studio.background import Background
from liaam.studio.contract import OMITTED
from liaam.studio.fits import LAYER_SIZE, Fit, Fits, truth_of
from liaam.studio.folder import Folder, checked_folder, plain_name, status_of
from liaam.studio.found_scale import found_scale
from liaam.studio.live import LiveVideos
from liaam.studio.measuring import kept_in
from liaam.studio.model_store import (
    ModelStore,
    is_set_aside,
    load_dropped_model,
    load_studio_model,
    model_json,
    set_aside,
)
from liaam.studio.pictures import Pictures, PictureSource, Uploads, jpeg_bytes
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.routes import (
    Events,
    attachment,
    checked_size,
    light_of,
    maybe_json,
    opacity_of,
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
KEEP = "0"  # balance of a request that keeps the colour of the light
KEPT = {"cache-control": "private, max-age=86400, immutable"}  # headers of answers that never change
METHODS_TO_CHOOSE: list[contract.Method] = [
    {"name": each.name, "summary": each.summary, "needs_colour": each.needs_colour} for each in METHODS.values()
]
FORMATS: contract.Formats = {
    "pictures": [*PICTURE_SUFFIXES],
    "landmarks": [*LANDMARK_SUFFIXES],
    "videos": [*VIDEO_SUFFIXES],
}
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
            route("GET", of_picture + "landmarks", self._landmarks),
            route("PUT", of_picture + "landmarks", self._save_landmarks, read_json),
            route("GET", of_picture + "history", self._history),
            route("GET", of_picture + "side", self._found_side),
            route("GET", "/api/scale", self._shared_scale),
            route("POST", "/api/review", self._review, read_json),
            route("PUT", "/api/sides", self._save_sides, read_json),
            route("POST", "/api/removed", self._remove, read_json),
            route("POST", "/api/restored", self._restore, read_json),
            route("POST", "/api/renamed", self._rename, read_json),
            route("GET", "/api/export/{kind}", self._export_landmarks),
            route("GET", "/api/measurements", self._measurements),
            route("GET", "/api/shapes", self._shapes),
            route("PUT", "/api/groups", self._save_groups, read_json),
            route("PUT", "/api/measuring", self._save_measuring, read_json),
            route("PUT", "/api/who", self._save_who, read_json),
            route("GET", of_picture + "scale", self._found_scale, limiter=fits),
            route("GET", of_picture + "others", self._others_points),
            route("POST", "/api/sets", self._make_set, read_json, status=201),
            route("GET", "/api/agreement", self._agreement),
            route("GET", "/api/agreement/model", self._model_agreement),
            route("PUT", "/api/template", self._save_template, read_json),
            route("POST", "/api/template/file", self._read_template, data),
            route("POST", "/api/training", self._train, maybe_json, status=202),
            route("DELETE", "/api/training", self._stop_training, maybe_json),
            Route("/api/events", self._events, methods=["GET"]),
            route("POST", FILES, self._take_in, data, status=201),
            route("DELETE", "/api/model/face", self._decline_face),
            route("PUT", "/api/model", self._use_model, read_json),
            route("POST", UPLOADS, self._upload, data, status=201),
            route("GET", UPLOADS + "/{id}/image", self._image, limiter=shown),
            route("GET", UPLOADS + "/{id}/chroma", self._chroma, limiter=shown),
            route("GET", UPLOADS + "/{id}/tiles/{level:int}/{column:int}/{row:int}", self._tile, limiter=shown),
            route("GET", "/api/model/file", self._model_file),
            route("POST", GUEST, self._receive_guest, data, models),
            route("DELETE", GUEST, self._dismiss_guest),
            route("POST", FITS, self._fit, read_json, fits),
            route("POST", FITS + "/all", self._fit_all, read_json, fits),
            route("GET", FITS + "/table", self._table_of_fits, limiter=fits),
            route("GET", FITS + "/{id}/layers/{layer}", self._layer, limiter=fits),
            route("GET", FITS + "/{id}/relit", self._relit, limiter=fits),
            route("GET", FITS + "/{id}/export", self._export_fit, limiter=fits),
        ]

    def _overview(self, request: Request, asked: contract.ProjectQuery) -> contract.Project | contract.Unchanged:
        project = self.project
        training = self.training
        model = self.models.current
        stamp = asked.stamp or ""
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
            "looking": self.background.looking,
            "model": model_json(self.models.current, overview.done, overview.unread, overview.sides),
            "face_again": self.background.may_return,
            "set_aside": self.models.own is None and is_set_aside(project.store),
            "checked": self.background.has_checked(overview.done),
            "training": training.state.as_json(),
            "versions": training.versions.as_json(project.templates.order),
            "methods": METHODS_TO_CHOOSE,
            "default_method": DEFAULT_METHOD,
            "default_ambient": AMBIENT,
            "fitting": self.background.progress,
            "formats": FORMATS,
            "limits": {
                "upload_bytes": self.settings.upload_bytes,
                "pixels": self.settings.pixels,
                "relit_pixels": self.settings.whole_pixels,
            },
            "problems": project.problems,
            "measuring": kept_in(project.store),
            "who": project.store.get("who") or "",
        }

    def _landmarks(self, request: Request) -> contract.Marks:
        return self.project.marks(request.path_params["name"])

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

    def _history(self, request: Request) -> list[contract.HistoryEntry]:
        return self.project.history(request.path_params["name"])

    def _found_scale(self, request: Request, asked: contract.ScaleQuery) -> contract.FoundScale:
        source = self.project.source(request.path_params["name"])
        with self.pictures.at_work(source) as pixels:
            return found_scale(pixels, source.size, asked)

    def _shared_scale(self, request: Request) -> contract.SharedScale:
        return self.project.shared_scale()

    def _review(self, request: Request, data: Any) -> contract.Reviewed:
        done = self.project.review(data)
        # One event, because a page that falls behind is disconnected. "" means that there is no file any more.
        written: list[contract.LandmarksChanged] = [
            {"name": name, "revision": now or ""} for name, now in done["revisions"].items()
        ]
        self.events.publish("landmarks", written)
        self.background.woken.set()
        self.events.publish("project", {})
        return {"changed": done["changed"], "refused": done["refused"]}

    def _found_side(self, request: Request) -> contract.FoundSide:
        return self.project.found_side(request.path_params["name"])

    def _save_sides(self, request: Request, data: Any) -> contract.SidesBefore:
        answer = self.project.save_sides(data)
        self.background.woken.set()
        self.events.publish("project", {})
        return answer

    @contextmanager
    def _changing_files(self) -> Iterator[None]:
        """Say that the folder has changed once pictures were moved in the block, even if that has failed."""
        try:
            yield
        finally:
            self.background.woken.set()
            self.events.publish("project", {})

    def _remove(self, request: Request, data: Any) -> contract.Removed:
        with self._changing_files():
            return picture_files.remove(self.project, data)

    def _restore(self, request: Request, data: Any) -> contract.Removed:
        with self._changing_files():
            return picture_files.restore(self.project, data)

    def _rename(self, request: Request, data: Any) -> contract.Renamed:
        with self._changing_files():
            answer = picture_files.rename(self.project, data)
        self.training.rename(answer["before"], answer["name"])
        return answer

    def _export_landmarks(self, request: Request) -> Response:
        kind = request.path_params["kind"]
        answer = attachment(*self.project.export(kind))
        if kind != "sliders" and self.project.has_both_sides():
            answer.headers["x-both-sides"] = "true"
        return answer

    def _measurements(self, request: Request, asked: contract.ShapesQuery) -> Response:
        return attachment(*shapes.table(self.project, asked))

    def _shapes(self, request: Request, asked: contract.ShapesQuery) -> contract.Shapes:
        return shapes.shapes(self.project, asked)

    def _others_points(self, request: Request) -> dict[str, list[contract.Point]]:
        return others(self.project, request.path_params["name"])

    def _make_set(self, request: Request, data: Any) -> contract.MadeSet:
        return make_set(self.project, data)

    def _agreement(self, request: Request) -> contract.Agreement:
        return agreement(self.project)

    def _model_agreement(self, request: Request) -> contract.ShapeAgreement:
        return model_agreement(self.project)

    def _save_groups(self, request: Request, data: Any) -> contract.Grouped:
        answer = shapes.save_groups(self.project, data)
        self.events.publish("project", {})
        return answer

    def _save_measuring(self, request: Request, data: Any) -> contract.Measuring:
        answer = self.project.save_measuring(data)
        self.events.publish("project", {})
        return answer

    def _save_who(self, request: Request, data: Any) -> contract.Who:
        answer = self.project.save_who(data)
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

    def _read_template(self, request: Request, asked: contract.FileQuery, data: bytes) -> contract.Template:
        return self.project.read_template(asked.name, data).as_json()

    async def _events(self, request: Request) -> Response:
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self.events.stream(), media_type="text/event-stream", headers=headers)

    def _train(self, request: Request, data: Any) -> contract.Training:
        asked = self.project.checked(contract.StartTraining, data or {}, "slips")
        return self.training.start(asked.slips is True).as_json()

    def _stop_training(self, request: Request, data: Any) -> contract.Training:
        self.project.checked(contract.StopTraining, data or {}, "nothing")
        return self.training.stop().as_json()

    def _model_file(self, request: Request) -> Response:
        if (current := self.models.current) is None:
            raise Refusal(404, "there is no model yet: train one")
        return attachment(f"{plain_name(current.model.name or 'model')}.liaam", current.model.to_bytes())

    def _decline_face(self, request: Request) -> None:
        self.background.decline()

    def _use_model(self, request: Request, data: Any) -> None:
        asked = self.project.checked(contract.UseModel, data, "source, face or studio")
        if asked.source == "face" and not self.background.may_return:
            raise Refusal(409, "the face model does not know the points of this folder, or is in use: reload the page")
        set_aside(self.project, self.models, asked.source == "face")

    def _receive_guest(self, request: Request, asked: contract.FileQuery, data: bytes) -> None:
        name = plain_name(asked.name)
        model = load_dropped_model(data, name, self.settings.points)
        facts = {"source": "guest", "trained": None, "pictures": {}, "name": name.removesuffix(".liaam")}
        self.models.publish(model, facts, "guest")

    def _dismiss_guest(self, request: Request) -> None:
        self.models.publish(None, place="guest")

    def _take_in(self, request: Request, asked: contract.FileQuery, data: bytes) -> contract.Added:
        answer = self.project.take_in(asked.name, data)
        self.background.woken.set()
        return answer

    def _upload(self, request: Request, asked: contract.UploadQuery, data: bytes) -> contract.Upload:
        """Keep a dropped picture; with a ``method``, also fit it. If that fails, asking for the fit will say why."""
        fit = None
        upload = self.uploads.add(data, asked.name)
        if asked.method is not None:
            with suppress(LiaamError):
                fit = self.fits.fit(self.uploads.source(upload.id), ("upload", upload.id), asked.method).as_json()
        return {"id": upload.id, "name": upload.name, "width": upload.width, "height": upload.height, "fit": fit}

    def _image(self, request: Request, asked: contract.ImageQuery) -> Response:
        size = checked_size(asked.size, IMAGE_SIZE)
        return self._cached(request, f"{size}", lambda picture: self.pictures.image(picture, size), asked.tag)

    def _tile(self, request: Request, asked: contract.TileQuery) -> Response:
        where = request.path_params
        level, column, row = where["level"], where["column"], where["row"]

        def make(picture: PictureSource) -> bytes:
            return self.tiles.get(picture, level, column, row)

        return self._cached(request, f"tile-{level}-{column}-{row}", make, asked.tag)

    def _chroma(self, request: Request, asked: contract.ImageQuery) -> Response:
        size = checked_size(asked.size, CHROMA_SIZE)
        current = self.models.current
        camera = CameraModel() if current is None else current.model.camera
        kind = f"chroma-{size}-{hash(camera.response) & 0xFFFFFFFF:x}"

        def make(picture: PictureSource) -> bytes:
            return self.pictures.chroma(picture, size, camera.suited_to(raw=picture.raw).response)

        return self._cached(request, kind, make, media="application/octet-stream")

    def _cached(
        self,
        request: Request,
        kind: str,
        make: Callable[[PictureSource], bytes],
        tag: str | None = None,
        media: str = "image/jpeg",
    ) -> Response:
        """Return bytes computed from a picture, or 304 if the browser has them; remember JPEGs that cannot be made.

        ``tag`` is that of the file which the address names.
        """
        where = request.path_params
        picture = self.uploads.source(where["id"]) if "id" in where else self.project.source(where["name"])
        headers = {"etag": f'"{picture.tag}-{kind}"', "cache-control": "private, no-cache"}
        if tag == picture.tag:
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

    def _layer(self, request: Request, asked: contract.LayerQuery) -> Response:
        fit = self.fits.get(request.path_params["id"])
        what = request.path_params["layer"]
        data, facts = self.fits.layer(fit, what, checked_size(asked.size, LAYER_SIZE), asked.balance != KEEP)
        return Response(data, media_type="image/png", headers={**KEPT, "x-scale": json.dumps(facts)})

    def _relit(self, request: Request, asked: contract.LightQuery) -> Response:
        fit = self.fits.get(request.path_params["id"])
        light = light_of(asked.light)
        size = checked_size(asked.size, LAYER_SIZE)
        image, _ = self.fits.draw(fit, "relit", size, light, balance=asked.balance != KEEP)
        return Response(jpeg_bytes(image), media_type="image/jpeg", headers=KEPT)

    def _export_fit(self, request: Request, asked: contract.FitFileQuery) -> Response:
        fit = self.fits.get(request.path_params["id"])
        light = light_of(asked.light)
        opacity = opacity_of(asked.opacity)
        pixel = self._pixel_of(fit)
        name, kind, data = self.fits.export(fit, asked.what, light, pixel, opacity, asked.balance != KEEP)
        return attachment(name, data, kind)

    def _fit(self, request: Request, data: Any) -> contract.Fit:
        asked = self.project.checked(contract.FitOne, data, "picture or upload, method and start")
        source, of, method = self._to_fit(asked)
        truth = None if of[0] == "upload" else truth_of(self.project.own_landmarks(of[1]))
        start = parse_start(asked.start)
        return self.fits.fit(source, of, method, start, truth, parse_side(asked.side)).as_json()

    def _fit_all(self, request: Request, data: Any) -> contract.Fits:
        asked = self.project.checked(contract.FitAll, data, "picture or upload, and method")
        source, of, method = self._to_fit(asked)
        fits, faults = self.fits.fit_all(source, of, method, parse_side(asked.side))
        return {"fits": [fit.as_json() for fit in fits], "faults": faults}

    def _to_fit(self, asked: contract.FitAll) -> tuple[PictureSource, tuple[str, str], str]:
        """Return the picture to fit; ``picture`` or ``upload``, and its name or id; and the method."""
        both = (("picture", asked.picture), ("upload", asked.upload))
        named = [(kind, name) for kind, name in both if name is not None]
        if len(named) != 1 or not isinstance(named[0][1], str):
            raise Refusal(422, "the picture to fit is unclear: send either picture, its name, or upload, its id")
        method = DEFAULT_METHOD if asked.method is OMITTED else asked.method
        if not isinstance(method, str):
            raise Refusal(422, "the method is not a string: send its name, such as 'soft-li'")
        kind, name = named[0]
        source = self.uploads.source(name) if kind == "upload" else self.project.source(name)
        return source, (kind, name), method

    def _table_of_fits(self, request: Request, asked: contract.FitsQuery) -> Response:
        fits = [self.fits.get(each) for each in asked.fits.split(",")]
        if len({fit.of for fit in fits}) > 1:
            raise Refusal(422, "the fits are of several pictures: send those of one")
        stem = plain_name(fits[0].source.name).rpartition(".")[0] or "fits"
        return attachment(f"{stem}.csv", self.fits.table(fits, self._pixel_of(fits[0])), "text/csv")

    def _pixel_of(self, fit: Fit) -> tuple[float, str] | None:
        """Return the length of a pixel of the picture of a fit, and its unit, if they are known."""
        return self.project.pixel_length(fit.of[1]) if fit.of[0] == "picture" else None

    async def on_fault(self, request: Request, fault: Exception) -> Response:
        """Return the error message; if the disk refused to write, use a status that makes the page retry."""
        answer: contract.Fault = {"error": self.project.folder.plain(fault)}
        status = 422
        cause = fault.__cause__
        if isinstance(fault, Refusal):
            answer = {**answer, **fault.details}
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


async def _on_http_fault(request: Request, fault: Exception) -> Response:
    assert isinstance(fault, HTTPException)
    answer: contract.Fault = {"error": "this address does not exist" if fault.status_code == 404 else fault.detail}
    return JSONResponse(answer, fault.status_code, fault.headers)


async def _on_bug(request: Request, fault: Exception) -> Response:
    answer: contract.Fault = {"error": f"the studio failed ({type(fault).__name__}): see its terminal for details"}
    return JSONResponse(answer, 500, {**HEADERS, "connection": "close"})  # the server closes it anyway
