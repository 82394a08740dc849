"""
Relighting
==========

Take the light of a room off a photograph, or put the face under another lamp.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets import load_face
from liaam.relighting import Lamp, Relighter

# %%
# Fit the face model that comes with liaam to a photograph that comes with it, too (CC0).

photograph = load_face().read_image()
fitter = liaam.Fitter(liaam.load_model("face"))
result = fitter.fit(photograph)
relighter = Relighter.of(fitter, photograph, result)

# %%
# ``flat`` gives the photograph under the light of training, ``shading`` the logarithm of the light that was removed, and
# ``under`` the face with a lamp in the given direction: x to the right, y down, z towards the viewer. All multiply the
# photograph with light, so that what is no light stays: freckles, make-up, glasses, a beard.

shading = relighter.shading().mean(axis=2)
images = {
    "photograph": photograph,
    "without shading": relighter.flat(),
    "shading": np.clip(1 + shading / 2, 0, 1),
    "lamp from the left": relighter.under((-1.0, -0.3, 0.5)),
    "lamp from above": relighter.under((0.0, -1.0, 0.5)),
    "two coloured lamps": relighter.under(
        [
            Lamp((-1.0, -0.2, 0.4), colour=(1.0, 0.75, 0.5)),
            Lamp((1.0, -0.2, 0.4), colour=(0.5, 0.7, 1.0)),
        ]
    ),
}
figure, axes = plt.subplots(2, 3, figsize=(9, 8), layout="constrained")
for axis, (name, image) in zip(axes.flat, images.items(), strict=True):
    axis.imshow(image, cmap="gray", vmin=0, vmax=1)
    axis.set_title(name)
    axis.axis("off")

# %%
# How well the light is known
# ---------------------------
# The map is 1 where the removed light is known exactly, and 0.8 where it is known to about 20 %.

certainty = relighter.certainty()
figure, axis = plt.subplots(figsize=(4, 4), layout="constrained")
axis.imshow(photograph)
shown = axis.imshow(certainty, vmin=0, vmax=1, alpha=np.isfinite(certainty) * 0.7)
axis.set_title(f"certainty, mean {relighter.certain:.2f}")
axis.axis("off")
figure.colorbar(shown)
plt.show()
