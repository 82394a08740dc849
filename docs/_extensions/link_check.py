"""Check the finished site: every internal link and anchor exists, and no page loads anything from the network."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util import logging

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
"""Elements that a browser loads by itself, and the attribute that names what."""

NOT_LOADED = {"canonical", "author", "license"}
"""Kinds of ``<link>`` that only name an address."""

logger = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, bool]:
    """Check when all is written."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Page(HTMLParser):
    """What a page links to, what it loads, and what can be linked to in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element."""
        named = {name: value or "" for name, value in attrs}
        self.anchors |= {named[key] for key in ("id", "name") if key in named}
        if tag == "a" and named.get("href"):
            self.links.add(named["href"])
        if tag in LOADED and named.get(LOADED[tag]) and named.get("rel") not in NOT_LOADED:
            self.loaded.add(named[LOADED[tag]])


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every broken link and of everything that is loaded from elsewhere."""
    if exception is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir)
    pages = {
        path: Page(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.html"))
        if "_static" not in path.parts
    }
    for path, page in pages.items():
        for fault in faults_of(path, page, pages):
            logger.warning("%s: %s", path.relative_to(folder), fault)


def faults_of(path: Path, page: Page, pages: dict[Path, Page]) -> list[str]:
    """Say what is wrong with a page."""
    faults = [f"loads {target} from the network" for target in sorted(page.loaded) if is_remote(target)]
    for target in sorted(page.links | page.loaded):
        address = urlsplit(target)
        if is_remote(target) or address.scheme:
            continue
        file = (path.parent / unquote(address.path)).resolve() if address.path else path
        if not file.exists():
            faults.append(f"links to {target}, which does not exist")
        elif address.fragment and file in pages and unquote(address.fragment) not in pages[file].anchors:
            faults.append(f"links to {target}, but that page has no such anchor")
    return faults


def is_remote(target: str) -> bool:
    """Whether a target is on another machine."""
    return target.startswith(("http:", "https:", "//"))
