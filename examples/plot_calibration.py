"""
Calibrating a camera
====================

Light invariance needs one angle of the camera. Estimate it from two images of a scene under different lights.
"""

import numpy as np

import liaam
from liaam.photometry import CameraModel, invariant_image
from liaam.plotting.photometry import figure_of_invariants, figure_of_sweep
from scenes import Camera, photograph, poster, uneven_light

# %%
# Two images of a poster: a warm lamp and a window. Camera and poster stand still. The exposure and the white balance of
# the camera must be fixed.

size, camera = (180, 240), Camera()
sheet = poster(size, 5)
images = {
    "lamp": photograph(sheet, uneven_light(size, 3, lamp_K=3200), camera, seed=0),
    "window": photograph(sheet, uneven_light(size, 8, lamp_K=5800), camera, seed=1),
}

# %%
# The estimate comes with a standard error. It also says whether the two lights differ enough to determine the angle.

estimate = liaam.theta_from_scene(list(images.values()))
low, high = np.rad2deg(estimate.interval)
print(f"{np.rad2deg(estimate.theta):.2f}°, 95 % interval {low:.2f}° to {high:.2f}°")
print(f"true angle {np.rad2deg(camera.theta()):.2f}°")
print(estimate.message)

# %%
# With the right angle the invariant images look alike, and the shadows are gone. Dark blue pixels are too dark or too
# bright to have a value.

model = CameraModel(theta=estimate.theta, theta_deviation=estimate.standard_error)
figure_of_invariants(
    {name: (image, invariant_image(image, model)) for name, image in images.items()}
)

# %%
# A wrong angle leaves shadows in the image. This is the sweep that ``liaam camera invariant --sweep`` draws.

figure_of_sweep(images["lamp"], model)

# %%
# ``model.save("camera.json")`` writes a camera file for ``liaam train --camera``. :doc:`/how-to/calibrate-a-camera`
# lists the other ways to calibrate.
