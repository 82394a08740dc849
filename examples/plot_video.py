"""
Tracking a video
================

Follow a face from frame to frame while a lamp moves around it.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.datasets import load_face
from liaam.plotting import overlay
from liaam.relighting import Relighter

# %%
# A video is made of the photograph that comes with liaam (CC0): the lamp moves around the face, and the picture shakes.

model = liaam.load_model("face")
fitter = liaam.Fitter(model)
photograph = load_face().read_image()
still = fitter.fit(photograph)
relighter = Relighter.of(fitter, photograph, still)

frames, shifts = [], []
for phase in np.linspace(0, 2 * np.pi, 16, endpoint=False):
    x, y = round(20 * np.cos(phase)), round(12 * np.sin(phase))
    lit = relighter.under((np.sin(phase), -0.2, 0.3), ambient=0.1)
    frames.append(np.roll(lit, (y, x), axis=(0, 1)))
    shifts.append((x, y))

# %%
# :class:`liaam.Tracker` takes one frame at a time. For a video file, :func:`liaam.track_video` does the loop, and
# ``liaam track`` writes tables and annotated videos.

tracker = liaam.Tracker(model)
tracked = [tracker.update(frame) for frame in frames]
print(*(str(frame.status) for frame in tracked))

figure, axes = plt.subplots(1, 4, figsize=(8, 3.0), layout="constrained")
for axis, i in zip(axes, (0, 4, 8, 12), strict=True):
    axis.imshow(overlay(frames[i], tracked[i].landmarks, model))
    axis.set_title(f"frame {i}: {tracked[i].status}", fontsize=9)
    axis.axis("off")

# %%
# The lamp moves the landmarks by about 1 % of the face's width.

width = np.ptp(still.landmarks[:, 0])
moved = [
    np.linalg.norm(frame.landmarks - shift - still.landmarks, axis=1).mean()
    for frame, shift in zip(tracked, shifts, strict=True)
]
figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
axis.plot(100 * np.array(moved) / width, "o-")
axis.set(xlabel="frame", ylabel="moved by, % of the face's width", ylim=(0, None))
