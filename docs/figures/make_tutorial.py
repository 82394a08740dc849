"""Make the pictures of the tutorial: ``python -m docs.figures.make_tutorial``. Runs its commands, for half a minute."""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

from PIL import Image

import liaam
from liaam.datasets.heads import HARD_LIGHT, SOFT_LIGHT
from liaam.fitting import Fitter
from liaam.plotting import figure_of_model, overlay_of_fit, save_figure

HERE = Path(__file__).parent


def main() -> None:
    """Write the pictures beside this script."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(shutil.copytree(SOFT_LIGHT, Path(name) / "faces"))
        new = HARD_LIGHT / "head-3.jpg"
        model = liaam.train(liaam.load_folder(folder), name="heads")
        save_figure(figure_of_model(model), Path(name) / "model.png", dpi=100)
        save("tutorial-model", [Image.open(Path(name) / "model.png").convert("RGB")])
        result = Fitter(model).fit(new)
        image = liaam.read_image(new)
        fitted = overlay_of_fit(image, result, model)
        save("tutorial-fit", [Image.fromarray(each) for each in (image, fitted, liaam.relight(model, new))])


def save(name: str, images: list[Image.Image]) -> None:
    """Write images beside each other."""
    height = min(image.height for image in images)
    scaled = [image.resize((round(image.width * height / image.height), height)) for image in images]
    whole = Image.new("RGB", (sum(image.width for image in scaled), height))
    for i, image in enumerate(scaled):
        whole.paste(image, (sum(each.width for each in scaled[:i]), 0))
    whole.save(HERE / f"{name}.webp", quality=85, method=6)


if __name__ == "__main__":
    main()
