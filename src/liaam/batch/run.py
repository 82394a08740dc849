"""A batch from pictures to table, or what is left of one that was stopped."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

from liaam import __version__
from liaam.batch.journal import Journal
from liaam.batch.pictures import find_pictures
from liaam.batch.pools import Chunk, Finished, in_processes, in_turn
from liaam.batch.tables import ParsedRow, Table, check_format, row_of, write_table
from liaam.batch.work import Job, Settings
from liaam.errors import LiaamError
from liaam.io import write_text_atomically
from liaam.progress import Progress
from liaam.workers import all_cores

CHUNK = 16
"""Pictures that a worker does at a time, and at most so many of each worker are done again after a kill."""

_SHARES = 4
"""Chunks for each worker that there should be at least, so that none ends long before the others."""


@dataclass(frozen=True)
class Summary:
    """What a batch came to.

    Attributes
    ----------
    output : Path
    statuses : dict of str to int
        Number of pictures by status: those of :class:`liaam.fitting.FitStatus`, and ``error``.
    fitted : int
        Pictures that became rows in this run, errors too; the others were done already.
    seconds : float
        That this run took to fit them.
    """

    output: Path
    statuses: dict[str, int]
    fitted: int = 0
    seconds: float = 0.0

    @property
    def total(self) -> int:
        """Number of pictures."""
        return sum(self.statuses.values())


def run_batch(
    model: str | os.PathLike[str],
    pictures: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    jobs: int | None = None,
    chunk: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    progress: Progress | None = None,
) -> Summary:
    """Fit a model to pictures and write a table, or go on with a batch that was stopped.

    Rows are in the natural order of the pictures' paths. They and the table depend on model, pictures and settings
    only, but for the column ``seconds``.

    Parameters
    ----------
    model : path-like
        A model file.
    pictures : path-like, or iterable of path-like
        A folder or pattern (see :func:`find_pictures`); or paths, which are read one by one, and become a row each
        whether the picture can be read or not.
    output : path-like
        The table to write; ends in ``.parquet`` (needs the extra ``batch``), ``.csv`` or ``.jsonl``. Beside it stand
        ``OUTPUT.json``, a summary, and until it is complete ``OUTPUT.parts``, what is done.
    settings : Settings, optional
    jobs : int, optional
        Worker processes; one per core if left out. Scripts that ask for more than one need the usual
        ``if __name__ == "__main__"``.
    chunk : int, optional
        Pictures that a worker does at a time; 16, or fewer where there are few pictures.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers then do the work (needs the extra ``cluster``).
    restart : bool
        Whether to begin anew where there are results of other settings, or a file that no batch has written.
    progress : callable, optional
        Called with (done, total, what).

    Returns
    -------
    Summary

    Raises
    ------
    LiaamError
        The model, the settings or the output make no sense, or another batch works on the same output. A picture that
        cannot be fitted is no error but a row.
    KeyboardInterrupt
        With a message that says how to go on.

    Examples
    --------
    >>> summary = run_batch("faces.liaam", "images/**", "faces.parquet")          # doctest: +SKIP
    >>> summary.statuses                                                          # doctest: +SKIP
    {'converged': 981, 'doubtful': 17, 'error': 2}
    """
    batch = _Batch(Path(output), _job_of(Path(model), settings or Settings()))
    workers = _workers(jobs, chunk, scheduler)
    paths = (
        find_pictures(pictures) if isinstance(pictures, (str, os.PathLike)) else (os.fspath(path) for path in pictures)
    )
    return batch.run(paths, workers, restart, progress or (lambda done, total, what: None))


@dataclass(frozen=True)
class _Workers:
    """Who does the work."""

    jobs: int
    chunk: int | None
    scheduler: str | None

    def chunk_for(self, pictures: int) -> int:
        """Size of a chunk where there is so much to do."""
        return self.chunk or max(1, min(CHUNK, pictures // (_SHARES * self.jobs)))

    def do(self, job: Job, chunks: Iterable[Chunk]) -> Finished:
        """Do chunks, in whatever order."""
        if self.scheduler is not None:
            from liaam.batch.cluster import on_cluster  # it needs an optional library

            return on_cluster(job, chunks, self.scheduler)
        return in_turn(job, chunks) if self.jobs == 1 else in_processes(job, chunks, self.jobs)


def _workers(jobs: int | None, chunk: int | None, scheduler: str | None) -> _Workers:
    if min(jobs or 1, chunk or 1) < 1 or 0 in (jobs, chunk):
        raise LiaamError("jobs and chunk must be at least 1")
    if scheduler is not None and jobs is not None:
        raise LiaamError(f"scheduler {scheduler}: how many jobs there are is told by its workers; leave --jobs out")
    if scheduler is not None and find_spec("distributed") is None:
        raise LiaamError(f'scheduler {scheduler}: a cluster needs Dask; run pip install "liaam[cluster]"')
    return _Workers(jobs or all_cores(), chunk, scheduler)


def _job_of(model: Path, settings: Settings) -> Job:
    """Read a model file, and find out before the work whether it can be fitted like that."""
    from liaam.model import load_model

    load_model(model)  # whose errors name the file
    job = Job(model.read_bytes(), settings, str(Path.cwd()))
    job.check()
    return job


@dataclass(frozen=True)
class _Batch:
    """A batch: its output, and what is to be done for it."""

    output: Path
    job: Job

    @property
    def facts(self) -> dict[str, Any]:
        """All that decides a row, beside its picture."""
        digest = hashlib.sha256(self.job.model_file).hexdigest()
        return {"liaam": __version__, "model": digest, **self.job.settings.describe()}

    @property
    def parts(self) -> Path:
        return self.output.with_name(f"{self.output.name}.parts")

    def run(self, pictures: Iterable[str], workers: _Workers, restart: bool, tell: Progress) -> Summary:
        """Do what is not done yet, and write the table."""
        self._check_output()
        with Journal(self.parts) as journal, _tidy(journal):
            self._take_up(journal, restart)
            tell(0, 1, "listing pictures")
            journal.list(pictures, self.job.start_file)
            if not journal.total:
                raise LiaamError(f"{self.output}: there is no picture to fit; name some, or a folder that holds them")
            earlier = None if restart else self._complete(journal)
            if earlier is None:
                summary = self._finish(journal, workers, tell)
            else:
                summary = Summary(self.output, earlier["statuses"])
            journal.remove()
        return summary

    def _check_output(self) -> None:
        """Complain, before the work, about a table that cannot be written."""
        check_format(self.output)
        if self.output.is_dir() or not self.output.parent.is_dir():
            what = "it is a folder" if self.output.is_dir() else f"the folder {self.output.parent} does not exist"
            raise LiaamError(
                f"{self.output} cannot be written: {what}; give the name of a file in a folder that exists"
            )

    def _check_earlier(self) -> None:
        """Complain, before the work, about a table that would undo another."""
        if not self.output.exists():
            return
        earlier = earlier_summary(self.output)
        if earlier is None:
            raise LiaamError(
                f"{self.output} exists and is not from an earlier batch; give another name with -o, or add --restart "
                "to replace it"
            )
        self._refuse_others(earlier["settings"])

    def _take_up(self, journal: Journal, restart: bool) -> None:
        """Go on with a journal of the same settings, or begin one."""
        if not restart:
            before = journal.facts
            if before is not None and journal.statuses:
                self._refuse_others(before)
                journal.check()
                return
            self._check_earlier()
        journal.restart(self.facts)

    def _refuse_others(self, before: dict[str, Any]) -> None:
        facts = self.facts
        changed = [f"{key} ({_in_words(before.get(key))}, now {_in_words(facts[key])})" for key in facts]
        changed = [text for key, text in zip(facts, changed, strict=True) if before.get(key) != facts[key]]
        if changed:
            raise LiaamError(
                f"{self.output}: an earlier batch had another {', '.join(changed)}; give another name with -o, or add "
                "--restart to begin anew"
            )

    def _complete(self, journal: Journal) -> dict[str, Any] | None:
        """Summary of an earlier batch of the same settings and the very same pictures."""
        earlier = earlier_summary(self.output)
        same = earlier is not None and (earlier["settings"], earlier["pictures"]) == (self.facts, journal.digest())
        return earlier if same else None

    def _finish(self, journal: Journal, workers: _Workers, tell: Progress) -> Summary:
        summary = self._fit(journal, workers, tell)
        tell(summary.total, summary.total, f"writing {self.output.name}")
        table = Table(self._rows(journal), self.job.model.n_points, self.job.settings.covariance, self.facts)
        write_table(self.output, table)
        facts = {
            "settings": self.facts,
            "statuses": summary.statuses,
            "pictures": journal.digest(),
            "bytes": self.output.stat().st_size,
        }
        write_text_atomically(summary_file(self.output), json.dumps(facts, indent=1) + "\n")
        return summary

    def _rows(self, journal: Journal) -> Iterator[ParsedRow]:
        """All rows, as text and as what it stands for; none may be missing or damaged."""
        n_rows = 0
        for text in journal.rows():
            row = row_of(text, self.job.model.n_points, self.job.settings.covariance)
            if row is None:
                raise journal.damage("a row cannot be read")
            n_rows += 1
            yield text, row
        if n_rows != journal.total:
            raise journal.damage(f"{journal.total - n_rows} rows are missing")

    def _fit(self, journal: Journal, workers: _Workers, tell: Progress) -> Summary:
        """Fit what the journal does not hold yet."""
        total, statuses, begin = journal.total, Counter(journal.statuses), perf_counter()
        before = statuses.total()
        tell(before, total, "starting" if not before else "going on")
        chunks = journal.todo(workers.chunk_for(total - before))
        try:
            if before < total:
                with closing(workers.do(self.job, chunks)) as finished:
                    for chunk, rows in finished:
                        journal.keep(chunk, rows)
                        statuses.update(status for status, _ in rows)
                        done = statuses.total()
                        rate = (done - before) / (perf_counter() - begin)
                        tell(done, total, f"{rate:.1f} pictures/s; {in_words(statuses)}")
        except KeyboardInterrupt:
            if not statuses:
                raise KeyboardInterrupt("stopped: no picture is done yet") from None
            kept = f"{statuses.total()} of {total} pictures are kept in {self.parts}"
            raise KeyboardInterrupt(f"stopped: {kept}; the same command goes on from there") from None
        summary = Summary(self.output, dict(sorted(statuses.items())))
        return replace(summary, fitted=summary.total - before, seconds=perf_counter() - begin)


def summary_file(output: Path) -> Path:
    """File beside a table that says how it was made."""
    return output.with_name(f"{output.name}.json")


def earlier_summary(output: Path) -> dict[str, Any] | None:
    """Summary of the batch that has written a table; None where there is none, or it is damaged or of another table."""
    try:
        summary = json.loads(summary_file(output).read_bytes())
        known = summary["bytes"] == output.stat().st_size
        statuses, settings, pictures = (summary[key] for key in ("statuses", "settings", "pictures"))
        sound = isinstance(settings, dict) and isinstance(pictures, str) and isinstance(statuses, dict)
        counted = sound and all(type(number) is int and number >= 0 for number in statuses.values())
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return summary if known and counted else None


@contextmanager
def _tidy(journal: Journal) -> Iterator[None]:
    """Leave nothing behind when it ends before the first row."""
    try:
        yield
    except BaseException:
        with suppress(LiaamError, OSError):
            if not journal.statuses:
                journal.remove()
        raise


def in_words(statuses: dict[str, int]) -> str:
    """Counts of statuses, the most frequent first."""
    ordered = sorted(statuses.items(), key=lambda entry: (-entry[1], entry[0]))
    return ", ".join(f"{number} {status}" for status, number in ordered)


def _in_words(value: Any) -> str:
    if isinstance(value, str):
        return value if len(value) < 60 else f"{value[:8]}…"
    return "none" if value is None else json.dumps(value)
