"""Make the documentation's figures: ``python -m docs.figures.make_figures``. Needs no data.

All show generated scenes. They are the figures that commands write, made by the same code: ``demo.png`` by ``liaam
demo``, ``shadow.png`` and ``noise.png`` by ``python -m experiments noise``, ``reconstruct.png`` by
``python -m experiments reconstruct``, ``calibration.png`` by ``liaam camera scene``; the experiments take a few
trials only.
"""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

from experiments.noise import noise_experiment
from experiments.reconstruct import reconstruct_experiment
from experiments.runner import run_experiment
from liaam.calibration import theta_from_scene
from liaam.datasets import Sample
from liaam.demo import run_demo
from liaam.io import Landmarks
from liaam.photometry import CameraModel, invariant_image
from liaam.plotting import figure_of_lamps, save_figure
from liaam.plotting.photometry import figure_of_invariants
from liaam.training import learn_lamps
from scenes import (
    DIFFUSE,
    Camera,
    Head,
    Pose,
    lateral,
    photograph,
    poster,
    render,
    uneven_light,
)

HERE = Path(__file__).parent

TRIALS = 6
METHODS = ("grey", "rgb", "li", "li-pcs", "li+noise")
PICTURES = 1


def main() -> None:
    """Write every figure beside this script."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_demo(folder / "demo")
        run_experiment(noise_experiment(methods=METHODS, trials=TRIALS), folder / "noise")
        run_experiment(reconstruct_experiment(methods=("li",), trials=PICTURES), folder / "reconstruct")
        draw_calibration(folder / "calibration.png")
        draw_lamps(HERE / "lamps.png")
        keep(folder / "calibration.png", "calibration.png")
        keep(folder / "demo" / "figure.png", "demo.png")
        keep(folder / "noise" / "pictures.png", "shadow.png")
        keep(folder / "noise" / "figure.png", "noise.png")
        keep(folder / "reconstruct" / "figure.png", "reconstruct.png")


def draw_calibration(path: Path) -> None:
    """One poster under two lights, and its invariant images at the angle that the two tell."""
    size, names = (240, 320), ("lamp.png", "window.png")
    sheet, lights = poster(size, 5), [uneven_light(size, 3, lamp_K=3200), uneven_light(size, 8, lamp_K=5800)]
    pictures = [photograph(sheet, light, Camera(), seed=i) for i, light in enumerate(lights)]
    camera = CameraModel(theta=theta_from_scene(pictures).theta)
    rows = {name: (picture, invariant_image(picture, camera)) for name, picture in zip(names, pictures, strict=True)}
    save_figure(figure_of_invariants(rows), path, dpi=90)


def draw_lamps(path: Path) -> None:
    """A head under the lamps of two others."""
    lights = {"day": DIFFUSE, "left": lateral("left"), "right": lateral("right")}

    def photographed(head: int, pose: Pose) -> list[Sample]:
        scenes = {name: render(Head(head), pose, lights=light, size=(200, 160)) for name, light in lights.items()}
        return [Sample(f"{head}-{name}", scene.image, Landmarks(scene.landmarks)) for name, scene in scenes.items()]

    lamps = learn_lamps([*photographed(1, Pose()), *photographed(2, Pose(yaw=0.1))], "day")
    other = photographed(5, Pose(yaw=-0.15))[0]
    save_figure(figure_of_lamps(lamps, other.read_image(), other.landmarks.points), path, dpi=110)


def keep(figure: Path, name: str) -> None:
    """Copy a figure to beside this script."""
    shutil.copyfile(figure, HERE / name)
    print(f"written to {HERE / name}")


if __name__ == "__main__":
    main()
