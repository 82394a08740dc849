"""
Uncertainty
===========

A fit says how sure it is: a quality from 0 to 1 for the whole fit, and a covariance for each landmark.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets import load_face
from liaam.plotting import overlay_of_fit

# %%
# Both are calibrated in training, on images that are left out in turn. The face model that comes with liaam fits a
# photograph (CC0), the same with the mouth covered, and the same turned by 90°, which the search does not look for.

model = liaam.load_model("face")
fitter = liaam.Fitter(model)
photograph = load_face().read_image()
covered = photograph.copy()
covered[330:460, 70:320] = (40, 90, 160)
images = {"as taken": photograph, "covered": covered, "turned": np.rot90(photograph)}

# %%
# Easy and difficult images
# -------------------------
# The ellipses hold a landmark with a probability of 95 %. Where the face is covered, the quality is lower and the
# ellipses are larger. The fit to the turned face is wrong: its status is ``doubtful``.

figure, axes = plt.subplots(1, 3, figsize=(9, 4.2), layout="constrained")
for axis, (name, image) in zip(axes, images.items(), strict=True):
    result = fitter.fit(image)
    axis.imshow(overlay_of_fit(image, result, model, ellipses=True))
    axis.set_title(name)
    axis.axis("off")
    print(f"{name}: mean standard deviation {result.sd.mean():.1f} pixels")

# %%
# An image without the object
# ---------------------------
# A fit to something else has a low quality, and its status is not ``converged``.

rng = np.random.default_rng(0)
blocks = rng.integers(90, 140, (50, 38)).repeat(8, axis=0).repeat(8, axis=1)
wall = blocks[..., None] + rng.integers(-9, 9, (400, 304, 3))
result = fitter.fit(wall.astype(np.uint8))
print(f"{result.status}: quality {result.quality:.2f}")
print(result.message)

# %%
# In your own code, test ``result.status.ok`` before you use the landmarks, or set a limit for ``result.quality``.
# :doc:`/explanation/uncertainty` explains where both numbers come from, and how accurate they are on real faces.
