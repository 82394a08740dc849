"""
Objects other than faces
========================

A wing under a microscope (grey), a beetle and a key: trained on twelve images of each in soft light, and fitted in hard
light from one side. The landmarks of the training images define what the object is.
"""

import cv2
import matplotlib.pyplot as plt
import numpy as np

import liaam

# %%
# Three kinds of objects
# ----------------------
# Each is drawn as filled areas and lines between points, x and y from -1 to 1. Some of the points are its landmarks.

AROUND = np.linspace(0, 2 * np.pi, 60)


def oval(x, y, width, height):
    """Points of an ellipse around a centre."""
    return np.stack([x + width * np.cos(AROUND), y + height * np.sin(AROUND)], axis=1)


def wing():
    outline = oval(0, 0, 0.95, 0.38)
    outline[:, 1] *= 1 - 0.3 * outline[:, 0]
    tips = np.array([[-0.93, -0.1], [-0.8, 0.27], [-0.2, 0.4], [0.45, 0.3]])
    forks = np.array([[-0.1, -0.14], [-0.05, 0.02], [-0.2, 0.12], [0.35, -0.07]])
    root = np.array([[0.9, -0.02]])
    veins = [[tips[0], forks[1], root[0]], [tips[1], forks[2], forks[3], root[0]]]
    veins += [[tips[2], forks[2]], [forks[0], forks[1]], [forks[1], forks[2]]]
    veins += [[[-0.6, -0.4], forks[0], root[0]], [tips[3], forks[3]]]
    parts = [(outline, (205, 205, 205), 0), (outline, (70, 70, 70), 3)]
    parts += [(np.array(vein, float), (80, 80, 80), 2) for vein in veins]
    return parts, np.concatenate([tips, forks, root, [[-0.6, -0.4]]]), (236, 236, 236)


def beetle():
    shell = (52, 92, 48)
    head = (38, 46, 34)
    eye = (16, 16, 16)
    parts = []
    for side in (-1, 1):
        for y in (-0.15, 0.15, 0.45):
            leg = [[0.3 * side, y], [0.62 * side, y - 0.1], [0.8 * side, y + 0.15]]
            parts.append((np.array(leg), head, 4))
    parts += [
        (oval(0, -0.62, 0.2, 0.18), head, 0),
        (oval(0, -0.35, 0.36, 0.2), head, 0),
    ]
    parts += [(oval(0, 0.25, 0.42, 0.58), shell, 0)]
    parts += [(np.array([[0, -0.25], [0, 0.82]]), (20, 34, 20), 2)]
    for side in (-1, 1):
        parts += [(oval(0.13 * side, -0.68, 0.04, 0.05), eye, 0)]
        parts += [(oval(0.22 * side, 0.2, 0.07, 0.1), (190, 120, 40), 0)]
    middle = [[0, -0.8], [0, -0.25], [0, 0.82]]
    pairs = [
        [0.13, -0.68],
        [0.36, -0.35],
        [0.42, 0.25],
        [0.22, 0.2],
        [0.8, 0.6],
        [0.8, 0],
    ]
    both = [[side * x, y] for x, y in pairs for side in (-1, 1)]
    return parts, np.array(middle + both), (196, 178, 150)


def key():
    brass = (188, 152, 70)
    dark = (120, 90, 36)
    x = [-0.05, 0.3, 0.3, 0.45, 0.45, 0.6, 0.6, 0.75, 0.75, 0.95, 0.85, -0.05]
    y = [0.08, 0.08, 0.3, 0.3, 0.16, 0.16, 0.34, 0.34, 0.08, 0.0, -0.08, -0.08]
    teeth = np.stack([x, y], axis=1)
    parts = [(oval(-0.5, 0, 0.42, 0.4), brass, 0), (oval(-0.5, 0, 0.42, 0.4), dark, 2)]
    parts += [(oval(-0.68, 0, 0.12, 0.13), (72, 80, 92), 0), (teeth, brass, 0)]
    parts += [(np.concatenate([teeth, teeth[:1]]), dark, 2)]
    ring = [[-0.92, 0], [-0.5, -0.4], [-0.5, 0.4], [-0.68, -0.13], [-0.68, 0.13]]
    return parts, np.concatenate([ring, teeth[1:11]]), (72, 80, 92)


# %%
# Photographs
# -----------
# No two objects are alike: each is stretched, bent, turned and moved a little. The light is a gradient of brightness across the
# image, in front of a ground with some texture.


def photograph(kind, rng, contrast, size=240):
    """Return an image and its landmarks, in light from one side with a contrast (0 is even light)."""
    parts, landmarks, ground = kind()
    stretch, shear, bend = rng.normal((1, 0, 0), (0.06, 0.04, 0.06))
    angle = rng.normal(0, 0.08)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = rng.normal(size / 2, 5, 2)

    def placed(points):
        x, y = np.asarray(points).T
        bent = np.stack([x * stretch + shear * y, y / stretch + bend * x**2], axis=1)
        return 0.41 * size * bent @ turn.T + place

    image = np.full((size, size, 3), ground, np.uint8)
    for points, colour, thickness in parts:
        fixed = [np.round(placed(points) * 16).astype(np.int32)]
        shade = np.clip(np.array(colour) * rng.normal(1, 0.05), 0, 255).tolist()
        if thickness:
            cv2.polylines(image, fixed, False, shade, thickness, cv2.LINE_AA, 4)
        else:
            cv2.fillPoly(image, fixed, shade, cv2.LINE_AA, 4)
    texture = cv2.GaussianBlur(rng.normal(0, 14, (size, size)), (0, 0), 2)
    side = rng.uniform(0, 2 * np.pi)
    across = np.linspace(-1, 1, size)
    ramp = np.cos(side) * across[None] + np.sin(side) * across[:, None]
    light = np.exp(contrast * (ramp - 0.6))
    noisy = (
        image * light[..., None] + texture[..., None] + rng.normal(0, 2, image.shape)
    )
    return np.clip(noisy, 0, 255).astype(np.uint8), placed(landmarks)


# %%
# Train and fit
# -------------
# Green fits may be used; the ellipses contain a landmark with a probability of 95 %.

figure, axes = plt.subplots(3, 4, figsize=(10, 7.6), layout="constrained")
for row, kind in zip(axes, (wing, beetle, key), strict=True):
    rng = np.random.default_rng(5)
    training = [photograph(kind, rng, 0.15) for _ in range(12)]
    model = liaam.train(training, diagonal=100, lamps=None, regressor=False)
    row[0].imshow(photograph(kind, rng, 0.15)[0])
    row[0].set_title(f"{kind.__name__}, soft light")
    row[0].axis("off")
    for axis in row[1:]:
        image, truth = photograph(kind, rng, 1.0)
        result = liaam.fit(model, image)
        error = np.linalg.norm(result.landmarks - truth, axis=1).mean()
        result.plot(image, ax=axis).set_title(f"{result.status}, error {error:.1f} px")
