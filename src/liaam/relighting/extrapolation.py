"""Extrapolation beyond the mesh, where the model has no values.

:func:`around` diffuses values between pixels of similar colour. :func:`continued` predicts a change of light from the
image's colours, by a relation learnt inside the mesh. Along a brow, for example, shadow and hair are both dark and both
on the border. The nearest values would relight the hair, and the lit skin above it, like the shadow.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

FARTHEST = 4.0
"""Distance beyond the mesh to which a change of light extends, in reaches."""

LEAST_SHARE = 1e-3
"""Weight of a change of light below which it is set to 0."""

BLUR_OWN = 1.0
"""Standard deviation of the Gaussian that denoises the image before colours are compared, pixels."""

LARGEST = 30.0
"""Reach in pixels that is enough. From twice as much, of objects of 1500 pixels, resolutions are lower accordingly."""

NEAREST, FINEST = 1.0, 0.1
"""Finest scale of the diffusion across the mesh's border: at least this many pixels, and reaches."""

ENOUGH, PLENTY = 4.0, 16.0
"""Standard deviation, pixels, from which smoothing is done at a lower resolution: Gaussian, and edge-preserving."""

FURTHER, STEPS, EDGE = 2.0, 5.0, 0.8
"""Scales of the diffusion: the coarsest, in reaches; the ratio of consecutive scales; and the change of log light,
summed over channels, that counts as a distance of one scale."""

ANOTHER_LIGHT, ANOTHER_COLOUR = 0.6, 0.25
"""Difference in brightness and in colour, in logarithms, at which a pixel counts as not part of the object."""

DARKER = 1.5
"""The same for darker pixels if light is added: some light on dark hair is less visible than a halo on a wall."""

CUT_OFF = 0.05
"""Ratio of the weight that reaches a pixel with and without edges, below which edges separate it from the mesh."""

WINDOWS, SMOOTH = (2.0, 0.7, 0.25), 1.2
"""Standard deviations of the Gaussian windows of :func:`continued`, in reaches; and in pixels at the resolution at
which the windows are computed."""

LEAST_CONTRAST = 0.1
"""Change of log light within a window below which the relation between colour and light is not learnt."""


def around(
    values: np.ndarray,
    weights: np.ndarray,
    own: np.ndarray,
    reach: float,
    lightened: np.ndarray | bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate values (h, w, c) beyond the pixels of weight 1 (h, w, 1), and weigh the result.

    Return means of nearby values, and their share (h, w, 1): 1 next to known values, falling to 0 at :data:`FARTHEST`
    times the reach, which is the standard deviation of a Gaussian in pixels. Values diffuse between pixels of similar
    colour, so that those of a shadow stay within it. ``own`` (h, w, 3) are logarithms of the image's light: pixels that
    differ from the object in colour, or are separated from it by edges, belong to something else, such as the wall
    behind a cheek, and their share is low. ``lightened`` (h, w, 1) tells where the change adds light.
    """
    import cv2

    (height, width), step = own.shape[:2], _step_of(reach)
    if step > 1:
        size, lightened = _fewer(own, step), np.broadcast_to(np.float32(lightened), weights.shape)
        values, known = _reduced(values, weights, size)
        found, share = around(values, known, _resized(own, size), reach / step, _resized(lightened, size) > 0.5)
        return _resized(found, (width, height)), _resized(share, (width, height))
    c, seen = values.shape[2], cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
    layers = np.concatenate([weights * values, weights * own, weights], axis=2)
    means = _diffused(layers, seen, reach)
    away = cv2.distanceTransform((weights <= 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[..., None]
    share = _smoothstep(1.0 - (away - 1.0) / (FARTHEST * reach))
    share *= _smoothstep(_transmitted(weights, seen, max(FURTHER * reach, NEAREST)) / CUT_OFF)
    difference, each = seen - means[..., c:], np.ones((1, 3), np.float32)
    brighter = cv2.transform(difference, each / 3)[..., None]  # a sum, faster than by an axis
    colour = cv2.transform(np.square(difference - brighter), each)[..., None]
    limit = np.where((brighter < 0) & lightened, DARKER, ANOTHER_LIGHT)
    apart = np.square(brighter / limit) + colour / ANOTHER_COLOUR**2
    share *= np.exp(-0.5 * np.maximum(apart - 1.0, 0.0))
    return means[..., :c], np.where(share > LEAST_SHARE, share, 0.0).astype(np.float32)


def continued(change: np.ndarray, inside: np.ndarray, own: np.ndarray, reach: float) -> np.ndarray:
    """Extrapolate a change of log light (h, w, 3) beyond the mesh from the logarithms of the image's light, ``own``.

    Within a window, the change is modelled as an affine function of the image's log light. Its slope is large across a
    shadow's edge, and small across paint. It is learnt inside the mesh and applied to the window's pixels outside. This
    is a weighted guided filter (He, Sun and Tang, "Guided image filtering", IEEE TPAMI 2013) at a lower resolution (He
    and Sun, "Fast guided filter", 2015). Narrow windows replace wide ones where they hold enough pixels. The result is
    clipped to its range inside the mesh.
    """
    import cv2

    if not inside.any():
        return np.zeros_like(change)
    height, width = inside.shape
    size = _fewer(inside, _step_of(reach))
    reduced, known = _reduced(change, inside[..., None].astype(np.float32), size)
    found = _learnt(reduced, known, _resized(own, size), reach / _step_of(reach))
    predicted = _resized(found[..., :3], (width, height))
    seen = cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
    for i in range(3):
        predicted += seen[..., i : i + 1] * _resized(found[..., 3 * i + 3 : 3 * i + 6], (width, height))
    return np.clip(predicted, change[inside].min(axis=0), change[inside].max(axis=0))


def _step_of(reach: float) -> int:
    """Return by how much images are reduced before values are extrapolated to a reach in pixels."""
    return max(1, int(reach / LARGEST))


def _reduced(values: np.ndarray, weights: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Reduce values (h, w, c) of weights of 0 and 1 (h, w, 1) to (width, height).

    The reduced weights are 1 where all pixels have weight 1, or many if none has.
    """
    if size == weights.shape[1::-1]:
        return values, weights
    shares = _resized(weights, size)
    most = float(shares.max())
    whole = (shares > (0.999 if most > 0.999 else 0.5 * most)).astype(np.float32)
    return _resized(values * weights, size) / np.maximum(shares, 1e-6), whole


def _learnt(change: np.ndarray, known: np.ndarray, own: np.ndarray, reach: float) -> np.ndarray:
    """Learn affine functions of the image's log light (h, w, 12), at a lower resolution; see :func:`continued`."""
    import cv2

    seen, step = cv2.GaussianBlur(own, (0, 0), BLUR_OWN), max(1, int(WINDOWS[-1] * reach / SMOOTH))
    weighted, size = seen * known, _fewer(seen, step)
    # Products at full resolution, summed at a lower one.
    factors = [seen, seen[..., 1:], seen[..., 2:], change, change, change]
    products = (factor * weighted[..., i % 3, None] for i, factor in enumerate(factors))
    sums = np.dstack([_resized(part, size) for part in (weighted, change * known, *products, known)])
    found = np.zeros(1, np.float32)
    for i, window in enumerate(WINDOWS):
        affine, seen_share = _affine_in_windows(sums, max(window * reach, NEAREST) / step)
        found = affine if i == 0 else found + _smoothstep(2.0 * seen_share) * (affine - found)
    return found


def _affine_in_windows(sums: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Fit affine functions (h, w, 12) to windows of sums of products; also return the known fraction (h, w, 1)."""
    height, width = sums.shape[:2]
    step = max(1, int(scale / SMOOTH))
    small = _blurred(_resized(sums, _fewer(sums, step)), scale / step)
    layers = _resized(np.concatenate([_affine(_means(small)), small[..., -1:]], axis=2), (width, height))
    return layers[..., :-1], layers[..., -1:]


def _fewer(picture: np.ndarray, step: int) -> tuple[int, int]:
    """Return width and height of an image (h, w, ...) reduced by a step."""
    return -(-picture.shape[1] // step), -(-picture.shape[0] // step)


def _affine(means: np.ndarray) -> np.ndarray:
    """Compute offset and slopes (h, w, 12) of the affine functions that fit windows, from their mean products."""
    colour, change = means[..., :3], means[..., 3:6]
    upper = means[..., 6:12]
    products = upper[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*colour.shape, 3)
    covariance = products - colour[..., :, None] * colour[..., None, :]
    covariance += LEAST_CONTRAST**2 * np.eye(3, dtype=np.float32)
    mixed = means[..., 12:21].reshape(*colour.shape, 3) - colour[..., :, None] * change[..., None, :]
    # Cramer's rule is faster than a solver for many small matrices.
    a, b, c = np.moveaxis(covariance, 2, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    slopes = adjugate @ mixed / np.einsum("hwi,hwi->hw", a, adjugate[..., 0, :])[..., None, None]
    offset = change - np.einsum("hwi,hwij->hwj", colour, slopes)
    return np.concatenate([offset, slopes.reshape(*colour.shape[:2], 9)], axis=2)


def _means(sums: np.ndarray) -> np.ndarray:
    """Divide sums (h, w, c + 1) by the weights in their last layer."""
    return sums[..., :-1] / np.maximum(sums[..., -1:], 1e-6)


def _diffused(layers: np.ndarray, seen: np.ndarray, reach: float) -> np.ndarray:
    """Compute edge-preserving means (h, w, c) of layers (h, w, c + 1), at the finest scale with enough weight.

    Uses the domain transform (Gastal and Oliveira, "Domain transform for edge-aware image and video processing", ACM
    TOG 2011), in which a change of light counts as a distance.
    """
    scale, finest = max(FURTHER * reach, NEAREST), max(FINEST * reach, NEAREST)
    means = _means(_averaged(layers, seen, scale))
    while scale > finest:
        scale = max(scale / STEPS, finest)
        sums = _averaged(layers, seen, scale)
        means = means + _smoothstep(2.0 * sums[..., -1:]) * (_means(sums) - means)
    return means


def _transmitted(weights: np.ndarray, seen: np.ndarray, scale: float) -> np.ndarray:
    """Return the fraction (h, w, 1) of nearby weights that edges do not block."""
    with_edges, without = (_averaged(weights, picture, scale, ENOUGH) for picture in (seen, np.zeros_like(seen)))
    return with_edges / np.maximum(without, 1e-6)


def _averaged(layers: np.ndarray, seen: np.ndarray, scale: float, enough: float = PLENTY) -> np.ndarray:
    """Average layers with preserved edges."""
    from liaam.relighting.domain_transform import averaged

    return _on_fewer_pixels(partial(averaged, edge=EDGE), (layers, seen), scale, enough)


def _blurred(layers: np.ndarray, scale: float) -> np.ndarray:
    """Blur (h, w, c) float32 by a Gaussian."""
    import cv2

    return _on_fewer_pixels(lambda picture, sigma: cv2.GaussianBlur(picture, (0, 0), sigma), (layers,), scale, ENOUGH)


def _on_fewer_pixels(
    smooth: Callable[..., np.ndarray], pictures: Sequence[np.ndarray], scale: float, enough: float
) -> np.ndarray:
    """Smooth images (h, w, c) at a scale in pixels; for large scales at a lower resolution."""
    step = int(scale / enough)
    if step < 2:
        return smooth(*pictures, scale)
    height, width = pictures[0].shape[:2]
    small = (_resized(picture, _fewer(picture, step)) for picture in pictures)
    return _resized(smooth(*small, scale / step), (width, height))


def _resized(layers: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resize layers (h, w, c) to (width, height), four at a time as OpenCV requires; by area means if smaller."""
    import cv2

    if size == (layers.shape[1], layers.shape[0]):
        return layers
    how = cv2.INTER_AREA if size[0] < layers.shape[1] else cv2.INTER_LINEAR
    parts = range(0, layers.shape[2], 4)
    return np.dstack([cv2.resize(layers[..., i : i + 4], size, interpolation=how) for i in parts])


def _smoothstep(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
