"""Show Markdown files of the repository, such as CONTRIBUTING.md, as pages of the site, and keep their links right.

Markdown in the repository links to files. Here a link to a file that is a page, or to an example, becomes a link to the
page. A link to any other file of the repository, such as a module, becomes plain text.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path

from sphinx.application import Sphinx

LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
IMAGE = re.compile(r"!\[([^\]]*)\]\(([^()\s]+)\)")


def setup(app: Sphinx) -> dict[str, bool]:
    """Replace the source of these pages as it is read."""
    app.add_config_value("repository_pages", {}, "env")
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def read(app: Sphinx, docname: str, source: list[str]) -> None:
    """Give the text of a page."""
    path = Path(app.env.doc2path(docname))
    if path.suffix != ".md":
        return
    site, root = Path(app.srcdir), Path(app.srcdir).parent
    files = {page: root / name for page, name in app.config.repository_pages.items()}
    text, home = source[0], path.parent
    if docname in files:
        app.env.note_dependency(str(files[docname]))
        text, home = files[docname].read_text(encoding="utf-8"), files[docname].parent
    pages = {file.resolve(): site / f"{page}.md" for page, file in files.items()}
    pages |= {path: site / "gallery" / f"{path.stem}.rst" for path in (root / "examples").glob("plot_*.py")}
    pages[root / "examples/README.rst"] = site / "gallery/index.rst"
    source[0] = with_links(text, home, path.parent, target_of(site, root, pages))


def target_of(site: Path, root: Path, pages: dict[Path, Path]) -> Callable[[Path], Path | None]:
    """Give what turns a linked file into the file to link to: None for one that the site does not have."""

    def target(file: Path) -> Path | None:
        if file in pages:
            return pages[file]
        if file.is_relative_to(site) or not file.is_relative_to(root) or not file.exists():
            return file  # of the site, or a broken link, which Sphinx reports
        return None

    return target


def with_links(text: str, home: Path, page_home: Path, target: Callable[[Path], Path | None]) -> str:
    """Change the links of a text from a file in ``home`` for a page in ``page_home``."""

    def changed(match: re.Match[str]) -> str:
        label, link = match.groups()
        name, mark, anchor = link.partition("#")
        if not name or "://" in link or link.startswith(("mailto:", "/")):
            return match.group()
        file = target((home / name).resolve())
        if file is None:
            return label
        start = "!" if match.group().startswith("!") else ""
        return f"{start}[{label}]({os.path.relpath(file, page_home)}{mark}{anchor})"

    return IMAGE.sub(changed, LINK.sub(changed, text))
