"""Run experiments: tasks in parallel, a journal for resuming, and five result files.

An :class:`Experiment` defines the work. :func:`run_experiment` runs it and writes

``results.csv``
    one row per trial and method, in the order of the tasks;
``summary.json``
    statistics of the rows;
``figure.png``, ``figure.svg``, ``report.md``
    the same for reading.

The results depend only on the experiment's settings, not on the number of workers or on interruptions.
"""

import csv
import hashlib
import io
import json
import multiprocessing
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import liaam
from liaam import __version__
from liaam.errors import LiaamError
from liaam.io import make_folder, write_text_atomically
from liaam.io.files import some_names
from liaam.plotting import save_figure
from liaam.progress import Progress
from liaam.workers import all_cores, flow, fresh_interpreters, obey_parent, one_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
PICTURES = "pictures.png"
"""File in the results' folder with a figure of the fitted images, if the experiment has one."""


class Task(Protocol):
    """A unit of work, small enough to be repeated after an interruption, with its own seed."""

    @property
    def key(self) -> str:
        """Name, unique in the experiment, which the progress bar shows."""
        ...


@dataclass(frozen=True)
class Trial:
    """A task identified by a condition, such as a swept value or a kind of image, and by the index of its draw."""

    condition: Any
    number: int

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"{self.condition}, trial {self.number}"


@dataclass(frozen=True)
class Named:
    """A task identified by a group, such as the model that fits it, and by a name in it."""

    group: Any
    name: str

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"group {self.group}, {self.name}"


@dataclass(frozen=True, eq=False)
class Experiment:
    """Definition of an experiment and of its report.

    Attributes
    ----------
    name, title : str
        Identifier and title.
    settings : dict
        Everything that determines the results, as JSON types. A run resumes only with the same settings.
    tasks : tuple of Task
        Picklable and hashable tasks. Each worker takes them in order. Put tasks that share a model next to each other,
        and train it in a function with an ``lru_cache``.
    work : callable
        From a task to its rows: a function at the top level of a module, or a ``functools.partial`` of one, so that it
        can be pickled. It must not depend on other tasks. All rows have the same keys, the columns of results.csv.
    summarise : callable
        From all rows to the summary, as JSON types.
    draw : callable
        From (rows, summary) to a figure.
    report : callable
        From the summary to the report's body in markdown: the question and a table of the results.
    pictures : callable, optional
        Returns a figure of the fitted images for the report.
    choices : tuple of str
        Choices that the paper leaves open, one sentence each.
    left_out : tuple of str
        Unused data, with the reasons.
    skips_faults : bool
        Whether to skip a task that raises a LiaamError (the summary names it), rather than end the run.
    """

    name: str
    title: str
    settings: dict[str, Any]
    tasks: tuple[Task, ...]
    work: Callable[[Any], list[Row]]
    summarise: Callable[[list[Row]], dict[str, Any]]
    draw: Callable[[list[Row], dict[str, Any]], "Figure"]
    report: Callable[[dict[str, Any]], str]
    pictures: Callable[[], "Figure"] | None = None
    choices: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    skips_faults: bool = False

    def __post_init__(self) -> None:
        """Raise if two tasks have the same key."""
        keys = [task.key for task in self.tasks]
        if not keys:
            raise LiaamError(f"experiment {self.name} has nothing to do; give at least one trial and one value")
        if len(set(keys)) < len(keys):
            raise LiaamError(f"experiment {self.name}: two tasks have the same name; is a swept value given twice?")

    @property
    def journal(self) -> str:
        """Name of the file that keeps finished tasks until all are done. It depends on the fingerprint.

        A run with other settings therefore keeps the journal of an interrupted one.
        """
        return f"trials-{self.fingerprint}.jsonl"

    @property
    def fingerprint(self) -> str:
        """Short digest of the settings and the code, which determine the results."""
        text = json.dumps([self.name, self.settings, __version__, _code_digest()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Outcome:
    """Result of a task: rows, or the reason why there are none, as JSON types."""

    rows: list[Row]
    fault: str | None = None


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the source of the library and the experiments, so that results of other code are not reused."""
    digest = hashlib.sha256()
    for root in (Path(liaam.__file__).parent, Path(__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


Finished = Generator[tuple[Task, Outcome], None, None]


def run_experiment(
    experiment: Experiment, out: Path, jobs: int | None = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Run an experiment, or resume an interrupted one, and write its files.

    Parameters
    ----------
    experiment : Experiment
    out : Path
        Folder for the results; created if missing.
    jobs : int or None
        Number of worker processes; None for one per core. Scripts that use more than one need
        ``if __name__ == "__main__"``.
    progress : callable, optional
        Called with (done, total, what).

    Returns
    -------
    dict
        The summary, as written.

    Raises
    ------
    LiaamError
        If a task fails, a worker dies, or the results cannot be written.
    KeyboardInterrupt
        With a message on how to resume.
    """
    jobs = all_cores() if jobs is None else jobs
    if jobs < 1:
        raise LiaamError("jobs must be at least 1")
    tell = progress or (lambda done, total, what: None)
    make_folder(out)
    with Journal(out / experiment.journal) as journal:
        _complete(experiment, journal, jobs, tell)
        outcomes = [journal.outcomes[task.key] for task in experiment.tasks]
    tell(len(outcomes), len(outcomes), "figure")
    summary = _write_results(experiment, outcomes, out)
    journal.remove()
    return summary


def finished(experiment: Experiment, out: Path) -> dict[str, Any] | None:
    """Return the summary of a finished run of the same experiment in a folder, or None."""
    files = ["results.csv", "summary.json", "figure.png", "figure.svg", "report.md"]
    files += [PICTURES] if experiment.pictures else []
    if not all((out / name).is_file() for name in files):
        return None
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return None
    same = isinstance(summary, dict) and summary.get("fingerprint") == experiment.fingerprint
    return summary if same else None


class Journal:
    """Finished tasks on disk, one line each; ``outcomes`` has them by the task's key."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.outcomes: dict[str, Outcome] = {}
        kept = _whole_lines(path)
        for line in kept:
            self._note(json.loads(line))
        write_text_atomically(path, "".join(f"{line}\n" for line in kept))  # without an incomplete line
        self._file = path.open("a", encoding="utf-8")

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, key: str, outcome: Outcome) -> None:
        """Write a finished task to disk."""
        line = json.dumps({"key": key, "rows": outcome.rows, "fault": outcome.fault}, default=_plain)
        try:
            self._file.write(f"{line}\n")
            self._file.flush()
        except OSError as error:
            raise LiaamError(f"{self.path} cannot be written ({error.strerror or error}): free some space") from error
        self._note(json.loads(line))  # parsed as in a resumed run, so that both write the same

    def remove(self) -> None:
        """Delete the journal."""
        self.path.unlink(missing_ok=True)

    def _note(self, entry: dict[str, Any]) -> None:
        self.outcomes[entry["key"]] = Outcome(entry["rows"], entry["fault"])


def _whole_lines(path: Path) -> list[str]:
    """Return the lines before the first incomplete entry. Tasks after it are repeated."""
    if not path.is_file():
        return []
    whole = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            break
        if not line.endswith("\n") or not _is_entry(entry):
            break
        whole.append(line.rstrip("\n"))
    return whole


def _is_entry(entry: Any) -> bool:
    """Return whether a line of a journal is a finished task."""
    if not isinstance(entry, dict) or set(entry) != {"key", "rows", "fault"} or not isinstance(entry["key"], str):
        return False
    rows, fault = entry["rows"], entry["fault"]
    return isinstance(rows, list) and all(isinstance(row, dict) for row in rows) and isinstance(fault, str | None)


def _plain(value: Any) -> Any:
    """Convert NumPy numbers to JSON types."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"a row may hold numbers and text, not {type(value).__name__}")


def _complete(experiment: Experiment, journal: Journal, jobs: int, tell: Progress) -> None:
    """Run the tasks that are not in the journal."""
    total = len(experiment.tasks)
    todo = [task for task in experiment.tasks if task.key not in journal.outcomes]
    tell(total - len(todo), total, "starting" if len(todo) == total else "going on")
    done_by = _in_turn if min(jobs, len(todo)) < 2 else _in_workers
    try:
        with closing(done_by(experiment, todo, min(jobs, len(todo)))) as finished:
            for task, outcome in finished:
                journal.add(task.key, outcome)
                tell(len(journal.outcomes), total, task.key)
    except KeyboardInterrupt:
        kept = f"{len(journal.outcomes)} of {total} tasks are kept in {journal.path}"
        raise KeyboardInterrupt(f"stopped: {kept}; the same command goes on from there") from None


def _in_turn(experiment: Experiment, tasks: list[Task], _jobs: int) -> Finished:
    """Run tasks one after the other in this process."""
    with one_thread():
        for task in tasks:
            yield task, _perform(experiment.work, experiment.skips_faults, task)


def _in_workers(experiment: Experiment, tasks: list[Task], jobs: int) -> Finished:
    """Run tasks in worker processes. Yield them in order of completion."""
    perform = partial(_perform_alone, experiment.work, experiment.skips_faults)
    try:
        with ProcessPoolExecutor(jobs, fresh_interpreters(), obey_parent) as pool:
            try:
                for task, future in flow(partial(pool.submit, perform), tasks, lambda: jobs + 1):
                    yield task, future.result()
            except BaseException:  # a task takes minutes
                for worker in multiprocessing.active_children():
                    worker.kill()
                raise
    except BrokenProcessPool:
        raise LiaamError(
            "a worker process died (killed, or out of memory); the same command goes on where it stopped, and needs "
            "less memory with fewer jobs"
        ) from None


def _perform_alone(work: Callable[[Any], list[Row]], skips_faults: bool, task: Task) -> Outcome:
    """Run a task in a worker process."""
    with one_thread():
        return _perform(work, skips_faults, task)


def _perform(work: Callable[[Any], list[Row]], skips_faults: bool, task: Task) -> Outcome:
    try:
        return Outcome(work(task))
    except LiaamError as error:
        if not skips_faults:
            raise
        return Outcome([], f"{task.key}: {error}")


def _write_results(experiment: Experiment, outcomes: list[Outcome], out: Path) -> dict[str, Any]:
    """Write the files of a finished experiment and return the summary."""
    rows = [row for outcome in outcomes for row in outcome.rows]
    left_out = [*experiment.left_out, *(outcome.fault for outcome in outcomes if outcome.fault)]
    if not rows:
        raise LiaamError(f"experiment {experiment.name} has no result; {some_names(left_out, 3, '; ')}")
    summary = {
        "experiment": experiment.name,
        "fingerprint": experiment.fingerprint,
        "settings": experiment.settings,
        "left_out": left_out,
        **experiment.summarise(rows),
    }
    write_text_atomically(out / "results.csv", as_csv(rows))
    save_figure(experiment.draw(rows, summary), out / "figure.png", out / "figure.svg")
    if experiment.pictures:
        save_figure(experiment.pictures(), out / PICTURES)
    write_text_atomically(out / "report.md", _report(experiment, summary))
    write_text_atomically(out / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def as_csv(rows: list[Row]) -> str:
    """Format rows as CSV text with a header, and numbers with at most six decimals."""
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: round(value, 6) if isinstance(value, float) else value for key, value in row.items()} for row in rows
    )
    return text.getvalue()


def markdown_table(header: list[str], rows: list[list[str]], numbers: bool = True) -> str:
    """Return a markdown table. The first column is left-aligned, and numbers in the others are right-aligned."""
    rule = ["---", *["---:" if numbers else "---"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, rule, *rows))


def _report(experiment: Experiment, summary: dict[str, Any]) -> str:
    """Return report.md with the experiment's own body."""
    settings = [[key, _in_words(value)] for key, value in experiment.settings.items()]
    parts = [
        f"# {experiment.title}",
        experiment.report(summary).strip(),
        f"![{experiment.title}](figure.png)",
        *(["## What was fitted", f"![What was fitted]({PICTURES})"] if experiment.pictures else []),
        *_bullets("Choices where the paper leaves it open", experiment.choices),
        *_bullets("Left out", summary["left_out"]),
        "## Settings",
        markdown_table(["setting", "value"], [*settings, ["liaam", __version__]], numbers=False),
        "Every fit is in `results.csv`, what the fits come to in `summary.json`.",
    ]
    return "\n\n".join(parts) + "\n"


def _bullets(title: str, items: Any) -> list[str]:
    return [f"## {title}", "\n".join(f"- {item}" for item in items)] if items else []


def _in_words(value: Any) -> str:
    """Format a setting as text: lists with commas, mappings as name = value."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_in_words(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_in_words(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
