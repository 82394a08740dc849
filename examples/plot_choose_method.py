"""
Choosing a method
=================

Compare four methods on one image under a hard light from the side. Methods that compare pixel values take the change
of light for a change of the face. Methods that are invariant to light do not.
"""

# sphinx_gallery_thumbnail_number = 2

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting import overlay_of_fit
from scenes import Expression, Head, Pose, lateral, make_set, render

# %%
# The model is trained under soft, frontal light; the test image is lit from the left.

head = Head(5)
training = make_set(8, head=head, seed=1, size=(240, 180))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training],
    diagonal=100,
    leave_out=False,
    methods=["grey", "rgb", "li"],  # besides the default, soft-li
)
test = render(
    head,
    Pose(yaw=0.06),
    Expression(smile=0.3),
    lights=lateral("left"),
    seed=2,
    size=(240, 180),
)

# %%
# All methods start from the same box around the landmarks, a few pixels off.

(x0, y0), (x1, y1) = test.landmarks.min(axis=0), test.landmarks.max(axis=0)
box = (x0 + 3, y0 - 2, x1 + 4, y1 - 1)
fits = {
    method: liaam.fit(model, test.image, box, method)
    for method in ("grey", "rgb", "li", "soft-li")
}

figure, axes = plt.subplots(1, 4, figsize=(9, 3.4), layout="constrained")
for axis, (method, fit) in zip(axes, fits.items(), strict=True):
    error = np.linalg.norm(fit.landmarks - test.landmarks, axis=1).mean()
    axis.imshow(overlay_of_fit(test.image, fit, model))
    axis.set_title(f"{method}: {error:.2f} px")
    axis.axis("off")

# %%
# The error after each iteration shows the path of each method. ``grey`` and ``rgb`` converge too, but in the wrong place.
# Generated light obeys the assumptions of ``li`` exactly. In photographs, ``soft-li`` is more accurate
# (:doc:`/how-to/choose-a-method`).

figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
for method, fit in fits.items():
    errors = [
        np.linalg.norm(step.landmarks - test.landmarks, axis=1).mean()
        for step in fit.history
    ]
    axis.plot(errors, label=method)
axis.set(xlabel="accepted step", ylabel="mean error, pixels", ylim=(0, None))
axis.legend()

# %%
# ``li`` also estimates the angle of the camera's invariant projection. The true angle of this camera is known.

print(
    f"estimated {np.rad2deg(fits['li'].theta):.1f}°, true {np.rad2deg(test.theta):.1f}°"
)

# %%
# Use the default, ``soft-li``, unless you have a reason not to. :doc:`/how-to/choose-a-method` has the reasons.
