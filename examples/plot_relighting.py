"""
Relighting
==========

Take the shading off a fitted image, or put the face under another lamp.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets.scenes import Expression, Head, Pose, lateral, make_set, render
from liaam.relighting import Relighter

head = Head(5)
training = make_set(10, head=head, seed=1, size=(240, 180))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training],
    diagonal=100,
    leave_out=False,
)

# %%
# Fit an image under hard light from the left.

test = render(
    head,
    Pose(yaw=0.06),
    Expression(smile=0.3),
    lights=lateral("left"),
    seed=2,
    size=(240, 180),
)
fitter = liaam.Fitter(model)
result = fitter.fit(test.image)
relighter = Relighter.of(fitter, test.image, result)

# %%
# ``flat`` gives the face under the light of training, ``shading`` what was removed, and ``under`` the face with a lamp
# in the given direction: x to the right, y down, z towards the viewer.

shading = relighter.shading().mean(axis=2)
images = {
    "input": test.image,
    "without shading": relighter.flat(),
    "shading": np.clip(1 + shading / 4, 0, 1),
    "lamp from the right": relighter.under((1.0, -0.3, 0.6)),
    "lamp from above": relighter.under((0.0, -1.0, 0.5)),
}
figure, axes = plt.subplots(1, len(images), figsize=(11, 3.2), layout="constrained")
for axis, (name, image) in zip(axes, images.items(), strict=True):
    axis.imshow(image, cmap="gray", vmin=0, vmax=1)
    axis.set_title(name)
    axis.axis("off")

# %%
# Compare with the truth
# ----------------------
# The generated face can be rendered under the light of training, so the error is known. Both images are compared as
# logarithms of linear light inside the mesh, up to one exposure.

truth = render(
    head, Pose(yaw=0.06), Expression(smile=0.3), seed=2, size=(240, 180)
).image
inside = relighter.shading().any(axis=2)


def spread(image):
    log = [
        np.log((picture[inside].astype(float) / 255 + 0.02) ** 2.2)
        for picture in (image, truth)
    ]
    return np.std(log[0] - log[1])


print(
    f"input: {spread(test.image):.2f}, without shading: {spread(relighter.flat()):.2f}"
)

# %%
# :doc:`/explanation/relighting` says how this works and how far to trust it.
