"""Run a batch from images to table, or resume one."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

from liaam import __version__
from liaam.batch.journal import Journal
from liaam.batch.pictures import find_pictures
from liaam.batch.tables import BatchTable, ParsedRow, check_format, row_of, write_table
from liaam.batch.work import ERROR, FitJob, FitRow, JournalRow, Pool, Settings
from liaam.errors import LiaamError, installing
from liaam.fitting.result import USABLE
from liaam.io import Contour, write_text_atomically
from liaam.io.atomic import check_output
from liaam.io.landmarks.base import PRESENT
from liaam.model import load_model
from liaam.models import model_file
from liaam.progress import Progress
from liaam.workers import all_cores, flow, limited_threads, one_thread

REASONS = 3  # Images that could not be fitted whose reasons are said; the table has all
DEATHS = 2  # An image is given up, with an error in its row, if so many processes died while it was in progress


@dataclass(frozen=True)
class Summary:
    """Result of a batch.

    Attributes
    ----------
    output : Path
    statuses : dict of str to int
        Number of images by status: those of :class:`liaam.fitting.FitStatus`, and ``error``.
    fitted : int
        Images processed in this run, including errors. The others were finished before.
    seconds : float
        Time of this run's fits.
    absent : int
        Number of fits that may be used, with landmarks that are absent.
    faults : tuple of str
        Why images could not be fitted, with their names: of the first three.
    sides : dict of str to int
        Number of fits that may be used by side, if the model knows two sides.
    rows : dict of str to int
        Number of rows by status; more than images if several objects of an image were fitted.
    """

    output: Path
    statuses: dict[str, int]
    fitted: int = 0
    seconds: float = 0.0
    absent: int = 0
    faults: tuple[str, ...] = ()
    sides: dict[str, int] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Number of images."""
        return sum(self.statuses.values())


def run_batch(
    model: str | os.PathLike[str],
    pictures: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    progress: Progress | None = None,
) -> Summary:
    """Fit a model to images and write a table, or resume an interrupted batch.

    Rows are in the natural order of the image paths. Except for the column ``seconds``, the table depends only on
    model, images and settings.

    Parameters
    ----------
    model : path-like
        A model file.
    pictures : path-like, or iterable of path-like
        A folder or pattern (see :func:`find_pictures`), or paths. Each path becomes a row, even if the image cannot be
        read.
    output : path-like
        The table to write, with suffix ``.parquet`` (needs the extra ``batch``), ``.csv`` or ``.jsonl``. The summary
        is written to ``OUTPUT.json``. Until the table is complete, ``OUTPUT.parts`` holds the finished rows.
    settings : Settings, optional
    jobs : int, optional
        Number of threads. By default one per core.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers then fit the images (needs the extra ``cluster``).
    restart : bool
        Whether to start over, and replace results of other settings or a file that no batch wrote.
    progress : callable, optional
        Called with (done, total, what).

    Returns
    -------
    Summary

    Raises
    ------
    LiaamError
        If the model, the settings or the output are invalid, or another batch uses the same output. An image that
        cannot be fitted raises no error; its row has the status ``error``.
    KeyboardInterrupt
        With a message on how to resume.

    Examples
    --------
    >>> summary = run_batch("faces.liaam", "images/**", "faces.parquet")          # doctest: +SKIP
    >>> summary.statuses                                                          # doctest: +SKIP
    {'converged': 981, 'doubtful': 17, 'error': 2}
    """
    load_model(model)  # its errors name the file
    job = FitJob(model_file(model).read_bytes(), settings or Settings(), str(Path.cwd()))
    job.check()  # before any work
    _check_workers(jobs, scheduler)
    progress = progress or (lambda done, total, what: None)
    batch = _Batch(Path(output), job, jobs or all_cores(), scheduler, progress)
    paths = (
        find_pictures(pictures) if isinstance(pictures, (str, os.PathLike)) else (os.fspath(path) for path in pictures)
    )
    return batch.run(paths, restart)


def _check_workers(jobs: int | None, scheduler: str | None) -> None:
    if jobs is not None and jobs < 1:
        raise LiaamError("jobs must be at least 1")
    if scheduler is not None and jobs is not None:
        raise LiaamError(f"scheduler {scheduler}: its workers determine the number of jobs; leave --jobs out")
    if scheduler is not None and find_spec("distributed") is None:
        raise LiaamError(f"scheduler {scheduler}: a cluster needs Dask; run {installing('cluster')}")


@dataclass(frozen=True)
class _Batch:
    """A batch: its output, its job and its workers."""

    output: Path
    job: FitJob
    jobs: int
    scheduler: str | None
    progress: Progress

    @property
    def facts(self) -> dict[str, Any]:
        """Everything that determines a row, except its image."""
        digest = hashlib.sha256(self.job.model_file).hexdigest()
        return {"liaam": __version__, "model": digest, **self.job.settings.describe()}

    @property
    def parts(self) -> Path:
        return self.output.with_name(f"{self.output.name}.parts")

    def run(self, pictures: Iterable[str], restart: bool) -> Summary:
        """Fit the remaining images and write the table."""
        check_format(self.output)
        check_output(self.output)
        with Journal(self.parts) as journal, _tidy(journal):
            self._take_up(journal, restart)
            self.progress(0, 1, "listing images")
            journal.list(pictures, self.job.start_file)
            if not journal.total:
                raise LiaamError(f"{self.output}: there is no image to fit; give images, or a folder of images")
            earlier = None if restart else earlier_summary(self.output)
            if earlier is not None and (earlier["settings"], earlier["pictures"]) == (self.facts, journal.digest()):
                faults = tuple(earlier.get("faults", ()))
                counts = {"absent": earlier.get("absent", 0), "sides": earlier.get("sides", {})}
                counts["rows"] = earlier.get("rows", earlier["statuses"])
                summary = Summary(self.output, earlier["statuses"], faults=faults, **counts)
            else:
                summary = self._finish(journal)
            journal.remove()
        return summary

    def _take_up(self, journal: Journal, restart: bool) -> None:
        """Resume a journal of the same settings, or start a new one. Raise if the table would replace another file."""
        if not restart:
            before = journal.facts
            if before is not None and journal.statuses:
                self._refuse_others(before)
                journal.check()
                return
            if self.output.exists():
                earlier = earlier_summary(self.output)
                if earlier is None:
                    raise LiaamError(
                        f"{self.output} exists and is not from an earlier batch; give another name with -o, or add "
                        "--restart to replace it"
                    )
                self._refuse_others(earlier["settings"])
        journal.restart(self.facts)

    def _refuse_others(self, before: dict[str, Any]) -> None:
        facts = self.facts
        changed = [
            f"{key} {_in_words(before.get(key))} and not {_in_words(facts[key])}"
            for key in facts
            if before.get(key) != facts[key]
        ]
        if changed:
            raise LiaamError(
                f"{self.output}: an earlier batch had {', '.join(changed)}; give another name with -o, or add "
                "--restart to start over"
            )

    def _finish(self, journal: Journal) -> Summary:
        summary = self._fit(journal)
        self.progress(summary.total, summary.total, f"writing {self.output.name}")
        model = self.job.model
        contours = Contour.all_of(model.contours)
        names = model.landmark_names
        tally = _Tally()
        table = BatchTable(
            self._rows(journal, tally), model.n_points, self.job.settings.covariance, self.facts, contours, names
        )
        write_table(self.output, table)
        sides = dict(sorted(tally.sides.items()))
        rows = dict(sorted(tally.statuses.items()))
        summary = replace(summary, absent=tally.absent, faults=tuple(tally.faults), sides=sides, rows=rows)
        facts = {
            "settings": self.facts,
            "statuses": summary.statuses,
            "absent": summary.absent,
            "faults": list(summary.faults),
            "sides": summary.sides,
            "rows": summary.rows,
            "pictures": journal.digest(),
            "bytes": self.output.stat().st_size,
        }
        write_text_atomically(summary_file(self.output), json.dumps(facts, indent=1) + "\n")
        return summary

    def _rows(self, journal: Journal, tally: "_Tally") -> Iterator[ParsedRow]:
        """Iterate over all rows, as text and parsed, and add them to a tally. Raise if one is damaged or missing."""
        n_rows = 0
        for text in journal.rows():
            n_rows += 1
            for each in text.split("\n"):
                row = row_of(each, self.job.model.n_points, self.job.settings.covariance)
                if row is None:
                    raise journal.damage("a row cannot be read")
                tally.add(row)
                yield each, row
        if n_rows != journal.total:
            raise journal.damage(f"{journal.total - n_rows} rows are missing")

    @contextmanager
    def _pool(self) -> Iterator[Pool]:
        if self.scheduler is None:
            # Fits release the interpreter's lock. At the end, running ones are waited for.
            with one_thread(), limited_threads(self.jobs) as pool:
                yield partial(pool.submit, self.job.row), lambda: self.jobs, ()
            return
        from liaam.batch.cluster import on_cluster  # needs an optional library

        with on_cluster(self.job, self.scheduler) as pool:
            yield pool

    def _fitted(self, journal: Journal) -> Generator[tuple[str, JournalRow], None, None]:
        """Fit the images that have no row, in any order.

        Those that were in progress when a process died come last and alone, so that a second death is of one image.
        """
        suspects = journal.suspects()
        for path in [path for path, deaths in suspects.items() if deaths >= DEATHS]:
            del suspects[path]
            yield path, self.job.row_of_death(path)
        again = []
        with self._pool() as (submit, room, died):
            for path, future in flow(submit, map(journal.begin, journal.todo()), room):
                try:
                    yield path, future.result()
                except died:
                    again.append(path)
            for path in [*suspects, *again]:  # the row of one is kept before the next begins
                try:
                    yield path, submit(journal.begin(path)).result()
                except died:
                    yield path, self.job.row_of_death(path)

    def _fit(self, journal: Journal) -> Summary:
        """Fit the images that have no row in the journal."""
        total = journal.total
        statuses = Counter(journal.statuses)
        begin = perf_counter()
        before = statuses.total()
        self.progress(before, total, "starting" if not before else "resuming")
        try:
            if before < total:
                with closing(self._fitted(journal)) as fitted:
                    for path, row in fitted:
                        journal.keep(path, row)
                        statuses[row[0]] += 1
                        done = statuses.total()
                        rate = (done - before) / (perf_counter() - begin)
                        self.progress(done, total, f"{rate:.1f} images/s; {in_words(statuses)}")
        except KeyboardInterrupt:
            if not statuses:
                raise KeyboardInterrupt("stopped: no image is finished yet") from None
            progress_so_far = f"{statuses.total()} of {total} images are finished and kept in {self.parts}"
            raise KeyboardInterrupt(f"stopped: {progress_so_far}; run the same command again to resume") from None
        return Summary(self.output, dict(sorted(statuses.items())), statuses.total() - before, perf_counter() - begin)


@dataclass
class _Tally:
    """What is said of the rows of a table besides their statuses."""

    absent: int = 0  # number of fits that may be used, with absent landmarks
    faults: list[str] = field(default_factory=list)  # why images could not be fitted, of the first
    sides: Counter[str] = field(default_factory=Counter)  # number of fits that may be used, by side
    statuses: Counter[str] = field(default_factory=Counter)  # number of rows by status

    def add(self, row: FitRow) -> None:
        """Add a row."""
        self.absent += has_absent(row)
        self.statuses[row["status"]] += 1
        if row["side"] and row["status"] in USABLE:
            self.sides[row["side"]] += 1
        if row["status"] == ERROR and len(self.faults) < REASONS:
            message = row["message"]
            names_image = message.startswith(row["path"])
            self.faults.append(message if names_image else f"{row['path']}: {message}")


def has_absent(row: FitRow) -> bool:
    """Return whether the row of a fit that may be used has absent landmarks."""
    present = row["present"] or ()
    return row["status"] in USABLE and any(value is not None and value < PRESENT for value in present)


def summary_file(output: Path) -> Path:
    """Return the path of the summary beside a table."""
    return output.with_name(f"{output.name}.json")


def earlier_summary(output: Path) -> dict[str, Any] | None:
    """Return the summary of the batch that wrote a table; None if it is missing, damaged or of another table."""
    try:
        summary = json.loads(summary_file(output).read_bytes())
        unchanged = summary["bytes"] == output.stat().st_size
        statuses, settings, pictures = (summary[key] for key in ("statuses", "settings", "pictures"))
        faults = summary.get("faults", [])
        sound = isinstance(settings, dict) and isinstance(pictures, str) and isinstance(statuses, dict)
        sound = sound and isinstance(faults, list) and all(isinstance(fault, str) for fault in faults)
        sides = summary.get("sides", {})
        rows = summary.get("rows", statuses)
        sound = sound and isinstance(sides, dict) and isinstance(rows, dict)
        numbers = (*statuses.values(), *sides.values(), *rows.values(), summary.get("absent", 0)) if sound else ()
        counted = sound and all(map(_is_count, numbers))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return summary if unchanged and counted else None


def _is_count(number: Any) -> bool:
    return type(number) is int and number >= 0


@contextmanager
def _tidy(journal: Journal) -> Iterator[None]:
    """Remove the journal if the block raises before the first row."""
    try:
        yield
    except BaseException:
        with suppress(LiaamError, OSError):
            if not journal.statuses:
                journal.remove()
        raise


def in_words(statuses: dict[str, int]) -> str:
    """Format counts of statuses, most frequent first."""
    ordered = sorted(statuses.items(), key=lambda entry: (-entry[1], entry[0]))
    return ", ".join(f"{number} {status}" for status, number in ordered)


def _in_words(value: Any) -> str:
    if isinstance(value, str):
        return value if len(value) < 60 else f"{value[:8]}…"
    return "none" if value is None else json.dumps(value)
