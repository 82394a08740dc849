"""Make the studio's images: ``python -m docs.figures.make_studio_figures``, from the root of the checkout.

Needs what the studio's benchmark needs: Playwright and a Chromium. The portraits are generated.
"""

import sys
import tempfile
from pathlib import Path

from benchmarks.studio import browsing, material, served
from liaam.io import Contour, Landmarks, write_image, write_landmarks
from scenes import DIFFUSE, Head, make_set

HERE = Path(__file__).parent

N_DONE, N_LEFT = 5, 5
DONE = """() => {
  const { pictures, training } = window.liaamStudio.state.project;
  return training.state === "done" && pictures.every((picture) => picture.state !== "new");
}"""
"""The model has placed the points of all pictures."""


def portraits(folder: Path) -> None:
    """Write pictures of one head, some of them with landmarks."""
    for i, scene in enumerate(make_set(N_DONE + N_LEFT, Head(5), DIFFUSE, seed=3, size=(320, 240))):
        write_image(folder / f"portrait-{i + 1:02d}.png", scene.image)
        if i < N_DONE:
            contours = tuple(Contour(tuple(indices), closed) for indices, closed in scene.contours)
            write_landmarks(folder / f"portrait-{i + 1:02d}.ljson", Landmarks(scene.landmarks, contours))


def main() -> None:
    """Write the pictures."""
    with tempfile.TemporaryDirectory() as name, browsing() as page:
        if page is None:
            sys.exit(1)
        folder, lit = Path(name) / "portraits", Path(name) / "lit"
        folder.mkdir()
        lit.mkdir()
        portraits(folder)
        picture = material(lit)[1]
        with served(folder) as address:
            page.goto(address)  # which trains, as there are enough pictures with landmarks
            page.wait_for_function(DONE, timeout=300_000)
            page.locator("[data-testid=strip] [data-name='portrait-07.png']").click()
            page.wait_for_function("() => window.liaamStudio.annotate.source() === 'proposal'")
            page.wait_for_timeout(6000)  # messages have gone
            page.screenshot(path=HERE / "studio-annotate.png")
            page.locator("[data-testid=tab-fit]").click()
            page.locator("[data-testid=fit-file]").set_input_files(picture)
            page.wait_for_function("() => window.liaamStudio.fit.fit?.width === 640")
            page.locator("[data-testid=layer-flat]").click()
            page.wait_for_load_state("networkidle")
            page.wait_for_timeout(1000)
            page.screenshot(path=HERE / "studio-fit.png")


if __name__ == "__main__":
    main()
