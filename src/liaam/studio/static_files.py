"""The files of the page, which browsers keep as long as they do not change.

The page refers to its files below an address with the hash of all of them. There they never change, so that a reload
asks for none. The page itself is asked for each time, and names its modules at the beginning, so that the browser
fetches them together instead of one after the other.
"""

import hashlib
import re
import threading
from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

PREFIX = "/kept"
PAGE = "index.html"
FOREVER = {"cache-control": "private, max-age=31536000, immutable"}
_REFERENCE = re.compile(r'(?<=\s)(href|src)="(?![#/]|https?:)([^"]+)"')


class Page:
    """The files of the page in a folder, and their hash, which is computed again when one changes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._facts: list[tuple[str, int, int]] = []
        self._version = ""

    @property
    def shown(self) -> str:
        """Hash that the page has referred to last, which takes no time."""
        return self._version or self.version

    @property
    def version(self) -> str:
        """Hash of all files."""
        files = sorted(path for path in self.folder.rglob("*") if path.is_file())
        facts = []
        for path in files:
            stat = path.stat()
            facts.append((path.relative_to(self.folder).as_posix(), stat.st_mtime_ns, stat.st_size))
        with self._lock:
            if facts != self._facts:
                digest = hashlib.sha256()
                for path in files:
                    digest.update(path.relative_to(self.folder).as_posix().encode())
                    digest.update(hashlib.sha256(path.read_bytes()).digest())
                self._facts, self._version = facts, digest.hexdigest()[:16]
            return self._version

    def html(self) -> str:
        """Return the page, which refers to its files by their hash."""
        base = f"{PREFIX}/{self.version}"
        text = (self.folder / PAGE).read_text(encoding="utf-8")
        modules = sorted(path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*.js"))
        scripts = set(re.findall(r'<script src="([^"]+)"', text))  # those that are no modules
        preloads = [f'<link rel="modulepreload" href="{name}">' for name in modules if name not in scripts]
        text = text.replace("</head>", "\n".join([*preloads, "</head>"]), 1)
        return _REFERENCE.sub(rf'\1="{base}/\2"', text)

    def answer(self, request: Request) -> Response:
        """Return the page, or 304 if the browser has it."""
        text = self.html()
        headers = {
            "etag": f'"{hashlib.sha256(text.encode()).hexdigest()[:16]}"',
            "cache-control": "private, no-cache",
        }
        if request.headers.get("if-none-match") == headers["etag"]:
            return Response(status_code=304, headers=headers)
        return HTMLResponse(text, headers=headers)

    def routes(self) -> list[BaseRoute]:
        """Return the routes of the page and its files. Other addresses of the files are not kept."""
        kept = Mount(f"{PREFIX}/{{version}}", _KeptFiles(self))
        return [
            Route("/", self.answer, methods=["GET"]),
            kept,
            Mount("/", StaticFiles(directory=self.folder, html=True)),
        ]


class _KeptFiles(StaticFiles):
    """Files below the hash of the page; below an earlier hash they are those of now, and are not kept."""

    def __init__(self, page: Page) -> None:
        super().__init__(directory=page.folder)
        self._page = page

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file, to be kept if the hash is that of now."""
        response = await super().get_response(path, scope)
        if response.status_code in (200, 304) and scope["path_params"].get("version") == self._page.shown:
            response.headers.update(FOREVER)
        return response
