"""
Tracking a video
================

Follow a face from frame to frame while a lamp moves from one side to the other.
"""

import matplotlib.pyplot as plt
import numpy as np

import liaam
from liaam.plotting import overlay
from scenes import (
    Ambient,
    Expression,
    Head,
    PointLight,
    Pose,
    make_set,
    render,
)

head = Head(5)
training = make_set(8, head=head, seed=1, size=(200, 150))
model = liaam.train(
    [(scene.image, scene.landmarks) for scene in training], diagonal=80, leave_out=False
)

# %%
# A generated video of 16 frames: the head turns, the mouth opens and closes, and the lamp swings.

frames = []
for i in range(16):
    phase = 2 * np.pi * i / 16
    lights = (PointLight((np.sin(phase), 0.2, 0.8), 4000.0, 1.0), Ambient(7000.0, 0.3))
    pose, expression = (
        Pose(yaw=0.15 * np.sin(phase)),
        Expression(mouth_open=0.2 - 0.2 * np.cos(phase)),
    )
    frames.append(render(head, pose, expression, lights, size=(200, 150), seed=i))

# %%
# :class:`liaam.Tracker` takes one frame at a time. For a video file, :func:`liaam.track_video` does the loop, and
# ``liaam track`` writes tables and annotated videos.

tracker = liaam.Tracker(model)
tracked = [tracker.update(scene.image) for scene in frames]
print([str(frame.status) for frame in tracked])

figure, axes = plt.subplots(1, 4, figsize=(8, 3.0), layout="constrained")
for axis, i in zip(axes, (0, 4, 8, 12), strict=True):
    axis.imshow(overlay(frames[i].image, tracked[i].landmarks, model))
    axis.set_title(f"frame {i}: {tracked[i].status}", fontsize=9)
    axis.axis("off")

# %%
# Errors stay below a pixel under the moving light.

errors = [
    np.linalg.norm(frame.landmarks - scene.landmarks, axis=1).mean()
    for frame, scene in zip(tracked, frames, strict=True)
]
figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
axis.plot(errors, "o-")
axis.set(xlabel="frame", ylabel="mean error, pixels", ylim=(0, None))
