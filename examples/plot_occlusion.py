"""
Occlusion
=========

A hand or a cup in front of the face pulls a least-squares fit away. A robust loss gives such pixels less weight.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting import overlay_of_fit
from scenes import Head, Pose, make_set, render

head = Head(5)
training = make_set(8, head=head, seed=1, size=(240, 180))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training],
    diagonal=100,
    leave_out=False,
    methods=["grey"],
)

# %%
# A patch covers a part of the face.

test = render(head, Pose(yaw=0.05), size=(240, 180), seed=3)
image = test.image.copy()
image[120:165, 95:150] = np.array([40, 120, 190]) + np.random.default_rng(0).integers(
    -15, 15, (45, 55, 3)
)

# %%
# Suffixes choose the loss: ``grey+tukey`` is ``grey`` with Tukey's loss. The methods that compare gradient orientations,
# ``igo`` and ``soft-li``, have bounded residuals and need a loss less.

box = (*test.landmarks.min(axis=0), *test.landmarks.max(axis=0))
figure, axes = plt.subplots(1, 4, figsize=(9, 3.4), layout="constrained")
for axis, method in zip(
    axes, ("grey", "grey+huber", "grey+tukey", "soft-li"), strict=True
):
    result = liaam.fit(model, image, box, method)
    error = np.linalg.norm(result.landmarks - test.landmarks, axis=1).mean()
    axis.imshow(overlay_of_fit(image, result, model))
    axis.set_title(f"{method}: {error:.2f} px")
    axis.axis("off")
