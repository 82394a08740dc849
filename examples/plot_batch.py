"""
Batch on Dask
=============

Fit many images: in memory on threads, or into one table on the workers of a Dask cluster.
"""

import csv
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from distributed import Client

import liaam
from liaam.batch import Settings, run_batch
from scenes import Head, lateral, make_set

# %%
# A model, and a folder with 24 images under another light.

head = Head(5)
training = make_set(8, head=head, seed=1, size=(160, 120))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training], diagonal=80, leave_out=False
)

folder = Path(tempfile.mkdtemp())
model.save(folder / "face.liaam")
scenes = make_set(24, head, lateral("right"), seed=50, size=(160, 120))
for i, scene in enumerate(scenes):
    liaam.write_image(folder / f"image{i:02d}.png", scene.image)

# %%
# In memory
# ---------
# :func:`liaam.fit_many` fits on threads and returns the results in the order of the images.

results = liaam.fit_many(model, [scene.image for scene in scenes])
print(
    sum(result.status.ok for result in results), "of", len(results), "fits can be used"
)

# %%
# On a cluster
# ------------
# :func:`liaam.batch.run_batch` writes one row per image to a table. It resumes after a stop and takes the workers of any
# Dask scheduler. Here the scheduler and its workers are threads of this process. On a real cluster, give the address
# of its scheduler, such as ``tcp://host:8786``. The command line does the same:
# ``liaam batch face.liaam images -o table.csv --scheduler tcp://host:8786``.

with Client(
    n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
) as client:
    summary = run_batch(
        folder / "face.liaam",
        folder / "*.png",
        folder / "table.csv",
        Settings(covariance=False),
        scheduler=client.scheduler_info()["address"],
    )
print(summary.statuses)

# %%
# The table has one row per image: path, status, angle, cost, landmarks.

with (folder / "table.csv").open(newline="", encoding="utf-8") as file:
    rows = list(csv.DictReader(file))
found = [
    np.array(
        [
            [float(row[f"x{i}"]), float(row[f"y{i}"])]
            for i in range(1, model.n_points + 1)
        ]
    )
    for row in rows
]

figure, axes = plt.subplots(2, 6, figsize=(9, 4.4), layout="constrained")
for axis, scene, shape, row in zip(axes.ravel(), scenes, found, rows, strict=False):
    axis.imshow(scene.image)
    axis.plot(*shape.T, ".", color="#ff4060", markersize=2)
    axis.set_title(
        f"{row['status']}, {np.linalg.norm(shape - scene.landmarks, axis=1).mean():.2f} px",
        fontsize=8,
    )
    axis.axis("off")
