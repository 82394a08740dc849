"""
Own features
============

A method can compare the channels of any function of an image, such as a dense descriptor or a layer of a network. Here
it is DAISY of scikit-image (``pip install scikit-image``): 104 channels for each pixel.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage.feature import daisy

import liaam
from liaam.fitting import features_method
from liaam.plotting import overlay_of_fit
from scenes import DIFFUSE, Head, lateral, make_set

RADIUS = 8


def dense_daisy(image):
    """Return the descriptors of all pixels, (h, w, 104)."""
    grey = np.pad(image.mean(axis=2), RADIUS, mode="edge")
    return daisy(
        grey,
        step=1,
        radius=RADIUS,
        rings=2,
        histograms=6,
        orientations=8,
        normalization="l2",
    )


# %%
# The function takes sRGB values in [0, 1], (h, w, 3), at the resolution of the model, and returns (h, w, c). The model
# is trained with it, and keeps its name and the seven principal components of its channels.

training = make_set(8, head=Head(5), lights=DIFFUSE, seed=1, size=(240, 180))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training],
    diagonal=100,
    leave_out=False,
    features=dense_daisy,
    methods=["grey"],
)

# %%
# ``features_method`` makes the row of the table of methods. It can be changed like any other row, for instance by
# ``loss="huber"``.

tests = make_set(4, head=Head(5), lights=lateral(), seed=2, size=(240, 180))
methods = {
    "grey": "grey",
    "DAISY": features_method(dense_daisy),
    "soft-li": "soft-li",
}
figure, axes = plt.subplots(1, 3, figsize=(8, 3.6), layout="constrained")
for axis, (name, method) in zip(axes, methods.items(), strict=True):
    fitter, errors = liaam.Fitter(model, method), []
    for test in tests:
        box = (*test.landmarks.min(axis=0), *test.landmarks.max(axis=0))
        result = fitter.fit(test.image, box)
        distances = np.linalg.norm(result.landmarks - test.landmarks, axis=1)
        errors.append(distances.mean())
    axis.imshow(overlay_of_fit(test.image, result, model))
    axis.set_title(f"{name}: {np.mean(errors):.2f} px")
    axis.axis("off")

# %%
# A model file does not hold the function. After loading the model, give the method with the same function; without it,
# all other methods work as usual.
