"""What is known of an object, carried on beyond its mesh's border, where no model says anything.

Values are carried along what looks alike (:func:`around`). A change of light is told better by the picture itself
(:func:`continued`): inside the mesh it is known how light and paint colour the object's pixels, and nearby they do so
outside. Along a brow, the shadow of its ridge and its hair are both dark, and lie both on the border; the nearest
values would give the hair the shadow's light, and the lit skin above it too.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

FARTHEST, FARTHEST_SOFT = 4.0, 2.5
"""How far a change of light goes beyond the mesh, in reaches; and where one Gaussian carries it."""

LEAST_SHARE = 1e-3
"""Share of a change of light below which none is left."""

BLUR_OWN = 1.0
"""Deviation of the Gaussian that takes the noise from what is compared with the object next to it, pixels."""

NEAREST, FINEST = 1.0, 0.1
"""Finest scale at which values are carried over the mesh's border: at least so many pixels, and reaches."""

ENOUGH, PLENTY = 4.0, 16.0
"""Deviation of a Gaussian, pixels, from which a wider one is made on fewer pixels; and of one that keeps to edges."""

FURTHER, STEPS, EDGE = 2.0, 5.0, 0.8
"""Scales at which values are carried over the mesh's border along what looks alike: the coarsest, in reaches; how many
times finer the next is; and the change of log light, summed over channels, that is as far as a scale."""

ANOTHER_LIGHT, ANOTHER_COLOUR = 0.6, 0.25
"""How much brighter or darker, and how differently coloured, in logarithms, another thing than the object is."""

DARKER = 1.5
"""How much darker where light is added: a little on dark hair does less harm than a halo on a bright wall."""

CUT_OFF = 0.05
"""Share of what would come from the mesh, were there no edges, below which a place is cut off from it by them."""

WINDOWS, SMOOTH = (2.0, 0.7, 0.25), 1.2
"""Deviations of the Gaussian windows within which colours tell light, in reaches; and of one, pixels, that is wide
enough for functions that are put between pixels again."""

UNTOLD = 0.1
"""Change of log light within a window that is too small to tell light from."""


def around(
    values: np.ndarray,
    weights: np.ndarray,
    own: np.ndarray,
    reach: float,
    soft: bool = False,
    lightened: np.ndarray | bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Carry values on beyond where they have weight, and say how much of them to take there.

    Parameters
    ----------
    values : (h, w, c) float32
    weights : (h, w, 1) float32
        1 where the values are known, 0 where nothing is known of them.
    own : (h, w, 3) float32
        Logarithms of the picture's light. What looks unlike the object next to it, or is cut off from it by edges, is
        another thing (the wall behind a cheek), and what happens to the object is none of its business.
    reach : float
        How far they are carried: deviation of a Gaussian, pixels.
    soft : bool
        Weights go down to 0 softly: one blur will do, where else values are carried along what looks alike, so that
        those of a shadow stay in the shadow, the nearest next to where they are known.
    lightened : (h, w, 1) bool
        Where the change adds light.

    Returns
    -------
    values : (h, w, c) float32
        Weighted means of the values nearby.
    share : (h, w, 1) float32
        1 next to where values are known, less and less further out, 0 beyond :data:`FARTHEST` times the reach.
    """
    import cv2

    c, seen = values.shape[2], cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
    layers = np.concatenate([weights * values, weights * own, weights], axis=2)
    means = _means(_blurred(layers, reach)) if soft else _carried(layers, seen, reach)
    away = cv2.distanceTransform((weights <= 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[..., None]
    share = _smoothstep(1.0 - (away - 1.0) / ((FARTHEST_SOFT if soft else FARTHEST) * reach))
    if not soft:
        share *= _smoothstep(_let_through(weights, seen, max(FURTHER * reach, NEAREST)) / CUT_OFF)
    unlike = seen - means[..., c:]
    brighter = unlike.mean(axis=2, keepdims=True)
    tint = np.square(unlike - brighter).sum(axis=2, keepdims=True)
    limit = np.where((brighter < 0) & lightened, DARKER, ANOTHER_LIGHT)
    apart = np.square(brighter / limit) + tint / ANOTHER_COLOUR**2
    share *= np.exp(-0.5 * np.maximum(apart - 1.0, 0.0))
    return means[..., :c], np.where(share > LEAST_SHARE, share, 0.0).astype(np.float32)


def continued(change: np.ndarray, inside: np.ndarray, own: np.ndarray, reach: float) -> np.ndarray:
    """Continue a change of light beyond the mesh by the picture's own colours.

    Within a window, the change is an affine function of the picture's log light: its slope follows the light where a
    shadow's edge is seen, and is flat across paint that the light leaves alone. It is learnt inside the mesh and
    holds for the window's pixels outside (He, Sun and Tang, "Guided image filtering", IEEE TPAMI 2013, with weights;
    on fewer pixels as in He and Sun, "Fast guided filter", 2015). Narrow windows take over from wide ones where there
    are enough pixels to learn from.

    Parameters
    ----------
    change : (h, w, 3) float32
        Logarithm of light under the picture's light over that under another, right inside the mesh.
    inside : (h, w) bool
    own : (h, w, 3) float32
        Logarithms of the picture's light.
    reach : float
        See :func:`around`.

    Returns
    -------
    (h, w, 3) float32
        Within the range that the change has inside.
    """
    import cv2

    if not inside.any():
        return np.zeros_like(change)
    (height, width), seen = inside.shape, cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
    step = max(1, int(WINDOWS[-1] * reach / SMOOTH))
    # Sums of products, so that the picture can be made smaller after they are multiplied.
    parts = [seen, change, *(seen[..., i:] * seen[..., i : i + 1] for i in range(3))]
    parts += [change * seen[..., i : i + 1] for i in range(3)] + [np.ones_like(seen[..., :1])]
    sums = _resized(np.concatenate(parts, axis=2) * inside[..., None], _fewer(inside, step))
    found = np.zeros(1, np.float32)
    for i, window in enumerate(WINDOWS):
        told, known = _told_by_colours(sums, max(window * reach, NEAREST) / step)
        found = told if i == 0 else found + _smoothstep(2.0 * known) * (told - found)
    layers = _resized(found, (width, height))
    told = layers[..., :3] + sum(seen[..., i : i + 1] * layers[..., 3 * i + 3 : 3 * i + 6] for i in range(3))
    return np.clip(told, change[inside].min(axis=0), change[inside].max(axis=0))


def _told_by_colours(sums: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Affine functions (h, w, 12) that fit windows of sums of products, and the share (h, w, 1) known of them."""
    height, width = sums.shape[:2]
    step = max(1, int(scale / SMOOTH))
    small = _blurred(_resized(sums, _fewer(sums, step)), scale / step)
    layers = _resized(np.concatenate([_affine(_means(small)), small[..., -1:]], axis=2), (width, height))
    return layers[..., :-1], layers[..., -1:]


def _fewer(picture: np.ndarray, step: int) -> tuple[int, int]:
    """Width and height of a picture (h, w, ...) with a pixel for every so many rows and columns."""
    return -(-picture.shape[1] // step), -(-picture.shape[0] // step)


def _affine(means: np.ndarray) -> np.ndarray:
    """Offset, and slope by each channel, (h, w, 12), of affine functions that fit windows with these mean products."""
    colour, change = means[..., :3], means[..., 3:6]
    upper = means[..., 6:12]
    products = upper[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*colour.shape, 3)
    covariance = products - colour[..., :, None] * colour[..., None, :] + UNTOLD**2 * np.eye(3, dtype=np.float32)
    mixed = means[..., 12:21].reshape(*colour.shape, 3) - colour[..., :, None] * change[..., None, :]
    # The inverse by Cramer's rule: of very many small matrices it is quicker than a solver.
    a, b, c = np.moveaxis(covariance, 2, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    slopes = adjugate @ mixed / np.einsum("hwi,hwi->hw", a, adjugate[..., 0, :])[..., None, None]
    offset = change - np.einsum("hwi,hwij->hwj", colour, slopes)
    return np.concatenate([offset, slopes.reshape(*colour.shape[:2], 9)], axis=2)


def _means(sums: np.ndarray) -> np.ndarray:
    """Weighted means of sums (h, w, c + 1) whose last layer is the weights'."""
    return sums[..., :-1] / np.maximum(sums[..., -1:], 1e-6)


def _carried(layers: np.ndarray, seen: np.ndarray, reach: float) -> np.ndarray:
    """Means (h, w, c) of layers (h, w, c + 1) along what looks alike, of the nearest where there are any.

    The averages are those of the domain transform (Gastal and Oliveira, "Domain transform for edge-aware image and
    video processing", ACM TOG 2011), in which a change of light counts as a distance.
    """
    scale, finest = max(FURTHER * reach, NEAREST), max(FINEST * reach, NEAREST)
    means = _means(_averaged(layers, seen, scale))
    while scale > finest:
        scale = max(scale / STEPS, finest)
        sums = _averaged(layers, seen, scale)
        means = means + _smoothstep(2.0 * sums[..., -1:]) * (_means(sums) - means)
    return means


def _let_through(weights: np.ndarray, seen: np.ndarray, scale: float) -> np.ndarray:
    """Share (h, w, 1) of weights nearby that edges do not hold off."""
    with_edges, without = (_averaged(weights, picture, scale, ENOUGH) for picture in (seen, np.zeros_like(seen)))
    return with_edges / np.maximum(without, 1e-6)


def _averaged(layers: np.ndarray, seen: np.ndarray, scale: float, enough: float = PLENTY) -> np.ndarray:
    """Averages along what looks alike."""
    from liaam.relighting.carrying import averaged  # numba: imported when first needed

    return _on_fewer_pixels(partial(averaged, edge=EDGE), (layers, seen), scale, enough)


def _blurred(layers: np.ndarray, scale: float) -> np.ndarray:
    """Gaussian blur of (h, w, c) float32."""
    import cv2

    return _on_fewer_pixels(lambda picture, sigma: cv2.GaussianBlur(picture, (0, 0), sigma), (layers,), scale, ENOUGH)


def _on_fewer_pixels(
    smooth: Callable[..., np.ndarray], pictures: Sequence[np.ndarray], scale: float, enough: float
) -> np.ndarray:
    """Smooth pictures (h, w, c) at a scale in pixels, a wide one on fewer: as good, and quicker by the step squared."""
    step = int(scale / enough)
    if step < 2:
        return smooth(*pictures, scale)
    height, width = pictures[0].shape[:2]
    small = (_resized(picture, _fewer(picture, step)) for picture in pictures)
    return _resized(smooth(*small, scale / step), (width, height))


def _resized(layers: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Layers (h, w, c) at another (width, height): means where smaller; OpenCV resizes four at a time."""
    import cv2

    if size == (layers.shape[1], layers.shape[0]):
        return layers
    how = cv2.INTER_AREA if size[0] < layers.shape[1] else cv2.INTER_LINEAR
    parts = range(0, layers.shape[2], 4)
    return np.dstack([cv2.resize(layers[..., i : i + 4], size, interpolation=how) for i in parts])


def _smoothstep(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
