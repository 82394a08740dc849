"""
Measuring specimens
===================

Train on a ``.tps`` file of digitised leaves, fit new leaves, and measure them in millimetres with standard errors.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.io import write_collection
from scenes.leaf import draw_leaf

# %%
# Leaves
# ------
# Each generated leaf has its own length, width and bend. Its seven landmarks are base and tip, the ends of two pairs of
# veins, and the point where the first pair meets the midrib. The camera is fixed: a pixel is 0.25 mm.

SCALE = 0.25

rng = np.random.default_rng(4)
leaves = [draw_leaf(rng) for _ in range(28)]
digitised, new = leaves[:16], leaves[16:]

# %%
# Train on a .tps file
# --------------------
# tpsDig and geomorph keep the landmarks of all images in one ``.tps`` file, with y counted upwards from the bottom. A
# folder with such a file is read like any other.

folder = Path(tempfile.mkdtemp())
marks = {}
for i, (image, landmarks) in enumerate(digitised):
    liaam.write_image(folder / f"leaf{i:02d}.png", image)
    marks[f"leaf{i:02d}.png"] = liaam.Landmarks(landmarks, scale=SCALE)
write_collection(folder / "leaves.tps", marks)
print("\n".join((folder / "leaves.tps").read_text().splitlines()[:10]))

data = liaam.load_folder(folder)
model = liaam.train(data, diagonal=100)

# %%
# Fit new leaves
# --------------

results = liaam.fit_many(model, [image for image, _ in new])
figure, axes = plt.subplots(1, 4, figsize=(8, 3), layout="constrained")
for axis, (image, _), result in zip(axes, new, results, strict=False):
    result.plot(image, ax=axis).set_title(result.status)

# %%
# A data frame
# ------------
# :func:`liaam.to_dataframe` makes a pandas data frame with one row per landmark, counted from 1, of any list of results.
# Here, the positions relative to the base of each leaf, in millimetres, and how uncertain each landmark is.

names = [f"leaf{i}" for i in range(len(results))]
frame = liaam.to_dataframe(results, names)
print(frame.head())

base = frame[frame.landmark == 1].set_index("image")
frame["width"] = SCALE * (frame.x - frame.image.map(base.x))
frame["height"] = SCALE * (frame.image.map(base.y) - frame.y)
print(frame.pivot_table(["width", "height", "sd"], "landmark").round(2))

figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
frame.plot.scatter(
    x="width", y="height", c="landmark", colormap="tab10", s=12, ax=axes[0]
)
axes[0].set(aspect="equal", xlabel="from the base, mm", ylabel="above the base, mm")
frame.boxplot(column="sd", by="landmark", ax=axes[1])
axes[1].set(ylabel="standard deviation, pixels", title="")
figure.suptitle("")

# %%
# :func:`liaam.evaluate` makes such a data frame of the errors on landmarked images.

errors = liaam.evaluate(model, new)
print(errors.report())
print(errors.to_dataframe().groupby("landmark").error.median().round(2))

# %%
# Measure
# -------
# :func:`liaam.measure` takes distances, angles and areas by the numbers of the landmarks, counted from 1. The standard
# errors come from the covariances of the landmarks. :func:`liaam.to_dataframe` takes the table, too.

specimens = [
    liaam.Specimen(name, result.landmarks, result.landmark_covariances, scale=SCALE)
    for name, result in zip(names, results, strict=True)
]
MEASURES = ("distance:1-2", "distance:4-5", "angle:4-3-5", "area:1-4-6-2-7-5")
table = liaam.measure(specimens, MEASURES)
truth = liaam.measure(
    [liaam.Specimen("leaf", landmarks, scale=SCALE) for _, landmarks in new], MEASURES
)

titles = {
    "distance_1_2": "length, mm",
    "distance_4_5": "width, mm",
    "angle_4_3_5": "angle of veins, degrees",
    "area_1_4_6_2_7_5": "area, mm²",
}
figure, axes = plt.subplots(1, 4, figsize=(10, 2.7), layout="constrained")
for axis, (name, title) in zip(axes, titles.items(), strict=True):
    errors = 1.96 * np.array(table[f"{name}_se"])
    axis.axline((np.mean(truth[name]), np.mean(truth[name])), slope=1, color="0.7")
    axis.errorbar(truth[name], table[name], errors, fmt=".", markersize=4)
    axis.set(title=title, xlabel="true")
axes[0].set_ylabel("measured, 95 % interval")

# %%
# Shapes
# ------
# The table also holds the centroid size and the Procrustes coordinates ``X1``, ``Y1``, ``X2`` ..., with y upwards as in
# geomorph. ``liaam measure`` writes the same table as ``.csv``.

figure, axis = plt.subplots(figsize=(3, 4), layout="constrained")
for i in range(1, model.n_points + 1):
    axis.plot(table[f"X{i}"], table[f"Y{i}"], ".", markersize=4)
axis.set(aspect="equal", title="Procrustes coordinates")
