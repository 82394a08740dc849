"""Fit an image and make its row, in this process or on a cluster."""

import json
import os
import re
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from liaam.errors import LiaamError, StartError
from liaam.fitting import FitResult, Fitter
from liaam.fitting.many import refuse_one_start
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.result import check_absent
from liaam.fitting.search.starts import check_start, start_file
from liaam.fitting.single import kept_fitter
from liaam.fitting.specimens import fit_photograph
from liaam.formatting import finite_or_none
from liaam.io import is_raw
from liaam.model import AAM, load_model
from liaam.photometry import CameraModel
from liaam.scale.choice import columns_of
from liaam.scale.lengths import Length
from liaam.trays.naming import POSITION, check_name_by

BESIDE = "beside"  # Start from the landmark file beside each image
ERROR = "error"  # Status of an image that could not be fitted, in addition to those of FitStatus

FitRow = dict[str, Any]
JournalRow = tuple[str, str]
"""Status, and a line of JSON for each object, so that resumed and uninterrupted batches have identical rows."""

Pool = tuple[Callable[[str], "Future[JournalRow]"], Callable[[], int], tuple[type[Exception], ...]]
"""How to fit an image by its path, how many may be in progress now, and what a future raises if a process died."""


@dataclass(frozen=True)
class Settings:
    """Settings that determine the rows, in addition to model and images.

    Attributes
    ----------
    method : str
        See :data:`liaam.fitting.METHODS`.
    init : str, path or sequence of float, optional
        Where fits start: a box ``x0,y0,x1,y1`` or ``x,y,size`` for all; a landmark file for all; a folder with a
        landmark or ``.box`` file named like each image; or ``beside`` for such files beside the images. By default
        the object is searched for.
    iterations : int
        Maximum number of iterations at each blur level.
    camera : CameraModel, optional
        Camera of the images, if it is not the training camera.
    response : str, optional
        Response of the images' camera, if it differs from the training camera's. RAW files are linear by default.
    covariance : bool
        Whether rows hold the covariance of each landmark.
    every : bool
        Whether to fit every object that the search finds in an image, with a row for each.
    name_by : str
        What names the specimens (:data:`liaam.trays.NAME_BY`).
    rotations : str, optional
        Orientations to search (:attr:`liaam.fitting.Fitter.rotations`).
    side : str
        Side of the objects (:attr:`liaam.fitting.Fitter.side`).
    absent : str
        What rows hold of absent landmarks (:data:`liaam.fitting.result.ABSENT`).
    """

    method: str = DEFAULT_METHOD
    init: str | os.PathLike[str] | Sequence[float] | None = None
    iterations: int = 50
    camera: CameraModel | None = None
    response: str | None = None
    covariance: bool = True
    rotations: str | None = None
    every: bool = False
    name_by: str = POSITION
    absent: str = "empty"
    side: str = "auto"

    def __post_init__(self) -> None:
        check_absent(self.absent)
        refuse_one_start(self.every, self.init)
        check_name_by(self.name_by)
        if isinstance(self.init, os.PathLike):
            object.__setattr__(self, "init", os.fspath(self.init))
        elif self.init is not None and not isinstance(self.init, str):
            object.__setattr__(self, "init", _box_text(self.init))

    def describe(self) -> dict[str, Any]:
        """Return the settings as JSON types."""
        camera = None if self.camera is None else {**self.camera.describe(), "history": []}
        return {**vars(self), "camera": camera}


def _box_text(box: Sequence[float]) -> str:
    try:
        return ",".join(str(float(number)) for number in box)
    except (TypeError, ValueError):
        raise StartError(f"init {box!r}: give a path, 'beside', or a box of numbers (x0, y0, x1, y1)") from None


@dataclass(frozen=True, eq=False)
class FitJob:
    """Everything that a worker needs. It is pickled and sent to the workers of a cluster.

    It holds the content of the model file, because the file may change and a cluster may not have access to it, and
    the folder that relative paths start from.
    """

    model_file: bytes
    settings: Settings
    folder: str

    def __reduce__(self) -> tuple:
        """Pickle without the cached model."""
        return type(self), (self.model_file, self.settings, self.folder)

    def check(self) -> None:
        """Raise, before any work, if model, method and start do not match."""
        self.fitter(raw=False)
        if self.settings.init not in (None, BESIDE):
            check_start(self.absolute(str(self.settings.init)))

    @cached_property
    def model(self) -> AAM:
        """The model of `model_file`."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.liaam"
            path.write_bytes(self.model_file)
            return load_model(path)

    def fitter(self, raw: bool) -> Fitter:
        """Return the fitter for RAW files, or for other images."""
        settings = self.settings
        camera = (settings.camera or self.model.camera).suited_to(raw=raw, response=settings.response)
        options = {"max_iterations": settings.iterations, "rotations": settings.rotations, "side": settings.side}
        return kept_fitter(self.model, settings.method, camera, **options)

    def absolute(self, path: str) -> str:
        """Return the absolute path of an existing file, or else the text itself, which may be numbers."""
        there = os.path.join(self.folder, path)  # noqa: PTH118
        return there if os.path.lexists(there) else path

    def start_file(self, path: str) -> Path | None:
        """Return the file with the start of an image, or None."""
        start = self._start(path)
        try:
            return None if start is None else start_file(start, Path(path))
        except LiaamError:  # the row will report it
            return None

    def row_of_death(self, path: str) -> JournalRow:
        """Return the row of an image during whose fit a process died more than once."""
        message = f"{path}: the process died while fitting it (killed or out of memory); check it, or make it smaller"
        return self._kept([failed_row(path, message)], None)

    def row(self, path: str) -> JournalRow:
        """Fit one image. Report errors in its row, so that the batch continues."""
        begin = perf_counter()
        try:
            rows = self._fit(path)
        except LiaamError as fault:
            rows = [failed_row(path, self._as_named(str(fault), path))]
        except Exception as fault:
            message = f"unexpected {type(fault).__name__} ({fault}); please report it with the image"
            rows = [failed_row(path, message)]
        return self._kept(rows, round(perf_counter() - begin, 4))

    def _kept(self, rows: list[FitRow], seconds: float | None) -> JournalRow:
        """Return the rows of an image as text, with the time, and without covariances unless they are wanted."""
        for row in rows:
            row["seconds"] = seconds
            if not self.settings.covariance:
                del row["covariance"]
        return rows[0]["status"], "\n".join(json.dumps(row, allow_nan=False) for row in rows)

    def _fit(self, path: str) -> list[FitRow]:
        picture = Path(self.folder, path)
        every = self.settings.every
        names = {"stem": _printable(picture.stem), "name_by": self.settings.name_by}
        photograph = fit_photograph(self.fitter(is_raw(picture)), picture, self._start(path), every=every, **names)
        fitted = photograph.specimens
        rows = []
        for i, (result, specimen) in enumerate(zip(fitted.results, fitted.named, strict=True)):
            row = fit_row(result, path, photograph.size, photograph.length, self.settings.absent)
            number = i + 1 if every else None
            named = {"object": number, "specimen": specimen.name, "code": specimen.code, "message": fitted.message(i)}
            named["fingerprint"] = photograph.fingerprint
            if every and row["n_found"] is not None:  # each result knows of its own object only
                named["n_found"] = len(fitted.results)
            rows.append(row | named)
        return rows

    def _start(self, path: str) -> str | None:
        """Return the start of an image in a form that :func:`liaam.fitting.search.starts.read_start` accepts."""
        init = self.settings.init
        if init == BESIDE:
            return str(Path(self.folder, path).parent)
        return None if init is None else self.absolute(str(init))

    def _as_named(self, message: str, path: str) -> str:
        """Replace the absolute paths of image and start in a message by the paths as the user gave them."""
        start = Path(path).parent if self.settings.init == BESIDE else Path(str(self.settings.init or path))
        named = {str(Path(self.folder, start)): str(start), str(Path(self.folder, path)): path}
        named.pop(os.sep, None)  # it is in all paths
        places = "|".join(re.escape(place) for place in sorted(named, key=len, reverse=True))
        return re.sub(places, lambda match: named[match.group()], message)


def fit_row(
    result: FitResult, path: str, size: tuple[int, int], length: Length | None, absent: str = "empty"
) -> FitRow:
    """Return the row of a fit to an image of a size (width, height), whose scale may be known.

    ``absent`` is what it holds of absent landmarks (:data:`liaam.fitting.result.ABSENT`).
    """
    facts = result.to_dict(absent, rounded=False)
    return {
        "path": _printable(path),
        "status": facts["status"],
        "message": facts["message"],
        "quality": _short(facts["quality"]),
        "side": facts["side"] or "",
        "object": None,
        "specimen": "",
        "code": "",
        "fingerprint": "",
        "score": _short(facts["score"]),
        "n_found": facts["n_found"],
        "theta_deg": _short(facts["theta_deg"]),
        "cost": facts["cost"],
        "iterations": facts["iterations"],
        "expansion": _short(facts["expansion"]),
        "landmarks": _shorts(facts["landmarks"]),
        "covariance": _shorts(facts["covariance"]),
        "present": None if facts["present"] is None else _shorts(facts["present"]),
        "size": size,
        **columns_of(length),
    }


def failed_row(path: str, message: str) -> FitRow:
    """Return the row of an image that could not be fitted."""
    numbers = ("quality", "object", "score", "n_found", "theta_deg", "cost", "iterations", "expansion")
    row = dict.fromkeys((*numbers, "landmarks", "covariance", "present", "seconds"))
    name = _printable(Path(path).stem)
    texts = {"path": _printable(path), "status": ERROR, "message": _printable(message), "specimen": name, "code": ""}
    texts |= {"side": "", "fingerprint": ""}
    return texts | columns_of(None) | row


def _printable(text: str) -> str:
    """Escape bytes of a file name that are not UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode()


def _short(value: float | None) -> float | None:
    return None if value is None else _shorts([value])[0]


def _shorts(values: list) -> list[float | None]:
    """Return all numbers of (nested) lists, of which some may be None, as the shortest decimals of the same float32."""
    numbers = np.array(values, np.float64).ravel()  # None becomes NaN
    with np.errstate(over="ignore"):  # values beyond float32 become None
        # str would depend on print options.
        return [finite_or_none(float(np.format_float_scientific(value))) for value in numbers.astype(np.float32)]
