"""
Relighting
==========

Take the shading off a fitted image, or put the face under another lamp.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets import Sample
from liaam.datasets.scenes import (
    DIFFUSE,
    Expression,
    Head,
    Pose,
    lateral,
    make_set,
    random_expression,
    random_pose,
    render,
)
from liaam.io import Landmarks
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
# Persons that the model has not seen
# -----------------------------------
# A model of many persons needs lamps: here, three persons under five lights. Then it relights other persons.

SIZE = (160, 120)
lamps = {
    "day": DIFFUSE,
    "left": lateral("left", azimuth=0.6),
    "right": lateral("right", azimuth=0.6),
    "far left": lateral("left", azimuth=1.2),
    "far right": lateral("right", azimuth=1.2),
}


def photographed(person, lights):
    rng = np.random.default_rng(person)
    pose, expression = random_pose(rng, SIZE), random_expression(rng)
    scenes = {
        name: render(Head(person), pose, expression, light, size=SIZE)
        for name, light in lights.items()
    }
    return [
        Sample(f"{person}-{name}", scene.image, Landmarks(scene.landmarks))
        for name, scene in scenes.items()
    ]


model = liaam.train(
    [photographed(person, {"day": DIFFUSE})[0] for person in range(20, 34)],
    diagonal=60,
    leave_out=False,
    lamps=[sample for person in (20, 21, 22) for sample in photographed(person, lamps)],
    training_lamp="day",
)
fitter = liaam.Fitter(model)

# %%
# Six persons under four new lights, which is 24 images. Each row of inputs has the relit images below it. An image whose
# fit is not trustworthy has its status as title.

tests = {
    "left": lateral("left"),
    "right": lateral("right"),
    "warm": lateral("right", temperature_K=2800, ambient_temperature_K=9000),
    "steep": lateral("left", azimuth=0.5, elevation=0.8),
}
persons = [photographed(person, tests) for person in range(60, 66)]
figure, axes = plt.subplots(
    2 * len(tests), len(persons), figsize=(9, 9.4), layout="constrained"
)
for column, samples in enumerate(persons):
    for i, sample in enumerate(samples):
        result = fitter.fit(sample.read_image())
        relighter = Relighter.of(fitter, sample.read_image(), result)
        for row, image in enumerate((sample.read_image(), relighter.flat())):
            axes[2 * i + row, column].imshow(image)
            axes[2 * i + row, column].axis("off")
        if not result.status.ok:
            axes[2 * i + 1, column].set_title(str(result.status), fontsize=8)

# %%
# :doc:`/explanation/relighting` says how this works and how far to trust it.
