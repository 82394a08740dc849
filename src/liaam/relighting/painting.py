"""From the model's reference frame onto a picture, and over its border without a seam."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from liaam.mesh import ReferenceFrame, signed_areas
from liaam.model import AAM
from liaam.photometry import Response, from_linear, to_linear
from liaam.photometry.encoding import as_colour, stored_values
from liaam.relighting.appearance import ShadowFree

LARGEST = 10
"""Size of a shape, in sizes of the image, beyond which it is not painted."""

SOFT_EDGE = 0.05
"""Width of the border in which the appearance goes over into the picture, as a share of the model's diagonal."""

REACH = 0.04
"""How far beyond the mesh shading is taken off: deviation of a Gaussian, as a share of the shape's diagonal."""


FARTHEST = 2.5
"""How far a change of light goes beyond the mesh, in deviations of the Gaussian that carries it."""

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


def paint(image: np.ndarray, shape: np.ndarray, model: AAM, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Carry values of the reference frame to where a shape lies in an image.

    Parameters
    ----------
    image : (h, w, ...) array
        Gives the size.
    shape : (n, 2) float
        Landmarks, image pixels.
    model : AAM
    values : (n_pixels, c) float32

    Returns
    -------
    picture : (h, w, c) float32
        Zero outside the mesh; triangles that are turned over stay empty, and so does all of a shape that is
        not finite, or many times as large as the image.
    inside : (h, w) bool
    """
    from scipy.ndimage import map_coordinates

    height, width = image.shape[:2]
    picture, inside = np.zeros((height, width, values.shape[1]), np.float32), np.zeros((height, width), bool)
    # A fit that has blown up may be of any size.
    sane = np.isfinite(shape).all() and np.ptp(shape, axis=0).max() < LARGEST * max(height, width)
    triangles = model.triangles[signed_areas(shape, model.triangles) > 1e-3] if sane else model.triangles[:0]
    if not len(triangles):
        return picture, inside
    there = ReferenceFrame(shape, triangles)
    x, y = (there.pixels[:, ::-1] + there.origin).astype(int).T
    seen = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    if not seen.any():
        return picture, inside
    own = np.einsum("nv,nva->na", there.weights[seen], model.shape_model.mean[there.vertices[seen]])
    own = (own - model.frame.origin)[:, ::-1].T
    known = np.ones((len(values), 1), np.float32)
    layers = np.moveaxis(model.frame.picture(np.concatenate([values, known], axis=1)), 2, 0)
    *carried, share = (map_coordinates(layer, own, order=1, mode="nearest") for layer in layers)
    # At the mesh's border the pixels outside it do not count.
    kept = share > 1e-3
    picture[y[seen][kept], x[seen][kept]] = np.stack([layer[kept] / share[kept] for layer in carried], axis=1)
    inside[y[seen][kept], x[seen][kept]] = True
    return picture, inside


def without_shading(
    image: np.ndarray, shape: np.ndarray, model: AAM, appearance: ShadowFree, response: Response = "srgb"
) -> tuple[np.ndarray, np.ndarray]:
    """Picture with the object under the training light, and the shading that was taken off.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
        Stored values.
    shape : (n, 2) float
        Fitted landmarks.
    model : AAM
    appearance : ShadowFree
    response : Response
        Of the image's camera.

    Returns
    -------
    picture : (h, w, 3) float32
        Stored values in [0, 1]; as the image outside the mesh.
    shading : (h, w, 3) float32
        Logarithm of image / appearance, 0 outside the mesh.
    """
    image = as_colour(image)
    stored = stored_values(image)
    log_rgb, inside = paint(image, shape, model, appearance.log_rgb)
    fresh = np.clip(from_linear(np.exp(log_rgb), response), 0, 1)
    floor = 0.5 * float(to_linear(np.array(1 / 255), response))
    shading = np.log(np.maximum(to_linear(stored, response), floor)) - log_rgb
    return (
        np.where(inside[..., None], fresh, stored).astype(np.float32),
        np.where(inside[..., None], shading, 0.0).astype(np.float32),
    )


def log_light(image: np.ndarray, response: Response) -> np.ndarray:
    """Logarithm of linear light of a picture's stored values, (h, w, 3) float32; black counts as half a step."""
    floor = 0.5 * float(to_linear(np.array(1 / 255), response))
    return np.log(np.maximum(to_linear(stored_values(image), response), floor)).astype(np.float32)


def eight_bits(log_rgb: np.ndarray, response: Response) -> np.ndarray:
    """Stored values (h, w, 3) uint8 of logarithms of light; what is brighter than white is white."""
    return np.rint(255 * np.clip(from_linear(np.exp(log_rgb), response), 0.0, 1.0)).astype(np.uint8)


def soft_edge(model: AAM) -> np.ndarray:
    """Weights of the model's pixels, (n_pixels,) float32: 0 at the mesh's border, 1 well inside."""
    from scipy.ndimage import distance_transform_edt

    inside = model.frame.picture(np.ones(model.n_pixels, np.float32), 0.0) > 0
    depth = np.asarray(distance_transform_edt(np.pad(inside, 1)))[1:-1, 1:-1]
    share = np.clip((depth - 1.0) / (SOFT_EDGE * model.diagonal), 0.0, 1.0)
    return (share * share * (3.0 - 2.0 * share))[inside].astype(np.float32)


def around(
    values: np.ndarray, weights: np.ndarray, own: np.ndarray, reach: float, soft: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Carry values on beyond where they have weight, and say how much of them to take there.

    Parameters
    ----------
    values : (h, w, c) float32
    weights : (h, w, 1) float32
        1 where the values are known, 0 where nothing is known of them.
    own : (h, w, 3) float32
        Logarithms of the picture's light. What looks unlike the object next to it is another thing (the wall behind a
        cheek), and what happens to the object is none of its business.
    reach : float
        How far they are carried: deviation of a Gaussian, pixels.
    soft : bool
        Weights go down to 0 softly: one blur will do, where else values are carried along what looks alike, so that
        those of a shadow stay in the shadow, the nearest next to where they are known.

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
    fading = _smoothstep(1.0 - (away - 1.0) / (FARTHEST * reach))
    unlike = seen - means[..., c:]
    brighter = unlike.mean(axis=2, keepdims=True)
    tint = np.square(unlike - brighter).sum(axis=2, keepdims=True)
    apart = np.square(brighter / ANOTHER_LIGHT) + tint / ANOTHER_COLOUR**2
    share = fading * np.exp(-0.5 * np.maximum(apart - 1.0, 0.0))
    return means[..., :c], np.where(share > LEAST_SHARE, share, 0.0).astype(np.float32)


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


def _averaged(layers: np.ndarray, seen: np.ndarray, scale: float) -> np.ndarray:
    """Averages along what looks alike."""
    from liaam.relighting.carrying import averaged  # numba: imported when first needed

    return _on_fewer_pixels(partial(averaged, edge=EDGE), (layers, seen), scale, PLENTY)


def _blurred(layers: np.ndarray, scale: float) -> np.ndarray:
    """Gaussian blur of (h, w, c) float32."""
    import cv2

    return _on_fewer_pixels(lambda picture, sigma: cv2.GaussianBlur(picture, (0, 0), sigma), (layers,), scale, ENOUGH)


def _on_fewer_pixels(
    smooth: Callable[..., np.ndarray], pictures: Sequence[np.ndarray], scale: float, enough: float
) -> np.ndarray:
    """Smooth pictures (h, w, c) at a scale in pixels, a wide one on fewer: as good, and quicker by the step squared."""
    import cv2

    step = int(scale / enough)
    if step < 2:
        return smooth(*pictures, scale)
    height, width = pictures[0].shape[:2]
    small = (_resized(picture, (-(-width // step), -(-height // step)), cv2.INTER_AREA) for picture in pictures)
    return _resized(smooth(*small, scale / step), (width, height), cv2.INTER_LINEAR)


def _resized(layers: np.ndarray, size: tuple[int, int], how: int) -> np.ndarray:
    """Layers (h, w, c) at another (width, height); OpenCV resizes four at a time."""
    import cv2

    parts = range(0, layers.shape[2], 4)
    return np.dstack([cv2.resize(layers[..., i : i + 4], size, interpolation=how) for i in parts])


def _smoothstep(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def blended(image: np.ndarray, painted: np.ndarray, response: Response, reach: float) -> np.ndarray:
    """Lay an appearance over a picture, and take the shading next to it off.

    Parameters
    ----------
    image : (h, w, 3) array
    painted : (h, w, 4) float32
        Logarithms of light, and their weights.
    response : Response
        Of the image's camera.
    reach : float
        How far shading is taken off beyond the weights, pixels.

    Returns
    -------
    (h, w, 3) uint8
    """
    picture = np.rint(255 * stored_values(image)).astype(np.uint8)
    rows, columns = box_around(painted[..., 3] > 0, 4 * reach)
    weights = painted[rows, columns, 3:]
    if not weights.size:
        return picture
    own = log_light(image[rows, columns], response)
    shading = own - painted[rows, columns, :3]
    nearby, share = around(shading, weights, own, reach, soft=True)
    taken = weights * shading + (1.0 - weights) * share * nearby
    changed = np.abs(taken).max(axis=2) > 0
    picture[rows, columns][changed] = eight_bits(own - taken, response)[changed]
    return picture


def box_around(inside: np.ndarray, margin: float) -> tuple[slice, slice]:
    """Rows and columns of a mask (h, w) and so much around it; none of an empty one."""
    slices = []
    for axis in (1, 0):
        (seen,) = np.nonzero(inside.any(axis=axis))
        first, last = (seen[0], seen[-1] + 1) if len(seen) else (0, 0)
        grown = round(margin) if len(seen) else 0
        slices.append(slice(max(0, int(first) - grown), int(last) + grown))
    return slices[0], slices[1]
