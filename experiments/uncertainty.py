"""Do the confidence ellipses contain the truth, and does the quality separate right fits from wrong ones?

The default method fits from starts near the object and from starts too far away. It fits generated heads at three noise
levels, under the training light and under a hard light from the side. Given a folder of persons, it also fits real
faces: the spot-lit image and left-out diffuse images with a person's model, and unseen persons.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import Panel, figure_of_curves
from experiments.measures import or_dash, percent
from experiments.protocol import (
    CONVERGED,
    STARTS,
    VARIANCE,
    Header,
    Split,
    Table,
    disturbed_start,
    eight_bit,
    face_size,
    held,
    is_right,
    qualities_of,
    quality_area,
    select,
    tell,
)
from experiments.runner import Experiment, Named, Row
from experiments.solvers import Request, get_solver
from experiments.spot import facts_of, find_persons
from liaam.datasets import Sample
from liaam.error_measures import nme
from liaam.fitting import Fitter
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.formatting import finite_or_none
from liaam.model import AAM
from liaam.model.shape import rotation, shifted_into

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVELS = (50, 80, 95, 99)
"""Confidence levels of the ellipses in per cent."""

TOLD = (80, 95)
"""Confidence levels in the table. The figure has all."""

NOISES = (2.0, 5.0, 10.0)
"""Standard deviation of the noise of generated images, of 255."""

PICTURES = 24
"""Number of generated training images of a head, and of test images."""

LEFT_OUT = (0, 2, 4)
"""Indices of the diffuse images of a person, of five, that are left out in turn."""

STARTED = ("near", "far")

CHOICES = (
    f"Right is a fit whose error is below {CONVERGED:.0%} of the inter-ocular distance. Ellipses are those of right "
    "fits from near starts; the quality has to tell right from wrong among all fits; where it is not known it counts "
    "as 0.",
    STARTS,
    "Far starts: the same start turned by 40 to 75°, scaled by 0.5 to 1.6 and moved by N(0, 0.7 IOD) per axis; "
    "what leaves the picture is shifted back into it.",
    f"Generated: heads of {PICTURES} pictures without noise under frontal light to train on and {PICTURES} others to "
    "fit, every other one under a hard light from the side; far starts are those of the middle noise.",
    f"Real: pictures {', '.join(str(i + 1) for i in LEFT_OUT)} of a person are left out of that person's model in "
    "turn; the spot-lit picture is fitted by the model of all five; every other person makes a model of strangers, "
    "fitted to the others' spot-lit and diffuse pictures.",
    f"Models keep {VARIANCE:.0%} of the variance of shape and of appearance.",
)


@dataclass(frozen=True, eq=False)
class Picture:
    """An image to fit, with its landmarks, light and starts, and the standard deviation of added noise, of 255."""

    name: str
    image: np.ndarray
    truth: np.ndarray
    light: str
    noise: float = 0.0
    starts: tuple[str, ...] = STARTED


def generated(request: Request, name: str) -> Iterator[tuple[AAM, list[Picture]]]:
    """Yield a head's model and its images at all noise levels."""
    from scenes import DIFFUSE, Camera, Head, lateral, make_set, random_expression, random_pose, render

    rng, camera = request.rng("head", name), Camera().noiseless("srgb")
    head = Head(int(rng.integers(1, 1_000_000)))
    taken = make_set(PICTURES, head, DIFFUSE, camera, seed=int(rng.integers(1_000_000)))
    model = trained(request, [(scene.image, scene.landmarks) for scene in taken], f"head {name}")
    pictures = []
    for i in range(PICTURES):
        light, lights = ("training", DIFFUSE) if i % 2 else ("side", lateral("left" if i % 4 else "right"))
        scene = render(head, random_pose(rng), random_expression(rng), lights, camera)
        for noise in NOISES:
            image = np.clip(scene.image + noise / 255 * rng.standard_normal(scene.image.shape), 0, 1).astype(np.float32)
            starts = STARTED if noise == NOISES[1] else STARTED[:1]
            pictures.append(Picture(f"{i}", image, scene.landmarks, light, noise, starts))
    yield model, pictures


def spot_lit(request: Request, name: str) -> Iterator[tuple[AAM, list[Picture]]]:
    """Yield the model of a person's diffuse images, and the spot-lit image."""
    person = get_person(request.data, name)
    yield trained(request, person.training, person.key), [_real(person.tested[0], "spot")]


def left_out(request: Request, name: str) -> Iterator[tuple[AAM, list[Picture]]]:
    """Yield a person's models of all diffuse images but one, and that image."""
    person = get_person(request.data, name)
    for out in LEFT_OUT:
        others = [sample for i, sample in enumerate(person.training) if i != out]
        yield trained(request, others, person.key), [_real(person.training[out], "training")]


def strangers(request: Request, name: str) -> Iterator[tuple[AAM, list[Picture]]]:
    """Yield the model of every second person, and the images of a person not among them."""
    person = get_person(request.data, name)
    pictures = [_real(person.tested[0], "spot"), *(_real(sample, "training") for sample in person.training[::2])]
    yield get_half(request, get_persons(request.data).index(person) % 2), pictures


MAKERS: dict[str, Callable[[Request, str], Iterator[tuple[AAM, list[Picture]]]]] = {
    "generated": generated,
    "left out": left_out,
    "spot": spot_lit,
    "strangers": strangers,
}
GROUPS = tuple(MAKERS)


def _real(sample: Sample, light: str) -> Picture:
    return Picture(sample.name, eight_bit(sample), sample.landmarks.points, light)


@lru_cache(maxsize=1)
def get_persons(folder: Path | None) -> tuple[Split, ...]:
    """Find a folder's persons; once per process."""
    return find_persons(folder or Path())[0]


def get_person(folder: Path | None, name: str) -> Split:
    """Get a person by name."""
    return next(person for person in get_persons(folder) if person.name == name)


@lru_cache(maxsize=1)
def get_half(request: Request, without: int) -> AAM:
    """Train on every second person; once per process, since neighbouring tasks share the model."""
    others = [person for i, person in enumerate(get_persons(request.data)) if i % 2 != without]
    return trained(request, [sample for person in others for sample in person.training], f"without {without}")


def trained(request: Request, data: Sequence, name: str) -> AAM:
    """Train a model with calibrated quality of fits."""
    return get_solver(request.solver).train(data, variance=VARIANCE, leave_out=True, name=name)


def lost(start: np.ndarray, unit: float, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Move a start too far for any fit to succeed, but within an image of size (width, height), (n, 2) float64."""
    centre, turn = start.mean(axis=0), rng.uniform(0.7, 1.3) * rng.choice([-1, 1])
    moved = rng.uniform(0.5, 1.6) * (start - centre) @ rotation(turn).T + centre + rng.normal(0.0, 0.7 * unit, 2)
    return shifted_into(moved, size)


def fit_subject(request: Request, subject: Named) -> list[Row]:
    """Fit all images of a subject from near and far."""
    rows = []
    for model, pictures in MAKERS[subject.group](request, subject.name):
        fitter = Fitter(model, DEFAULT_METHOD, get_solver(request.solver).options)
        rows += [
            {"group": subject.group, "subject": subject.name, **row}
            for picture in pictures
            for row in fit_picture(request, fitter, picture)
        ]
    return rows


def fit_picture(request: Request, fitter: Fitter, picture: Picture) -> Iterator[Row]:
    """Fit an image from each of its starts.

    ``held_L`` is the fraction of the landmarks inside their L % ellipse, ``deviation`` the root mean square of the
    reported standard deviations. It and ``nme`` are divided by the face's size.
    """
    unit, rng = face_size(picture.truth), request.rng(fitter.model.name, picture.name, "start")
    near = disturbed_start(fitter.model.shape_model.mean, picture.truth, unit, rng)
    size = (picture.image.shape[1], picture.image.shape[0])
    for start in picture.starts:
        result = fitter.fit(picture.image, near if start == "near" else lost(near, unit, size, rng))
        yield {
            "picture": picture.name,
            "light": picture.light,
            "noise": picture.noise,
            "start": start,
            "nme": nme(result.landmarks, picture.truth, unit),
            **{f"held_{level}": held(result, picture.truth, level) for level in LEVELS},
            "deviation": float(np.sqrt(np.mean(np.square(result.sd)))) / unit,
            "quality": result.quality,
            "status": str(result.status),
        }


def uncertainty_experiment(
    data: Path | None = None, heads: int = 4, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data or Path(), (DEFAULT_METHOD,), heads, seed, solver)
    persons, missing = find_persons(data) if data else ((), ())
    subjects = [Named("generated", str(i)) for i in range(heads)]
    subjects += [Named(group, person.name) for group in ("left out", "spot") for person in persons]
    halves = [*persons[0::2], *persons[1::2]] if len(persons) > 2 else []
    subjects += [Named("strangers", person.name) for person in halves]
    facts = facts_of(data, persons) if data else {}
    return Experiment(
        name="uncertainty",
        title="Do the ellipses hold the truth, and does the quality tell right fits from wrong ones?",
        settings={**facts, "heads": heads, "seed": seed, "solver": request.settings()["solver"]},
        tasks=tuple(subjects),
        work=partial(fit_subject, request),
        summarise=summarise,
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=missing,
        skips_faults=True,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Coverage and area under the ROC curve by group, and for generated heads by noise and by light."""
    groups = {group: select(rows, group=group) for group in GROUPS}
    for noise in NOISES:
        groups[f"generated, noise {noise:g}"] = select(groups["generated"], noise=noise)
    for light in ("training", "side"):
        groups[f"generated, {light} light"] = select(groups["generated"], light=light)
    groups["all"] = rows
    return {"groups": {name: _cell(own) for name, own in groups.items() if own}}


def _cell(rows: Sequence[Row]) -> dict[str, Any]:
    near = [row for row in rows if row["start"] == "near"]
    right = [row for row in near if is_right(row)]

    def mean(name: str, own: Sequence[Row]) -> float | None:
        return finite_or_none(float(np.mean([row[name] for row in own]))) if own else None

    return {
        "fits": len(rows),
        "near": len(near),
        "right": sum(map(is_right, rows)),
        "nme_median": finite_or_none(float(np.median([row["nme"] for row in near]))) if near else None,
        "deviation": mean("deviation", right),
        **{f"held_{level}": mean(f"held_{level}", right) for level in LEVELS},
        "roc_area": quality_area(rows),
    }


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Coverage and ROC by group."""
    header = ["group", "fits", "right", "error, %", "stated, %", *(f"in {level} %" for level in TOLD), "ROC"]
    return header, [
        [
            name,
            str(cell["fits"]),
            str(cell["right"]),
            percent(cell["nme_median"]),
            percent(cell["deviation"]),
            *(percent(cell[f"held_{level}"], 1) for level in TOLD),
            or_dash(cell["roc_area"], ".3f"),
        ]
        for name, cell in summary["groups"].items()
    ]


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Draw observed against nominal coverage, and the ROC curve of the quality."""
    own = [group for group in GROUPS if group in summary["groups"]]
    shares = {group: _held(summary["groups"][group]) for group in own}
    passed = {group: _roc(*qualities_of(select(rows, group=group))) for group in own}
    return figure_of_curves(
        [
            Panel("ellipse drawn for, %", "landmarks in it, %", shares, {"as stated": [(x, x) for x in LEVELS]}),
            Panel("wrong fits let pass, %", "right fits kept, %", passed),
        ]
    )


def _held(cell: dict[str, Any]) -> list[tuple[float, float | None]]:
    """Observed coverage by level, in per cent."""
    return [(level, None if cell[f"held_{level}"] is None else 100 * cell[f"held_{level}"]) for level in LEVELS]


def _roc(right: np.ndarray, wrong: np.ndarray) -> list[tuple[float, float | None]]:
    """Fractions (wrong, right) of fits, in per cent, with at least each quality, from high to low."""
    if not len(right) or not len(wrong):
        return []
    limits = np.unique(np.concatenate([right, wrong, [np.inf]]))[::-1]
    return [(100 * float(np.mean(wrong >= limit)), 100 * float(np.mean(right >= limit))) for limit in limits]


def report(summary: dict[str, Any]) -> str:
    """Format the question and the results."""
    question = (
        "Do the ellipses that a fit states of its landmarks hold the true ones, and does its quality tell whether it "
        "is right? Error: median of the fits from near; stated: the landmarks' standard deviation, root mean square; "
        "both by inter-ocular distance. Then the share of the landmarks in their ellipses, of right fits from near, "
        "and the area under the ROC curve of the quality, of all fits."
    )
    return tell(question, table(summary))
