"""
Checking landmarks
==================

Landmarks in another order, a contour that runs backwards, or two points exchanged make a model that fits badly. Find such mistakes
before training.
"""

import matplotlib.pyplot as plt

import liaam
from liaam.plotting import overlay_of_faults
from scenes import Head, make_set

scenes = make_set(12, head=Head(5), seed=1, size=(200, 150))
shapes = [scene.landmarks.copy() for scene in scenes]

# %%
# Two mistakes: in image 3 the points of an eye run the other way round, in image 7 two points are exchanged.

(eye, _), *_ = [contour for contour in scenes[0].contours if contour[1]]
shapes[3][list(eye)] = shapes[3][list(eye)[::-1]]
shapes[7][[2, 40]] = shapes[7][[40, 2]]

# %%
# :func:`liaam.find_label_faults` compares each image with the images most like it.

faults = liaam.find_label_faults(shapes)
for fault in faults:
    print(f"image {fault.picture}: {fault.message}")

figure, axes = plt.subplots(
    1, len(faults), figsize=(4 * len(faults), 5), layout="constrained", squeeze=False
)
for axis, fault in zip(axes[0], faults, strict=True):
    axis.imshow(
        overlay_of_faults(scenes[fault.picture].image, shapes[fault.picture], [fault])
    )
    axis.set_title(f"image {fault.picture}: {fault.kind}")
    axis.axis("off")

# %%
# ``shapes[fault.picture][fault.order]`` are the landmarks in the order of the other images. ``liaam check FOLDER -o
# FAULTS`` does the same for a folder and writes corrected copies.
