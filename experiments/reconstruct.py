"""What would the object look like without the shadow? (Paper section 6, eq 11, and Fig 4.)

There are three kinds of data, as in :mod:`experiments.convergence`: generated scenes, rendered also under the training
light; one person's images with and without a simulated shadow; and persons under a real spot light, without truth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments import simulated, spot
from experiments.measures import or_dash
from experiments.protocol import Split
from experiments.runner import Experiment, Row, Trial, markdown_table
from experiments.solvers import Request, get_solver, make_fitters
from experiments.subjects import SCENE_HEAD, get_subject, subject_facts
from liaam.error_measures import error_statistics, point_error, root_mean_square
from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter, get_method
from liaam.model import AAM
from liaam.photometry import CameraModel
from liaam.plotting import figure_of_pictures
from liaam.relighting import shadow_free, without_shading
from liaam.training import sample_appearance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("li", "li+noise")

N_TRAINING = 24
"""Number of generated training images."""

GAMMA = 4.0

EXPOSURE = 0.75
"""Exposure, fixed so that the appearance under the training light has one level."""

CAMERAS = ("narrow", "broad")
"""Cameras of the generated images: the paper's ideal camera (line sensors, one colour temperature per pixel), and one
with broad sensors, noise, 8 bits and mixed lights."""

SHOWN = 3
"""Number of images in the figure."""

SHADING_RANGE = 2.0
"""Range from black to white in the figure's shading, in natural logarithms."""

CHOICES = (
    "The appearance's coordinates are the most likely ones under the fit's residual and the prior of training; errors "
    "are of the natural logarithm of linear light, root mean square over the pixels inside the mesh and the "
    "channels, in the model's reference frame: fitted against true shape.",
    "Scenes: expressions and poses that training has not seen, hard light from either side with cast shadows; the "
    "truth is the same head rendered under the training light. `model` is the error of the truth projected on the "
    "model, about the best that a fit can do.",
)


@dataclass(frozen=True, eq=False)
class Case:
    """An image whose shading is to be removed, and if known the same image under the training light.

    ``start`` and ``shape`` (n, 2) are the start of the fit and the true landmarks.
    """

    name: str
    image: np.ndarray
    start: np.ndarray
    shape: np.ndarray
    canonical: np.ndarray | None


def get_case(setup: Request, task: Any) -> tuple[Mapping[str, Fitter], Case]:
    """Fitters and image of a task."""
    if isinstance(task, Split):
        study = spot.study_of(task, setup)
        return study.fitters, Case(task.key, study.image, study.start(setup.seed, 0), study.truth, None)
    if task.condition == "shadow":
        case = simulated.make_case(get_subject(setup.data), setup.seed, task.number, GAMMA, sigma_n=0.0)
        fitters = simulated.get_fitters(setup.data, setup.methods, setup.solver)
        canonical = get_subject(setup.data).images[case.picture]
        return fitters, Case(f"picture {case.picture + 1}", case.image, case.start, case.truth, canonical)
    fitters = _scene_fitters(task.condition, setup.methods, setup.solver)
    return fitters, _scene_case(task.condition, setup.seed, task.number)


def _camera(kind: str):
    from scenes import Camera, narrow_band_camera

    if kind == "broad":
        return Camera(exposure=EXPOSURE), "additive"
    return replace(narrow_band_camera(response="srgb"), exposure=EXPOSURE), "planckian"


@lru_cache(maxsize=2)
def _scene_fitters(kind: str, methods: tuple[str, ...], solver: str) -> dict[str, Fitter]:
    from scenes import Head, make_set

    camera, mixing = _camera(kind)
    scenes = make_set(N_TRAINING, Head(SCENE_HEAD), camera=camera, mixing=mixing)
    pairs = [(scene.image, scene.landmarks) for scene in scenes]
    model = get_solver(solver).train(pairs, camera=CameraModel(theta=scenes[0].theta), name="generated head")
    return make_fitters(model, methods, solver)


def _scene_case(kind: str, seed: int, number: int) -> Case:
    from scenes import DIFFUSE, Head, lateral, random_expression, random_pose, render

    camera, mixing = _camera(kind)
    rng = np.random.default_rng([seed, number, 4])
    pose, expression = random_pose(rng), random_expression(rng)
    lit, canonical = (
        render(Head(SCENE_HEAD), pose, expression, lights, camera, seed=number, mixing=mixing)
        for lights in (lateral("left" if number % 2 else "right"), DIFFUSE)
    )
    start = simulated.displaced(lit.landmarks, GAMMA, seed, number)
    return Case(f"{kind}-band camera", lit.image, start, lit.landmarks, canonical.image)


def run_trial(setup: Request, task: Any) -> list[Row]:
    """Fit, reconstruct the appearance, and measure its error if the truth is known."""
    fitters, case = get_case(setup, task)
    rows = []
    for method, fitter in fitters.items():
        result = fitter.fit(case.image, case.start)
        rows.append(
            {
                "kind": getattr(task, "condition", "spot"),
                "method": method,
                "picture": case.name,
                "trial": getattr(task, "number", 0),
                "error_px": point_error(result.landmarks, case.shape),
                **_errors(fitter, case, result),
                "status": str(result.status),
            }
        )
    return rows


def _errors(fitter: Fitter, case: Case, result: FitResult) -> dict[str, float]:
    """Errors of log light of the input, of the reconstruction, and of the truth projected on the model."""
    if case.canonical is None:
        return {"input_rms": np.nan, "rebuilt_rms": np.nan, "model_rms": np.nan}
    model, appearance = fitter.model, fitter.model.levels[-1].appearances["log"]
    truth, known = texture_of(model, case.canonical, case.shape)
    lit, seen = texture_of(model, case.image, case.shape)
    rebuilt = shadow_free(fitter, case.image, result).log_rgb
    nearest = appearance.texture(np.tensordot(appearance.modes, truth - appearance.mean, axes=([1, 2], [0, 1])))
    return {
        "input_rms": _rms(lit - truth, known * seen),
        "rebuilt_rms": _rms(rebuilt - truth, known),
        "model_rms": _rms(nearest - truth, known),
    }


def texture_of(model: AAM, image: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log values (n_pixels, 3) of an image under a shape, blurred as the model is, and mask of usable pixels."""
    return sample_appearance(image, shape, model.warp, "log", model.response, model.levels[-1].blur)


def _rms(errors: np.ndarray, usable: np.ndarray) -> float:
    return root_mean_square(errors[usable > 0])


def reconstruct_experiment(
    data: Path | None = None,
    methods: Sequence[str] = METHODS,
    trials: int = 8,
    seed: int = 0,
    solver: str = "liaam",
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    for method in methods:
        if get_method(method).appearance != "log":
            raise MethodError(
                f"method {method} does not fit log-RGB, so it rebuilds nothing; give li, li-pc, li-pcs or chroma"
            )
    setup = Request(data, tuple(methods), trials, seed, solver)
    facts, tasks, left_out = _plan(data, trials)
    return Experiment(
        name="reconstruct",
        title="The object without its shadows",
        settings={
            **facts,
            "gamma": GAMMA,
            **setup.settings(),
        },
        tasks=tasks,
        work=partial(run_trial, setup),
        summarise=partial(summarise, setup.methods),
        draw=partial(draw, setup, tasks),
        report=report,
        choices=CHOICES,
        left_out=left_out,
    )


def _plan(data: Path | None, trials: int) -> tuple[dict[str, Any], tuple, tuple[str, ...]]:
    if data is None:
        facts = {**subject_facts(None), "pictures": N_TRAINING}
        return facts, tuple(Trial(kind, number) for kind in CAMERAS for number in range(trials)), ()
    persons, left_out = spot.group_persons(data)
    if persons:
        return spot.facts_of(data, persons), persons[:trials], left_out
    return subject_facts(data), tuple(Trial("shadow", number) for number in range(trials)), ()


QUANTITIES = ("error_px", "input_rms", "rebuilt_rms", "model_rms")


def summarise(methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Statistics by kind of image and method."""
    found: dict[str, Any] = {}
    for kind in dict.fromkeys(row["kind"] for row in rows):
        found[kind] = {
            method: {
                quantity: error_statistics(np.array([r[quantity] for r in rows if _is(r, kind, method)]))
                for quantity in QUANTITIES
            }
            for method in methods
        }
    return {"kinds": found}


def _is(row: Row, kind: str, method: str) -> bool:
    return (row["kind"], row["method"]) == (kind, method)


def draw(setup: Request, tasks: Sequence[Any], _rows: list[Row], _summary: dict[str, Any]) -> "Figure":
    """Draw the input, the reconstruction by the first method, the truth if known, and the shading."""
    shown = [tasks[i] for i in np.unique(np.linspace(0, len(tasks) - 1, SHOWN).astype(int))]
    return figure_of_pictures([_pictures(setup, task) for task in shown])


def _pictures(setup: Request, task: Any) -> dict[str, np.ndarray | None]:
    fitters, case = get_case(setup, task)
    method, fitter = next(iter(fitters.items()))
    result = fitter.fit(case.image, case.start)
    appearance = shadow_free(fitter, case.image, result)
    picture, shading = without_shading(case.image, result.landmarks, fitter.model, appearance, fitter.model.response)
    grey = np.clip(0.5 + shading.mean(axis=2) / (2 * SHADING_RANGE), 0, 1)
    return {
        f"{case.name}: input": case.image,
        f"without shading ({method})": picture,
        "truth": case.canonical,
        "shading taken off (log)": np.where(shading.any(axis=2), grey, 1.0),
    }


def report(summary: dict[str, Any]) -> str:
    """Errors of log light by kind of image and method."""
    header = ["pictures", "method", "landmarks, px", "input", "rebuilt", "model"]
    rows = [
        [kind, method, *(or_dash(cell[quantity]["median"]) for quantity in QUANTITIES)]
        for kind, methods in summary["kinds"].items()
        for method, cell in methods.items()
    ]
    return (
        "How near is the rebuilt appearance to what the object looks like under the light of training? (Paper eq 11 "
        f"and Fig 4.)\n\nMedian errors of log light, by picture and method:\n\n{markdown_table(header, rows)}"
    )
