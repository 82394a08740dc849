"""
Relighting
==========

Take the shading off a fitted image, or put the face under another lamp.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.relighting import Relighter
from scenes import (
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
# A model of many persons relights others. Faces are trained under lamps by default, so the model knows what light does to
# hair, neck and background, too.

SIZE = (160, 120)


def photographed(person, lights):
    rng = np.random.default_rng(person)
    pose, expression = random_pose(rng, SIZE), random_expression(rng)
    return [
        render(Head(person), pose, expression, light, size=SIZE) for light in lights
    ]


scenes = [photographed(person, [DIFFUSE])[0] for person in range(20, 34)]
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in scenes],
    diagonal=60,
    leave_out=False,
)
fitter = liaam.Fitter(model)

# %%
# Six persons under four new lights, which is 24 images. Each row of inputs has the relit images below it.

tests = [
    lateral("left"),
    lateral("right"),
    lateral("right", temperature_K=2800, ambient_temperature_K=9000),
    lateral("left", azimuth=0.5, elevation=0.8),
]
inputs, relit, doubtful = [], [], 0
for person in range(60, 66):
    scenes = photographed(person, tests)
    results = [fitter.fit(scene.image) for scene in scenes]
    inputs.append([scene.image for scene in scenes])
    relit.append(
        [
            Relighter.of(fitter, scene.image, result).flat()
            for scene, result in zip(scenes, results, strict=True)
        ]
    )
    doubtful += sum(not result.status.ok for result in results)

grid = np.stack([inputs, relit])
height, width = grid.shape[3:5]
grid = grid.transpose(2, 0, 3, 1, 4, 5).reshape(8 * height, 6 * width, 3)
figure, axis = plt.subplots(
    figsize=(9, 9 * 8 * height / (6 * width)), layout="constrained"
)
axis.imshow(grid)
axis.axis("off")
print(f"{doubtful} of 24 fits are marked as doubtful")

# %%
# :doc:`/explanation/relighting` says how this works and how far to trust it.
