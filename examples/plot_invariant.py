"""
The light-invariant image
=========================

Under some assumptions, a change of light moves the logarithm of a colour in a plane. The invariant image keeps the
direction orthogonal to this plane.
"""

import matplotlib.pyplot as plt
import numpy as np

from liaam.calibration import agreement, averaged
from liaam.photometry import CameraModel, invariant_image
from liaam.plotting.photometry import invariant_picture
from scenes import Head, lateral, render

head, size = Head(5), (240, 180)
scenes = {"from the left": lateral("left"), "from the right": lateral("right")}
scenes = {name: render(head, lights=light, size=size) for name, light in scenes.items()}
camera = CameraModel(theta=next(iter(scenes.values())).theta)

# %%
# The shading differs between the two images. The invariant hardly does.

figure, axes = plt.subplots(2, 2, figsize=(6, 7.6), layout="constrained")
for row, (name, scene) in zip(axes, scenes.items(), strict=True):
    row[0].imshow(scene.image)
    row[0].set_title(f"light {name}")
    row[1].imshow(invariant_picture(invariant_image(scene.image, camera)))
    row[1].set_title("invariant image")
for axis in axes.ravel():
    axis.axis("off")

# %%
# The correlation between the two images puts a number on it.

(found,) = agreement(
    averaged([scene.image for scene in scenes.values()], camera, block=2)
)
print(f"invariant {found.invariant:.3f}, logarithm of grey {found.log_grey:.3f}")

# %%
# The angle belongs to the camera. A wrong one lets the shading through. The images are blurred, since noise would hide
# the difference.

for offset in (0, 10, 20, 40):
    theta = camera.theta + np.deg2rad(offset)
    images = [
        invariant_image(scene.image, CameraModel(theta=theta), blur=2)
        for scene in scenes.values()
    ]
    both = np.isfinite(images[0]) & np.isfinite(images[1])
    print(
        f"angle off by {offset:2d}°: correlation {np.corrcoef(images[0][both], images[1][both])[0, 1]:.3f}"
    )
