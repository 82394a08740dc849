"""
Hard light and lamps
====================

A model that has seen one light only can fail under hard light from the side. Learn what lamps do from one object, and
train with copies of the images under these lamps.
"""

# sphinx_gallery_thumbnail_number = 2

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets import Sample
from liaam.io import Landmarks
from liaam.plotting import figure_of_lamps
from liaam.training import learn_lamps
from scenes import DIFFUSE, Head, Pose, lateral, make_set, render

SIZE = (200, 150)

# %%
# Learn the lamps
# ---------------
# Photograph one object or a few under each lamp, without moving them. The names say which object and which lamp:
# ``1-left`` is object 1 under the lamp ``left``. Here the objects are two generated heads.

lights = {"day": DIFFUSE, "left": lateral("left"), "right": lateral("right")}
samples = []
for person in (1, 2):
    for name, light in lights.items():
        scene = render(Head(person), lights=light, size=SIZE)
        samples.append(
            Sample(f"{person}-{name}", scene.image, Landmarks(scene.landmarks))
        )

lamps = learn_lamps(samples, training_lamp="day")

# %%
# What the lamps make of another head, which was photographed in one light only:

other = render(Head(5), Pose(yaw=-0.15), size=SIZE)
figure_of_lamps(lamps, other.image, other.landmarks)

# %%
# Train with and without lamps
# ----------------------------
# The training images show six heads under soft light.

pairs = []
for person in (3, 4, 5, 6, 7, 8):
    pairs += [
        (scene.image, scene.landmarks)
        for scene in make_set(2, Head(person), seed=person, size=SIZE)
    ]

models = {
    "one light": liaam.train(pairs, diagonal=80, leave_out=False, lamps=None),
    "with lamps": liaam.train(pairs, diagonal=80, leave_out=False, lamps=lamps),
}

# %%
# Fit four heads that neither model has seen, under a light that is in none of the training images.

light = lateral("left", azimuth=1.5, ambient_strength=0.03)
tests = [
    render(Head(person), Pose(yaw=0.05), lights=light, size=SIZE)
    for person in (11, 12, 13, 14)
]

figure, axes = plt.subplots(2, 4, figsize=(8, 5.4), layout="constrained")
for row, (name, model) in zip(axes, models.items(), strict=True):
    errors = []
    for axis, test in zip(row, tests, strict=True):
        box = (*test.landmarks.min(axis=0), *test.landmarks.max(axis=0))
        result = liaam.fit(model, test.image, box)
        errors.append(np.linalg.norm(result.landmarks - test.landmarks, axis=1).mean())
        axis.imshow(test.image)
        axis.plot(*result.landmarks.T, ".", color="#ff4060", markersize=3)
        axis.set_title(f"{name}: {errors[-1]:.1f} px", fontsize=9)
        axis.axis("off")
    print(f"{name}: mean error {np.mean(errors):.2f} pixels")

# %%
# :doc:`/how-to/train-for-hard-light` says what to photograph, and what lamps brought on real faces.
