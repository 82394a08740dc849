"""One way to run any experiment: tasks in parallel, a journal to go on from, and five files at the end.

An :class:`Experiment` says what is done; :func:`run_experiment` does it and writes

``results.csv``
    one row per trial and method, in the order of the tasks;
``summary.json``
    what the rows come to;
``figure.png``, ``figure.svg``, ``report.md``
    the same for people.

The results depend on the experiment's settings only: not on the number of workers, nor on how often the run
was stopped and taken up again.
"""

import csv
import hashlib
import io
import json
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import liaam
from liaam import __version__
from liaam.errors import LiaamError
from liaam.io import make_folder, write_text_atomically
from liaam.plotting import save_figure
from liaam.progress import Progress
from liaam.workers import WorkerDied, all_cores, in_workers, one_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
PICTURES = "pictures.png"
"""File in the results' folder that shows what was fitted, where an experiment has such pictures."""


class Task(Protocol):
    """A unit of work that is small enough to be done again after a stop, and knows its own seed."""

    @property
    def key(self) -> str:
        """Name, unique in the experiment; people see it beside the progress bar."""
        ...


@dataclass(frozen=True)
class NumberedTrial:
    """A task that is told by the number of its draw alone."""

    number: int

    @property
    def key(self) -> str:
        """Name for the journal."""
        return f"trial {self.number}"


@dataclass(frozen=True, eq=False)
class Experiment:
    """What an experiment does, and how it is told.

    Attributes
    ----------
    name, title : str
        For programs and for people.
    settings : dict
        Everything that decides the results, as JSON knows it. A stopped run is only taken up under the same
        settings.
    tasks : tuple of Task
        Picklable and hashable. Give what shares a model neighbouring places, and train it in a function with an
        ``lru_cache``: each worker takes the tasks in their order.
    work : callable
        From a task to its rows: a function at the top of a module, or a ``functools.partial`` of one, so that it
        can be sent to a worker. It may not depend on other tasks.
    columns : mapping of str to str
        Columns of results.csv and their formats, such as ``{"error_px": ".6f", "status": ""}``.
    summarise : callable
        From all rows to the summary, as JSON knows it.
    draw : callable
        From (rows, summary) to a figure.
    report : callable
        From (rows, summary) to the report's body in markdown: what was asked, and a table of what came out.
    pictures : callable, optional
        Gives a figure of what is fitted, for the report.
    choices : tuple of str
        What was chosen where the paper leaves it open, a sentence each.
    left_out : tuple of str
        What the data held but the experiment does not use, and why.
    skips_faults : bool
        Whether a task that raises a LiaamError is left out (the summary names it), rather than ending the run.
    """

    name: str
    title: str
    settings: dict[str, Any]
    tasks: tuple[Task, ...]
    work: Callable[[Any], list[Row]]
    columns: Mapping[str, str]
    summarise: Callable[[list[Row]], dict[str, Any]]
    draw: Callable[[list[Row], dict[str, Any]], "Figure"]
    report: Callable[[list[Row], dict[str, Any]], str]
    pictures: Callable[[], "Figure"] | None = None
    choices: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    skips_faults: bool = False

    def __post_init__(self) -> None:
        """Refuse tasks that the journal could not tell apart."""
        keys = [task.key for task in self.tasks]
        if not keys:
            raise LiaamError(f"experiment {self.name} has nothing to do; give at least one trial and one value")
        if len(set(keys)) < len(keys):
            raise LiaamError(f"experiment {self.name}: two tasks have the same name; is a swept value given twice?")

    @property
    def journal(self) -> str:
        """File in the results' folder that keeps finished tasks until all are done: one for each fingerprint.

        So a run with other settings does not undo what a stopped one has done.
        """
        return f"trials-{self.fingerprint}.jsonl"

    @property
    def fingerprint(self) -> str:
        """Short digest of what decides the results: settings, and the code."""
        text = json.dumps([self.name, self.settings, __version__, _code_digest()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Outcome:
    """What a task gave: rows, or the reason why there are none. Only what JSON keeps, bit for bit.

    Attributes
    ----------
    rows : list of dict
    fault : str, optional
    """

    rows: list[Row]
    fault: str | None = None


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the library's source and the experiments', so that no result outlives the code that gave it."""
    digest = hashlib.sha256()
    for root in (Path(liaam.__file__).parent, Path(__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


Finished = Generator[tuple[Task, Outcome], None, None]


def run_experiment(
    experiment: Experiment, out: Path, jobs: int | None = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Run an experiment, or go on with one that was stopped, and write its files.

    Parameters
    ----------
    experiment : Experiment
    out : Path
        Folder for the results; made if it does not exist.
    jobs : int or None
        Worker processes; None for one per core. Scripts that ask for more than one need the usual
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
        A task failed, a worker died, or nothing could be written.
    KeyboardInterrupt
        With a message that says how to go on.
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
    """Give the summary that an earlier run of the same experiment has left in a folder; None where there is none."""
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
    """Finished tasks on disk, a line each.

    Attributes
    ----------
    outcomes : dict of str to Outcome
        By the task's key.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.outcomes: dict[str, Outcome] = {}
        kept = _whole_lines(path)
        for line in kept:
            self._note(json.loads(line))
        write_text_atomically(path, "".join(f"{line}\n" for line in kept))  # without a torn line
        self._file = path.open("a", encoding="utf-8")

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, key: str, outcome: Outcome) -> None:
        """Keep a finished task; it is on disk when this returns."""
        line = json.dumps({"key": key, "rows": outcome.rows, "fault": outcome.fault}, default=_plain)
        try:
            self._file.write(f"{line}\n")
            self._file.flush()
        except OSError as error:
            raise LiaamError(f"{self.path} cannot be written ({error.strerror or error}): free some space") from error
        self._note(json.loads(line))  # what a run that goes on would read, so that both write the same

    def remove(self) -> None:
        """Forget everything: the results are written."""
        self.path.unlink(missing_ok=True)

    def _note(self, entry: dict[str, Any]) -> None:
        self.outcomes[entry["key"]] = Outcome(entry["rows"], entry["fault"])


def _whole_lines(path: Path) -> list[str]:
    """Lines up to the first that is no whole entry: what a kill left half-written is done again."""
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
    """Whether a line of a journal is a finished task."""
    if not isinstance(entry, dict) or set(entry) != {"key", "rows", "fault"} or not isinstance(entry["key"], str):
        return False
    rows, fault = entry["rows"], entry["fault"]
    return isinstance(rows, list) and all(isinstance(row, dict) for row in rows) and isinstance(fault, str | None)


def _plain(value: Any) -> Any:
    """Give NumPy's numbers as JSON knows them."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"a row may hold numbers and text, not {type(value).__name__}")


def _complete(experiment: Experiment, journal: Journal, jobs: int, tell: Progress) -> None:
    """Do what the journal does not hold yet."""
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
    """Do tasks one after the other in this process."""
    with one_thread():
        for task in tasks:
            yield task, _perform(experiment.work, experiment.skips_faults, task)


def _in_workers(experiment: Experiment, tasks: list[Task], jobs: int) -> Finished:
    """Do tasks in worker processes; they come in the order in which they finish."""
    try:
        yield from in_workers(partial(_perform_alone, experiment.work, experiment.skips_faults), tasks, jobs)
    except WorkerDied:
        raise LiaamError(
            "a worker process died (killed, or out of memory); the same command goes on where it stopped, and needs "
            "less memory with fewer jobs"
        ) from None


def _perform_alone(work: Callable[[Any], list[Row]], skips_faults: bool, task: Task) -> Outcome:
    """Do a task in a worker process."""
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
    """Write the files of a finished experiment; gives the summary."""
    rows = [row for outcome in outcomes for row in outcome.rows]
    left_out = [*experiment.left_out, *(outcome.fault for outcome in outcomes if outcome.fault)]
    if not rows:
        raise LiaamError(f"experiment {experiment.name} has no result; {'; '.join(left_out)}")
    summary = {
        "experiment": experiment.name,
        "fingerprint": experiment.fingerprint,
        "settings": experiment.settings,
        "left_out": left_out,
        **experiment.summarise(rows),
    }
    write_text_atomically(out / "results.csv", as_csv(rows, experiment.columns))
    save_figure(experiment.draw(rows, summary), out / "figure.png", out / "figure.svg")
    if experiment.pictures:
        save_figure(experiment.pictures(), out / PICTURES)
    write_text_atomically(out / "report.md", _report(experiment, rows, summary))
    write_text_atomically(out / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def as_csv(rows: list[Row], columns: Mapping[str, str]) -> str:
    """Rows as CSV text with a header, each column in its format."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([format(row[column], style) for column, style in columns.items()] for row in rows)
    return text.getvalue()


def markdown_table(header: list[str], rows: list[list[str]], numbers: bool = True) -> str:
    """A table in markdown, the first column to the left and numbers in the others to the right."""
    rule = ["---", *["---:" if numbers else "---"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, rule, *rows))


def _report(experiment: Experiment, rows: list[Row], summary: dict[str, Any]) -> str:
    """Write the whole of report.md around the experiment's own part."""
    settings = [[key, _in_words(value)] for key, value in experiment.settings.items()]
    parts = [
        f"# {experiment.title}",
        experiment.report(rows, summary).strip(),
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
    """A setting as text: lists by commas, groups as name = value."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_in_words(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_in_words(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
