"""
First model
===========

Train a model on ten images of a face under one light. Then fit it to a new image under a hard light from the left.
"""

# sphinx_gallery_thumbnail_number = 2

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting import figure_of_model
from scenes import Expression, Head, Pose, lateral, make_set, render

# %%
# Training images
# ---------------
# A training image comes with its landmarks, an (n, 2) array of x and y in pixels. Here we generate portraits of one
# head with random poses and expressions under soft, frontal light.

head = Head(5)
training = make_set(10, head=head, seed=1, size=(240, 180))

figure, axes = plt.subplots(1, 4, figsize=(8, 2.9), layout="constrained")
for axis, scene in zip(axes, training, strict=False):
    axis.imshow(scene.image)
    axis.plot(*scene.landmarks.T, ".", color="white", markersize=2)
    axis.axis("off")

# %%
# Train
# -----
# :func:`liaam.train` takes pairs of image and landmarks, or what :func:`liaam.load_folder` returns. ``leave_out=False``
# skips the calibration of the quality; see :ref:`the example on uncertainty <sphx_glr_gallery_plot_uncertainty.py>`.

pairs = [(scene.image, scene.landmarks) for scene in training]
model = liaam.train(pairs, diagonal=100, leave_out=False, name="example head")
print(model)

# %%
# Look at the model before using it. The mean must be sharp: a blurred mean means that the landmarks of some images are
# in another order or misplaced.

figure_of_model(model)

# %%
# Fit
# ---
# The new image has a light that the model has never seen. :func:`liaam.fit` searches for the object, so it needs no
# start.

test = render(
    head,
    Pose(yaw=0.06),
    Expression(smile=0.3),
    lights=lateral("left"),
    seed=2,
    size=(240, 180),
)
result = liaam.fit(model, test.image)
error = np.linalg.norm(result.landmarks - test.landmarks, axis=1).mean()
print(
    result.status,
    f"after {result.n_iterations} iterations, mean error {error:.2f} pixels",
)

figure, axes = plt.subplots(1, 2, figsize=(6, 4), layout="constrained")
axes[0].imshow(test.image)
axes[0].set_title("new image")
axes[0].axis("off")
result.plot(ax=axes[1]).set_title("fit")

# %%
# ``result.status.ok`` says whether the landmarks can be used. They are in ``result.landmarks``, and
# :func:`liaam.write_landmarks` writes them to a file. ``model.save("face.liaam")`` keeps the model.
