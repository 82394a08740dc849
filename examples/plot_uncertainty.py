"""
Uncertainty
===========

A fit says how sure it is: a quality from 0 to 1 for the whole fit, and a covariance for each landmark.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting import overlay
from scenes import Camera, Expression, Head, Pose, make_set, render

# %%
# Both are calibrated in training: the images are left out in turn and fitted by a model of the others. This takes about
# as long as the training itself.

head = Head(5)
training = make_set(8, head=head, seed=1, size=(200, 150))
model = liaam.train([(scene.image, scene.landmarks) for scene in training], diagonal=80)

# %%
# Easy and difficult images
# -------------------------
# The ellipses hold a landmark with a probability of 95 %. Noise lowers the quality. A head that is turned further than
# in any training image is fitted badly: the quality is low, the status is ``doubtful``, and the ellipses are larger.

scenes = {
    "clean": render(head, Pose(yaw=0.05), size=(200, 150)),
    "noisy": render(
        head, Pose(yaw=0.05), camera=Camera(read_noise=0.1), size=(200, 150)
    ),
    "turned": render(head, Pose(yaw=0.45), Expression(mouth_open=0.9), size=(200, 150)),
}

figure, axes = plt.subplots(1, 3, figsize=(8, 4.2), layout="constrained")
for axis, (name, scene) in zip(axes, scenes.items(), strict=True):
    result = liaam.fit(model, scene.image)
    axis.imshow(
        overlay(
            scene.image,
            result.landmarks,
            model,
            covariances=result.landmark_covariances,
        )
    )
    axis.set_title(f"{name}: {result.status}, quality {result.quality:.2f}", fontsize=9)
    axis.axis("off")
    print(f"{name}: mean deviation {result.sd.mean():.2f} pixels")

# %%
# An image without the object
# ---------------------------
# A fit to something else settles too. Its quality is low, and the status is not ``converged``.

rng = np.random.default_rng(0)
blocks = rng.integers(90, 140, (50, 38)).repeat(4, axis=0).repeat(4, axis=1)
wall = blocks[..., None] + rng.integers(-9, 9, (200, 152, 3))
result = liaam.fit(model, wall.astype(np.uint8))
print(f"{result.status}: quality {result.quality:.2f}")
print(result.message)

# %%
# In your own code, test ``result.status.ok`` before you use the landmarks, or set a limit for ``result.quality``.
# :doc:`/explanation/uncertainty` explains where both numbers come from, and how well they hold on real faces.
