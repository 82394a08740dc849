"""Write fits to one web page: their pictures, the worst first, filters by status, and the table.

The page needs neither a server nor a network: everything is in the one file.
"""

import base64
import html
import io
import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from liaam.batch.tables import BatchTable, write_csv_rows
from liaam.batch.work import ERROR, FitRow, failed_row, fit_row
from liaam.drawing import DOUBTFUL, LANDMARK, LOST
from liaam.errors import LiaamError
from liaam.fitting import FitResult, FitStatus
from liaam.fitting.result import check_absent
from liaam.io import write_text_atomically
from liaam.io.atomic import check_output
from liaam.io.files import count_of, natural_key
from liaam.photometry.picture import load_picture
from liaam.progress import Progress, reported
from liaam.scale.lengths import Length

REPORT_SUFFIXES = (".html", ".htm")
THUMBNAIL = 256
"""Larger side of the pictures in pixels: with 8 kB each, a page of 2,000 has 20 MB."""
JPEG_QUALITY = 65
"""Of the pictures, which are to be looked at and not measured; it gives those 8 kB."""
HEAD_BYTES = 1000
"""Beginning of a page in which the mark of a report is looked for."""
UNKNOWN_QUALITY = 2.0
"""Place in the order of fits whose quality is unknown: after all others, whose quality is at most 1."""
MOST_PLACES = 2
"""Places of a part in the page: the title is in its head and its body."""
GENERATOR = b'<meta name="generator" content="liaam">'
"""Near the start of each report, to tell it from other pages."""


@dataclass(frozen=True)
class Entry:
    """A fit on the page, or an image that could not be fitted.

    Attributes
    ----------
    name : str
        Name to show, such as that of the image's file.
    row : dict
        Its row, as of the table of ``liaam batch``.
    sd : float
        Median standard deviation of the landmarks in pixels; NaN unless the fit may be used.
    picture : bytes
        JPEG of the object and its landmarks; empty without a fit.
    """

    name: str
    row: FitRow
    sd: float = np.nan
    picture: bytes = b""


def entry_of_fit(
    result: FitResult,
    pixels: np.ndarray,
    path: str,
    name: str,
    number: int | None = None,
    length: Length | None = None,
    absent: str = "empty",
) -> Entry:
    """Make the entry of a fit to the pixels (h, w, 3) of an image file.

    ``number`` is that of the object among several in the image, ``length`` that of a pixel, and ``absent`` what the row
    holds of absent landmarks (:data:`liaam.fitting.result.ABSENT`).
    """
    from liaam.plotting import thumbnail

    row = fit_row(result, path, (pixels.shape[1], pixels.shape[0]), length, absent)
    row |= {"object": number, "seconds": None}
    sd = float(np.median(result.sd)) if result.status.ok else np.nan
    return Entry(name, row, sd, _jpeg(thumbnail(pixels, result, THUMBNAIL)))


def entry_of_error(error: LiaamError, path: str, name: str) -> Entry:
    """Make the entry of an image that could not be fitted."""
    return Entry(name, failed_row(path, str(error)))


def write_report(
    path: str | os.PathLike[str],
    results: Sequence[FitResult | LiaamError],
    images: Sequence[Any] | None = None,
    *,
    title: str = "",
    absent: str = "empty",
    progress: Progress | bool | None = None,
) -> None:
    """Write fits to one web page, with their pictures, the worst first, filters by status, and the table.

    Parameters
    ----------
    path : path-like
        The page, such as ``report.html``. It can be opened without a server or a network.
    results : sequence of FitResult or LiaamError
        Those of :func:`liaam.fit_many`, also with ``errors="return"``.
    images : sequence of path or array, optional
        The images that were fitted. By default those that the results name, which are read again.
    title : str
        Title of the page. By default the number of fits.
    absent : {"empty", "estimate"}
        What its table holds of absent landmarks: nothing, or the estimates of their positions.
    progress : bool or callable, optional
        Whether to show a progress bar; by default on a terminal, after two seconds. Or a function that is called with
        (done, total, what).

    Raises
    ------
    LiaamError
        If the page cannot be written, an image cannot be read again, or the results have different landmarks.

    Examples
    --------
    >>> images = sorted(Path("wings").glob("*.jpg"))                                      # doctest: +SKIP
    >>> write_report("report.html", fit_many(model, images, errors="return"), images)     # doctest: +SKIP
    """
    page = check_report(path)
    check_absent(absent)
    fitted = [getattr(result, "image", None) for result in results] if images is None else list(images)
    if len(fitted) != len(results):
        raise LiaamError(f"{len(results)} results and {len(fitted)} images: give the image of each result")
    entries = []
    with reported("pictures", progress) as tell:
        for i, (result, image) in enumerate(zip(results, fitted, strict=True)):
            tell(i, len(results), "pictures")
            entries.append(_entry(result, image, f"images[{i}]", absent))
    fits = [result for result in results if isinstance(result, FitResult)]
    names = fits[0].landmark_names if fits else ()
    write_entries(page, entries, len(fits[0].landmarks) if fits else 0, names, title)


def _entry(result: FitResult | LiaamError, image: Any, name_of_array: str, absent: str) -> Entry:
    """Make the entry of a result. An image that is an array has no path, and gets a name."""
    path = os.fspath(image) if isinstance(image, (str, os.PathLike)) else name_of_array
    name = Path(path).name
    if isinstance(result, LiaamError):
        return entry_of_error(result, path, name)
    if image is None:
        raise LiaamError(f"{name_of_array}: the result does not name its image; give images=")
    return entry_of_fit(result, load_picture(image, path)[0], path, name, absent=absent)


def check_report(path: str | os.PathLike[str]) -> Path:
    """Return the path of a page to write. Raise if it cannot be written, or does not end as a page."""
    page = Path(path)
    if page.suffix.lower() not in REPORT_SUFFIXES:
        raise LiaamError(f"{page}: a report is a web page; give a name that ends in .html")
    check_output(page)
    refuse_other_page(page)
    return page


def refuse_other_page(page: Path) -> None:
    """Raise if a page would be overwritten that is no report."""
    if not page.is_file():
        return
    with page.open("rb") as file:
        if GENERATOR not in file.read(HEAD_BYTES):
            raise LiaamError(f"{page} exists and is not a report of liaam; give another name to keep it")


def write_entries(path: Path, entries: Iterable[Entry], n_points: int, names: Sequence[str], title: str = "") -> None:
    """Write the page of entries, whose fits have landmarks of these names (or none)."""
    ordered = sorted(entries, key=_order)
    for entry in ordered:
        landmarks = entry.row["landmarks"]
        if landmarks is not None and len(landmarks) != 2 * n_points:
            raise LiaamError(
                f"{entry.name} has {len(landmarks) // 2} landmarks, not {n_points}; report one model's fits"
            )
    counts = Counter(entry.row["status"] for entry in ordered)
    title = title or count_of(len(ordered), "fit")
    by_path = sorted(ordered, key=lambda entry: natural_key(entry.row["path"]))
    parts = {
        "title": html.escape(title),
        "filters": "\n".join(_filter(status, number) for status, number in counts.items()),
        "meanings": "\n".join(_meaning(status) for status in counts),
        "cards": "\n".join(_card(i, entry, path) for i, entry in enumerate(ordered)),
        "rows": "\n".join(_table_row(i, entry) for i, entry in enumerate(ordered)),
        "csv": _in_script(_csv_of(by_path, n_points, names)),
    }
    text = (files("liaam.batch") / "report.html").read_text("utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part, MOST_PLACES)
    write_text_atomically(path, text)


def _order(entry: Entry) -> tuple:
    """Return the place of an entry on the page: errors, failed, doubtful and good fits, each by rising quality."""
    row = entry.row
    quality = UNKNOWN_QUALITY if row["quality"] is None else row["quality"]
    return _grade(row["status"]), quality, natural_key(entry.name), row["object"] or 0


def _grade(status: str) -> int:
    """Return 0 for errors, 1 for failed fits, 2 for those to check, and 3 for those that may be used."""
    if status == ERROR:
        return 0
    known = FitStatus(status)
    if known.ok:
        return 3
    return 1 if known.lost else 2


def _dot(status: str) -> str:
    """Return a dot in the colour of the landmarks of such fits."""
    colour = (LOST, LOST, DOUBTFUL, LANDMARK)[_grade(status)]
    return f'<span class="dot" style="background:{colour}"></span>'


def _filter(status: str, number: int) -> str:
    """Return the check box that shows or hides the fits of a status, with their number."""
    return (
        f'<label><input type="checkbox" name="status" value="{status}" checked> {_dot(status)}{status} '
        f"<b>{number}</b></label>"
    )


def _meaning(status: str) -> str:
    """Return what a status means; the message of an error is beside its image."""
    if status == ERROR:
        message = "The image could not be read or fitted. The reason is beside it."
    else:
        message = FitStatus(status).message
    return f"<dt>{_dot(status)}{status}</dt><dd>{html.escape(message)}</dd>"


def _label(entry: Entry) -> str:
    """Return the name of an entry, with the number of the object where an image has several."""
    number = entry.row["object"]
    return html.escape(entry.name if number is None else f"{entry.name}, object {number}")


def _linked(entry: Entry, page: Path) -> str:
    """Return the name of an entry, linked to its image if that is a file."""
    image = Path(entry.row["path"])
    if not image.is_file():
        return _label(entry)
    try:
        address = quote(Path(os.path.relpath(image, page.parent)).as_posix())
    except ValueError:  # on another drive
        return _label(entry)
    return f'<a href="{address}">{_label(entry)}</a>'


def _card(i: int, entry: Entry, page: Path) -> str:
    """Return the picture of an entry with what is said below it."""
    row = entry.row
    picture = ""
    if entry.picture:
        source = base64.b64encode(entry.picture).decode()
        picture = f'<img alt="{_label(entry)}" loading="lazy" decoding="async" src="data:image/jpeg;base64,{source}">'
    quality = "" if row["quality"] is None else f", quality {row['quality']:.2f}"
    why = f"<p>{html.escape(row['message'])}</p>" if row["status"] == ERROR else ""
    side = f", {html.escape(row['side'])}" if row["side"] else ""
    return (
        f'<li data-i="{i}" data-status="{row["status"]}"><div class="picture">{picture}</div>'
        f"<h3>{_linked(entry, page)}</h3><p>{_dot(row['status'])}{row['status']}{quality}{side}</p>{why}</li>"
    )


def _table_row(i: int, entry: Entry) -> str:
    """Return the row of an entry in the page's table."""
    row = entry.row
    numbers = (_number(row["quality"], 2), _number(row["score"], 2), _number(entry.sd, 1), row["iterations"])
    cells = "".join(f"<td>{'' if number is None else number}</td>" for number in numbers)
    message = html.escape(row["message"])
    return (
        f'<tr data-i="{i}" data-status="{row["status"]}"><th scope="row">{_label(entry)}</th>'
        f"<td>{row['status']}</td>{cells}<td>{message}</td></tr>"
    )


def _number(value: float | None, decimals: int) -> str:
    """Return a number as text, empty if it is unknown."""
    return "" if value is None or not np.isfinite(value) else f"{value:.{decimals}f}"


def _csv_of(entries: Sequence[Entry], n_points: int, names: Sequence[str]) -> str:
    """Return the table of ``liaam batch`` without covariances, which ``liaam measure`` reads."""
    text = io.StringIO()
    rows = (("", entry.row) for entry in entries)
    write_csv_rows(text, BatchTable(rows, n_points, covariance=False, facts={}, names=tuple(names)))
    return text.getvalue()


def _in_script(text: str) -> str:
    """Return a text as JSON that may stand in a script of a page."""
    return json.dumps(text).replace("<", "\\u003c")


def _jpeg(picture: np.ndarray) -> bytes:
    import cv2

    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()
