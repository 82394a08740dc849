"""Error measures of relit images against the truth, which generated scenes provide."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.reconstruct import EXPOSURE
from liaam.error_measures import root_mean_square
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.photometry import CameraModel
from liaam.photometry.encoding import usable_range
from liaam.photometry.response import from_linear, to_linear
from liaam.relighting import paint
from liaam.relighting.painting import REACH, log_light
from liaam.training import sample_appearance, train
from scenes import (
    DIFFUSE,
    Camera,
    Head,
    Lights,
    Scene,
    lateral,
    make_set,
    random_expression,
    random_pose,
    render,
)

LIGHTS: dict[str, Lights] = {
    "left": lateral("left"),
    "right": lateral("right"),
    "warm": lateral("right", temperature_K=2800, azimuth=1.1, ambient_temperature_K=9000, ambient_strength=0.2),
    "steep": lateral("left", temperature_K=3300, azimuth=0.5, elevation=0.8),
}
"""Hard lights with cast shadows. The training light is diffuse and neutral."""

SMOOTH = 0.1
"""Maximum difference of log light between neighbours in the true flat-lit image at which a seam would be visible."""

GRAIN = 1.0
"""Standard deviation in pixels of the Gaussian filter before a seam is measured. It removes pixel noise, which differs
inside and outside the mesh."""


@dataclass(frozen=True, eq=False)
class LitPair:
    """A person in one pose under hard light, and the same under the training light (the truth)."""

    light: str
    lit: Scene
    flat: Scene


def training_camera() -> Camera:
    """Camera with the exposure of training, at which the model and the truth have the same level of light."""
    return Camera(exposure=EXPOSURE)


def train_on_flat_light(head: Head, n: int = 24, size: tuple[int, int] = (320, 240), **options) -> AAM:
    """Train on images of a person under diffuse light."""
    scenes = make_set(n, head, camera=training_camera(), size=size)
    return train(
        [(s.image, s.landmarks) for s in scenes], camera=CameraModel(theta=scenes[0].theta), lamps=None, **options
    )


def lit_pairs(head: Head, lights: dict[str, Lights] = LIGHTS, size: tuple[int, int] = (320, 240)) -> Iterator[LitPair]:
    """Images of a person in unseen poses and with unseen expressions."""
    for i, (name, light) in enumerate(lights.items()):
        rng = np.random.default_rng([head.seed, i, 4])
        pose, expression = random_pose(rng, size), random_expression(rng)
        lit, flat = (render(head, pose, expression, x, training_camera(), size, seed=i) for x in (light, DIFFUSE))
        yield LitPair(name, lit, flat)


# In the measures, log_rgb (h, w, 3) is the logarithm of light of the relit image, shape (n, 2) are the fitted
# landmarks, and flat is the truth.


def flat_error(model: AAM, log_rgb: np.ndarray, shape: np.ndarray, flat: Scene) -> float:
    """Root mean square error of log light against the true flat-lit image, inside the mesh, as sharp as the model.

    Both images are warped to the model's reference frame by the true landmarks, and blurred like its sharpest level.
    The truth has neither noise nor rounding, and the same exposure as in training. All channels count, at all pixels of
    the frame that lie in the fitted mesh and whose true values are neither dark nor clipped.
    """
    covered = mesh_mask(model, log_rgb, shape)
    made = np.where(covered[..., None], np.exp(log_rgb), 0.0).astype(np.float32)

    def sampled(picture: np.ndarray, encoding: str = "log") -> np.ndarray:
        return sample_appearance(picture, flat.landmarks, model.warp, encoding, "linear", model.levels[-1].blur)[0]

    truth, share = sampled(flat.linear), sampled(np.repeat(covered[..., None].astype(np.float32), 3, axis=2), "value")
    low, high = np.log(to_linear(np.array(usable_range(model.response)), model.response))
    counts = (truth > low).all(axis=1) & (truth < high).all(axis=1) & (share.min(axis=1) > 0.999)
    return root_mean_square((sampled(made) - truth)[counts])


def told(model: AAM, flat: Scene) -> np.ndarray:
    """Mask of pixels where the true flat-lit image is neither dark nor clipped in any channel, (h, w) bool."""
    stored = from_linear(np.clip(flat.linear, 0, 1), model.response)
    low, high = usable_range(model.response)
    return np.asarray(((stored > low) & (stored < high)).all(axis=2))


def pixel_error(model: AAM, log_rgb: np.ndarray, shape: np.ndarray, flat: Scene) -> float:
    """The same for each pixel of the image, including its noise."""
    counts = mesh_mask(model, log_rgb, shape) & told(model, flat)
    return root_mean_square(log_rgb[counts] - np.log(flat.linear[counts]))


def beyond_error(model: AAM, log_rgb: np.ndarray, shape: np.ndarray, flat: Scene) -> float:
    """Root mean square error of log light next to the mesh, smoothed by :data:`GRAIN`.

    It covers the region that a change of light affects (:data:`liaam.relighting.painting.REACH`), where blending that
    hides a seam could smear the image. All pixels count, including hair and walls, except dark or clipped ones of the
    true flat-lit image.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    away = np.asarray(distance_transform_edt(~mesh_mask(model, log_rgb, shape)))
    counts = (away > 0) & (away <= REACH * diagonal_of(shape)) & told(model, flat)
    truth = np.log(np.maximum(flat.linear, 1e-4))
    return root_mean_square(gaussian_filter(log_rgb - truth, (GRAIN, GRAIN, 0))[counts])


def seam(model: AAM, picture: np.ndarray, shape: np.ndarray, flat: Scene) -> float:
    """Ratio of the gradient across the mesh's border to the gradient inside the mesh.

    The gradient is the mean absolute difference of log luminance, smoothed by :data:`GRAIN`, between neighbours: one
    inside and one outside the mesh, divided by that of neighbours inside. Only neighbours with similar true flat-lit
    values in all channels count (:data:`SMOOTH`), because an edge of the object would hide a seam. An untouched image
    has about 1.
    """
    from scipy.ndimage import gaussian_filter

    inside = mesh_mask(model, picture, shape)
    made = gaussian_filter(log_light(picture, model.response).mean(axis=2), GRAIN)
    truth = gaussian_filter(np.log(np.maximum(flat.linear, 1e-4)), (GRAIN, GRAIN, 0))
    across, within = [], []
    for axis in (0, 1):
        steps, alike = np.abs(np.diff(made, axis=axis)), np.abs(np.diff(truth, axis=axis)).max(axis=2) < SMOOTH
        first, second = (np.delete(inside, which, axis=axis) for which in (-1, 0))
        across.append(steps[(first ^ second) & alike])
        within.append(steps[first & second & alike])
    return float(np.concatenate(across).mean() / np.concatenate(within).mean())


def mesh_mask(model: AAM, picture: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Mask of a shape's mesh in an image, (h, w) bool."""
    return paint(picture, shape, model, np.ones((model.n_pixels, 1), np.float32))[1]
