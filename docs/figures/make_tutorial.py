"""Make the pictures of the tutorial: ``python -m docs.figures.make_tutorial``. Works as its commands, in a minute."""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

from PIL import Image

import liaam
from liaam.datasets.heads import FACE, HARD_LIGHT, SOFT_LIGHT
from liaam.fitting import Fitter
from liaam.plotting import figure_of_model, overlay_of_fit, save_figure

HERE = Path(__file__).parent


def main() -> None:
    """Write the pictures beside this script."""
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(shutil.copytree(SOFT_LIGHT, Path(folder_name) / "faces"))
        model = liaam.train(liaam.load_folder(folder), name="heads")
        save_figure(figure_of_model(model), Path(folder_name) / "model.png", dpi=100)
        save("tutorial-model", [Image.open(Path(folder_name) / "model.png").convert("RGB")])
        fitter = Fitter(model)
        for name, path in (("tutorial-fit", HARD_LIGHT / "head-3.jpg"), ("tutorial-photo", FACE / "lisa.jpg")):
            image = liaam.read_image(path)
            shown = [image, overlay_of_fit(image, fitter.fit(path), model)]
            if path.parent == HARD_LIGHT:  # six generated heads do not say how skin looks in a dark photograph
                shown.append(liaam.relight(model, path))
            save(name, [Image.fromarray(each) for each in shown])


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
