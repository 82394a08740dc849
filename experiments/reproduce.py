"""Run all experiments of the paper's section 7, and write one report with a table of its claims."""

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.baselines import baselines_experiment
from experiments.bound import bound_experiment
from experiments.claims import CLAIMS, Verdict, up_to
from experiments.convergence import convergence_experiment
from experiments.displacement import displacement_experiment
from experiments.noise import NOISE_METHODS, noise_experiment
from experiments.reconstruct import reconstruct_experiment
from experiments.runner import PICTURES, Experiment, finished, run_experiment
from experiments.simulated import METHODS, shadow_colour
from experiments.solvers import get_solver
from experiments.spot import spot_experiment
from experiments.subjects import STRENGTH
from liaam import __version__
from liaam.errors import LiaamError
from liaam.io import make_folder, write_text_atomically
from liaam.progress import Progress


@dataclass(frozen=True)
class Size:
    """Size of a run: swept values, numbers of draws, of starts per person and of images of each kind to reconstruct."""

    trials: int
    variant_trials: int
    spot_trials: int
    pictures: int
    gammas: tuple[float, ...]
    sigmas: tuple[float, ...]


SIZES = {
    "quick": Size(6, 6, 1, 4, (0.0, 4.0, 16.0), (0.0, 2.0, 5.0, 10.0)),
    "full": Size(60, 24, 10, 16, (0.0, 2.0, 4.0, 8.0, 12.0, 16.0), (0.0, 2.0, 5.0, 10.0, 15.0, 20.0)),
}
"""Sizes by name."""


@dataclass(frozen=True)
class Variant:
    """Another value for one choice that the paper leaves open: its subfolder, its description, solver and shadow."""

    folder: str
    what: str
    solver: str = "paper"
    strength: float = STRENGTH

    @property
    def summary(self) -> str:
        """Describe the difference in a sentence."""
        if self.strength != STRENGTH:
            return f"as the first columns, but full shadow leaves {shadow_colour(self.strength)} of the light"
        return get_solver(self.solver).summary


VARIANTS = (
    Variant("liaam", "liaam's own solver", "liaam"),
    Variant("paper-90", "modes of 90 % of the variance", "paper-90"),
    Variant("paper-100px", "reference frame of 100 px", "paper-100px"),
    Variant("paper-theta1", "θ2 starts at θ1", "paper-theta1"),
    Variant("mild-shadow", "milder shadow", strength=-1.2),
)

VARIANCE_READING = "γ and σn read as variances"


@dataclass(frozen=True, eq=False)
class Part:
    """One experiment of a run, its subfolder, its heading in the report and its column of the claims table.

    The report has a section for it if it is ``shown``.
    """

    folder: str
    heading: str
    column: str
    experiment: Experiment
    shown: bool = True


def plan(person: Path | None, persons: Path | None, size: str, seed: int) -> list[Part]:
    """Return all parts in the order of execution; the parameters are those of :func:`reproduce`."""
    if size not in SIZES:
        raise LiaamError(f"unknown size {size!r}; choose from {', '.join(SIZES)}")
    amount = SIZES[size]
    parts = [*_main_parts("scenes", "generated scenes", None, amount, seed)]
    if person is not None:
        parts += _main_parts("person", person.resolve().name, person, amount, seed)
    if persons is not None:
        parts += _spot_parts(persons, amount, seed)
    for variant in VARIANTS:
        parts += _variant_parts(variant, person, amount, seed)
    return parts


def _main_parts(folder: str, name: str, data: Path | None, size: Size, seed: int) -> list[Part]:
    made = {
        "displacement": displacement_experiment(data, METHODS, size.trials, seed, gammas=size.gammas),
        "noise": noise_experiment(data, NOISE_METHODS, size.trials, seed, sigmas=size.sigmas),
        "bound": bound_experiment(data, size.trials, seed),
        "convergence": convergence_experiment(data, METHODS, size.trials, seed),
        "baselines": baselines_experiment(data, size.trials, seed),
        "reconstruct": reconstruct_experiment(data, trials=size.pictures, seed=seed),
    }
    return [Part(f"{folder}/{key}", f"{made[key].title} ({name})", name, made[key]) for key in made]


def _spot_parts(persons: Path, size: Size, seed: int) -> list[Part]:
    name = f"{persons.resolve().name}, real spot light"
    made = {
        "spot": spot_experiment(persons, trials=size.spot_trials, seed=seed),
        "convergence": convergence_experiment(persons, METHODS, size.spot_trials, seed),
        "reconstruct": reconstruct_experiment(persons, ("li",), size.pictures, seed),
    }
    return [Part(f"persons/{key}", f"{made[key].title} ({name})", name, made[key]) for key in made]


def _variant_parts(variant: Variant, data: Path | None, size: Size, seed: int) -> list[Part]:
    common = (data, METHODS, size.variant_trials, seed, variant.solver)
    made = {
        "displacement": displacement_experiment(*common, size.gammas, variant.strength),
        "noise": noise_experiment(*common, size.sigmas, variant.strength),
    }
    return [
        Part(f"variants/{variant.folder}/{key}", f"{one.title}: {variant.what}", variant.what, one, shown=False)
        for key, one in made.items()
    ]


def reproduce(
    out: Path,
    person: Path | None = None,
    persons: Path | None = None,
    size: str = "full",
    seed: int = 0,
    jobs: int | None = 1,
    progress: Progress | None = None,
) -> dict[str, dict[str, Verdict]]:
    """Run all experiments in subfolders of ``out`` and write ``report.html``; finished experiments are not repeated.

    Generated scenes are always used. ``person`` is a folder of one person's landmarked images under homogeneous light,
    ``persons`` one of many persons, as in the spot protocol, and ``size`` one of :data:`SIZES`. Returns verdicts by
    column of the claims table and name of the claim.
    """
    parts = plan(person, persons, size, seed)
    make_folder(out)
    total = sum(len(part.experiment.tasks) for part in parts)
    before, columns = 0, {}
    for part in parts:
        summary = finished(part.experiment, out / part.folder)
        if summary is None:
            summary = run_experiment(part.experiment, out / part.folder, jobs, _share(progress, before, total, part))
        columns.setdefault(part.column, {})[part.experiment.name] = summary
        before += len(part.experiment.tasks)
    _add_variance_reading(columns, "generated scenes" if person is None else person.resolve().name)
    verdicts = {
        column: {claim.name: verdict for claim in CLAIMS if (verdict := claim.of(found)) is not None}
        for column, found in columns.items()
    }
    write_text_atomically(out / "report.html", report_html(out, parts, verdicts, size))
    return verdicts


def _share(progress: Progress | None, before: int, total: int, part: Part) -> Progress | None:
    """Convert the progress of one part to that of the run."""
    if progress is None:
        return None
    return lambda done, _total, what: progress(before + done, total, f"{part.folder}: {what}")


def _add_variance_reading(columns: dict[str, dict[str, Any]], main: str) -> None:
    """Add the column in which a swept 16 means a standard deviation of 4: the lower part of the swept range."""
    found = columns[main]
    largest = {name: max(_values(found[name])) ** 0.5 for name in ("displacement", "noise")}
    columns[VARIANCE_READING] = {name: up_to(found[name], max(limit, 2.0)) for name, limit in largest.items()}


def _values(summary: Mapping[str, Any]) -> list[float]:
    return [cell[summary["swept"]] for cell in next(iter(summary["methods"].values()))]


STYLE = """
:root { color-scheme: light dark; --line: #8884; --yes: #1b8a5a; --no: #c0392b; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 78rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .9rem; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid var(--line); padding: .35rem .7rem; text-align: left; vertical-align: top; }
img { max-width: 100%; height: auto; background: white; border-radius: 4px; }
.yes { color: var(--yes); font-weight: 600; } .no { color: var(--no); font-weight: 600; }
td:first-child { min-width: 14rem; } small { opacity: .75; } nav ul { columns: 2; font-size: .9rem; }
"""


def report_html(out: Path, parts: Sequence[Part], verdicts: Mapping[str, Mapping[str, Verdict]], size: str) -> str:
    """Return the report as one page: the claims, then each experiment with its figure."""
    shown = [part for part in parts if part.shown]
    links = "".join(f'<li><a href="#{_anchor(part)}">{html.escape(part.heading)}</a></li>' for part in shown)
    body = "".join(_section(out, part) for part in shown)
    return (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'><title>Light-invariant fitting of AAMs</title>"
        f"<style>{STYLE}</style></head><body>"
        "<h1>Light-invariant fitting of active appearance models: the experiments</h1>"
        "<p>Experiments after section 7 of D. Pizarro, J. Peyras and A. Bartoli, <i>Light-Invariant Fitting of Active "
        f"Appearance Models</i>, CVPR 2008, run by liaam {__version__} at size <i>{html.escape(size)}</i>. Every "
        "number comes from the fits in the <code>results.csv</code> files beside this page.</p>"
        f"<h2>Claims</h2>{claims_table(verdicts)}{_about_columns()}<h2>Experiments</h2><nav><ul>{links}</ul></nav>{body}"
        "</body></html>\n"
    )


def claims_table(verdicts: Mapping[str, Mapping[str, Verdict]]) -> str:
    """Return a table with claims as rows, and data and choices as columns."""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in verdicts)
    rows = "".join(
        f"<tr><td>{html.escape(claim.text)}<br><small>{html.escape(claim.criterion)}</small></td>"
        + "".join(_verdict_cell(found.get(claim.name)) for found in verdicts.values())
        + "</tr>"
        for claim in CLAIMS
    )
    return f"<table><thead><tr><th>claim and criterion</th>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _verdict_cell(verdict: Verdict | None) -> str:
    if verdict is None:
        return "<td>–</td>"
    kind, word = ("yes", "holds") if verdict.holds else ("no", "does not hold")
    return f"<td><span class='{kind}'>{word}</span><br><small>{html.escape(verdict.evidence)}</small></td>"


def _about_columns() -> str:
    choices = "".join(
        f"<li><b>{html.escape(variant.what)}</b>: {html.escape(variant.summary)}.</li>" for variant in VARIANTS
    )
    return (
        f"<p>The first columns use the paper's solver ({html.escape(get_solver('paper').summary)}). The others change "
        "one choice that the paper leaves open, to show whether a claim depends on it:</p>"
        f"<ul>{choices}<li><b>{html.escape(VARIANCE_READING)}</b>: the same fits, of the swept values only those up "
        "to the root of the largest.</li></ul>"
    )


def _anchor(part: Part) -> str:
    return part.folder.replace("/", "-")


def _section(out: Path, part: Part) -> str:
    """Return the section of one experiment with its embedded figure."""
    from markdown_it import MarkdownIt

    folder = out / part.folder
    text = (folder / "report.md").read_text(encoding="utf-8")
    page = MarkdownIt("commonmark").enable("table").render(text.partition("\n")[2])
    for name in ("figure.png", PICTURES):
        if f'src="{name}"' in page:
            data = base64.b64encode((folder / name).read_bytes()).decode()
            page = page.replace(f'src="{name}"', f'src="data:image/png;base64,{data}"')
    page = page.replace("<h2>", "<h4>").replace("</h2>", "</h4>")
    return f"<section id='{_anchor(part)}'><h3>{html.escape(part.heading)}</h3>{page}</section>"
