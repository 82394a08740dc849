"""Train on simulated portraits under one light, fit a portrait under another, and compare methods.

    python examples/fit_under_changed_light.py [FIGURE.png]

The same steps serve photographs: replace the simulated pictures by ``liaam.load_folder("folder")``.
"""

import sys

import numpy as np

import liaam
from liaam.datasets.scenes import Expression, Head, Pose, lateral, make_set, render

METHODS = ("grey", "rgb", "li")


def main(figure_path: str | None = None) -> None:
    # 1. Pictures with landmarks under one light, and one picture under a hard light from the left.
    head = Head(5)
    training = make_set(10, head=head, seed=1)
    test = render(head, Pose(yaw=0.06), Expression(smile=0.3), lights=lateral("left"), seed=2)

    # 2. Train. Pairs of image and landmarks will do; so does what liaam.load_folder returns.
    model = liaam.train([(scene.image, scene.landmarks) for scene in training], name="example head")
    print(f"model: {model.n_images} pictures, {model.n_points} landmarks, {model.n_pixels} pixels")

    # 3. Fit from a box around the landmarks, a little off.
    (x0, y0), (x1, y1) = test.landmarks.min(axis=0), test.landmarks.max(axis=0)
    box = (x0 + 4, y0 - 3, x1 + 6, y1 - 2)
    fits = {method: liaam.fit(model, test.image, box, method) for method in METHODS}
    for method, fit in fits.items():
        error = np.linalg.norm(fit.landmarks - test.landmarks, axis=1).mean()
        angle = f", angle {np.rad2deg(fit.theta):.0f} degrees" if np.isfinite(fit.theta) else ""
        print(f"{method:5s} mean error {error:5.2f} pixels, {fit.status}, {fit.n_iterations} iterations{angle}")
    if figure_path:
        draw(figure_path, test.image, fits)


def draw(path: str, image: np.ndarray, fits: dict[str, liaam.FitResult]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(fits), figsize=(3 * len(fits), 4), layout="constrained")
    for axis, (method, fit) in zip(axes, fits.items(), strict=True):
        axis.imshow(image)
        axis.plot(*fit.start.T, ".", color="white", markersize=2)
        axis.plot(*fit.landmarks.T, ".", color="red", markersize=4)
        axis.set_title(f"{method}: {fit.status}")
        axis.axis("off")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
