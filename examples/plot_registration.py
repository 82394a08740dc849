"""
Registering two images
======================

Align two images of a plane by a homography although the light has changed.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting.photometry import checkerboard
from scenes import photograph, poster, uneven_light

# %%
# The second image is taken from a slightly different place, under another light.

size = (180, 240)
sheet = poster(size, 2)
moved = np.array([[1.02, 0.03, -5.0], [-0.02, 1.01, 3.0], [5e-5, -4e-5, 1.0]])
first = photograph(sheet, uneven_light(size, 3, lamp_K=3200), seed=0)
second = photograph(sheet, uneven_light(size, 8, lamp_K=6500), seed=1, homography=moved)

registration = liaam.register(first, second)
print(registration.status, f"after {registration.n_iterations} iterations")

# %%
# The homography maps pixels of the first image to pixels of the second. Its error at the corners of the image:

corners = np.array(
    [
        [0, 0, 1],
        [size[1] - 1, 0, 1],
        [size[1] - 1, size[0] - 1, 1],
        [0, size[0] - 1, 1],
    ],
    float,
)
places = [
    (corners @ matrix.T)[:, :2] / (corners @ matrix.T)[:, 2:]
    for matrix in (registration.homography, moved)
]
print(
    "errors at the corners, pixels:",
    np.linalg.norm(places[0] - places[1], axis=1).round(2),
)

aligned, _ = registration.warp(second)
images = {
    "first": first,
    "second": second,
    "first and aligned second": checkerboard(first, aligned),
}
figure, axes = plt.subplots(1, 3, figsize=(10, 2.9), layout="constrained")
for axis, (name, image) in zip(axes, images.items(), strict=True):
    axis.imshow(image)
    axis.set_title(name)
    axis.axis("off")
